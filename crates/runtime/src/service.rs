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
use tokio::time::{Instant, timeout};

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
        let client = self.with_ros("service client", &name, |ros, dds_name| {
            ros.create_client::<S::Request, S::Response>(
                MAPPING,
                dds_name,
                &ServiceTypeName::new(S::PACKAGE, S::NAME),
                Qos::services().profile(),
                Qos::services().profile(),
            )
        })?;
        Ok(ServiceClient {
            inner: Arc::new(Inner { client: Mutex::new(client), name, node: self.clone() }),
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
    client: Mutex<Client<S::Request, S::Response>>,
    name: String,
    node: Node,
}

impl<S: RosService> ServiceClient<S> {
    /// Name in the graph.
    pub fn name(&self) -> &str {
        &self.inner.name
    }

    /// True when someone offers the service.
    pub fn is_available(&self) -> bool {
        self.inner.node.offers_service(&self.inner.name)
    }

    /// Calls the service, waiting for it to appear first.
    ///
    /// # Errors
    /// [`CallError`]: after `patience` in all.
    pub async fn call(
        &self,
        request: S::Request,
        patience: Duration,
    ) -> Result<S::Response, CallError> {
        let name = || self.inner.name.clone();
        let middleware =
            |e: String| CallError::Middleware { name: self.inner.name.clone(), reason: e };
        let end = Instant::now() + patience;
        self.inner.node.wait_for_service(&self.inner.name, end).await?;
        let answer = async {
            let client = self.inner.client.lock().await;
            let id =
                client.async_send_request(request).await.map_err(|e| middleware(e.to_string()))?;
            client.async_receive_response(id).await.map_err(|e| middleware(e.to_string()))
        };
        let left = end.saturating_duration_since(Instant::now());
        match timeout(left, answer).await {
            Ok(result) => result,
            Err(_) => Err(CallError::Timeout { name: name(), seconds: patience.as_secs_f64() }),
        }
    }
}

/// Between the discovery of a service and the first call: the other side has to discover us too, or
/// it would not send its answer to us.
const SETTLE: Duration = Duration::from_millis(100);

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

    pub(crate) async fn wait_for_service(&self, name: &str, end: Instant) -> Result<(), CallError> {
        if self.offers_service(name) {
            return Ok(());
        }
        loop {
            if Instant::now() >= end {
                return Err(CallError::Unavailable(name.into()));
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
            if self.offers_service(name) {
                tokio::time::sleep(SETTLE).await;
                return Ok(());
            }
        }
    }
}
