//! `/dashboard_client`: every command of the dashboard server as a service.

use crate::dashboard::Dashboard;
use crate::io_services::answer;
use tdv_msgs::RosService;
use tdv_msgs::std_srvs::srv::{Trigger, TriggerResponse};
use tdv_msgs::ur_dashboard_msgs::msg::{ProgramState, RobotMode, SafetyMode, VersionInformation};
use tdv_msgs::ur_dashboard_msgs::srv as s;
use tdv_runtime::{Node, RuntimeError};
use tdv_ur_protocol::dashboard::{Answer, Request};

const TRIGGERS: [(&str, Request); 13] = [
    ("power_on", Request::PowerOn),
    ("power_off", Request::PowerOff),
    ("brake_release", Request::BrakeRelease),
    ("play", Request::Play),
    ("pause", Request::Pause),
    ("stop", Request::Stop),
    ("unlock_protective_stop", Request::UnlockProtectiveStop),
    ("restart_safety", Request::RestartSafety),
    ("close_popup", Request::ClosePopup),
    ("close_safety_popup", Request::CloseSafetyPopup),
    ("shutdown", Request::Shutdown),
    ("quit", Request::Quit),
    ("clear_operational_mode", Request::ClearOperationalMode),
];

pub fn serve(node: &Node, dashboard: &Dashboard) -> Result<(), RuntimeError> {
    for (name, request) in TRIGGERS {
        let d = dashboard.clone();
        node.service::<Trigger, _, _>(&format!("/dashboard_client/{name}"), move |_| {
            let (d, request) = (d.clone(), request.clone());
            async move {
                match d.ask(&request).await {
                    Ok((said, message)) => {
                        TriggerResponse { success: said == Answer::Done, message }
                    }
                    Err(error) => answer::<anyhow::Error>(Err(error)),
                }
            }
        })?;
    }
    let d = dashboard.clone();
    node.service::<Trigger, _, _>("/dashboard_client/connect", move |_| {
        let d = d.clone();
        async move { answer(d.connect().await.map(|()| "connected".into())) }
    })?;
    queries(node, dashboard)?;
    texts(node, dashboard)
}

/// A service whose request becomes a command and whose answer becomes the response; an answer that did
/// not come is a refusal with the reason as its words.
fn typed<S: RosService>(
    node: &Node,
    dashboard: &Dashboard,
    name: &str,
    request: fn(S::Request) -> Request,
    response: fn(Answer, String) -> S::Response,
) -> Result<(), RuntimeError> {
    let d = dashboard.clone();
    node.service::<S, _, _>(&format!("/dashboard_client/{name}"), move |r| {
        let d = d.clone();
        async move {
            let (said, words) = match d.ask(&request(r)).await {
                Ok(answer) => answer,
                Err(error) => (Answer::Refused, format!("{error:#}")),
            };
            response(said, words)
        }
    })
}

