//! Arbitrary bytes and damaged streams through every codec: no panic, and nothing that grows without
//! bound. `TDV_FUZZ_CASES` raises the number of cases.

use proptest::prelude::*;
use tdv_ur_protocol::dashboard::Request as DashboardRequest;
use tdv_ur_protocol::gripper::{LineReader, MAX_LINE, Request, Response};
use tdv_ur_protocol::modbus::{GripperInputs, GripperOutputs, ModbusRequest};
use tdv_ur_protocol::rtde::{
    Client, ClientConfig, ClientPackage, DRIVER_OUTPUTS, FieldType, FrameReader, MAX_PACKAGE,
    Recipe, ServerPackage, TextLevel, Value, input_field, output_field,
};
use tdv_ur_protocol::script;

fn cases() -> ProptestConfig {
    let n = std::env::var("TDV_FUZZ_CASES").ok().and_then(|v| v.parse().ok()).unwrap_or(256);
    ProptestConfig { cases: n, failure_persistence: None, ..ProptestConfig::default() }
}

/// A whole session of a controller as bytes.
fn session() -> Vec<u8> {
    let types: Vec<&str> =
        DRIVER_OUTPUTS.iter().map(|n| output_field(n).map_or("DOUBLE", FieldType::name)).collect();
    let types = types.join(",");
    let recipe = Recipe::from_answer(1, &DRIVER_OUTPUTS, &types).unwrap();
    let values: Vec<Value> = recipe.fields.iter().map(|f| Value::zero(f.1)).collect();
    let data = ServerPackage::Data(recipe.encode(&values).unwrap()).to_bytes();
    let text = ServerPackage::Text {
        level: TextLevel::Warning,
        message: "late".into(),
        source: "RTDE".into(),
    };
    [
        ServerPackage::ProtocolVersion(true).to_bytes(),
        ServerPackage::ControllerVersion([3, 15, 8, 1]).to_bytes(),
        ServerPackage::SetupOutputs { id: 1, types }.to_bytes(),
        ServerPackage::SetupInputs { id: 2, types: "INT32".into() }.to_bytes(),
        ServerPackage::Start(true).to_bytes(),
        text.to_bytes(),
        data.clone(),
        data,
    ]
    .concat()
}

/// Bytes of `valid` with some changed, cut out or doubled.
fn damaged(valid: Vec<u8>) -> impl Strategy<Value = Vec<u8>> {
    let n = valid.len();
    prop::collection::vec((0..n, any::<u8>(), 0..3_u8), 0..6).prop_map(move |edits| {
        let mut out = valid.clone();
        for (at, byte, kind) in edits {
            let at = at.min(out.len().saturating_sub(1));
            match kind {
                0 => out[at] = byte,
                1 if out.len() > 1 => {
                    out.remove(at);
                }
                _ => out.insert(at, byte),
            }
        }
        out
    })
}

fn config() -> ClientConfig {
    ClientConfig {
        frequency: 125.0,
        outputs: DRIVER_OUTPUTS.to_vec(),
        inputs: vec![vec!["input_int_register_24"]],
    }
}

fn feed_client(bytes: &[u8], piece: usize) {
    let (mut client, _) = Client::new(config());
    for part in bytes.chunks(piece.max(1)) {
        if client.receive(part).is_err() {
            return;
        }
    }
}

