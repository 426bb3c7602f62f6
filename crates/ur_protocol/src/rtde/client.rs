use super::{
    CB3_RATE, ClientPackage, E_SERIES_RATE, FrameReader, PROTOCOL_VERSION, Recipe, ServerPackage,
    TextLevel, Value,
};
use crate::ProtocolError;

/// What a client wants from the controller.
#[derive(Debug, Clone, PartialEq)]
pub struct ClientConfig {
    /// Output packages per second; zero for the highest that the controller has.
    pub frequency: f64,
    /// Output fields.
    pub outputs: Vec<&'static str>,
    /// Input recipes.
    pub inputs: Vec<Vec<&'static str>>,
}

/// What received bytes lead to.
#[derive(Debug, Clone, PartialEq)]
pub enum ClientEvent {
    /// Bytes to send.
    Send(Vec<u8>),
    /// Everything is set up; data follow. The controller's version: major, minor, bug-fix, build.
    Ready([u32; 4]),
    /// Values of the output fields.
    Data(Vec<Value>),
    /// A text of the controller.
    Text(TextLevel, String),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    Version,
    Controller,
    Outputs,
    Inputs(usize),
    Start,
    Running,
}

/// A client's side of an RTDE connection; the caller moves the bytes.
#[derive(Debug)]
pub struct Client {
    config: ClientConfig,
    reader: FrameReader,
    step: Step,
    version: [u32; 4],
    outputs: Option<Recipe>,
    inputs: Vec<Recipe>,
}

impl Client {
    /// A client and the first bytes that it sends.
    pub fn new(config: ClientConfig) -> (Self, Vec<u8>) {
        let client = Self {
            config,
            reader: FrameReader::default(),
            step: Step::Version,
            version: [0; 4],
            outputs: None,
            inputs: Vec::new(),
        };
        (client, ClientPackage::ProtocolVersion(PROTOCOL_VERSION).to_bytes())
    }

    /// Takes in received bytes.
    ///
    /// # Errors
    /// [`ProtocolError`]; the connection has to be closed.
    pub fn receive(&mut self, bytes: &[u8]) -> Result<Vec<ClientEvent>, ProtocolError> {
        self.reader.push(bytes);
        let mut events = Vec::new();
        while let Some(frame) = self.reader.next_frame()? {
            let package = ServerPackage::parse(frame)?;
            self.take(package, &mut events)?;
        }
        Ok(events)
    }

    fn take(
        &mut self,
        package: ServerPackage,
        events: &mut Vec<ClientEvent>,
    ) -> Result<(), ProtocolError> {
        let send = |p: ClientPackage| ClientEvent::Send(p.to_bytes());
        let owned = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect();
        match (self.step, package) {
            (_, ServerPackage::Text { level, message, .. }) => {
                events.push(ClientEvent::Text(level, message));
            }
            (Step::Version, ServerPackage::ProtocolVersion(true)) => {
                self.step = Step::Controller;
                events.push(send(ClientPackage::ControllerVersion));
            }
            (Step::Version, ServerPackage::ProtocolVersion(false)) => {
                return Err(ProtocolError::Field {
                    field: "protocol version".into(),
                    reason: format!("the controller refuses version {PROTOCOL_VERSION}"),
                });
            }
            (Step::Controller, ServerPackage::ControllerVersion(v)) => {
                self.version = v;
                self.step = Step::Outputs;
                let names = owned(&self.config.outputs);
                let frequency = match self.config.frequency {
                    f if f > 0.0 => f,
                    _ if v[0] < 5 => CB3_RATE,
                    _ => E_SERIES_RATE,
                };
                events.push(send(ClientPackage::SetupOutputs { frequency, names }));
            }
            (Step::Outputs, ServerPackage::SetupOutputs { id, types }) => {
                self.outputs = Some(Recipe::from_answer(id, &self.config.outputs, &types)?);
                self.step = Step::Inputs(0);
                events.push(self.next_setup(0));
            }
            (Step::Inputs(i), ServerPackage::SetupInputs { id, types }) => {
                let names = self.config.inputs.get(i).map_or(&[][..], Vec::as_slice);
                self.inputs.push(Recipe::from_answer(id, names, &types)?);
                events.push(self.next_setup(i + 1));
            }
            (Step::Start, ServerPackage::Start(true)) => {
                self.step = Step::Running;
                events.push(ClientEvent::Ready(self.version));
            }
            (Step::Start, ServerPackage::Start(false)) => {
                return Err(ProtocolError::Field {
                    field: "start".into(),
                    reason: "the controller does not start the synchronisation".into(),
                });
            }
            (Step::Running, ServerPackage::Data(payload)) => {
                if let Some(recipe) = &self.outputs {
                    events.push(ClientEvent::Data(recipe.decode(&payload)?));
                }
            }
            // Anything else is an answer to something that was not asked.
            _ => {}
        }
        Ok(())
    }

