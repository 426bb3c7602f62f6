use crate::arguments::CalibrateArgs;
use anyhow::Context as _;
use tdv_geometry::pose_to_xyz_quat;
use tdv_perception::hand_eye::{Mount, calibrate, pairs_from_yaml};

/// Prints where the camera is, how well the pairs agree, and the launch line that says so.
pub fn run(args: &CalibrateArgs) -> anyhow::Result<()> {
    let text =
        std::fs::read_to_string(&args.poses).with_context(|| args.poses.display().to_string())?;
    let pairs = pairs_from_yaml(&text).with_context(|| args.poses.display().to_string())?;
    let (mount, parent) = if args.eye_in_hand {
        (Mount::EyeInHand, "tool0")
    } else {
        (Mount::EyeToHand, "base_link")
    };
    let found = calibrate(&pairs, mount)?;
    for (i, (d, a)) in found.residuals.iter().enumerate() {
        println!("pair {i:3}: {:6.2} mm  {:6.3} deg", d * 1e3, a.to_degrees());
    }
    println!(
        "all {:4}: {:6.2} mm  {:6.3} deg (root mean square)",
        pairs.len(),
        found.rms.0 * 1e3,
        found.rms.1.to_degrees()
    );
    let ([x, y, z], [qx, qy, qz, qw]) = pose_to_xyz_quat(&found.camera);
    println!("{parent} to the camera's optical frame:");
    println!(
        "ros2 run tf2_ros static_transform_publisher --x {x:.6} --y {y:.6} --z {z:.6} --qx {qx:.7} \
         --qy {qy:.7} --qz {qz:.7} --qw {qw:.7} --frame-id {parent} --child-frame-id {}",
        args.camera_frame
    );
    Ok(())
}
