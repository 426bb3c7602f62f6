//! Joining the ROS graph as the environment says.

use crate::RuntimeError;
use ros2_client::Context;
use ros2_client::dds::rustdds::dds::statusevents::{DomainParticipantStatusEvent, StatusEvented};
use ros2_client::dds::rustdds::{DomainParticipant, DomainParticipantBuilder, GUID, RTPSEntity};
use std::collections::BTreeSet;
use std::env;
use std::net::Ipv4Addr;
use std::thread;
use std::time::{Duration, Instant};

/// Where other nodes are looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DiscoveryRange {
    /// This machine only.
    Localhost,
    /// All networks of this machine (ROS's default).
    Subnet,
}

/// What the environment says about the graph to join.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Environment {
    /// `ROS_DOMAIN_ID`, 0 to 232.
    pub domain: u16,
    /// `ROS_AUTOMATIC_DISCOVERY_RANGE`, or the older `ROS_LOCALHOST_ONLY`.
    pub range: DiscoveryRange,
}

impl Environment {
    /// From the process environment.
    ///
    /// # Errors
    /// [`RuntimeError::Environment`] naming variable and value.
    pub fn read() -> Result<Self, RuntimeError> {
        Self::from_values(|name| env::var(name).ok().filter(|v| !v.is_empty()))
    }

    fn from_values(get: impl Fn(&str) -> Option<String>) -> Result<Self, RuntimeError> {
        let bad = |name, value: String, reason: &str| RuntimeError::Environment {
            name,
            value,
            reason: reason.into(),
        };
        let domain = match get("ROS_DOMAIN_ID") {
            None => 0,
            Some(text) => match text.trim().parse::<u16>() {
                Ok(domain) if domain <= 232 => domain,
                _ => return Err(bad("ROS_DOMAIN_ID", text, "want a number from 0 to 232")),
            },
        };
        let local_only = get("ROS_LOCALHOST_ONLY").is_some_and(|v| v == "1");
        let range = match get("ROS_AUTOMATIC_DISCOVERY_RANGE") {
            None if local_only => DiscoveryRange::Localhost,
            None => DiscoveryRange::Subnet,
            Some(text) => match text.to_ascii_uppercase().as_str() {
                "LOCALHOST" => DiscoveryRange::Localhost,
                "SUBNET" | "SYSTEM_DEFAULT" => DiscoveryRange::Subnet,
                _ => {
                    let reason = "want LOCALHOST or SUBNET (OFF is not supported)";
                    return Err(bad("ROS_AUTOMATIC_DISCOVERY_RANGE", text, reason));
                }
            },
        };
        Ok(Self { domain, range })
    }

    /// Joins the graph; see [`introduce`] for how long it takes.
    ///
    /// # Errors
    /// [`RuntimeError::Join`].
    pub(crate) fn join(self) -> Result<Context, RuntimeError> {
        let error = |reason: String| RuntimeError::Join { domain: self.domain, reason };
        let mut builder = DomainParticipantBuilder::new(self.domain);
        if self.range == DiscoveryRange::Localhost {
            builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
        }
        let participant = builder.build().map_err(|e| error(e.to_string()))?;
        introduce(&participant);
        Context::from_domain_participant(participant).map_err(|e| error(e.to_string()))
    }
}

/// Bounds of the wait of [`introduce`].
const INTRODUCTION: [Duration; 2] = [Duration::from_millis(300), Duration::from_secs(3)];

/// Waits until every participant of another make that is already there has met this one, that is, has
/// sent an endpoint of its own.
///
/// Fast DDS 2.14 (Jazzy's) drops endpoints that reach it out of order without a source timestamp, and
/// RustDDS sends none: what we announce before Fast DDS knows us is repaired later than what we announce
/// right after (docs/decisions/0004).
fn introduce(participant: &DomainParticipant) {
    let began = Instant::now();
    let events = participant.status_listener();
    // A GUID begins with its maker's number.
    let make = |guid: GUID| u16::from_be_bytes([guid.to_bytes()[0], guid.to_bytes()[1]]);
    let mut strangers = BTreeSet::new();
    loop {
        while let Some(event) = events.try_recv_status() {
            match event {
                DomainParticipantStatusEvent::ParticipantDiscovered { dpd }
                    if make(dpd.guid) != make(participant.guid()) =>
                {
                    strangers.insert(dpd.guid.prefix);
                }
                DomainParticipantStatusEvent::ParticipantLost { id, .. } => {
                    strangers.remove(&id);
                }
                _ => {}
            }
        }
        for reader in participant.discovered_readers() {
            strangers.remove(&reader.reader_proxy.remote_reader_guid.prefix);
        }
        for writer in participant.discovered_writers() {
            strangers.remove(&writer.writer_proxy.remote_writer_guid.prefix);
        }
        let waited = began.elapsed();
        if waited > INTRODUCTION[1] || (strangers.is_empty() && waited > INTRODUCTION[0]) {
            return;
        }
        thread::sleep(Duration::from_millis(10));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(values: &[(&str, &str)]) -> Result<Environment, RuntimeError> {
        Environment::from_values(|name| {
            values.iter().find(|(n, _)| *n == name).map(|(_, v)| v.to_string())
        })
    }

    #[test]
    fn environment() {
        use DiscoveryRange::{Localhost, Subnet};
        let ok = |values: &[(&str, &str)]| {
            read(values).map(|e| (e.domain, e.range)).map_err(|e| e.to_string())
        };
        assert_eq!(ok(&[]), Ok((0, Subnet)));
        assert_eq!(ok(&[("ROS_DOMAIN_ID", "42")]), Ok((42, Subnet)));
        assert_eq!(ok(&[("ROS_LOCALHOST_ONLY", "1")]), Ok((0, Localhost)));
        assert_eq!(ok(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost")]), Ok((0, Localhost)));
        assert_eq!(
            ok(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"), ("ROS_LOCALHOST_ONLY", "1")]),
            Ok((0, Subnet))
        );
        for (name, value) in [
            ("ROS_DOMAIN_ID", "233"),
            ("ROS_DOMAIN_ID", "x"),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"),
        ] {
            let text = ok(&[(name, value)]).expect_err(value);
            assert!(text.contains(name) && text.contains(value), "{text}");
        }
    }
}
