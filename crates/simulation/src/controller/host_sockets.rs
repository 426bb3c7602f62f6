//! A script's `socket_...` functions on [`super::sockets`]. Time-outs count control cycles.

use super::core::Core;
use super::sockets::{ScriptSockets, SocketState};
use tdv_urscript::{Call, Reply, Value};

pub(super) const SIGNATURES: &str = "\
socket_sendln(str, socket_name = 'socket_0')
socket_get_var(name, socket_name = 'socket_0', timeout = 2)
";

/// Numbers that one read may ask for.
const MAX_NUMBERS: usize = 30;

fn text(v: &Value) -> String {
    match v {
        Value::Text(t) => t.to_string(),
        other => other.to_string(),
    }
}

fn number(v: &Value) -> Result<f64, String> {
    v.number().ok_or_else(|| format!("a number is needed, not {}", v.kind()))
}

fn count(v: &Value) -> Result<usize, String> {
    let n = number(v)?;
    if (1.0..=MAX_NUMBERS as f64).contains(&n) {
        Ok(n as usize)
    } else {
        Err(format!("{n} numbers cannot be read at once: 1 to {MAX_NUMBERS} are possible"))
    }
}

/// A list of numbers with their count in front, as the read functions give it.
fn counted(numbers: &[f64]) -> Value {
    let mut all = vec![numbers.len() as f64];
    all.extend_from_slice(numbers);
    Value::numbers(&all)
}

pub(super) fn call(core: &mut Core, call: Call<'_>) -> Result<Reply, String> {
    let a = call.args;
    let waited = call.waited as f64 * core.generation.cycle();
    let late = |timeout: &Value| -> Result<bool, String> {
        let t = number(timeout)?;
        Ok(t > 0.0 && waited >= t)
    };
    let s: &mut ScriptSockets = &mut core.sockets;
    let sent = |s: &ScriptSockets, name: &Value, bytes: Vec<u8>| {
        Reply::Done(Value::Bool(s.send(&text(name), bytes)))
    };
    Ok(match call.function {
        "socket_open" => {
            let name = text(&a[2]);
            if call.waited == 0 {
                let port = number(&a[1])?;
                if !(1.0..=65535.0).contains(&port) {
                    return Err(format!("port {port} is not one of 1 to 65535"));
                }
                if !s.open(&name, &text(&a[0]), port as u16) {
                    return Err("too many sockets are open".into());
                }
            }
            match s.state(&name) {
                SocketState::Connecting => Reply::Wait,
                state => Reply::Done(Value::Bool(state == SocketState::Open)),
            }
        }
        "socket_close" => {
            s.close(&text(&a[0]));
            Reply::Done(Value::Nothing)
        }
        "socket_send_string" => sent(s, &a[1], text(&a[0]).into_bytes()),
        "socket_send_line" | "socket_sendln" => {
            sent(s, &a[1], format!("{}\n", text(&a[0])).into_bytes())
        }
        "socket_send_int" => {
            let bytes = (number(&a[0])? as i32).to_be_bytes();
            sent(s, &a[1], bytes.to_vec())
        }
        "socket_send_byte" => {
            let byte = number(&a[0])? as i64 as u8;
            sent(s, &a[1], vec![byte])
        }
        "socket_set_var" => {
            let line = format!("SET {} {}\n", text(&a[0]), text(&a[1]));
            sent(s, &a[2], line.into_bytes())
        }
        "socket_get_var" => {
            let (variable, name) = (text(&a[0]), text(&a[1]));
            if call.waited == 0 && !s.send(&name, format!("GET {variable}\n").into_bytes()) {
                return Err(format!("socket '{name}' is not connected"));
            }
            match s.take_until(&name, |b| b.ends_with(b"\n")) {
                Some(line) => {
                    let line = String::from_utf8_lossy(&line).into_owned();
                    let value = line.split_whitespace().nth(1).and_then(|v| v.parse().ok());
                    Reply::Done(Value::Int(value.unwrap_or(0)))
                }
                None if late(&a[2])? => Reply::Done(Value::Int(0)),
                None => Reply::Wait,
            }
        }
        "socket_read_line" => match s.take_until(&text(&a[0]), |b| b.ends_with(b"\n")) {
            Some(line) => Reply::Done(Value::text(
                String::from_utf8_lossy(&line).trim_end_matches(['\r', '\n']),
            )),
            None if late(&a[1])? => Reply::Done(Value::text("")),
            None => Reply::Wait,
        },
        "socket_read_string" => {
            let name = text(&a[0]);
            let (prefix, suffix) = (text(&a[1]), text(&a[2]));
            let got = if suffix.is_empty() {
                // Whatever has arrived.
                match s.waiting(&name) {
                    0 => None,
                    n => s.take(&name, n),
                }
            } else {
                s.take_until(&name, |b| b.ends_with(suffix.as_bytes()))
            };
            match got {
                Some(bytes) => {
                    let line = String::from_utf8_lossy(&bytes).into_owned();
                    let line = line.strip_suffix(&suffix).unwrap_or(&line);
                    let begin = line.find(&prefix).map_or(0, |i| i + prefix.len());
                    Reply::Done(Value::text(&line[begin..]))
                }
                None if late(&a[4])? => Reply::Done(Value::text("")),
                None => Reply::Wait,
            }
        }
        "socket_read_byte_list" => {
            let n = count(&a[0])?;
            match s.take(&text(&a[1]), n) {
                Some(bytes) => {
                    let bytes: Vec<f64> = bytes.iter().map(|b| f64::from(*b)).collect();
                    Reply::Done(counted(&bytes))
                }
                None if late(&a[2])? => Reply::Done(counted(&[])),
                None => Reply::Wait,
            }
        }
        "socket_read_binary_integer" => {
            let n = count(&a[0])?;
            match s.take(&text(&a[1]), 4 * n) {
                Some(bytes) => {
                    let ints: Vec<f64> = bytes
                        .chunks_exact(4)
                        .map(|b| f64::from(i32::from_be_bytes([b[0], b[1], b[2], b[3]])))
                        .collect();
                    Reply::Done(counted(&ints))
                }
                None if late(&a[2])? => Reply::Done(counted(&[])),
                None => Reply::Wait,
            }
        }
        "socket_read_ascii_float" => {
            let n = count(&a[0])?;
            match s.take_until(&text(&a[1]), |b| b.ends_with(b")")) {
                Some(bytes) => {
                    let line = String::from_utf8_lossy(&bytes).into_owned();
                    let inner = line.rsplit('(').next().unwrap_or("").trim_end_matches(')');
                    let numbers: Option<Vec<f64>> =
                        inner.split(',').map(|w| w.trim().parse().ok()).collect();
                    let numbers = numbers.filter(|v| v.len() == n).unwrap_or_default();
                    Reply::Done(counted(&numbers))
                }
                None if late(&a[2])? => Reply::Done(counted(&[])),
                None => Reply::Wait,
            }
        }
        other => return Err(format!("'{other}' is not there")),
    })
}
