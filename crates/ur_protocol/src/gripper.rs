//! ASCII socket protocol of the Robotiq URCap (TCP 63352), as the 2F-85 speaks it.

use crate::ProtocolError;

/// Longest line accepted, bytes.
pub const MAX_LINE: usize = 256;

/// The gripper's variables that this project uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Variable {
    /// `ACT`: activation, 0 or 1.
    Activate,
    /// `GTO`: go to the requested position, 0 or 1.
    GoTo,
    /// `POS`: position; requested when set, measured when read. 0 open, 255 closed.
    Position,
    /// `SPE`: speed 0..255.
    Speed,
    /// `FOR`: force 0..255.
    Force,
    /// `STA`: 0 reset, 1 activating, 3 active.
    Status,
    /// `OBJ`: see [`ObjectStatus`].
    Object,
    /// `FLT`: fault code.
    Fault,
    /// `PRE`: echo of the requested position.
    RequestEcho,
    /// `ATR`: automatic release.
    AutoRelease,
    /// `ARD`: direction of the automatic release.
    AutoReleaseDirection,
    /// `PCO`: echo of the position register (older firmware).
    PositionCommand,
    /// `MOD`: operation mode, 0 for two fingers.
    Mode,
    /// `SID`: Modbus slave id.
    SlaveId,
}

const NAMES: [(Variable, &str); 14] = [
    (Variable::Activate, "ACT"),
    (Variable::GoTo, "GTO"),
    (Variable::Position, "POS"),
    (Variable::Speed, "SPE"),
    (Variable::Force, "FOR"),
    (Variable::Status, "STA"),
    (Variable::Object, "OBJ"),
    (Variable::Fault, "FLT"),
    (Variable::RequestEcho, "PRE"),
    (Variable::AutoRelease, "ATR"),
    (Variable::AutoReleaseDirection, "ARD"),
    (Variable::PositionCommand, "PCO"),
    (Variable::Mode, "MOD"),
    (Variable::SlaveId, "SID"),
];

impl Variable {
    /// Three letters on the wire.
    pub fn name(self) -> &'static str {
        NAMES.iter().find(|n| n.0 == self).map_or("", |n| n.1)
    }

    /// Variable from its three letters.
    pub fn parse(name: &str) -> Option<Self> {
        NAMES.iter().find(|n| n.1 == name).map(|n| n.0)
    }
}

/// Value of `OBJ`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum ObjectStatus {
    /// Fingers are moving.
    Moving = 0,
    /// Stopped by contact while opening.
    ContactOpening = 1,
    /// Stopped by contact while closing.
    ContactClosing = 2,
    /// At the requested position: no object, or the object is lost.
    AtPosition = 3,
}

impl ObjectStatus {
    /// From the register's value.
    pub fn from_register(value: u8) -> Option<Self> {
        [Self::Moving, Self::ContactOpening, Self::ContactClosing, Self::AtPosition]
            .into_iter()
            .find(|s| *s as u8 == value)
    }
}

/// What a fault code of `FLT` (or of the Modbus fault register) means; `None` for no fault.
pub fn fault_text(code: u8) -> Option<&'static str> {
    // The upper half of the byte belongs to the gripper's controller.
    match code & 0x0f {
        0x00 => None,
        0x05 => Some("action delayed: activation has to be completed first"),
        0x07 => Some("the activation bit has to be set first"),
        0x08 => Some("over temperature: it has to cool down"),
        0x09 => Some("no communication for 1 s"),
        0x0a => Some("under voltage"),
        0x0b => Some("automatic release is under way"),
        0x0c => Some("internal fault: contact the maker"),
        0x0d => Some("activation fault: something hinders the fingers"),
        0x0e => Some("over current"),
        0x0f => Some("automatic release is done: activate again"),
        _ => Some("unknown fault"),
    }
}

/// A request to the gripper.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// `GET VAR`
    Get(Variable),
    /// `SET VAR value [VAR value ...]`
    Set(Vec<(Variable, u8)>),
}

impl Request {
    /// The line with its newline.
    pub fn to_line(&self) -> String {
        match self {
            Self::Get(v) => format!("GET {}\n", v.name()),
            Self::Set(pairs) => {
                let mut line = String::from("SET");
                for (v, x) in pairs {
                    line.push_str(&format!(" {} {x}", v.name()));
                }
                line.push('\n');
                line
            }
        }
    }

