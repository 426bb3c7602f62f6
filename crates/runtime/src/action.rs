//! Action servers: one goal at a time, a new goal takes over from the old one.

use crate::RuntimeError;
use crate::node::Node;
use crate::qos::Qos;
use crate::service::MAPPING;
use futures::Stream;
use ros2_client::action::{
    ActionServerQosPolicies, GetResultRequest, GetResultResponse, GoalId, GoalStatusEnum,
    SendGoalRequest, SendGoalResponse,
};
use ros2_client::action_msgs::{
    CancelGoalRequest, CancelGoalResponse, CancelGoalResponseEnum, GoalInfo, GoalStatus,
    GoalStatusArray,
};
use ros2_client::builtin_interfaces::Time;
use ros2_client::{ActionServer, ActionTypeName, ReadResult, RmwRequestId};
use std::collections::BTreeMap;
use std::future::{Future, poll_fn};
use std::pin::pin;
use std::task::{Context, Poll};
use tdv_msgs::RosAction;
use tokio::sync::{mpsc, watch};

/// How a goal ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalEnd {
    /// Reached.
    Succeeded,
    /// Given up, or taken over by a newer goal.
    Aborted,
    /// Given up because the client asked for it.
    Canceled,
}

/// A goal under execution, in the hands of the handler.
pub struct Goal<A: RosAction> {
    /// What the client wants.
    pub goal: A::Goal,
    id: GoalId,
    cancel: watch::Receiver<Wish>,
    to_server: mpsc::UnboundedSender<Event<A>>,
}

impl<A: RosAction> Goal<A> {
    /// Tells the client how it goes.
    pub fn feedback(&self, feedback: A::Feedback) {
        // The server task outlives its goals unless the node ends.
        let _ = self.to_server.send(Event::Feedback(self.id, feedback));
    }

    /// True once the client cancelled or a newer goal took over: stop and return.
    pub fn is_canceled(&self) -> bool {
        *self.cancel.borrow() != Wish::Go
    }

    /// True when it is a newer goal that ended this one, not the client.
    pub fn is_replaced(&self) -> bool {
        *self.cancel.borrow() == Wish::GiveWay
    }

    /// Waits until [`Goal::is_canceled`].
    pub async fn canceled(&mut self) {
        if self.cancel.wait_for(|w| *w != Wish::Go).await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}

/// What becomes of a goal that is carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wish {
    Go,
    /// A newer goal has taken over.
    GiveWay,
    /// The client takes it back.
    Cancel,
}

enum Event<A: RosAction> {
    Goal(RmwRequestId, SendGoalRequest<A::Goal>),
    Cancel(RmwRequestId, CancelGoalRequest),
    Result(RmwRequestId, GetResultRequest),
    Feedback(GoalId, A::Feedback),
    Finished(GoalId, GoalEnd, A::Result),
    Unreadable(String),
}

struct Record<R> {
    status: GoalStatusEnum,
    accepted: Time,
    cancel: watch::Sender<Wish>,
    canceled_by_client: bool,
    result: Option<R>,
    waiting: Vec<RmwRequestId>,
    /// Order of acceptance: the oldest finished goals are forgotten first.
    number: u64,
}

impl<R> Record<R> {
    fn is_active(&self) -> bool {
        self.result.is_none()
    }
}

/// Finished goals whose results can still be asked for.
const KEEP_FINISHED: usize = 16;

struct Server<A: RosAction> {
    inner: ActionServer<A::Goal, A::Result, A::Feedback>,
    goals: BTreeMap<GoalId, Record<A::Result>>,
    accepted: u64,
    name: String,
}

