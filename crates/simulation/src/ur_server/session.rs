//! One RTDE client's conversation, without its socket.

use super::state::{InputRegisters, Source};
use crate::controller::{Controller, Message, MessageKind};
use std::collections::HashMap;
use tdv_ur_protocol::ProtocolError;
use tdv_ur_protocol::rtde::{
    ClientPackage, FieldType, PROTOCOL_VERSION, Recipe, ServerPackage, TextLevel, Value,
    input_field, output_field,
};

/// Which client owns which input field.
pub(crate) type Owners = HashMap<String, u64>;

/// Input recipes that a client may set up.
const MAX_RECIPES: usize = 255;

/// The state of one client.
#[derive(Debug)]
pub(crate) struct Session {
    client: u64,
    version: [u32; 4],
    fastest: f64,
    outputs: Option<(Recipe, Vec<Source>)>,
    /// Seconds between two packages.
    period: f64,
    inputs: Vec<Recipe>,
    started: bool,
    due: f64,
}

impl Session {
    pub(crate) fn new(client: u64, version: [u32; 4], fastest: f64) -> Self {
        Self {
            client,
            version,
            fastest,
            outputs: None,
            period: 1.0 / fastest,
            inputs: Vec::new(),
            started: false,
            due: 0.0,
        }
    }

    /// What a package from the client is answered with.
    ///
    /// # Errors
    /// [`ProtocolError`] when the client has to be thrown out.
    pub(crate) fn handle(
        &mut self,
        package: ClientPackage,
        owners: &mut Owners,
        registers: &mut InputRegisters,
    ) -> Result<Vec<ServerPackage>, ProtocolError> {
        Ok(match package {
            ClientPackage::ProtocolVersion(v) => {
                vec![ServerPackage::ProtocolVersion(v == PROTOCOL_VERSION)]
            }
            ClientPackage::ControllerVersion => {
                vec![ServerPackage::ControllerVersion(self.version)]
            }
            ClientPackage::SetupOutputs { frequency, names } => {
                vec![self.setup_outputs(frequency, &names)]
            }
            ClientPackage::SetupInputs { names } => vec![self.setup_inputs(&names, owners)],
            ClientPackage::Start => {
                self.started = self.outputs.is_some();
                let mut answer = vec![ServerPackage::Start(self.started)];
                if !self.started {
                    answer.push(warning("no output recipe is set up"));
                }
                answer
            }
            ClientPackage::Pause => {
                self.started = false;
                vec![ServerPackage::Pause(true)]
            }
            ClientPackage::Data(payload) => {
                let id = payload.first().copied().unwrap_or(0);
                let recipe =
                    self.inputs.iter().find(|r| r.id == id).ok_or(ProtocolError::Recipe(id))?;
                for ((name, _), value) in recipe.fields.iter().zip(recipe.decode(&payload)?) {
                    registers.write(name, value);
                }
                registers.settle();
                Vec::new()
            }
            ClientPackage::Text(_) => Vec::new(),
        })
    }

    fn setup_outputs(&mut self, frequency: f64, names: &[String]) -> ServerPackage {
        let known: Vec<Option<FieldType>> = names.iter().map(|n| output_field(n)).collect();
        let wanted =
            if frequency.is_finite() && frequency > 0.0 { frequency } else { self.fastest };
        self.period = 1.0 / wanted.min(self.fastest);
        let types = types_text(&known, |_| None);
        self.started = false;
        self.outputs = known
            .into_iter()
            .collect::<Option<Vec<_>>>()
            .filter(|k| !k.is_empty())
            .and_then(|kinds| {
                let sources = names.iter().map(|n| Source::of(n)).collect::<Option<Vec<_>>>()?;
                let fields = names.iter().cloned().zip(kinds).collect();
                Some((Recipe { id: 1, fields }, sources))
            });
        ServerPackage::SetupOutputs { id: u8::from(self.outputs.is_some()), types }
    }