proptest! {
    #![proptest_config(cases())]

    #[test]
    fn rtde_frames_and_packages(bytes in prop::collection::vec(any::<u8>(), 0..600), piece in 1..64_usize) {
        let mut reader = FrameReader::default();
        'all: for part in bytes.chunks(piece) {
            reader.push(part);
            loop {
                match reader.next_frame() {
                    Ok(Some(frame)) => {
                        prop_assert!(frame.payload.len() <= MAX_PACKAGE);
                        let _ = ServerPackage::parse(frame.clone());
                        let _ = ClientPackage::parse(frame);
                    }
                    Ok(None) => break,
                    Err(_) => break 'all,
                }
            }
        }
        feed_client(&bytes, piece);
    }

    #[test]
    fn rtde_session_with_damage(bytes in damaged(session()), piece in 1..200_usize) {
        feed_client(&bytes, piece);
    }

    #[test]
    fn rtde_recipes(names in prop::collection::vec("[a-zA-Z_0-9]{0,24}", 0..8), types in "[A-Z0-9,]{0,60}", payload in prop::collection::vec(any::<u8>(), 0..300)) {
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        for n in &names {
            let _ = (input_field(n), output_field(n));
        }
        if let Ok(recipe) = Recipe::from_answer(7, &names, &types) {
            let _ = recipe.decode(&payload);
        }
    }

    #[test]
    fn gripper_lines(bytes in prop::collection::vec(any::<u8>(), 0..400), text in "\\PC{0,60}") {
        let mut reader = LineReader::default();
        for part in bytes.chunks(7) {
            if reader.push(part).is_err() {
                break;
            }
            while let Some(line) = reader.next_line() {
                prop_assert!(line.len() <= MAX_LINE + 7);
                let _ = (Request::parse(&line), Response::parse(&line));
            }
        }
        let _ = (Request::parse(&text), Response::parse(&text));
    }

    #[test]
    fn gripper_requests_come_back(line in "(GET|SET) ((POS|SPE|FOR|GTO|ACT|MOD|SID) [0-9]{1,3} ?){0,4}") {
        if let Ok(request) = Request::parse(&line) {
            prop_assert_eq!(Request::parse(&request.to_line()).unwrap(), request);
        }
    }

    #[test]
    fn modbus_replies(bytes in prop::collection::vec(any::<u8>(), 0..300), at in any::<u16>(), count in any::<u8>(), values in prop::collection::vec(any::<u16>(), 0..200)) {
        let read = ModbusRequest::Read { slave: 9, function: 3, at, count };
        if let Ok(Some(registers)) = read.reply(&bytes) {
            let _ = GripperInputs::from_registers(&registers);
        }
        let write = ModbusRequest::Write { slave: 9, at, values };
        let _ = write.reply(&bytes);
        prop_assert!(write.to_bytes().len() <= 256 && read.to_bytes().len() == 8);
    }

    #[test]
    fn modbus_damage_is_found(bytes in damaged(vec![9, 3, 6, 0xB9, 0, 0, 0xFF, 0xBD, 0, 0x1d, 0xed])) {
        let read = GripperInputs::request(9);
        if let Ok(Some(r)) = read.reply(&bytes) {
            prop_assert_eq!(r.len(), 3);
        }
    }

    #[test]
    fn modbus_registers(a in any::<u16>(), b in any::<u16>(), c in any::<u16>(), position in any::<u8>()) {
        prop_assert!(GripperInputs::from_registers(&[a, b, c]).is_some());
        let out = GripperOutputs { position, ..Default::default() };
        prop_assert_eq!(out.registers()[1], u16::from(position));
    }

    #[test]
    fn dashboard_answers(line in "\\PC{0,80}", state in "(STOPPED|PLAYING|true|false|Robotmode:|Safetymode:|URSoftware) ?\\PC{0,30}") {
        for request in [
            DashboardRequest::RobotMode,
            DashboardRequest::SafetyMode,
            DashboardRequest::ProgramState,
            DashboardRequest::IsProgramSaved,
            DashboardRequest::PolyscopeVersion,
            DashboardRequest::SerialNumber,
            DashboardRequest::Running,
            DashboardRequest::Play,
            DashboardRequest::Raw(line.clone()),
        ] {
            let _ = (request.answer(&line), request.answer(&state));
        }
        if let Ok(sent) = DashboardRequest::Load(line).to_line() {
            prop_assert_eq!(sent.matches('\n').count(), 1);
        }
    }

    #[test]
    fn scripts(text in "(?s).{0,200}") {
        let _ = script::replaces_program(&text);
        if let Ok(bytes) = script::upload(&text) {
            prop_assert!(bytes.is_ascii() && bytes.ends_with(b"\n") && bytes.len() <= text.len() + 1);
        }
    }
}
