//! Looking at the graph: who publishes, subscribes and serves what.

use crate::node::{Node, lock};
use crate::{Qos, RuntimeError};
use ros2_client::builtin_topics::ros_discovery;
use ros2_client::dds::rustdds::TopicKind;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use tdv_msgs::rmw_dds_common::msg::ParticipantEntitiesInfo;

/// One end of a topic at the level of the middleware.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// e.g. `rt/joint_states`, `rq/node/resetRequest`.
    pub dds_name: String,
    /// e.g. `sensor_msgs::msg::dds_::JointState_`.
    pub dds_type: String,
    /// Publisher (true) or subscription.
    pub writer: bool,
    /// Identifies the end in the whole graph.
    pub guid: [u8; 16],
}

/// A topic as `ros2 topic` shows it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicInfo {
    /// Type names seen, normally one, e.g. `sensor_msgs/msg/JointState`.
    pub types: BTreeSet<String>,
    /// Nodes that publish; `?` for an end whose node is unknown.
    pub publishers: Vec<String>,
    /// Nodes that subscribe.
    pub subscribers: Vec<String>,
}

/// A snapshot of the graph without the node that looks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Graph {
    /// Fully qualified names.
    pub nodes: BTreeSet<String>,
    /// By name.
    pub topics: BTreeMap<String, TopicInfo>,
    /// Type names of services by service name.
    pub services: BTreeMap<String, BTreeSet<String>>,
    /// Type names of actions by action name.
    pub actions: BTreeMap<String, BTreeSet<String>>,
}

/// Keeps track of which ends belong to which node. Make one, let it listen for a second or two, then
/// take snapshots.
pub struct GraphObserver {
    node: Node,
    participants: Arc<Mutex<BTreeMap<[u8; 16], ParticipantEntitiesInfo>>>,
}

impl Node {
    /// The ends of other nodes known now, as the middleware names them.
    pub fn endpoints(&self) -> Vec<Endpoint> {
        let Some(context) = self.context() else { return Vec::new() };
        let participant = context.domain_participant();
        let readers = participant.discovered_readers().into_iter().map(|r| Endpoint {
            dds_name: r.subscription_topic_data.topic_name().clone(),
            dds_type: r.subscription_topic_data.type_name().clone(),
            writer: false,
            guid: r.reader_proxy.remote_reader_guid.to_bytes(),
        });
        let writers = participant.discovered_writers().into_iter().map(|w| Endpoint {
            dds_name: w.publication_topic_data.topic_name.clone(),
            dds_type: w.publication_topic_data.type_name.clone(),
            writer: true,
            guid: w.writer_proxy.remote_writer_guid.to_bytes(),
        });
        readers.chain(writers).collect()
    }

    /// Whether any other node reads a topic, for what is made only when somebody looks. Goes through all
    /// known ends: ask about once a second, not for every message.
    ///
    /// # Errors
    /// [`RuntimeError::Name`].
    pub fn has_readers(&self, topic: &str) -> Result<bool, RuntimeError> {
        let dds_name = format!("rt{}", self.resolve(topic)?);
        Ok(self.endpoints().iter().any(|e| !e.writer && e.dds_name == dds_name))
    }

    /// Starts to observe the graph.
    ///
    /// # Errors
    /// [`RuntimeError`].
    pub fn observe_graph(&self) -> Result<GraphObserver, RuntimeError> {
        let context = self.context();
        let name = "/ros_discovery_info";
        let subscription = self.with_ros("subscription", name, |ros, _| {
            let participant = context.as_ref().map(|c| c.domain_participant());
            let participant = participant.ok_or_else(|| "the node has left".to_string())?;
            // This topic alone has no `rt` prefix.
            let topic = participant
                .create_topic(
                    ros_discovery::TOPIC_NAME.into(),
                    ros_discovery::TYPE_NAME.into(),
                    &ros_discovery::QOS_PUB,
                    TopicKind::NoKey,
                )
                .map_err(|e| e.to_string())?;
            ros.create_subscription::<ParticipantEntitiesInfo>(
                &topic,
                Some(Qos::latched_depth(100).profile()),
            )
            .map_err(|e| e.to_string())
        })?;
        let participants = Arc::new(Mutex::new(BTreeMap::new()));
        let counters = crate::diagnostics::TopicCounters::new(name, true);
        let map = participants.clone();
        self.spawn(
            "graph observer",
            crate::topics::pump(subscription, counters, move |info: ParticipantEntitiesInfo| {
                lock(&map).insert(info.gid.data, info);
            }),
        );
        Ok(GraphObserver { node: self.clone(), participants })
    }
}

impl GraphObserver {
    /// The graph as known now.
    pub fn snapshot(&self) -> Graph {
        let own = self.node.fully_qualified_name();
        let participants = lock(&self.participants).clone();
        build(&self.node.endpoints(), participants.values(), &own)
    }
}

