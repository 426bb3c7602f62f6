use super::Frame;
use crate::ProtocolError;

/// What a client sends.
#[derive(Debug, Clone, PartialEq)]
pub enum ClientPackage {
    /// `V`: protocol version wanted.
    ProtocolVersion(u16),
    /// `v`: asks for the controller's version.
    ControllerVersion,
    /// `O`: output recipe (names) and its rate in Hz.
    SetupOutputs {
        /// Packages per second.
        frequency: f64,
        /// Field names; empty ones (from a trailing comma) are dropped.
        names: Vec<String>,
    },
    /// `I`: input recipe (names).
    SetupInputs {
        /// Field names.
        names: Vec<String>,
    },
    /// `S`: start sending outputs.
    Start,
    /// `P`: pause.
    Pause,
    /// `U`: input data, recipe id first.
    Data(Vec<u8>),
    /// `M`: a text for the log.
    Text(Vec<u8>),
}

/// Severity of a text message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextLevel {
    /// The request failed.
    Exception,
    /// An error.
    Error,
    /// A warning.
    Warning,
    /// Information.
    Info,
}

/// What a controller sends.
#[derive(Debug, Clone, PartialEq)]
pub enum ServerPackage {
    /// `V`: whether the version is accepted.
    ProtocolVersion(bool),
    /// `v`: major, minor, bug-fix, build.
    ControllerVersion([u32; 4]),
    /// `O`: recipe id and comma-separated types.
    SetupOutputs {
        /// Recipe id.
        id: u8,
        /// Types, `NOT_FOUND` for an unknown name.
        types: String,
    },
    /// `I`: recipe id (0 on failure) and types, `IN_USE` for an owned register.
    SetupInputs {
        /// Recipe id.
        id: u8,
        /// Types.
        types: String,
    },
    /// `S`: accepted.
    Start(bool),
    /// `P`: accepted.
    Pause(bool),
    /// `U`: output data, recipe id first.
    Data(Vec<u8>),
    /// `M`: a text.
    Text {
        /// Severity.
        level: TextLevel,
        /// The message.
        message: String,
        /// Who says it.
        source: String,
    },
}

fn need(kind: &'static str, payload: &[u8], need: usize) -> Result<(), ProtocolError> {
    if payload.len() < need {
        return Err(ProtocolError::Truncated { kind, have: payload.len(), need });
    }
    Ok(())
}

fn names(bytes: &[u8]) -> Vec<String> {
    String::from_utf8_lossy(bytes)
        .split(',')
        .map(str::trim)
        .filter(|n| !n.is_empty())
        .map(str::to_owned)
        .collect()
}

impl ClientPackage {
    /// As the controller reads it.
    ///
    /// # Errors
    /// [`ProtocolError::PackageType`], [`ProtocolError::Truncated`].
    pub fn parse(frame: Frame) -> Result<Self, ProtocolError> {
        let p = &frame.payload;
        Ok(match frame.kind {
            b'V' => {
                need("protocol version", p, 2)?;
                Self::ProtocolVersion(u16::from_be_bytes([p[0], p[1]]))
            }
            b'v' => Self::ControllerVersion,
            b'O' => {
                need("output set-up", p, 8)?;
                let frequency = f64::from_be_bytes(std::array::from_fn(|i| p[i]));
                Self::SetupOutputs { frequency, names: names(&p[8..]) }
            }
            b'I' => Self::SetupInputs { names: names(p) },
            b'S' => Self::Start,
            b'P' => Self::Pause,
            b'U' => {
                need("data", p, 1)?;
                Self::Data(frame.payload)
            }
            b'M' => Self::Text(frame.payload),
            other => return Err(ProtocolError::PackageType(other)),
        })
    }

    /// The bytes to send.
    pub fn to_bytes(&self) -> Vec<u8> {
        let (kind, payload) = match self {
            Self::ProtocolVersion(v) => (b'V', v.to_be_bytes().to_vec()),
            Self::ControllerVersion => (b'v', Vec::new()),
            Self::SetupOutputs { frequency, names } => {
                let mut p = frequency.to_be_bytes().to_vec();
                p.extend_from_slice(names.join(",").as_bytes());
                (b'O', p)
            }
            Self::SetupInputs { names } => (b'I', names.join(",").into_bytes()),
            Self::Start => (b'S', Vec::new()),
            Self::Pause => (b'P', Vec::new()),
            Self::Data(p) => (b'U', p.clone()),
            Self::Text(p) => (b'M', p.clone()),
        };
        Frame { kind, payload }.to_bytes()
    }
}

