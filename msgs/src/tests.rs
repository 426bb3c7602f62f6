use super::codegen::parse::{Base, Count, parse_definition};
use super::codegen::{self, Kind};
use super::*;
use crate::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus, KeyValue};
use crate::geometry_msgs::msg::{Point, PoseStamped, PoseWithCovariance, Quaternion};
use crate::sensor_msgs::msg::{Image, JointState};
use crate::shape_msgs::msg::SolidPrimitive;
use crate::std_msgs::msg::Header;
use crate::tdv_msgs::msg::{HandJoints, TrackedObject};

fn header(sec: i32, nanosec: u32, frame: &str) -> Header {
    Header { stamp: builtin_interfaces::msg::Time { sec, nanosec }, frame_id: frame.into() }
}

/// The expected payloads come from a separate encoder written after the CDR rules (OMG CORBA 9.3):
/// little endian, each primitive aligned to its size counted from the end of the header, strings
/// with length and terminator, arrays without and sequences with a length.
fn golden<M: RosMessage>(message: &M, payload: &str) {
    let bytes = to_cdr_bytes(message).expect("encodes");
    let text: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
    assert_eq!(text, format!("00010000{payload}"), "{}", M::FULL_NAME);
    assert_eq!(&from_cdr_bytes::<M>(&bytes).expect("decodes"), message);
    let raw = RawMessage::from_bag(&bytes).expect("little endian");
    assert_eq!(to_cdr_bytes(&raw).expect("encodes"), bytes);
    assert_eq!(from_cdr_bytes::<RawMessage>(&bytes).expect("decodes"), raw);
    assert_eq!(raw.to_bag(), bytes);
}

#[test]
fn golden_bytes() {
    let mut pose = PoseStamped { header: header(1, 2, "ab"), ..Default::default() };
    pose.pose.position = Point { x: 1.0, y: 0.0, z: -2.0 };
    golden(
        &pose,
        "01000000020000000300000061620000000000000000f03f000000000000000000000000000000c000000000\
         0000000000000000000000000000000000000000000000000000f03f",
    );
    golden(
        &DiagnosticArray {
            header: header(-1, 999_999_999, ""),
            status: vec![DiagnosticStatus {
                level: DiagnosticStatus::WARN,
                name: "n".into(),
                message: "mm".into(),
                hardware_id: String::new(),
                values: vec![KeyValue { key: "k".into(), value: "value".into() }],
            }],
        },
        "ffffffffffc99a3b01000000000000000100000001000000020000006e000000030000006d6d000001000000\
         0000000001000000020000006b0000000600000076616c756500",
    );
    golden(
        &JointState {
            header: header(7, 8, "base"),
            name: vec!["a".into(), "bcd".into()],
            position: vec![0.5, 1.5],
            velocity: vec![],
            effort: vec![2.0],
        },
        "0700000008000000050000006261736500000000020000000200000061000000040000006263640002000000\
         00000000000000000000e03f000000000000f83f00000000010000000000000000000040",
    );
    golden(
        &Image {
            header: header(1, 0, "cam"),
            height: 1,
            width: 2,
            encoding: "mono8".into(),
            is_bigendian: 0,
            step: 2,
            data: vec![9, 8],
        },
        "01000000000000000400000063616d000100000002000000060000006d6f6e6f380000000200000002000000\
         0908",
    );
    golden(
        &HandJoints {
            header: header(1, 0, "c"),
            handedness: "left".into(),
            score: 0.5,
            joints: vec![Point { x: 1.0, y: 2.0, z: 3.0 }],
        },
        "01000000000000000200000063000000050000006c656674000000000000003f010000000000000000000000\
         0000f03f00000000000000400000000000000840",
    );
    golden(
        &SolidPrimitive { r#type: 1, dimensions: vec![1.0, 2.0, 3.0], ..Default::default() },
        "0100000003000000000000000000f03f0000000000000040000000000000084000000000",
    );
}

#[test]
fn long_arrays_have_no_length_prefix() {
    let mut message = PoseWithCovariance::default();
    message.covariance[35] = 1.0;
    let bytes = to_cdr_bytes(&message).expect("encodes");
    assert_eq!(bytes.len(), 4 + 8 * (7 + 36));
    assert_eq!(from_cdr_bytes::<PoseWithCovariance>(&bytes).expect("decodes"), message);
    let json = serde_json::to_string(&message).expect("json");
    assert_eq!(serde_json::from_str::<PoseWithCovariance>(&json).expect("json"), message);
}

#[test]
fn empty_messages_carry_the_filler_octet() {
    let request = std_srvs::srv::TriggerRequest::default();
    assert_eq!(to_cdr_bytes(&request).expect("encodes"), [0, 1, 0, 0, 0]);
}

#[test]
fn big_endian_is_read() {
    let bytes = [0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2];
    let time: builtin_interfaces::msg::Time = from_cdr_bytes(&bytes).expect("decodes");
    assert_eq!((time.sec, time.nanosec), (1, 2));
}

#[test]
fn bad_bytes_are_refused() {
    assert!(matches!(from_cdr_bytes::<Header>(&[0, 1]), Err(CdrError::TooShort(2))));
    assert!(matches!(
        from_cdr_bytes::<Header>(&[0, 3, 0, 0, 1]),
        Err(CdrError::Encapsulation(0, 3))
    ));
    let whole = to_cdr_bytes(&header(1, 2, "frame")).expect("encodes");
    for length in 4..whole.len() {
        assert!(
            matches!(from_cdr_bytes::<Header>(&whole[..length]), Err(CdrError::Decode { .. })),
            "{length}"
        );
    }
    // A length of 4 GiB must fail, not allocate.
    let hostile = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff];
    assert!(from_cdr_bytes::<tf2_msgs::msg::TFMessage>(&hostile).is_err());
    assert!(from_cdr_bytes::<std_msgs::msg::String>(&hostile).is_err());
}

