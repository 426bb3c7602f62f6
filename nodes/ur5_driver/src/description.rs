//! The robot's URDF for everyone, and where its links are.

use crate::arm_state::ArmState;
use anyhow::Context as _;
use std::path::Path;
use tdv_geometry::Stamp;
use tdv_msgs::geometry_msgs::msg::TransformStamped;
use tdv_msgs::std_msgs::msg::String as Text;
use tdv_msgs::tf2_msgs::msg::TFMessage;
use tdv_robot::urdf::RobotModel;
use tdv_runtime::{Node, Publisher, Qos, tracked};

/// The model, and the publishers of what is said once.
pub struct Description {
    model: RobotModel,
    _text: Publisher<Text>,
    _fixed: Publisher<TFMessage>,
}

impl Description {
    /// Publishes `/robot_description` and the fixed transforms; without a file there is none.
    pub fn publish(node: &Node, file: &str) -> anyhow::Result<Option<Self>> {
        if file.is_empty() {
            return Ok(None);
        }
        let model = RobotModel::load(Path::new(file)).context("parameter 'description_file'")?;
        let text = node.publisher("/robot_description", Qos::latched())?;
        text.publish(Text { data: model.text().to_owned() });
        let fixed = node.publisher("/tf_static", Qos::latched())?;
        let stamp = node.now();
        let transforms = model
            .joint_transforms(&[0.0; 6], 0.0)
            .into_iter()
            .filter(|j| j.3)
            .map(|(parent, link, pose, _)| tracked::transform(parent, link, stamp, &pose));
        fixed.publish(TFMessage { transforms: transforms.collect() });
        Ok(Some(Self { model, _text: text, _fixed: fixed }))
    }

    /// Adds the transforms of the moving links; `knuckle` in rad.
    pub fn moving(
        &self,
        out: &mut Vec<TransformStamped>,
        state: &ArmState,
        knuckle: f64,
        stamp: Stamp,
    ) {
        let joints = self.model.joint_transforms(&state.q, knuckle);
        out.extend(
            joints
                .into_iter()
                .filter(|j| !j.3)
                .map(|(parent, link, pose, _)| tracked::transform(parent, link, stamp, &pose)),
        );
    }
}
