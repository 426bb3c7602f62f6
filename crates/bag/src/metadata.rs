//! `metadata.yaml` of rosbag2, version 9. The QoS text goes into the MCAP channel and into this file:
//! readers that find two different texts yield no messages.

use std::fmt::Write as _;

/// Whether late subscribers get the last message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Durability {
    /// They do not.
    #[default]
    Volatile,
    /// They do (latched topics such as /tf_static).
    TransientLocal,
}

/// The QoS profile list of a topic as rosbag2 writes it, every line indented by `indent` spaces.
pub(crate) fn qos_text(durability: Durability, indent: usize) -> String {
    let durability = match durability {
        Durability::Volatile => "volatile",
        Durability::TransientLocal => "transient_local",
    };
    let lines = [
        "- history: keep_last".to_owned(),
        "  depth: 10".to_owned(),
        "  reliability: reliable".to_owned(),
        format!("  durability: {durability}"),
        "  deadline:".to_owned(),
        "    sec: 9223372036".to_owned(),
        "    nsec: 854775807".to_owned(),
        "  lifespan:".to_owned(),
        "    sec: 9223372036".to_owned(),
        "    nsec: 854775807".to_owned(),
        "  liveliness: automatic".to_owned(),
        "  liveliness_lease_duration:".to_owned(),
        "    sec: 9223372036".to_owned(),
        "    nsec: 854775807".to_owned(),
        "  avoid_ros_namespace_conventions: false".to_owned(),
    ];
    let pad = " ".repeat(indent);
    lines.iter().fold(String::new(), |mut s, l| {
        let _ = writeln!(s, "{pad}{l}");
        s
    })
}

/// What `metadata.yaml` says of a topic.
pub(crate) struct TopicSummary {
    pub name: String,
    pub type_name: String,
    pub durability: Durability,
    pub count: u64,
}

/// The whole file. Times in nanoseconds.
pub(crate) fn metadata_yaml(file: &str, start: u64, end: u64, topics: &[TopicSummary]) -> String {
    let count: u64 = topics.iter().map(|t| t.count).sum();
    let duration = end.saturating_sub(start);
    let mut y = String::from("rosbag2_bagfile_information:\n");
    let _ = write!(
        y,
        "  version: 9\n  storage_identifier: mcap\n  duration:\n    nanoseconds: {duration}\n  \
         starting_time:\n    nanoseconds_since_epoch: {start}\n  message_count: {count}\n  \
         topics_with_message_count:\n"
    );
    for t in topics {
        let _ = write!(
            y,
            "    - topic_metadata:\n        name: {}\n        type: {}\n        \
             serialization_format: cdr\n        offered_qos_profiles:\n{}        \
             type_description_hash: \"\"\n      message_count: {}\n",
            t.name,
            t.type_name,
            qos_text(t.durability, 10),
            t.count
        );
    }
    let _ = write!(
        y,
        "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {file}\n  \
         files:\n    - path: {file}\n      starting_time:\n        nanoseconds_since_epoch: {start}\n      \
         duration:\n        nanoseconds: {duration}\n      message_count: {count}\n  \
         custom_data: ~\n  ros_distro: jazzy\n"
    );
    y
}