fn queries(node: &Node, d: &Dashboard) -> Result<(), RuntimeError> {
    typed::<s::GetRobotMode>(
        node,
        d,
        "get_robot_mode",
        |_| Request::RobotMode,
        |a, answer| {
            let mode = if let Answer::RobotMode(m) = a { Some(m) } else { None };
            let robot_mode = RobotMode { mode: mode.unwrap_or(RobotMode::NO_CONTROLLER) };
            s::GetRobotModeResponse { robot_mode, answer, success: mode.is_some() }
        },
    )?;
    typed::<s::GetSafetyMode>(
        node,
        d,
        "get_safety_mode",
        |_| Request::SafetyMode,
        |a, answer| {
            let mode = if let Answer::SafetyMode(m) = a { Some(m) } else { None };
            let safety_mode =
                SafetyMode { mode: mode.unwrap_or(SafetyMode::UNDEFINED_SAFETY_MODE) };
            s::GetSafetyModeResponse { safety_mode, answer, success: mode.is_some() }
        },
    )?;
    typed::<s::IsProgramRunning>(
        node,
        d,
        "program_running",
        |_| Request::Running,
        |a, answer| s::IsProgramRunningResponse {
            answer,
            program_running: a == Answer::Flag(true),
            success: matches!(a, Answer::Flag(_)),
        },
    )?;
    let remote = |_| Request::IsInRemoteControl;
    typed::<s::IsInRemoteControl>(node, d, "is_in_remote_control", remote, |a, answer| {
        s::IsInRemoteControlResponse {
            answer,
            remote_control: a == Answer::Flag(true),
            success: matches!(a, Answer::Flag(_)),
        }
    })?;
    typed::<s::GetProgramState>(
        node,
        d,
        "program_state",
        |_| Request::ProgramState,
        |a, answer| {
            let (state, program_name, success) = match a {
                Answer::Program(state, name) => (state, name, true),
                _ => (String::new(), String::new(), false),
            };
            s::GetProgramStateResponse {
                state: ProgramState { state },
                program_name,
                answer,
                success,
            }
        },
    )?;
    let saved = |_| Request::IsProgramSaved;
    typed::<s::IsProgramSaved>(node, d, "program_saved", saved, |a, answer| {
        let (program_saved, program_name, success) = match a {
            Answer::Saved(saved, name) => (saved, name, true),
            _ => (false, String::new(), false),
        };
        s::IsProgramSavedResponse { answer, program_name, program_saved, success }
    })?;
    let loaded = |_| Request::LoadedProgram;
    typed::<s::GetLoadedProgram>(node, d, "get_loaded_program", loaded, |a, answer| {
        let name = if let Answer::Text(t) = a { Some(t) } else { None };
        let success = name.is_some();
        s::GetLoadedProgramResponse { answer, program_name: name.unwrap_or_default(), success }
    })?;
    let version = |_| Request::PolyscopeVersion;
    typed::<s::GetPolyScopeVersion>(node, d, "get_polyscope_version", version, |a, answer| {
        let [major, minor, bugfix, build] = if let Answer::Version(v) = a { v } else { [0; 4] };
        let version = VersionInformation { major, minor, bugfix, build };
        s::GetPolyScopeVersionResponse { answer, success: major > 0, version }
    })?;
    typed::<s::GetRobotModel>(
        node,
        d,
        "get_robot_model",
        |_| Request::RobotModel,
        |a, answer| {
            let model = if let Answer::Text(t) = a { Some(t) } else { None };
            let success = model.is_some();
            s::GetRobotModelResponse { success, answer, robot_model: model.unwrap_or_default() }
        },
    )?;
    let serial = |_| Request::SerialNumber;
    typed::<s::GetSerialNumber>(node, d, "get_serial_number", serial, |a, answer| {
        let number = if let Answer::Number(n) = a { Some(n) } else { None };
        let success = number.is_some();
        s::GetSerialNumberResponse { serial_number: number.unwrap_or(0), answer, success }
    })
}

fn texts(node: &Node, d: &Dashboard) -> Result<(), RuntimeError> {
    let load: fn(Answer, String) -> s::LoadResponse =
        |a, answer| s::LoadResponse { answer, success: a == Answer::Done };
    typed::<s::Load>(node, d, "load_program", |r| Request::Load(r.filename), load)?;
    let installation = |r: s::LoadRequest| Request::LoadInstallation(r.filename);
    typed::<s::Load>(node, d, "load_installation", installation, load)?;
    typed::<s::Popup>(
        node,
        d,
        "popup",
        |r| Request::Popup(r.message),
        |a, answer| s::PopupResponse { answer, success: a == Answer::Done },
    )?;
    typed::<s::AddToLog>(
        node,
        d,
        "add_to_log",
        |r| Request::AddToLog(r.message),
        |a, answer| s::AddToLogResponse { answer, success: a == Answer::Done },
    )?;
    typed::<s::RawRequest>(
        node,
        d,
        "raw_request",
        |r| Request::Raw(r.query),
        |_, answer| s::RawRequestResponse { answer },
    )
}