fn build<'a>(
    endpoints: &[Endpoint],
    participants: impl Iterator<Item = &'a ParticipantEntitiesInfo>,
    own: &str,
) -> Graph {
    let mut graph = Graph::default();
    let mut owners: BTreeMap<[u8; 16], String> = BTreeMap::new();
    // A participant that died without a word stays in the list of nodes for as long as its ends do.
    let alive: BTreeSet<[u8; 12]> = endpoints.iter().map(|e| prefix(&e.guid)).collect();
    for participant in participants {
        if !alive.contains(&prefix(&participant.gid.data)) {
            continue;
        }
        for node in &participant.node_entities_info_seq {
            let name = format!("{}/{}", node.node_namespace.trim_end_matches('/'), node.node_name);
            for gid in node.reader_gid_seq.iter().chain(&node.writer_gid_seq) {
                owners.insert(gid.data, name.clone());
            }
            if name != own {
                graph.nodes.insert(name);
            }
        }
    }
    for end in endpoints {
        let owner = owners.get(&end.guid).cloned().unwrap_or_else(|| "?".into());
        let ros_type = ros_type(&end.dds_type);
        if let Some(service) = end.dds_name.strip_prefix("rq") {
            let (Some(service), false) = (service.strip_suffix("Request"), end.writer) else {
                continue;
            };
            let ros_type = ros_type.trim_end_matches("_Request").to_string();
            if let Some(action) = service.strip_suffix("/_action/send_goal") {
                let ros_type = ros_type.trim_end_matches("_SendGoal").to_string();
                graph.actions.entry(action.into()).or_default().insert(ros_type);
            } else if !service.contains("/_action/") {
                graph.services.entry(service.into()).or_default().insert(ros_type);
            }
        } else if let Some(topic) = end.dds_name.strip_prefix("rt") {
            if topic.contains("/_action/") {
                continue;
            }
            let info = graph.topics.entry(topic.into()).or_default();
            info.types.insert(ros_type);
            let list = if end.writer { &mut info.publishers } else { &mut info.subscribers };
            list.push(owner);
            list.sort();
        }
    }
    graph
}

fn prefix(guid: &[u8; 16]) -> [u8; 12] {
    let mut out = [0; 12];
    out.copy_from_slice(&guid[..12]);
    out
}

/// `sensor_msgs::msg::dds_::JointState_` to `sensor_msgs/msg/JointState`.
fn ros_type(dds: &str) -> String {
    dds.replace("::dds_::", "::").trim_end_matches('_').replace("::", "/")
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_msgs::rmw_dds_common::msg::{Gid, NodeEntitiesInfo};

    fn end(name: &str, dds_type: &str, writer: bool, id: u8) -> Endpoint {
        let mut guid = [7; 16];
        guid[15] = id;
        Endpoint { dds_name: name.into(), dds_type: dds_type.into(), writer, guid }
    }

    #[test]
    fn snapshot_from_endpoints() {
        let ends = [
            end("rt/chatter", "std_msgs::msg::dds_::String_", true, 1),
            end("rt/chatter", "std_msgs::msg::dds_::String_", false, 2),
            end("rq/n/resetRequest", "std_srvs::srv::dds_::Trigger_Request_", false, 3),
            end("rr/n/resetReply", "std_srvs::srv::dds_::Trigger_Response_", true, 4),
            end(
                "rq/grip/_action/send_goalRequest",
                "control_msgs::action::dds_::GripperCommand_SendGoal_Request_",
                false,
                5,
            ),
            end("rt/grip/_action/feedback", "x::action::dds_::Y_FeedbackMessage_", true, 6),
        ];
        let mut gid = [7; 16];
        gid[15] = 1;
        let node = NodeEntitiesInfo {
            node_namespace: "/".into(),
            node_name: "n".into(),
            reader_gid_seq: vec![],
            writer_gid_seq: vec![Gid { data: gid }],
        };
        let info =
            ParticipantEntitiesInfo { gid: Gid { data: gid }, node_entities_info_seq: vec![node] };
        let gone = ParticipantEntitiesInfo {
            gid: Gid { data: [9; 16] },
            node_entities_info_seq: info.node_entities_info_seq.clone(),
        };
        let graph = build(&ends, [&info, &gone].into_iter(), "/me");
        assert_eq!(graph.nodes.iter().collect::<Vec<_>>(), ["/n"]);
        let chatter = &graph.topics["/chatter"];
        assert_eq!(chatter.publishers, ["/n"]);
        assert_eq!(chatter.subscribers, ["?"]);
        assert!(chatter.types.contains("std_msgs/msg/String"));
        assert!(graph.services["/n/reset"].contains("std_srvs/srv/Trigger"));
        assert!(graph.actions["/grip"].contains("control_msgs/action/GripperCommand"));
        assert_eq!(graph.topics.len(), 1);
        assert_eq!(graph.services.len(), 1);
    }
}
