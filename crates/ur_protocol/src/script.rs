//! URScript on its way to a controller: what may be sent to a script port, and the short secondary
//! programs that the driver sends. A `def` replaces the running program; a `sec` runs beside it and
//! must not move the arm.

use thiserror::Error;

/// TCP port of the secondary interface: takes scripts.
pub const SECONDARY_PORT: u16 = 30002;
/// TCP port of the realtime interface: takes scripts too.
pub const REALTIME_PORT: u16 = 30003;
/// Longest script that is sent, bytes.
pub const MAX_SCRIPT: usize = 1 << 20;

/// A script that cannot be sent.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum ScriptError {
    /// Nothing in it.
    #[error("the script is empty")]
    Empty,
    /// More than [`MAX_SCRIPT`].
    #[error("the script has {0} bytes, {MAX_SCRIPT} are possible")]
    Long(usize),
    /// The interpreter reads ASCII.
    #[error("the script has a character {0:?} that is not ASCII text")]
    Character(char),
    /// A value outside its range.
    #[error("{0}")]
    Value(String),
}

/// The bytes of a script: line ends made `\n`, one at the end.
///
/// # Errors
/// [`ScriptError`].
pub fn upload(text: &str) -> Result<Vec<u8>, ScriptError> {
    if text.trim().is_empty() {
        return Err(ScriptError::Empty);
    }
    if text.len() > MAX_SCRIPT {
        return Err(ScriptError::Long(text.len()));
    }
    let unix = text.replace("\r\n", "\n");
    let odd = |c: &char| !c.is_ascii() || (c.is_ascii_control() && !matches!(c, '\n' | '\t'));
    if let Some(c) = unix.chars().find(odd) {
        return Err(ScriptError::Character(c));
    }
    let mut bytes = unix.trim_end().as_bytes().to_vec();
    bytes.push(b'\n');
    Ok(bytes)
}

/// Whether a script would replace the program that runs: everything but a `sec`.
pub fn replaces_program(text: &str) -> bool {
    let first = text.lines().map(str::trim).find(|l| !l.is_empty() && !l.starts_with('#'));
    first.is_some_and(|l| !l.starts_with("sec "))
}

/// Sets mass (kg) and centre of gravity (m, in the flange).
///
/// # Errors
/// [`ScriptError::Value`].
pub fn set_payload(mass: f64, center: [f64; 3]) -> Result<String, ScriptError> {
    if !(0.0..=20.0).contains(&mass) || !center.iter().all(|c| c.abs() <= 1.0) {
        return Err(ScriptError::Value(format!(
            "payload {mass} kg at {center:?} m: 0 to 20 kg within 1 m of the flange are possible"
        )));
    }
    let [x, y, z] = center;
    Ok(secondary(&format!("set_payload({mass:.6}, [{x:.6}, {y:.6}, {z:.6}])")))
}

/// Makes the present force the zero (e-Series).
pub fn zero_ftsensor() -> String {
    secondary("zero_ftsensor()")
}

/// Sets the voltage of the tool connector.
///
/// # Errors
/// [`ScriptError::Value`] for anything but 0, 12 and 24 V.
pub fn set_tool_voltage(volts: u8) -> Result<String, ScriptError> {
    if ![0, 12, 24].contains(&volts) {
        return Err(ScriptError::Value(format!("tool voltage {volts}: 0, 12 or 24 V")));
    }
    Ok(secondary(&format!("set_tool_voltage({volts})")))
}

/// Sets one of the 32 flags.
///
/// # Errors
/// [`ScriptError::Value`].
pub fn set_flag(flag: u8, on: bool) -> Result<String, ScriptError> {
    if flag > 31 {
        return Err(ScriptError::Value(format!("flag {flag}: 0 to 31")));
    }
    let value = if on { "True" } else { "False" };
    Ok(secondary(&format!("set_flag({flag}, {value})")))
}

fn secondary(line: &str) -> String {
    format!("sec tdv_setting():\n  {line}\nend\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_of_an_upload() {
        assert_eq!(upload("def f():\r\n  sync()\r\nend").unwrap(), b"def f():\n  sync()\nend\n");
        assert_eq!(upload(" \n"), Err(ScriptError::Empty));
        assert_eq!(upload("popup(\"\u{fc}\")"), Err(ScriptError::Character('\u{fc}')));
        assert_eq!(upload("a\0b"), Err(ScriptError::Character('\0')));
        assert!(upload(&"x".repeat(MAX_SCRIPT + 1)).is_err());
    }

    #[test]
    fn settings_run_beside_the_program() {
        let payload = set_payload(1.25, [0.0, 0.0, 0.06]).unwrap();
        assert!(payload.contains("set_payload(1.250000, [0.000000, 0.000000, 0.060000])"));
        for text in [payload, zero_ftsensor(), set_tool_voltage(24).unwrap()] {
            assert!(!replaces_program(&text) && upload(&text).is_ok());
        }
        assert!(replaces_program("# hello\ndef f():\nend\n"));
        assert!(replaces_program("movej([0,0,0,0,0,0])"));
        assert!(set_payload(f64::NAN, [0.0; 3]).is_err() && set_payload(1.0, [9.0; 3]).is_err());
        assert!(set_tool_voltage(5).is_err() && set_flag(32, true).is_err());
    }
}
