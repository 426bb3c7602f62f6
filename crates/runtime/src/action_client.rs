//! Action clients.

use crate::action::GoalEnd;
use crate::node::Node;
use crate::qos::Qos;
use crate::service::MAPPING;
use crate::{CallError, RuntimeError};
use ros2_client::action::{ActionClientQosPolicies, GoalId, GoalStatusEnum};
use ros2_client::builtin_interfaces::Time;
use ros2_client::{ActionClient as RosClient, ActionTypeName};
use std::fmt::Display;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tdv_msgs::RosAction;
use tokio::sync::Mutex;
use tokio::time::{Instant, timeout};

/// Why a goal brought no result.
#[derive(Debug, thiserror::Error)]
pub enum ActionError {
    /// The server is not there, too slow, or the middleware refused.
    #[error(transparent)]
    Call(#[from] CallError),
    /// The server does not want the goal.
    #[error("action {0} rejected the goal")]
    Rejected(String),
    /// The server has forgotten the goal, for example because it was restarted.
    #[error("action {0} does not know the goal (was its server restarted?)")]
    Unknown(String),
}

/// A goal that a server has accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GoalTicket(GoalId);

/// Sends goals to one action server. Cloning is cheap. One wait for a result at a time: a second one
/// waits for the first to end, and dropping a wait gives way.
pub struct ActionClient<A: RosAction> {
    inner: Arc<Inner<A>>,
}

impl<A: RosAction> Clone for ActionClient<A> {
    fn clone(&self) -> Self {
        Self { inner: self.inner.clone() }
    }
}

struct Inner<A: RosAction> {
    client: RosClient<A::Goal, A::Result, A::Feedback>,
    /// Two waits at once on one service would take each other's answers.
    goal_turn: Mutex<()>,
    result_turn: Mutex<()>,
    cancel_turn: Mutex<()>,
    created: Instant,
    name: String,
    node: Node,
}

impl Node {
    /// A client of the action `A` under `name`.
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn action_client<A: RosAction>(&self, name: &str) -> Result<ActionClient<A>, RuntimeError> {
        let name = self.resolve(name)?;
        let services = || Qos::services().profile();
        let client = self.with_ros("action client", &name, |ros, dds_name| {
            ros.create_action_client::<A::Goal, A::Result, A::Feedback>(
                MAPPING,
                dds_name,
                &ActionTypeName::new(A::PACKAGE, A::NAME),
                ActionClientQosPolicies {
                    goal_service: services(),
                    result_service: services(),
                    cancel_service: services(),
                    feedback_subscription: Qos::reliable(10).profile(),
                    status_subscription: Qos::latched().profile(),
                },
            )
        })?;
        Ok(ActionClient {
            inner: Arc::new(Inner {
                client,
                goal_turn: Mutex::default(),
                result_turn: Mutex::default(),
                cancel_turn: Mutex::default(),
                created: Instant::now(),
                name,
                node: self.clone(),
            }),
        })
    }
}

impl<A: RosAction> ActionClient<A> {
    /// Name in the graph.
    pub fn name(&self) -> &str {
        &self.inner.name
    }

    /// True when someone serves the action.
    pub fn is_available(&self) -> bool {
        let services = ["send_goal", "get_result"];
        services.iter().all(|s| self.inner.node.offers_service(&self.service(s)))
    }

    /// Sends a goal, waiting for the server to appear first.
    ///
    /// # Errors
    /// [`ActionError`]: not accepted within `patience`.
    pub async fn send(&self, goal: A::Goal, patience: Duration) -> Result<GoalTicket, ActionError> {
        let end = Instant::now() + patience;
        for service in ["send_goal", "get_result"] {
            self.inner
                .node
                .wait_for_service(&self.service(service), self.inner.created, end)
                .await
                .map_err(|_| CallError::Unavailable(self.inner.name.clone()))?;
        }
        let left = end.saturating_duration_since(Instant::now());
        let call = async {
            let _turn = self.inner.goal_turn.lock().await;
            self.inner.client.async_send_goal(goal).await
        };
        let (id, response) = self.within(left, call).await?;
        if response.accepted {
            Ok(GoalTicket(id))
        } else {
            Err(ActionError::Rejected(self.inner.name.clone()))
        }
    }

    /// Waits for the end of a goal. Ask soon after sending it: servers forget old results.
    ///
    /// # Errors
    /// [`ActionError`]: no result within `patience`.
    pub async fn result(
        &self,
        ticket: GoalTicket,
        patience: Duration,
    ) -> Result<(GoalEnd, A::Result), ActionError> {
        let call = async {
            let _turn = self.inner.result_turn.lock().await;
            self.inner.client.async_request_result(ticket.0).await
        };
        let (status, result) = self.within(patience, call).await?;
        let end = match status {
            GoalStatusEnum::Succeeded => GoalEnd::Succeeded,
            GoalStatusEnum::Canceled => GoalEnd::Canceled,
            GoalStatusEnum::Unknown => return Err(ActionError::Unknown(self.inner.name.clone())),
            _ => GoalEnd::Aborted,
        };
        Ok((end, result))
    }

    /// [`ActionClient::send`], then [`ActionClient::result`], both within `patience`.
    ///
    /// # Errors
    /// [`ActionError`].
    pub async fn run(
        &self,
        goal: A::Goal,
        patience: Duration,
    ) -> Result<(GoalEnd, A::Result), ActionError> {
        let end = Instant::now() + patience;
        let ticket = self.send(goal, patience).await?;
        self.result(ticket, end.saturating_duration_since(Instant::now())).await
    }

    /// Asks the server to stop; true when it will.
    ///
    /// # Errors
    /// [`ActionError`].
    pub async fn cancel(
        &self,
        ticket: GoalTicket,
        patience: Duration,
    ) -> Result<bool, ActionError> {
        let call = async {
            let _turn = self.inner.cancel_turn.lock().await;
            self.inner.client.async_cancel_goal(ticket.0, Time::ZERO).await
        };
        Ok(!self.within(patience, call).await?.goals_canceling.is_empty())
    }

    /// The oldest unread feedback on the goal; feedback on other goals is skipped.
    pub fn feedback(&self, ticket: GoalTicket) -> Option<A::Feedback> {
        self.inner.client.receive_feedback(ticket.0).ok().flatten()
    }

    fn service(&self, part: &str) -> String {
        format!("{}/_action/{part}", self.inner.name)
    }

    async fn within<T, E: Display>(
        &self,
        patience: Duration,
        call: impl Future<Output = Result<T, E>>,
    ) -> Result<T, CallError> {
        let name = || self.inner.name.clone();
        match timeout(patience, call).await {
            Ok(Ok(value)) => Ok(value),
            Ok(Err(error)) => {
                Err(CallError::Middleware { name: name(), reason: error.to_string() })
            }
            Err(_) => Err(CallError::Timeout { name: name(), seconds: patience.as_secs_f64() }),
        }
    }
}
