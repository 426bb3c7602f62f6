//! Modbus RTU as a Robotiq 2F-85 speaks it on its serial line: slave 9, 115200 baud, 8N1. Three
//! registers are written at 0x03E8 and three read at 0x07D0. Source: Robotiq 2F-85 instruction manual.

use crate::gripper::ObjectStatus;
use thiserror::Error;

/// The gripper's slave id as delivered.
pub const SLAVE: u8 = 9;
/// First register that is written.
pub const OUTPUTS_AT: u16 = 0x03E8;
/// First register that is read.
pub const INPUTS_AT: u16 = 0x07D0;
/// Longest frame of the protocol, bytes.
pub const MAX_FRAME: usize = 256;

/// A reply that is not one.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum ModbusError {
    /// The check sum is wrong: a disturbed line, or two speakers.
    #[error("check sum {got:#06x}, expected {expected:#06x}")]
    Crc {
        /// As received.
        got: u16,
        /// As computed.
        expected: u16,
    },
    /// Another slave or function than was asked.
    #[error("reply of slave {slave}, function {function:#04x}: not what was asked")]
    Unasked {
        /// Slave id.
        slave: u8,
        /// Function code.
        function: u8,
    },
    /// The slave refuses: 1 function, 2 address, 3 value, 4 failure, 6 busy.
    #[error("the gripper refuses with exception {0}")]
    Exception(u8),
    /// Lengths or echoes that contradict the request.
    #[error("the reply does not fit the request: {0}")]
    Content(&'static str),
    /// More bytes than any frame has.
    #[error("more than {MAX_FRAME} bytes without a frame")]
    Flood,
}

/// CRC-16 of Modbus: polynomial 0xA001 (reflected), start 0xFFFF; the low byte goes first on the wire.
pub fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, byte| {
        (0..8).fold(
            crc ^ u16::from(*byte),
            |c, _| {
                if c & 1 == 1 { (c >> 1) ^ 0xA001 } else { c >> 1 }
            },
        )
    })
}

/// A request and with it what its reply has to look like.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ModbusRequest {
    /// Function 16: write registers.
    Write {
        /// Slave id.
        slave: u8,
        /// First register.
        at: u16,
        /// Values, at most 123.
        values: Vec<u16>,
    },
    /// Function 3 (holding) or 4 (input registers): read.
    Read {
        /// Slave id.
        slave: u8,
        /// 3 or 4.
        function: u8,
        /// First register.
        at: u16,
        /// How many, at most 125.
        count: u8,
    },
}

impl ModbusRequest {
    /// The frame.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::new();
        match self {
            Self::Write { slave, at, values } => {
                let values = &values[..values.len().min(123)];
                out.extend_from_slice(&[*slave, 0x10]);
                out.extend_from_slice(&at.to_be_bytes());
                out.extend_from_slice(&(values.len() as u16).to_be_bytes());
                out.push(2 * values.len() as u8);
                values.iter().for_each(|v| out.extend_from_slice(&v.to_be_bytes()));
            }
            Self::Read { slave, function, at, count } => {
                out.extend_from_slice(&[*slave, *function]);
                out.extend_from_slice(&at.to_be_bytes());
                out.extend_from_slice(&u16::from((*count).min(125)).to_be_bytes());
            }
        }
        out.extend_from_slice(&crc16(&out).to_le_bytes());
        out
    }

    fn head(&self) -> (u8, u8) {
        match self {
            Self::Write { slave, .. } => (*slave, 0x10),
            Self::Read { slave, function, .. } => (*slave, *function),
        }
    }

    /// The reply at the start of the received bytes: `None` until it is whole; the registers that were
    /// read (none for a write).
    ///
    /// # Errors
    /// [`ModbusError`]; the bytes have to be thrown away.
    pub fn reply(&self, bytes: &[u8]) -> Result<Option<Vec<u16>>, ModbusError> {
        if bytes.len() > MAX_FRAME {
            return Err(ModbusError::Flood);
        }
        let [slave, function, third, ..] = *bytes else { return Ok(None) };
        let asked = self.head();
        if slave != asked.0 || function & 0x7f != asked.1 {
            return Err(ModbusError::Unasked { slave, function });
        }
        let exception = function & 0x80 != 0;
        let size = match self {
            _ if exception => 5,
            Self::Write { .. } => 8,
            Self::Read { count, .. } if third == 2 * (*count).min(125) => 5 + usize::from(third),
            Self::Read { .. } => return Err(ModbusError::Content("byte count")),
        };
        let Some(frame) = bytes.get(..size) else { return Ok(None) };
        let (body, check) = frame.split_at(size - 2);
        let (got, expected) = (u16::from_le_bytes([check[0], check[1]]), crc16(body));
        if got != expected {
            return Err(ModbusError::Crc { got, expected });
        }
        if exception {
            return Err(ModbusError::Exception(third));
        }
        match self {
            Self::Write { at, values, .. } => {
                let echo =
                    [at.to_be_bytes(), (values.len().min(123) as u16).to_be_bytes()].concat();
                if body[2..] != echo[..] {
                    return Err(ModbusError::Content("address or count"));
                }
                Ok(Some(Vec::new()))
            }
            Self::Read { .. } => Ok(Some(
                body[3..].chunks_exact(2).map(|c| u16::from_be_bytes([c[0], c[1]])).collect(),
            )),
        }
    }
}

