//! The gripper: one thread that polls the state and carries out requests.

use crate::gripper_link::{GripperAddress, GripperLink};
use anyhow::bail;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};
use tdv_runtime::Node;
use tdv_ur_protocol::gripper::ObjectStatus;

/// Time between two looks at the gripper.
const PERIOD: Duration = Duration::from_millis(30);
/// Time for an activation.
const ACTIVATION: Duration = Duration::from_secs(10);

/// One state of the gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GripperState {
    /// Measured position register.
    pub position: u8,
    /// Requested position as the gripper has understood it.
    pub requested: u8,
    pub object: ObjectStatus,
    pub fault: u8,
    /// Number of the last request that was carried over.
    pub request: u32,
}

/// A position to go to, in registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Move {
    pub number: u32,
    pub position: u8,
    pub speed: u8,
    pub force: u8,
}

/// What the gripper is to do.
pub enum GripperOrder {
    Move(Move),
    /// Resets and activates; the fingers move fully open and closed.
    Reactivate(tokio::sync::oneshot::Sender<Result<(), String>>),
}

/// What happened, for the ROS side.
pub enum GripperEvent {
    Ready,
    State(GripperState),
    Lost(String),
}

/// Connects again and again until the node ends.
pub fn run(
    node: &Node,
    address: &GripperAddress,
    orders: &Receiver<GripperOrder>,
    mut report: impl FnMut(GripperEvent),
) {
    let mut pause = Duration::from_millis(250);
    while !node.shutdown().is_requested() {
        let outcome = session(node, address, orders, &mut |event| {
            if matches!(event, GripperEvent::Ready) {
                pause = Duration::from_millis(250);
            }
            report(event);
        });
        if let Err(error) = outcome {
            report(GripperEvent::Lost(format!("gripper at {address}: {error:#}")));
        }
        if !node.shutdown().is_requested() {
            std::thread::sleep(pause);
        }
        pause = (pause * 2).min(Duration::from_secs(4));
    }
}

fn activate(node: &Node, link: &mut GripperLink) -> anyhow::Result<()> {
    link.activate(false)?;
    wait_for(node, link, 0)?;
    link.activate(true)?;
    wait_for(node, link, 3)
}

fn wait_for(node: &Node, link: &mut GripperLink, status: u8) -> anyhow::Result<()> {
    let end = Instant::now() + ACTIVATION;
    while link.status()? != status {
        if Instant::now() > end || node.shutdown().is_requested() {
            bail!("activation did not come to status {status}");
        }
        std::thread::sleep(PERIOD);
    }
    Ok(())
}

fn session(
    node: &Node,
    address: &GripperAddress,
    orders: &Receiver<GripperOrder>,
    report: &mut impl FnMut(GripperEvent),
) -> anyhow::Result<()> {
    let mut link = GripperLink::open(address)?;
    if link.status()? != 3 {
        activate(node, &mut link)?;
    }
    // What was ordered while nobody was there has been reported as aborted.
    while orders.try_recv().is_ok() {}
    report(GripperEvent::Ready);
    let mut request = 0;
    while !node.shutdown().is_requested() {
        let first = match orders.recv_timeout(PERIOD) {
            Ok(first) => Some(first),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        };
        // Only the newest move counts.
        let mut newest = None;
        for order in first.into_iter().chain(orders.try_iter()) {
            match order {
                GripperOrder::Move(m) => newest = Some(m),
                GripperOrder::Reactivate(answer) => {
                    newest = None;
                    let done = activate(node, &mut link);
                    // Nobody waits any more when the call has timed out.
                    let _ = answer.send(done.as_ref().map(|_| ()).map_err(|e| format!("{e:#}")));
                    done?;
                }
            }
        }
        if let Some(m) = newest {
            link.order(&m)?;
            request = m.number;
        }
        report(GripperEvent::State(link.state(request)?));
    }
    Ok(())
}