#[test]
fn bounds_are_kept() {
    let message = SolidPrimitive { dimensions: vec![0.0; 4], ..Default::default() };
    assert!(matches!(to_cdr_bytes(&message), Err(CdrError::Encode { .. })));
}

#[test]
fn defaults_and_constants_of_the_definitions() {
    assert_eq!(Quaternion::default(), Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
    assert_eq!(TrackedObject::HELD, 3);
    assert_eq!(ur_dashboard_msgs::msg::RobotMode::NO_CONTROLLER, -1);
}

#[test]
fn schema_text() {
    let line = "=".repeat(80);
    assert_eq!(
        tf2_msgs::msg::TFMessage::schema(),
        format!(
            "geometry_msgs/TransformStamped[] transforms\n\
             {line}\nMSG: geometry_msgs/TransformStamped\n\
             std_msgs/Header header\nstring child_frame_id\nTransform transform\n\
             {line}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n\
             {line}\nMSG: geometry_msgs/Transform\nVector3 translation\nQuaternion rotation\n\
             {line}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n\
             {line}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n\
             {line}\nMSG: geometry_msgs/Quaternion\n\
             float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
        )
    );
    assert_eq!(schema_of("tf2_msgs/msg/TFMessage"), Some(tf2_msgs::msg::TFMessage::SCHEMA));
    assert_eq!(schema_of("tf2_msgs/msg/Nothing"), None);
    assert!(message_types().count() > 60);
}

#[test]
fn parser_reads_every_form() {
    let text = "# About it.\n# Second line.\nint8 A=-1 # why\nstring NAME='x # y'\nstring<=5 s\n\
                Other[<=3] list\nuint8[4] raw\nfloat32 f 1.5\npkg/Type t # frame";
    let d = parse_definition("mine", text).expect("parses");
    assert_eq!(d.doc, "About it. Second line.");
    assert_eq!((d.constants[0].rust, d.constants[0].value.as_str()), ("i8", "-1"));
    assert_eq!(d.constants[0].doc, "why");
    assert_eq!(d.constants[1].value, "\"x # y\"");
    assert_eq!(d.fields[0].ty.base, Base::Text { bound: Some(5) });
    assert_eq!(d.fields[1].ty.count, Count::AtMost(3));
    assert_eq!(d.fields[2].ty.count, Count::Fixed(4));
    assert_eq!(d.fields[3].default.as_deref(), Some("1.5"));
    assert_eq!(d.fields[4].doc, "frame");
    assert_eq!(d.dependencies(), [("mine".into(), "Other".into()), ("pkg".into(), "Type".into())]);
}

#[test]
fn parser_refuses_nonsense() {
    for text in [
        "uint8",
        "uint8 1x",
        "wstring a",
        "lower b",
        "uint8[x] a",
        "int32[2] A=1",
        "int8 a\nint8 a",
    ] {
        let error = parse_definition("p", text).expect_err(text);
        assert!(error.starts_with("line "), "{error}");
    }
    let error = codegen::parse_interface("p", "S", Kind::Service, "int8 a").expect_err("no ---");
    assert!(error.contains("expected 2 part(s)"), "{error}");
}