/// What the gripper is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GripperOutputs {
    /// rACT: activation.
    pub activate: bool,
    /// rGTO: go to the position.
    pub go_to: bool,
    /// rATR: automatic release (emergency).
    pub auto_release: bool,
    /// rPR: 0 open, 255 closed.
    pub position: u8,
    /// rSP
    pub speed: u8,
    /// rFR
    pub force: u8,
}

impl GripperOutputs {
    /// The three registers.
    pub fn registers(&self) -> [u16; 3] {
        let bits = u16::from(self.activate)
            | u16::from(self.go_to) << 3
            | u16::from(self.auto_release) << 4;
        [bits << 8, u16::from(self.position), u16::from(self.speed) << 8 | u16::from(self.force)]
    }

    /// The request that writes them.
    pub fn request(&self, slave: u8) -> ModbusRequest {
        ModbusRequest::Write { slave, at: OUTPUTS_AT, values: self.registers().to_vec() }
    }
}

/// What the gripper says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GripperInputs {
    /// gACT: echo of the activation bit.
    pub active: bool,
    /// gGTO: echo of the go-to bit.
    pub go_to: bool,
    /// gSTA: 0 reset, 1 activating, 3 active.
    pub status: u8,
    /// gOBJ
    pub object: ObjectStatus,
    /// gFLT
    pub fault: u8,
    /// gPR: echo of the requested position.
    pub requested: u8,
    /// gPO: measured position.
    pub position: u8,
    /// gCU: motor current (mA).
    pub current: u16,
}

impl GripperInputs {
    /// The request that reads them; the gripper takes function 3 and 4.
    pub fn request(slave: u8) -> ModbusRequest {
        ModbusRequest::Read { slave, function: 3, at: INPUTS_AT, count: 3 }
    }

    /// From the three registers, `None` for another number of them.
    pub fn from_registers(registers: &[u16]) -> Option<Self> {
        let [a, b, c] = *registers else { return None };
        let status = (a >> 8) as u8;
        Some(Self {
            active: status & 1 == 1,
            go_to: status >> 3 & 1 == 1,
            status: status >> 4 & 3,
            object: ObjectStatus::from_register(status >> 6)?,
            fault: (b >> 8) as u8,
            requested: b as u8,
            position: (c >> 8) as u8,
            current: 10 * (c & 0xff),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hex(text: &str) -> Vec<u8> {
        text.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect()
    }

    #[test]
    fn frames_of_the_manual() {
        let open = GripperOutputs {
            activate: true,
            go_to: true,
            position: 0,
            speed: 255,
            force: 255,
            ..Default::default()
        };
        let request = open.request(SLAVE);
        assert_eq!(request.to_bytes(), hex("09 10 03 E8 00 03 06 09 00 00 00 FF FF 72 19"));
        assert_eq!(request.reply(&hex("09 10 03 E8 00 03 01 30")), Ok(Some(vec![])));
        let read = ModbusRequest::Read { slave: SLAVE, function: 4, at: INPUTS_AT, count: 3 };
        let registers = read.reply(&hex("09 04 06 B9 00 00 FF BD 00 5C 9A")).unwrap().unwrap();
        let state = GripperInputs::from_registers(&registers).unwrap();
        assert_eq!(state.object, ObjectStatus::ContactClosing);
        assert_eq!((state.active, state.go_to, state.status, state.fault), (true, true, 3, 0));
        assert_eq!((state.requested, state.position, state.current), (255, 0xBD, 0));
    }

    #[test]
    fn replies_come_in_pieces_and_errors_are_typed() {
        let read = ModbusRequest::Read { slave: SLAVE, function: 4, at: INPUTS_AT, count: 3 };
        let whole = hex("09 04 06 B9 00 00 FF BD 00 5C 9A");
        for n in 0..whole.len() {
            assert_eq!(read.reply(&whole[..n]), Ok(None), "{n}");
        }
        for (i, _) in whole.iter().enumerate() {
            let mut bad = whole.clone();
            bad[i] ^= 0x10;
            assert!(read.reply(&bad).is_err(), "byte {i}");
        }
        let mut refusal = vec![9, 0x84, 2];
        refusal.extend_from_slice(&crc16(&refusal).to_le_bytes());
        assert_eq!(read.reply(&refusal), Err(ModbusError::Exception(2)));
        assert_eq!(read.reply(&[0; 300]), Err(ModbusError::Flood));
        assert_eq!(GripperInputs::from_registers(&[1, 2]), None);
    }
}
