//! `/io_and_status_controller`: outputs, slider, payload, force sensor, and the servo program.

use crate::program::Programs;
use crate::settings::Setting;
use crate::state::Shared;
use std::sync::{Arc, mpsc};
use tdv_msgs::std_srvs::srv::{Trigger, TriggerResponse};
use tdv_msgs::ur_msgs::srv::{
    SetAnalogOutput, SetAnalogOutputResponse, SetIO, SetIORequest, SetIOResponse, SetPayload,
    SetPayloadResponse, SetSpeedSliderFraction, SetSpeedSliderFractionResponse,
};
use tdv_runtime::{Node, RuntimeError};
use tdv_ur_protocol::script;

/// Slider positions that are taken: at zero the robot would stop for protection when it is moved again.
const SLIDER: std::ops::RangeInclusive<f64> = 0.01..=1.0;

/// An answer to a `Trigger`.
pub fn answer<E: std::fmt::Display>(result: Result<String, E>) -> TriggerResponse {
    match result {
        Ok(message) => TriggerResponse { success: true, message },
        Err(error) => TriggerResponse { success: false, message: format!("{error:#}") },
    }
}

/// Where settings go; refused while no robot is connected.
#[derive(Clone)]
pub struct Settings {
    sender: mpsc::Sender<Setting>,
    shared: Arc<Shared>,
}

impl Settings {
    pub fn new(sender: mpsc::Sender<Setting>, shared: Arc<Shared>) -> Self {
        Self { sender, shared }
    }

    fn set(&self, setting: Setting) -> bool {
        self.shared.arm().is_some() && self.sender.send(setting).is_ok()
    }
}

fn note(what: &str, result: anyhow::Result<()>) -> bool {
    if let Err(error) = &result {
        tracing::warn!("{what}: {error:#}");
    }
    result.is_ok()
}

async fn set_io(r: SetIORequest, settings: &Settings, programs: &Programs) -> anyhow::Result<bool> {
    let pin = r.pin as u8;
    Ok(match (r.fun, r.pin) {
        (SetIORequest::FUN_SET_DIGITAL_OUT, 0..=17) => {
            settings.set(Setting::Digital { pin, on: r.state != 0.0 })
        }
        (SetIORequest::FUN_SET_ANALOG_OUT, 0..=1) if (0.0..=1.0).contains(&r.state) => {
            settings.set(Setting::Analog { pin, voltage: true, level: f64::from(r.state) })
        }
        (SetIORequest::FUN_SET_FLAG, 0..=31) => {
            programs.send(&script::set_flag(pin, r.state != 0.0)?).await?;
            true
        }
        (SetIORequest::FUN_SET_TOOL_VOLTAGE, _) => {
            programs.send(&script::set_tool_voltage(r.state as u8)?).await?;
            true
        }
        _ => false,
    })
}

pub fn serve(
    node: &Node,
    shared: &Arc<Shared>,
    settings: &Settings,
    programs: &Programs,
) -> Result<(), RuntimeError> {
    let name = |n: &str| format!("/io_and_status_controller/{n}");
    let (s, p) = (settings.clone(), programs.clone());
    node.service::<SetIO, _, _>(&name("set_io"), move |r| {
        let (s, p) = (s.clone(), p.clone());
        async move {
            let done = set_io(r, &s, &p).await;
            let success = *done.as_ref().unwrap_or(&false);
            note("set_io", done.map(|_| ()));
            SetIOResponse { success }
        }
    })?;
    let s = settings.clone();
    node.service::<SetAnalogOutput, _, _>(&name("set_analog_output"), move |r| {
        let (pin, level) = (r.data.pin, f64::from(r.data.state));
        let good = pin < 2 && r.data.domain < 2 && (0.0..=1.0).contains(&level);
        let success = good && s.set(Setting::Analog { pin, voltage: r.data.domain == 1, level });
        async move { SetAnalogOutputResponse { success } }
    })?;
    let s = settings.clone();
    node.service::<SetSpeedSliderFraction, _, _>(&name("set_speed_slider"), move |r| {
        let fraction = r.speed_slider_fraction;
        let success = SLIDER.contains(&fraction) && s.set(Setting::SpeedSlider(fraction));
        async move { SetSpeedSliderFractionResponse { success } }
    })?;
    let p = programs.clone();
    node.service::<SetPayload, _, _>(&name("set_payload"), move |r| {
        let p = p.clone();
        async move {
            let c = &r.center_of_gravity;
            let sent = match script::set_payload(f64::from(r.mass), [c.x, c.y, c.z]) {
                Ok(text) => p.send(&text).await,
                Err(error) => Err(error.into()),
            };
            SetPayloadResponse { success: note("set_payload", sent) }
        }
    })?;
    let p = programs.clone();
    node.service::<Trigger, _, _>(&name("zero_ftsensor"), move |_| {
        let p = p.clone();
        async move { answer(p.send(&script::zero_ftsensor()).await.map(|()| "zeroed".into())) }
    })?;
    let p = programs.clone();
    node.service::<Trigger, _, _>(&name("resend_robot_program"), move |_| {
        let p = p.clone();
        async move { answer(p.send_servo().await.map(|()| "servo program sent".into())) }
    })?;
    let (p, s) = (programs.clone(), shared.clone());
    node.service::<Trigger, _, _>(&name("hand_back_control"), move |_| {
        p.release();
        s.hand_back();
        async { answer::<String>(Ok("the servo program ends".into())) }
    })?;
    let s = shared.clone();
    node.service::<Trigger, _, _>("~/reset", move |_| {
        let said = s.fault().map_or("there was no fault".into(), |f| format!("cleared: {f}"));
        s.reset();
        async { answer::<String>(Ok(said)) }
    })
}
