//! The node: what programs use to take part in the graph.

use crate::clock::Clock;
use crate::diagnostics::{Diagnostics, TopicCounters};
use crate::farewell;
use crate::inbox::{Inbox, inbox};
use crate::names::Resolver;
use crate::qos::Qos;
use crate::shutdown::Shutdown;
use crate::topics::{Publisher, into_inbox, pump};
use crate::{Environment, RuntimeError};
use ros2_client::dds::rustdds::RTPSEntity as _;
use ros2_client::{Context, Message, MessageTypeName, Name, NodeName, NodeOptions};
use std::future::Future;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use tdv_geometry::Stamp;
use tdv_msgs::{RawMessage, RosMessage};
use tokio::task::AbortHandle;

/// A node in the graph. Cloning is cheap; all clones are the same node.
///
/// Topic and service names are taken as in ROS: `/absolute`, `relative` to the namespace, or
/// `~/private` to the node, then remapped by the command line. Tasks of subscriptions and services
/// run on tokio; keep callbacks short, and do heavy work on a thread fed from an [`Inbox`].
#[derive(Clone)]
pub struct Node {
    pub(crate) shared: Arc<Shared>,
}

pub(crate) struct Shared {
    /// Taken at shutdown.
    ros: Mutex<Option<(ros2_client::Node, Context)>>,
    resolver: Resolver,
    clock: Clock,
    diagnostics: Diagnostics,
    shutdown: Shutdown,
    environment: Environment,
    tasks: Mutex<Vec<AbortHandle>>,
}

impl Node {
    /// Joins the graph. [`crate::run`] does this for you.
    ///
    /// # Errors
    /// [`RuntimeError`] when the domain cannot be joined or the name is bad.
    pub fn new(
        resolver: Resolver,
        environment: Environment,
        use_sim_time: bool,
    ) -> Result<Self, RuntimeError> {
        let context = environment.join()?;
        let create = |reason: String| RuntimeError::Create {
            what: "node",
            name: resolver.fully_qualified(),
            reason,
        };
        let name = NodeName::new(resolver.namespace(), resolver.node())
            .map_err(|e| create(e.to_string()))?;
        // Log and parameter topics are served by this crate.
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let ros = context.new_node(name, options).map_err(|e| create(e.to_string()))?;
        let shared = Shared {
            ros: Mutex::new(Some((ros, context))),
            resolver,
            clock: if use_sim_time { Clock::simulated() } else { Clock::system() },
            diagnostics: Diagnostics::default(),
            shutdown: Shutdown::default(),
            environment,
            tasks: Mutex::new(Vec::new()),
        };
        let node = Self { shared: Arc::new(shared) };
        if use_sim_time {
            let clock = node.clock().clone();
            node.subscribe("/clock", Qos::best_effort(1), {
                move |m: tdv_msgs::rosgraph_msgs::msg::Clock| {
                    clock.set(Stamp::from_ros(m.clock.sec, m.clock.nanosec));
                }
            })?;
        }
        Ok(node)
    }

    /// Name without namespace.
    pub fn name(&self) -> &str {
        self.shared.resolver.node()
    }

    /// Name with namespace, e.g. `/pose_tracker`.
    pub fn fully_qualified_name(&self) -> String {
        self.shared.resolver.fully_qualified()
    }

    /// The name in the graph of a topic, service or action.
    ///
    /// # Errors
    /// [`RuntimeError::Name`].
    pub fn resolve(&self, name: &str) -> Result<String, RuntimeError> {
        Ok(self.shared.resolver.resolve(name)?)
    }

    /// The graph's clock.
    pub fn clock(&self) -> &Clock {
        &self.shared.clock
    }

    /// The time now by the graph's clock.
    pub fn now(&self) -> Stamp {
        self.shared.clock.now()
    }

    /// What goes out on `/diagnostics`.
    pub fn diagnostics(&self) -> &Diagnostics {
        &self.shared.diagnostics
    }

