//! The parts of the driver and how they hang together.

use crate::arm::{self, ArmEvent, ArmLink};
use crate::arm_state::ArmState;
use crate::broadcast::Broadcast;
use crate::dashboard::Dashboard;
use crate::description::Description;
use crate::io_services::{self, Settings};
use crate::params::DriverParameters;
use crate::program::Programs;
use crate::recovery::{self, Helper};
use crate::state::Shared;
use crate::upload::ProgramKeeper;
use crate::{controllers, dashboard_services, gripper_action, trajectory};
use std::sync::{Arc, mpsc};
use tdv_msgs::std_msgs::msg::String as Text;
use tdv_robot::MotionParams;
use tdv_runtime::{Level, Node, Params, Qos, realtime};
use tdv_ur_protocol::dashboard::{robot_mode_name, safety_mode_name};
use tokio::sync::watch;

/// The node's life.
pub async fn drive(node: Node, params: Params<DriverParameters>) -> anyhow::Result<()> {
    let p = params.get();
    let motion = MotionParams { limits: p.limits()?, following: p.following_error };
    let shared = Arc::new(Shared::new(motion, p.enable_required));
    node.diagnostics().level(Level::Warn, format!("connecting to {}", p.robot_ip));

    let (knuckle_sender, knuckle) = watch::channel(None);
    let (orders, to_gripper) = mpsc::channel();
    gripper_action::serve(&node, &p, orders, knuckle.clone())?;
    gripper_action::start(&node, p.gripper_address(), to_gripper, knuckle_sender);

    let keeper = ProgramKeeper::new(p.headless, p.keep_program);
    let script_address = p.address(p.script_port);
    let programs = Programs::new(script_address, p.program(), keeper, node.diagnostics().clone());
    let (settings, to_arm) = mpsc::channel();
    let settings = Settings::new(settings, shared.clone());
    let dashboard = Dashboard::new(p.address(p.dashboard_port));
    trajectory::subscribe(&node, &shared, &p.controller_name)?;
    trajectory::serve(&node, &shared, &p.controller_name)?;
    trajectory::answer(&node, &shared, &p.controller_name)?;
    controllers::serve(
        &node,
        &shared,
        &p.controller_name,
        if p.frequency > 0.0 { p.frequency as u16 } else { 125 },
    )?;
    if p.enable_required {
        controllers::take_switch(&node, &shared)?;
    }
    io_services::serve(&node, &shared, &settings, &programs)?;
    dashboard_services::serve(&node, &dashboard)?;
    let helper = Helper {
        dashboard,
        programs: programs.clone(),
        shared: shared.clone(),
        headless: p.headless,
    };
    recovery::serve(&node, helper)?;
    take_scripts(&node, &programs)?;

    let description = Description::publish(&node, &p.description_file)?;
    let broadcast =
        Broadcast::new(&node, &p.controller_name, description, knuckle, shared.clone())?;
    let link =
        ArmLink { address: p.address(p.rtde_port), frequency: p.frequency, settings: to_arm };
    let mut watcher = Watcher {
        node: node.clone(),
        broadcast,
        programs,
        shared: shared.clone(),
        tokio: tokio::runtime::Handle::current(),
    };
    let thread_node = node.clone();
    let priority = p.thread_priority;
    let arm = tokio::task::spawn_blocking(move || {
        realtime::request("the robot's thread", priority);
        arm::run(&thread_node, &link, &shared, |event| watcher.event(event));
    });
    arm.await?;
    Ok(())
}

/// Raw URScript; what is not a `sec` replaces the servo program.
fn take_scripts(node: &Node, programs: &Programs) -> anyhow::Result<()> {
    let programs = programs.clone();
    let scripts = node.queue::<Text>("/urscript_interface/script_command", Qos::reliable(1), 4)?;
    node.spawn("urscript_interface", async move {
        let mut scripts = scripts;
        while let Some(m) = scripts.recv().await {
            if let Err(error) = programs.send(&m.data).await {
                tracing::warn!("script not sent: {error:#}");
            }
        }
    });
    Ok(())
}

/// What the RTDE thread does with its events.
struct Watcher {
    node: Node,
    broadcast: Broadcast,
    programs: Programs,
    shared: Arc<Shared>,
    tokio: tokio::runtime::Handle,
}

impl Watcher {
    fn event(&mut self, event: ArmEvent) {
        let diagnostics = self.node.diagnostics();
        match event {
            ArmEvent::Connected([major, minor, ..]) => {
                tracing::info!("connected to PolyScope {major}.{minor}");
                diagnostics.level(Level::Ok, format!("connected to PolyScope {major}.{minor}"));
                self.programs.connected(major);
            }
            ArmEvent::State(state, followed) => {
                self.broadcast.state(&state, followed, self.node.now());
                if self.programs.look(&state, followed) {
                    let programs = self.programs.clone();
                    // Success and failure are both told by the programs themselves.
                    self.tokio.spawn(async move { programs.send_servo().await.ok() });
                }
                self.say(&state, followed);
            }
            ArmEvent::Fault(why) => {
                tracing::error!("motion stopped: {why}");
                diagnostics.level(Level::Error, format!("motion stopped: {why}"));
            }
            ArmEvent::Lost(why) => {
                tracing::warn!("{why}");
                diagnostics.level(Level::Error, why);
                self.programs.lost();
                self.broadcast.lost();
            }
        }
    }

    fn say(&self, s: &ArmState, followed: bool) {
        let modes = format!(
            "robot mode {}, safety mode {}",
            robot_mode_name(s.robot_mode),
            safety_mode_name(s.safety_mode)
        );
        let (level, sentence) = if let Some(fault) = self.shared.fault() {
            (
                Level::Error,
                format!("motion stopped: {fault} (~/reset or set_mode clears it); {modes}"),
            )
        } else if !followed {
            (Level::Warn, format!("{modes}: {}", self.programs.reason(s)))
        } else {
            let program = s.program.map_or("unknown".into(), |p| format!("{p:?}"));
            (Level::Ok, format!("{modes}, program {program}"))
        };
        self.node.diagnostics().level(level, sentence);
    }
}