    /// As the gripper reads it.
    ///
    /// # Errors
    /// [`ProtocolError::GripperLine`].
    pub fn parse(line: &str) -> Result<Self, ProtocolError> {
        let bad = || ProtocolError::GripperLine(line.trim().to_owned());
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["GET", name] => Variable::parse(name).map(Self::Get).ok_or_else(bad),
            ["SET", rest @ ..] if !rest.is_empty() && rest.len() % 2 == 0 => rest
                .chunks_exact(2)
                .map(|p| Some((Variable::parse(p[0])?, p[1].parse().ok()?)))
                .collect::<Option<Vec<_>>>()
                .map(Self::Set)
                .ok_or_else(bad),
            _ => Err(bad()),
        }
    }
}

/// An answer of the gripper.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Response {
    /// `VAR value`
    Value(Variable, u8),
    /// `ack`
    Ack,
}

impl Response {
    /// The line with its newline.
    pub fn to_line(&self) -> String {
        match self {
            Self::Value(v, x) => format!("{} {x}\n", v.name()),
            Self::Ack => "ack\n".to_owned(),
        }
    }

    /// As the client reads it.
    ///
    /// # Errors
    /// [`ProtocolError::GripperLine`].
    pub fn parse(line: &str) -> Result<Self, ProtocolError> {
        let bad = || ProtocolError::GripperLine(line.trim().to_owned());
        match line.split_whitespace().collect::<Vec<_>>().as_slice() {
            ["ack"] => Ok(Self::Ack),
            [name, value] => {
                let variable = Variable::parse(name).ok_or_else(bad)?;
                Ok(Self::Value(variable, value.parse().map_err(|_| bad())?))
            }
            _ => Err(bad()),
        }
    }
}

/// Cuts a byte stream into lines. An answer `ack` may come without a newline, as the real URCap sends it.
#[derive(Debug, Default)]
pub struct LineReader {
    buffer: Vec<u8>,
}

impl LineReader {
    /// Adds received bytes.
    ///
    /// # Errors
    /// [`ProtocolError::Line`] when a line grows past [`MAX_LINE`] or is not ASCII.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(), ProtocolError> {
        self.buffer.extend_from_slice(bytes);
        let open = self.buffer.iter().rev().take_while(|b| **b != b'\n').count();
        if open > MAX_LINE || !bytes.is_ascii() {
            return Err(ProtocolError::Line(MAX_LINE));
        }
        Ok(())
    }

    /// The next line without its end.
    pub fn next_line(&mut self) -> Option<String> {
        let cut = match self.buffer.iter().position(|b| *b == b'\n') {
            Some(i) => i + 1,
            None if self.buffer == b"ack" => 3,
            None => return None,
        };
        let line: Vec<u8> = self.buffer.drain(..cut).collect();
        Some(String::from_utf8_lossy(&line).trim_end().to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_as_the_manual_has_them() {
        let set = Request::Set(vec![
            (Variable::Position, 100),
            (Variable::Speed, 255),
            (Variable::Force, 255),
            (Variable::GoTo, 1),
        ]);
        assert_eq!(set.to_line(), "SET POS 100 SPE 255 FOR 255 GTO 1\n");
        assert_eq!(Request::parse(&set.to_line()).unwrap(), set);
        assert_eq!(Request::parse("GET OBJ").unwrap(), Request::Get(Variable::Object));
        assert_eq!(Response::parse("POS 123\n").unwrap(), Response::Value(Variable::Position, 123));
        assert_eq!(Response::parse("ack").unwrap(), Response::Ack);
        for bad in ["", "SET", "SET POS", "SET POS 300", "SET XYZ 1", "GET", "GET POS 1", "HELLO"] {
            assert!(Request::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn line_reader_takes_an_ack_without_newline_and_refuses_floods() {
        let mut r = LineReader::default();
        r.push(b"POS 3\nack").unwrap();
        assert_eq!(r.next_line().as_deref(), Some("POS 3"));
        assert_eq!(r.next_line().as_deref(), Some("ack"));
        assert_eq!(r.next_line(), None);
        assert!(r.push(&[b'a'; 300]).is_err());
        assert!(LineReader::default().push(&[0xff, b'\n']).is_err());
    }
}