    /// Asks for, or waits for, the end of the node.
    pub fn shutdown(&self) -> &Shutdown {
        &self.shared.shutdown
    }

    /// Starts a task that ends with the node. A panic in it ends the node with exit code 1. Call
    /// only within the tokio runtime, as the body of [`crate::run`] is.
    pub fn spawn(&self, what: &str, task: impl Future<Output = ()> + Send + 'static) {
        let handle = tokio::spawn(task);
        let mut tasks = lock(&self.shared.tasks);
        tasks.retain(|t| !t.is_finished());
        tasks.push(handle.abort_handle());
        let shutdown = self.shared.shutdown.clone();
        let what = what.to_string();
        tokio::spawn(async move {
            if let Err(error) = handle.await
                && error.is_panic()
            {
                shutdown.fail(format!("the task \"{what}\" panicked"));
            }
        });
    }

    /// A publisher.
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn publisher<M: RosMessage>(
        &self,
        topic: &str,
        qos: Qos,
    ) -> Result<Publisher<M>, RuntimeError> {
        self.any_publisher(topic, MessageTypeName::new(M::PACKAGE, M::NAME), qos)
    }

    /// A publisher of encoded messages of the type `full_name`, e.g. `sensor_msgs/msg/Image`.
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn raw_publisher(
        &self,
        topic: &str,
        full_name: &str,
        qos: Qos,
    ) -> Result<Publisher<RawMessage>, RuntimeError> {
        self.any_publisher(topic, type_name("publisher", topic, full_name)?, qos)
    }

    /// A subscription that calls `callback` for each message, on a task of its own.
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn subscribe<M: RosMessage>(
        &self,
        topic: &str,
        qos: Qos,
        callback: impl FnMut(M) + Send + 'static,
    ) -> Result<(), RuntimeError> {
        let type_name = MessageTypeName::new(M::PACKAGE, M::NAME);
        self.any_subscription(topic, type_name, qos, |_| callback)
    }

    /// A subscription whose reader always gets the newest message; older unread ones are dropped and
    /// counted.
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn newest<M: RosMessage>(&self, topic: &str, qos: Qos) -> Result<Inbox<M>, RuntimeError> {
        self.queue(topic, qos, 1)
    }

    /// A subscription into a queue of `capacity` messages; the oldest gives way and is counted.
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn queue<M: RosMessage>(
        &self,
        topic: &str,
        qos: Qos,
        capacity: usize,
    ) -> Result<Inbox<M>, RuntimeError> {
        self.any_queue(topic, MessageTypeName::new(M::PACKAGE, M::NAME), qos, capacity)
    }

    /// Like [`Node::queue`], without decoding.
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn raw_queue(
        &self,
        topic: &str,
        full_name: &str,
        qos: Qos,
        capacity: usize,
    ) -> Result<Inbox<RawMessage>, RuntimeError> {
        self.any_queue(topic, type_name("subscription", topic, full_name)?, qos, capacity)
    }

    fn any_publisher<M: Message>(
        &self,
        topic: &str,
        type_name: MessageTypeName,
        qos: Qos,
    ) -> Result<Publisher<M>, RuntimeError> {
        let name = self.resolve(topic)?;
        let inner = self.with_ros("publisher", &name, |ros, dds_name| {
            let topic = ros.create_topic(dds_name, type_name, &qos.profile())?;
            ros.create_publisher(&topic, Some(qos.profile()))
        })?;
        let counters = TopicCounters::new(&name, false);
        self.diagnostics().add_topic(counters.clone());
        Ok(Publisher { inner, counters })
    }