impl Node {
    /// Serves the action `A` under `name`. `accept` judges a goal at once (an error is the reason for
    /// the log); `handler` carries it out, should watch [`Goal::canceled`] and must return in finite
    /// time. A newer accepted goal cancels the one before.
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn action_server<A, C, F, B>(
        &self,
        name: &str,
        mut accept: C,
        mut handler: F,
    ) -> Result<(), RuntimeError>
    where
        A: RosAction,
        C: FnMut(&A::Goal) -> Result<(), String> + Send + 'static,
        F: FnMut(Goal<A>) -> B + Send + 'static,
        B: Future<Output = (GoalEnd, A::Result)> + Send + 'static,
    {
        let name = self.resolve(name)?;
        let services = || Qos::services().profile();
        let inner = self.with_ros("action", &name, |ros, dds_name| {
            ros.create_action_server::<A::Goal, A::Result, A::Feedback>(
                MAPPING,
                dds_name,
                &ActionTypeName::new(A::PACKAGE, A::NAME),
                ActionServerQosPolicies {
                    goal_service: services(),
                    result_service: services(),
                    cancel_service: services(),
                    feedback_publisher: Qos::reliable(10).profile(),
                    status_publisher: Qos::latched().profile(),
                },
            )
        })?;
        let mut server =
            Server::<A> { inner, goals: BTreeMap::new(), accepted: 0, name: name.clone() };
        let node = self.clone();
        let (to_server, mut from_handlers) = mpsc::unbounded_channel();
        self.spawn(&format!("action {name}"), async move {
            loop {
                let event = poll_fn(|cx| server.poll(cx, &mut from_handlers)).await;
                if let Some((id, goal, cancel)) = server.handle(event, &mut accept) {
                    let work = handler(Goal { goal, id, cancel, to_server: to_server.clone() });
                    let done = to_server.clone();
                    node.spawn(&format!("goal of {name}"), async move {
                        let (end, result) = work.await;
                        let _ = done.send(Event::Finished(id, end, result));
                    });
                }
            }
        });
        Ok(())
    }
}

/// The next item of a stream that is made anew for each look. The reader behind it keeps the waker.
fn look<T>(
    stream: impl Stream<Item = ReadResult<T>>,
    cx: &mut Context<'_>,
) -> Poll<Result<T, String>> {
    match pin!(stream).poll_next(cx) {
        Poll::Ready(Some(item)) => Poll::Ready(item.map_err(|e| e.to_string())),
        Poll::Ready(None) | Poll::Pending => Poll::Pending,
    }
}

type NewGoal<A> = (GoalId, <A as RosAction>::Goal, watch::Receiver<Wish>);

