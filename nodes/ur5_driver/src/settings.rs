//! What the services set through RTDE inputs: slider, digital and analog outputs.

use tdv_ur_protocol::rtde::Value;

/// One change of an input recipe; a mask names what it changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Setting {
    /// Fraction 0.01..=1.
    SpeedSlider(f64),
    /// Pin 0-7 standard, 8-15 configurable, 16-17 tool.
    Digital { pin: u8, on: bool },
    /// Output 0 or 1, as a voltage or a current, 0..=1 of its range.
    Analog { pin: u8, voltage: bool, level: f64 },
}

/// The input recipes after the servo program's; fields that are masked out change nothing.
pub fn recipes() -> Vec<Vec<&'static str>> {
    vec![
        vec!["speed_slider_mask", "speed_slider_fraction"],
        vec!["standard_digital_output_mask", "standard_digital_output"],
        vec!["configurable_digital_output_mask", "configurable_digital_output"],
        vec!["tool_digital_output_mask", "tool_digital_output"],
        vec![
            "standard_analog_output_mask",
            "standard_analog_output_type",
            "standard_analog_output_0",
            "standard_analog_output_1",
        ],
    ]
}

impl Setting {
    /// Index into [`recipes`] and the values.
    pub fn values(&self) -> (usize, Vec<Value>) {
        match *self {
            Self::SpeedSlider(f) => (0, vec![Value::Uint32(1), Value::Double(f)]),
            Self::Digital { pin, on } => {
                let bit = 1_u8 << (pin % 8);
                let recipe = 1 + usize::from(pin / 8).min(2);
                (recipe, vec![Value::Uint8(bit), Value::Uint8(if on { bit } else { 0 })])
            }
            Self::Analog { pin, voltage, level } => {
                let bit = 1_u8 << (pin % 2);
                let kind = if voltage { bit } else { 0 };
                let levels = if pin == 0 { [level, 0.0] } else { [0.0, level] };
                let [a, b] = levels.map(Value::Double);
                (4, vec![Value::Uint8(bit), Value::Uint8(kind), a, b])
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_ur_protocol::rtde::input_field;

    #[test]
    fn values_fit_their_recipes() {
        for setting in [
            Setting::SpeedSlider(0.5),
            Setting::Digital { pin: 3, on: true },
            Setting::Digital { pin: 12, on: false },
            Setting::Digital { pin: 17, on: true },
            Setting::Analog { pin: 1, voltage: true, level: 0.25 },
        ] {
            let (recipe, values) = setting.values();
            let names = &recipes()[recipe];
            assert_eq!(names.len(), values.len());
            for (n, v) in names.iter().zip(&values) {
                assert_eq!(input_field(n), Some(v.field_type()), "{n}");
            }
        }
        let (recipe, values) = Setting::Digital { pin: 17, on: true }.values();
        assert_eq!((recipe, values), (3, vec![Value::Uint8(2), Value::Uint8(2)]));
    }
}