    fn any_subscription<M, F>(
        &self,
        topic: &str,
        type_name: MessageTypeName,
        qos: Qos,
        deliver: impl FnOnce(Arc<TopicCounters>) -> F,
    ) -> Result<(), RuntimeError>
    where
        M: Message + Send + Sync + 'static,
        F: FnMut(M) + Send + 'static,
    {
        let name = self.resolve(topic)?;
        let subscription = self.with_ros("subscription", &name, |ros, dds_name| {
            let topic = ros.create_topic(dds_name, type_name, &qos.profile())?;
            ros.create_subscription::<M>(&topic, Some(qos.profile()))
        })?;
        let counters = TopicCounters::new(&name, true);
        self.diagnostics().add_topic(counters.clone());
        let deliver = deliver(counters.clone());
        self.spawn(&format!("subscription {name}"), pump(subscription, counters, deliver));
        Ok(())
    }

    fn any_queue<M: Message + Send + Sync + 'static>(
        &self,
        topic: &str,
        type_name: MessageTypeName,
        qos: Qos,
        capacity: usize,
    ) -> Result<Inbox<M>, RuntimeError> {
        let (sender, receiver) = inbox(capacity);
        self.any_subscription(topic, type_name, qos, |counters| into_inbox(sender, counters))?;
        Ok(receiver)
    }

    /// Runs `make` on the middleware's node; `name` is absolute.
    pub(crate) fn with_ros<T, E: std::fmt::Display>(
        &self,
        what: &'static str,
        name: &str,
        make: impl FnOnce(&mut ros2_client::Node, &Name) -> Result<T, E>,
    ) -> Result<T, RuntimeError> {
        let create = |reason: String| RuntimeError::Create { what, name: name.to_string(), reason };
        let dds_name = Name::parse(name).map_err(|e| create(e.to_string()))?;
        match &mut *lock(&self.shared.ros) {
            Some((ros, _)) => make(ros, &dds_name).map_err(|e| create(e.to_string())),
            None => Err(RuntimeError::Gone { what, name: name.to_string() }),
        }
    }

    /// The middleware's context, until the node has left.
    pub(crate) fn context(&self) -> Option<Context> {
        lock(&self.shared.ros).as_ref().map(|(_, context)| context.clone())
    }

    /// Ends all tasks and leaves the graph; takes about 0.2 s. Publishers that are still held somewhere
    /// keep the participant (but not the node) in the graph until they are dropped.
    pub fn leave(&self) {
        for task in lock(&self.shared.tasks).drain(..) {
            task.abort();
        }
        // The other participants learn about each end that goes, and about the node, only while the
        // middleware's own threads still run. Without these waits they would keep dead ends in their
        // lists until the lease has run out, the better part of a minute.
        std::thread::sleep(FAREWELL);
        let taken = lock(&self.shared.ros).take();
        if let Some((ros, context)) = taken {
            let guid = context.domain_participant().guid();
            let mut key = [0_u8; 16];
            key[..12].copy_from_slice(guid.prefix.as_ref());
            key[12..].copy_from_slice(&PARTICIPANT_ENTITY);
            drop(ros);
            std::thread::sleep(FAREWELL);
            drop(context);
            farewell::say(self.shared.environment, &key);
        }
    }
}

/// Entity id of every RTPS participant.
const PARTICIPANT_ENTITY: [u8; 4] = [0, 0, 1, 0xc1];
/// Time for the last messages to go out.
const FAREWELL: Duration = Duration::from_millis(100);

fn type_name(
    what: &'static str,
    topic: &str,
    full_name: &str,
) -> Result<MessageTypeName, RuntimeError> {
    match full_name.split('/').collect::<Vec<_>>()[..] {
        [package, "msg", name] | [package, name] if !package.is_empty() && !name.is_empty() => {
            Ok(MessageTypeName::new(package, name))
        }
        _ => Err(RuntimeError::Create {
            what,
            name: topic.into(),
            reason: format!("{full_name:?} is not a message type such as sensor_msgs/msg/Image"),
        }),
    }
}

/// A panic cannot leave these values half-written: every change under the lock is one assignment.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}