impl ServerPackage {
    /// As the client reads it.
    ///
    /// # Errors
    /// [`ProtocolError::PackageType`], [`ProtocolError::Truncated`].
    pub fn parse(frame: Frame) -> Result<Self, ProtocolError> {
        let p = &frame.payload;
        let text = |b: &[u8]| String::from_utf8_lossy(b).into_owned();
        Ok(match frame.kind {
            b'V' => {
                need("protocol version", p, 1)?;
                Self::ProtocolVersion(p[0] != 0)
            }
            b'v' => {
                need("controller version", p, 16)?;
                Self::ControllerVersion(std::array::from_fn(|i| {
                    u32::from_be_bytes(std::array::from_fn(|k| p[4 * i + k]))
                }))
            }
            b'O' => {
                need("output set-up", p, 1)?;
                Self::SetupOutputs { id: p[0], types: text(&p[1..]) }
            }
            b'I' => {
                need("input set-up", p, 1)?;
                Self::SetupInputs { id: p[0], types: text(&p[1..]) }
            }
            b'S' => {
                need("start", p, 1)?;
                Self::Start(p[0] != 0)
            }
            b'P' => {
                need("pause", p, 1)?;
                Self::Pause(p[0] != 0)
            }
            b'U' => {
                need("data", p, 1)?;
                Self::Data(frame.payload)
            }
            b'M' => {
                need("text", p, 3)?;
                let n = usize::from(p[0]);
                need("text", p, n + 3)?;
                let m = usize::from(p[1 + n]);
                need("text", p, n + m + 3)?;
                let level = match p[2 + n + m] {
                    0 => TextLevel::Exception,
                    1 => TextLevel::Error,
                    2 => TextLevel::Warning,
                    _ => TextLevel::Info,
                };
                Self::Text { level, message: text(&p[1..=n]), source: text(&p[2 + n..2 + n + m]) }
            }
            other => return Err(ProtocolError::PackageType(other)),
        })
    }

    /// The bytes to send. Texts are cut at 255 bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let with_id = |id: u8, types: &str| {
            let mut p = vec![id];
            p.extend_from_slice(types.as_bytes());
            p
        };
        let (kind, payload) = match self {
            Self::ProtocolVersion(ok) => (b'V', vec![u8::from(*ok)]),
            Self::ControllerVersion(v) => (b'v', v.iter().flat_map(|x| x.to_be_bytes()).collect()),
            Self::SetupOutputs { id, types } => (b'O', with_id(*id, types)),
            Self::SetupInputs { id, types } => (b'I', with_id(*id, types)),
            Self::Start(ok) => (b'S', vec![u8::from(*ok)]),
            Self::Pause(ok) => (b'P', vec![u8::from(*ok)]),
            Self::Data(p) => (b'U', p.clone()),
            Self::Text { level, message, source } => {
                let mut p = Vec::new();
                for s in [message, source] {
                    let b = &s.as_bytes()[..s.len().min(255)];
                    p.push(b.len() as u8);
                    p.extend_from_slice(b);
                }
                p.push(match level {
                    TextLevel::Exception => 0,
                    TextLevel::Error => 1,
                    TextLevel::Warning => 2,
                    TextLevel::Info => 3,
                });
                (b'M', p)
            }
        };
        Frame { kind, payload }.to_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rtde::FrameReader;

    fn frame(bytes: &[u8]) -> Frame {
        let mut r = FrameReader::default();
        r.push(bytes);
        r.next_frame().unwrap().unwrap()
    }

    #[test]
    fn packages_round_trip() {
        let client = [
            ClientPackage::ProtocolVersion(2),
            ClientPackage::ControllerVersion,
            ClientPackage::SetupOutputs {
                frequency: 125.0,
                names: vec!["timestamp".into(), "actual_q".into()],
            },
            ClientPackage::SetupInputs { names: vec!["input_int_register_24".into()] },
            ClientPackage::Start,
            ClientPackage::Pause,
            ClientPackage::Data(vec![1, 2, 3]),
        ];
        for p in client {
            assert_eq!(ClientPackage::parse(frame(&p.to_bytes())).unwrap(), p);
        }
        let server = [
            ServerPackage::ProtocolVersion(true),
            ServerPackage::ControllerVersion([3, 15, 8, 106339]),
            ServerPackage::SetupOutputs { id: 1, types: "DOUBLE,VECTOR6D".into() },
            ServerPackage::SetupInputs { id: 2, types: "INT32".into() },
            ServerPackage::Start(true),
            ServerPackage::Pause(false),
            ServerPackage::Data(vec![1, 9]),
            ServerPackage::Text {
                level: TextLevel::Warning,
                message: "variables missing".into(),
                source: "RTDE".into(),
            },
        ];
        for p in server {
            assert_eq!(ServerPackage::parse(frame(&p.to_bytes())).unwrap(), p);
        }
    }

    #[test]
    fn known_bytes_of_the_handshake() {
        assert_eq!(ClientPackage::ProtocolVersion(2).to_bytes(), [0, 5, b'V', 0, 2]);
        assert_eq!(ClientPackage::Start.to_bytes(), [0, 3, b'S']);
        assert_eq!(ServerPackage::Start(true).to_bytes(), [0, 4, b'S', 1]);
    }

    #[test]
    fn trailing_commas_give_no_empty_name() {
        let p = ClientPackage::parse(Frame { kind: b'I', payload: b"a,b,".to_vec() }).unwrap();
        assert_eq!(p, ClientPackage::SetupInputs { names: vec!["a".into(), "b".into()] });
    }

    #[test]
    fn short_packages_are_typed_errors() {
        for kind in [b'V', b'O', b'U'] {
            assert!(ClientPackage::parse(Frame { kind, payload: vec![] }).is_err());
        }
        for payload in [vec![], vec![9, 1, 1], vec![0, 200, 0]] {
            assert!(ServerPackage::parse(Frame { kind: b'M', payload }).is_err());
        }
        assert_eq!(
            ServerPackage::parse(Frame { kind: b'x', payload: vec![] }),
            Err(ProtocolError::PackageType(b'x'))
        );
    }
}