    fn next_setup(&mut self, i: usize) -> ClientEvent {
        let package = match self.config.inputs.get(i) {
            Some(names) => {
                self.step = Step::Inputs(i);
                ClientPackage::SetupInputs { names: names.iter().map(|n| (*n).into()).collect() }
            }
            None => {
                self.step = Step::Start;
                ClientPackage::Start
            }
        };
        ClientEvent::Send(package.to_bytes())
    }

    /// True once data flow.
    pub fn is_running(&self) -> bool {
        self.step == Step::Running
    }

    /// Bytes that set the fields of input recipe `index`.
    ///
    /// # Errors
    /// [`ProtocolError::Recipe`] before the set-up or for an unknown index, and wrong values.
    pub fn input(&self, index: usize, values: &[Value]) -> Result<Vec<u8>, ProtocolError> {
        let recipe = self.inputs.get(index).ok_or(ProtocolError::Recipe(index as u8))?;
        Ok(ClientPackage::Data(recipe.encode(values)?).to_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> ClientConfig {
        ClientConfig {
            frequency: 125.0,
            outputs: vec!["timestamp", "actual_q"],
            inputs: vec![vec!["input_int_register_24"]],
        }
    }

    #[test]
    fn the_whole_handshake() {
        let (mut client, first) = Client::new(config());
        assert_eq!(first, ClientPackage::ProtocolVersion(2).to_bytes());
        let answers = [
            ServerPackage::ProtocolVersion(true),
            ServerPackage::ControllerVersion([3, 15, 8, 0]),
            ServerPackage::SetupOutputs { id: 1, types: "DOUBLE,VECTOR6D".into() },
            ServerPackage::SetupInputs { id: 4, types: "INT32".into() },
        ];
        let asked: Vec<u8> = answers
            .iter()
            .map(|a| match &client.receive(&a.to_bytes()).unwrap()[..] {
                [ClientEvent::Send(bytes)] => bytes[2],
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(asked, b"vOIS");
        assert!(client.input(0, &[Value::Int32(1)]).is_ok() && !client.is_running());
        let ready = client.receive(&ServerPackage::Start(true).to_bytes()).unwrap();
        assert_eq!(ready, [ClientEvent::Ready([3, 15, 8, 0])]);
        let recipe = Recipe::from_answer(1, &config().outputs, "DOUBLE,VECTOR6D").unwrap();
        let values = [Value::Double(2.0), Value::Vector6d([0.5; 6])];
        let data = ServerPackage::Data(recipe.encode(&values).unwrap()).to_bytes();
        assert_eq!(client.receive(&data).unwrap(), [ClientEvent::Data(values.to_vec())]);
        assert!(client.input(1, &[]).is_err());
    }

    #[test]
    fn the_rate_follows_from_the_controllers_version() {
        for (major, rate) in [(3, 125.0), (5, 500.0), (10, 500.0)] {
            let (mut client, _) = Client::new(ClientConfig { frequency: 0.0, ..config() });
            client.receive(&ServerPackage::ProtocolVersion(true).to_bytes()).unwrap();
            let version = ServerPackage::ControllerVersion([major, 0, 0, 0]).to_bytes();
            let events = client.receive(&version).unwrap();
            let [ClientEvent::Send(bytes)] = &events[..] else { panic!("{events:?}") };
            assert_eq!(bytes[3..11], f64::to_be_bytes(rate));
        }
    }

    #[test]
    fn refusals_are_errors() {
        let (mut client, _) = Client::new(config());
        assert!(client.receive(&ServerPackage::ProtocolVersion(false).to_bytes()).is_err());
        let (mut client, _) = Client::new(config());
        for a in
            [ServerPackage::ProtocolVersion(true), ServerPackage::ControllerVersion([5, 0, 0, 0])]
        {
            client.receive(&a.to_bytes()).unwrap();
        }
        let a = ServerPackage::SetupOutputs { id: 1, types: "DOUBLE,NOT_FOUND".into() };
        assert!(client.receive(&a.to_bytes()).unwrap_err().to_string().contains("actual_q"));
    }
}
