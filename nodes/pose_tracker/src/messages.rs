//! Messages to the tracker's core and back.

use nalgebra::Matrix6;
use tdv_geometry::Pose;
use tdv_msgs::tdv_msgs::msg::{TrackedObject, TrackedObjects};
use tdv_msgs::vision_msgs::msg::Detection3DArray;
use tdv_perception::Detection;
use tdv_perception::objects::{ObjectState, ObjectsOutput};
use tdv_runtime::tracked;

/// Detections, the table's pose in the camera, and what could not be read.
pub fn detections(message: &Detection3DArray) -> (Vec<Detection>, Option<Pose>, Vec<String>) {
    let (mut objects, mut table, mut problems) = (Vec::new(), None, Vec::new());
    for d in &message.detections {
        match tracked::detection_parts(d) {
            Ok((name, pose, _, score)) if name == "table" => {
                if score > 0.0 {
                    table = Some(pose);
                }
            }
            Ok((name, pose, covariance, score)) => objects.push(Detection {
                name,
                pose,
                confidence: score.clamp(0.0, 1.0),
                covariance: Matrix6::from_row_slice(&covariance),
                found: score > 0.0,
                reason: String::new(),
            }),
            Err(problem) => problems.push(problem),
        }
    }
    (objects, table, problems)
}

fn state_number(state: ObjectState) -> u8 {
    match state {
        ObjectState::Init => TrackedObject::INIT,
        ObjectState::Tracking => TrackedObject::TRACKING,
        ObjectState::Occluded => TrackedObject::OCCLUDED,
        ObjectState::Held => TrackedObject::HELD,
        ObjectState::Lost => TrackedObject::LOST,
    }
}

/// All objects and the tool as one message.
pub fn tracked_objects(output: &ObjectsOutput, reference: &str) -> TrackedObjects {
    let mut objects: Vec<TrackedObject> = output
        .objects
        .iter()
        .map(|o| {
            let mut message = TrackedObject {
                name: o.name.clone(),
                state: if o.pose.is_some() { state_number(o.state) } else { TrackedObject::INIT },
                relative_pose: tracked::pose_message(&o.relative.unwrap_or_default()),
                reference: if o.relative.is_some() { reference.into() } else { String::new() },
                confidence: o.confidence as f32,
                ..Default::default()
            };
            message.pose.pose = tracked::pose_message(&o.pose.unwrap_or_default());
            message.pose.covariance = std::array::from_fn(|i| o.covariance[(i / 6, i % 6)]);
            message
        })
        .collect();
    if let Some(tcp) = output.tcp {
        let mut message = TrackedObject {
            name: "tcp".into(),
            state: TrackedObject::TRACKING,
            relative_pose: tracked::pose_message(&output.tcp_relative.unwrap_or_default()),
            reference: if output.tcp_relative.is_some() { reference.into() } else { String::new() },
            confidence: 1.0,
            ..Default::default()
        };
        message.pose.pose = tracked::pose_message(&tcp);
        objects.push(message);
    }
    TrackedObjects { header: tracked::header(output.stamp), objects }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::{Stamp, pose_from_xyz_rpy};

    #[test]
    fn detections_with_nan_are_named_and_left_out() {
        let header = tracked::header_in(Stamp(3), "camera");
        let pose = pose_from_xyz_rpy([0.0, 0.0, 0.8], [0.0; 3]);
        let good = tracked::detection_message(&header, "mug", &pose, [0.0; 36], 0.9);
        let table = tracked::detection_message(&header, "table", &pose, [0.0; 36], 1.0);
        let mut bad = tracked::detection_message(&header, "coaster", &pose, [0.0; 36], 0.9);
        bad.results[0].pose.pose.position.z = f64::NAN;
        let message = Detection3DArray { header, detections: vec![good, bad, table] };
        let (objects, table, problems) = detections(&message);
        assert_eq!(objects.len(), 1);
        assert!(objects[0].found && table.is_some());
        assert!(problems[0].contains("coaster"));
    }
}