    fn setup_inputs(&mut self, names: &[String], owners: &mut Owners) -> ServerPackage {
        let known: Vec<Option<FieldType>> = names.iter().map(|n| input_field(n)).collect();
        let taken = |i: usize| owners.get(&names[i]).is_some_and(|o| *o != self.client);
        let types = types_text(&known, |i| taken(i).then_some("IN_USE"));
        let fine = (0..names.len()).all(|i| known[i].is_some() && !taken(i));
        if !fine || names.is_empty() || self.inputs.len() >= MAX_RECIPES {
            return ServerPackage::SetupInputs { id: 0, types };
        }
        let id = self.inputs.len() as u8 + 1;
        let fields: Vec<(String, FieldType)> =
            names.iter().zip(known).filter_map(|(n, k)| Some((n.clone(), k?))).collect();
        for (name, _) in &fields {
            owners.insert(name.clone(), self.client);
        }
        self.inputs.push(Recipe { id, fields });
        ServerPackage::SetupInputs { id, types }
    }

    /// Whether the client wants data.
    pub(crate) fn started(&self) -> bool {
        self.started
    }

    /// The data package that is due after `dt` more seconds, as bytes.
    pub(crate) fn tick(&mut self, dt: f64, c: &Controller) -> Option<Vec<u8>> {
        let (recipe, sources) = self.outputs.as_ref().filter(|_| self.started)?;
        if self.due > 0.5 * dt {
            self.due -= dt;
            return None;
        }
        self.due += self.period - dt;
        let values: Vec<Value> = sources.iter().map(|s| s.read(c)).collect();
        let payload = recipe.encode(&values).ok()?;
        Some(ServerPackage::Data(payload).to_bytes())
    }
}

/// A text of the controller as RTDE says it.
pub(crate) fn text(message: &Message) -> Vec<u8> {
    let level = match message.kind {
        MessageKind::Log => TextLevel::Info,
        MessageKind::Popup => TextLevel::Warning,
        MessageKind::Error => TextLevel::Error,
    };
    // The length of each part is one byte.
    let words: String = message.text.chars().filter(char::is_ascii).take(250).collect();
    ServerPackage::Text { level, message: words, source: "program".into() }.to_bytes()
}

fn types_text(
    known: &[Option<FieldType>],
    instead: impl Fn(usize) -> Option<&'static str>,
) -> String {
    let words: Vec<&str> = known
        .iter()
        .enumerate()
        .map(|(i, k)| instead(i).unwrap_or_else(|| k.map_or("NOT_FOUND", FieldType::name)))
        .collect();
    words.join(",")
}

fn warning(message: &str) -> ServerPackage {
    ServerPackage::Text {
        level: TextLevel::Warning,
        message: message.into(),
        source: "RTDE".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(list: &[&str]) -> Vec<String> {
        list.iter().map(|n| (*n).to_owned()).collect()
    }

    #[test]
    fn unknown_outputs_and_owned_inputs() {
        let (mut owners, mut registers) = (Owners::new(), InputRegisters::default());
        let mut a = Session::new(1, [3, 15, 8, 0], 125.0);
        let mut b = Session::new(2, [3, 15, 8, 0], 125.0);
        let outputs = ClientPackage::SetupOutputs {
            frequency: 500.0,
            names: names(&["actual_q", "nonsense"]),
        };
        let r = a.handle(outputs, &mut owners, &mut registers).unwrap();
        assert_eq!(r, [ServerPackage::SetupOutputs { id: 0, types: "VECTOR6D,NOT_FOUND".into() }]);
        let r = a.handle(ClientPackage::Start, &mut owners, &mut registers).unwrap();
        assert_eq!(r[0], ServerPackage::Start(false));

        let inputs = || ClientPackage::SetupInputs { names: names(&["input_int_register_24"]) };
        let r = a.handle(inputs(), &mut owners, &mut registers).unwrap();
        assert_eq!(r, [ServerPackage::SetupInputs { id: 1, types: "INT32".into() }]);
        let r = b.handle(inputs(), &mut owners, &mut registers).unwrap();
        assert_eq!(r, [ServerPackage::SetupInputs { id: 0, types: "IN_USE".into() }]);

        let data = ClientPackage::Data(vec![1, 0, 0, 0, 7]);
        a.handle(data, &mut owners, &mut registers).unwrap();
        assert_eq!(registers.inputs().registers.ints[24], 7);
        assert!(b.handle(ClientPackage::Data(vec![1, 0]), &mut owners, &mut registers).is_err());
        assert!(a.handle(ClientPackage::Data(vec![]), &mut owners, &mut registers).is_err());
    }
}