impl<A: RosAction> Server<A> {
    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        from_handlers: &mut mpsc::UnboundedReceiver<Event<A>>,
    ) -> Poll<Event<A>> {
        // What handlers report comes first, so that a result is there before it is asked for.
        if let Poll::Ready(Some(event)) = from_handlers.poll_recv(cx) {
            return Poll::Ready(event);
        }
        if let Poll::Ready(item) = look(self.inner.cancel_server().receive_request_stream(), cx) {
            return Poll::Ready(
                item.map_or_else(Event::Unreadable, |(id, r)| Event::Cancel(id, r)),
            );
        }
        if let Poll::Ready(item) = look(self.inner.goal_server().receive_request_stream(), cx) {
            return Poll::Ready(item.map_or_else(Event::Unreadable, |(id, r)| Event::Goal(id, r)));
        }
        if let Poll::Ready(item) = look(self.inner.result_server().receive_request_stream(), cx) {
            return Poll::Ready(
                item.map_or_else(Event::Unreadable, |(id, r)| Event::Result(id, r)),
            );
        }
        Poll::Pending
    }

    fn handle(
        &mut self,
        event: Event<A>,
        accept: &mut impl FnMut(&A::Goal) -> Result<(), String>,
    ) -> Option<NewGoal<A>> {
        match event {
            Event::Goal(request, goal) => return self.new_goal(request, goal, accept),
            Event::Cancel(request, cancel) => self.cancel(request, &cancel),
            Event::Result(request, GetResultRequest { goal_id }) => {
                match self.goals.get_mut(&goal_id) {
                    Some(record) if record.is_active() => record.waiting.push(request),
                    Some(record) => {
                        let result = record.result.clone().unwrap_or_default();
                        let status = record.status;
                        self.answer(request, status, result);
                    }
                    None => {
                        self.answer(request, GoalStatusEnum::Unknown, A::Result::default());
                    }
                }
            }
            Event::Feedback(goal, feedback) => {
                if let Err(error) = self.inner.send_feedback(goal, feedback) {
                    tracing::debug!("action {}: feedback not sent: {error}", self.name);
                }
            }
            Event::Finished(goal, end, result) => self.finish(goal, end, result),
            Event::Unreadable(error) => {
                tracing::warn!("action {}: request not understood: {error}", self.name);
            }
        }
        None
    }

    fn new_goal(
        &mut self,
        request: RmwRequestId,
        goal: SendGoalRequest<A::Goal>,
        accept: &mut impl FnMut(&A::Goal) -> Result<(), String>,
    ) -> Option<NewGoal<A>> {
        let verdict = if self.goals.contains_key(&goal.goal_id) {
            Err("its id is in use".to_string())
        } else {
            accept(&goal.goal)
        };
        let stamp = Time::now();
        let accepted = verdict.is_ok();
        if let Err(why) = verdict {
            tracing::warn!("action {}: goal rejected: {why}", self.name);
        }
        let mut out = None;
        if accepted {
            for record in self.goals.values().filter(|r| r.is_active() && !r.canceled_by_client) {
                record.cancel.send_replace(Wish::GiveWay);
            }
            let (cancel, canceled) = watch::channel(Wish::Go);
            self.accepted += 1;
            self.goals.insert(
                goal.goal_id,
                Record {
                    status: GoalStatusEnum::Executing,
                    accepted: stamp,
                    cancel,
                    canceled_by_client: false,
                    result: None,
                    waiting: Vec::new(),
                    number: self.accepted,
                },
            );
            out = Some((goal.goal_id, goal.goal, canceled));
        }
        if let Err(error) =
            self.inner.send_goal_response(request, SendGoalResponse { accepted, stamp })
        {
            tracing::warn!("action {}: answer not sent: {error}", self.name);
        }
        self.publish_status();
        out
    }

    fn cancel(&mut self, request: RmwRequestId, cancel: &CancelGoalRequest) {
        // The fields of the request are private; its encoded form is public knowledge.
        let wanted: tdv_msgs::action_msgs::srv::CancelGoalRequest = tdv_msgs::to_cdr_bytes(cancel)
            .and_then(|bytes| tdv_msgs::from_cdr_bytes(&bytes))
            .unwrap_or_default();
        let id = wanted.goal_info.goal_id.uuid;
        let stamp = &wanted.goal_info.stamp;
        let before = i64::from(stamp.sec) * 1_000_000_000 + i64::from(stamp.nanosec);
        let everything = id == [0; 16] && before == 0;
        let mut goals_canceling = Vec::new();
        let mut known = false;
        for (goal_id, record) in &mut self.goals {
            let named = *goal_id.uuid.as_bytes() == id;
            known |= named;
            let older = before != 0 && record.accepted.to_nanos() <= before;
            if (everything || named || older) && record.is_active() {
                record.status = GoalStatusEnum::Canceling;
                record.canceled_by_client = true;
                record.cancel.send_replace(Wish::Cancel);
                goals_canceling.push(GoalInfo { goal_id: *goal_id, stamp: record.accepted });
            }
        }
        let return_code = match (goals_canceling.is_empty(), id == [0; 16], known) {
            (false, _, _) => CancelGoalResponseEnum::None,
            (true, false, false) => CancelGoalResponseEnum::UnknownGoal,
            (true, false, true) => CancelGoalResponseEnum::GoalTerminated,
            (true, true, _) => CancelGoalResponseEnum::Rejected,
        };
        let response = CancelGoalResponse { return_code, goals_canceling };
        if let Err(error) = self.inner.send_cancel_response(request, response) {
            tracing::warn!("action {}: answer not sent: {error}", self.name);
        }
        self.publish_status();
    }

    fn finish(&mut self, goal: GoalId, end: GoalEnd, result: A::Result) {
        let Some(record) = self.goals.get_mut(&goal) else { return };
        record.status = match end {
            GoalEnd::Succeeded => GoalStatusEnum::Succeeded,
            // A goal that only a newer one replaced was not canceled in the sense of ROS.
            GoalEnd::Canceled if record.canceled_by_client => GoalStatusEnum::Canceled,
            GoalEnd::Canceled | GoalEnd::Aborted => GoalStatusEnum::Aborted,
        };
        record.result = Some(result.clone());
        let (status, waiting) = (record.status, std::mem::take(&mut record.waiting));
        for request in waiting {
            self.answer(request, status, result.clone());
        }
        self.publish_status();
        while self.goals.values().filter(|r| !r.is_active()).count() > KEEP_FINISHED {
            let oldest = self.goals.iter().filter(|(_, r)| !r.is_active());
            let Some(id) = oldest.min_by_key(|(_, r)| r.number).map(|(id, _)| *id) else { break };
            self.goals.remove(&id);
        }
    }

    fn answer(&self, request: RmwRequestId, status: GoalStatusEnum, result: A::Result) {
        let response = GetResultResponse { status, result };
        if let Err(error) = self.inner.send_result(request, response) {
            tracing::warn!("action {}: result not sent: {error}", self.name);
        }
    }

    fn publish_status(&self) {
        let status_list = self.goals.iter().map(|(goal_id, record)| GoalStatus {
            goal_info: GoalInfo { goal_id: *goal_id, stamp: record.accepted },
            status: record.status,
        });
        let message = GoalStatusArray { status_list: status_list.collect() };
        if let Err(error) = self.inner.send_goal_statuses(message) {
            tracing::debug!("action {}: status not sent: {error}", self.name);
        }
    }
}
