//! Service servers and clients.

use crate::node::Node;
use crate::qos::Qos;
use crate::{Endpoint, RuntimeError};
use futures::StreamExt;
use ros2_client::{Client, ServiceMapping, ServiceTypeName};
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tdv_msgs::RosService;
use tokio::sync::Mutex;
use tokio::time::{Instant, timeout_at};

/// How Fast DDS, the default middleware of ROS, lays services onto topics.
pub(crate) const MAPPING: ServiceMapping = ServiceMapping::Enhanced;

impl Node {
    /// Serves `S` under `name`. Requests are answered one after the other, so a long-running handler
    /// delays the next request of this service (only).
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn service<S, F, A>(&self, name: &str, mut handler: F) -> Result<(), RuntimeError>
    where
        S: RosService,
        F: FnMut(S::Request) -> A + Send + 'static,
        A: Future<Output = S::Response> + Send,
    {
        let name = self.resolve(name)?;
        let server = self.with_ros("service", &name, |ros, dds_name| {
            ros.create_server::<S::Request, S::Response>(
                MAPPING,
                dds_name,
                &ServiceTypeName::new(S::PACKAGE, S::NAME),
                Qos::services().profile(),
                Qos::services().profile(),
            )
        })?;
        let label = name.clone();
        self.spawn(&format!("service {name}"), async move {
            let mut requests = server.receive_request_stream();
            while let Some(request) = requests.next().await {
                match request {
                    Ok((id, request)) => {
                        let response = handler(request).await;
                        if let Err(error) = server.async_send_response(id, response).await {
                            tracing::warn!("service {label}: answer not sent: {error}");
                        }
                    }
                    Err(error) => {
                        tracing::warn!("service {label}: request not understood: {error}");
                    }
                }
            }
        });
        Ok(())
    }

    /// A client of `S` under `name`.
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn client<S: RosService>(&self, name: &str) -> Result<ServiceClient<S>, RuntimeError> {
        let name = self.resolve(name)?;
        let line = Mutex::new(Line { client: self.raw_client::<S>(&name)?, answered: false });
        let (created, node) = (Instant::now(), self.clone());
        Ok(ServiceClient { inner: Arc::new(Inner { line, created, name, node }) })
    }

    fn raw_client<S: RosService>(
        &self,
        name: &str,
    ) -> Result<Client<S::Request, S::Response>, RuntimeError> {
        self.with_ros("service client", name, |ros, dds_name| {
            ros.create_client::<S::Request, S::Response>(
                MAPPING,
                dds_name,
                &ServiceTypeName::new(S::PACKAGE, S::NAME),
                Qos::services().profile(),
                Qos::services().profile(),
            )
        })
    }
}

/// Why a call brought no answer.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// Nobody offers the service.
    #[error("service {0} is not available (is its node running, in the same domain?)")]
    Unavailable(String),
    /// No answer in time.
    #[error("service {name} did not answer within {seconds:.1} s")]
    Timeout {
        /// The service.
        name: String,
        /// How long was waited.
        seconds: f64,
    },
    /// The middleware refused.
    #[error("service {name}: {reason}")]
    Middleware {
        /// The service.
        name: String,
        /// What it says.
        reason: String,
    },
}

/// Calls one service. Cloning is cheap; calls through clones wait for each other.
pub struct ServiceClient<S: RosService> {
    inner: Arc<Inner<S>>,
}

impl<S: RosService> Clone for ServiceClient<S> {
    fn clone(&self) -> Self {
        Self { inner: self.inner.clone() }
    }
}

struct Inner<S: RosService> {
    /// Two calls at once on one client would take each other's answers.
    line: Mutex<Line<S>>,
    created: Instant,
    name: String,
    node: Node,
}

struct Line<S: RosService> {
    client: Client<S::Request, S::Response>,
    /// The server has discovered both of our ends: it answered once.
    answered: bool,
}

/// A server that never answered yet gets the request again after this long: its middleware may have met
/// our ends later than the request came.
const FIRST_ANSWER: Duration = Duration::from_secs(3);

impl<S: RosService> ServiceClient<S> {
    /// Name in the graph.
    pub fn name(&self) -> &str {
        &self.inner.name
    }

    /// True when someone offers the service.
    pub fn is_available(&self) -> bool {
        self.inner.node.offers_service(&self.inner.name)
    }

    /// Calls the service, waiting for it to appear first. Until it has answered this client for the
    /// first time, the request goes out again every 3 s, so it may be carried out more than once.
    ///
    /// # Errors
    /// [`CallError`]: after `patience` in all.
    pub async fn call(
        &self,
        request: S::Request,
        patience: Duration,
    ) -> Result<S::Response, CallError> {
        let Inner { line, created, name, node } = &*self.inner;
        let middleware = |e: String| CallError::Middleware { name: name.clone(), reason: e };
        let end = Instant::now() + patience;
        let late = || CallError::Timeout { name: name.clone(), seconds: patience.as_secs_f64() };
        node.wait_for_service(name, *created, end).await?;
        let mut line = timeout_at(end, line.lock()).await.map_err(|_| late())?;
        loop {
            let answer = async {
                let id = line.client.async_send_request(request.clone()).await;
                let id = id.map_err(|e| middleware(e.to_string()))?;
                let answer = line.client.async_receive_response(id).await;
                answer.map_err(|e| middleware(e.to_string()))
            };
            let again = if line.answered { end } else { end.min(Instant::now() + FIRST_ANSWER) };
            if let Ok(result) = timeout_at(again, answer).await {
                line.answered |= result.is_ok();
                return result;
            }
            if Instant::now() >= end {
                return Err(late());
            }
            tracing::debug!("service {name}: no answer yet, asking again");
        }
    }
}

/// Between the moment when both sides are there and the first call: the other side has to discover us
/// too, or it would neither take the request nor send its answer to us.
const SETTLE: Duration = Duration::from_millis(400);

impl Node {
    /// True when request and answer topics of the service have another end.
    pub(crate) fn offers_service(&self, name: &str) -> bool {
        let request = format!("rq{name}Request");
        let reply = format!("rr{name}Reply");
        let endpoints = self.endpoints();
        let has = |topic: &str, writer: bool| {
            endpoints.iter().any(|e: &Endpoint| e.dds_name == topic && e.writer == writer)
        };
        has(&request, false) && has(&reply, true)
    }

    /// Waits for a service that is called through ends made at `created`.
    pub(crate) async fn wait_for_service(
        &self,
        name: &str,
        created: Instant,
        end: Instant,
    ) -> Result<(), CallError> {
        let mut settled = created + SETTLE;
        while !self.offers_service(name) {
            if Instant::now() >= end {
                return Err(CallError::Unavailable(name.into()));
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
            settled = Instant::now() + SETTLE;
        }
        tokio::time::sleep_until(settled.min(end)).await;
        Ok(())
    }
}
