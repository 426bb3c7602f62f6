use super::outbox::lock;
use super::{Link, Shared, read_all};
use crate::gripper::{GripperRequest, GripperStatus};
use std::io::Write;
use std::net::TcpStream;
use std::sync::Arc;
use tdv_ur_protocol::gripper::{LineReader, Request, Response, Variable};

/// Serves one client of the gripper's socket.
pub(super) fn serve(mut stream: TcpStream, shared: &Arc<Shared>) {
    if shared.is_cut(Link::Gripper) {
        return;
    }
    let mut lines = LineReader::default();
    let Ok(mut out) = stream.try_clone() else { return };
    let end = read_all(&mut stream, shared, |bytes| {
        if shared.is_cut(Link::Gripper) {
            return Err("the connection is cut".into());
        }
        lines.push(bytes).map_err(|e| e.to_string())?;
        while let Some(line) = lines.next_line() {
            if line.is_empty() {
                continue;
            }
            let answer = match Request::parse(&line) {
                Ok(request) => {
                    let (registers, status) = &mut *lock(&shared.gripper);
                    answer(&request, registers, status).to_line()
                }
                Err(_) => "?\n".to_owned(),
            };
            out.write_all(answer.as_bytes()).map_err(|e| e.to_string())?;
        }
        Ok(())
    });
    if let Err(reason) = end {
        tracing::warn!("gripper client disconnected: {reason}");
    }
}

fn answer(request: &Request, r: &mut GripperRequest, s: &mut GripperStatus) -> Response {
    match request {
        Request::Get(variable) => {
            let value = match variable {
                Variable::Activate => u8::from(r.activate),
                Variable::GoTo => u8::from(r.go_to),
                Variable::Position => s.position,
                Variable::Speed => r.speed,
                Variable::Force => r.force,
                Variable::Status => s.activation as u8,
                Variable::Object => s.object as u8,
                Variable::Fault => s.fault,
                Variable::RequestEcho | Variable::PositionCommand => s.requested,
                Variable::AutoRelease => u8::from(r.auto_release),
                Variable::AutoReleaseDirection | Variable::Mode => 0,
                Variable::SlaveId => 9,
            };
            Response::Value(*variable, value)
        }
        Request::Set(pairs) => {
            for (variable, value) in pairs {
                match variable {
                    Variable::Activate => r.activate = *value != 0,
                    Variable::GoTo => r.go_to = *value != 0,
                    Variable::Position => r.position = *value,
                    Variable::Speed => r.speed = *value,
                    Variable::Force => r.force = *value,
                    Variable::AutoRelease => r.auto_release = *value != 0,
                    // The rest cannot be written; the gripper acknowledges all the same.
                    _ => {}
                }
            }
            Response::Ack
        }
    }
}
