//! Registers and digital lines as they stand in the controller.

/// General purpose registers of one direction.
#[derive(Debug, Clone, PartialEq)]
pub struct Registers {
    /// `int_register_0` to `47`.
    pub ints: [i32; 48],
    /// `double_register_0` to `47`.
    pub doubles: [f64; 48],
    /// Bits 0 to 127; RTDE clients write 64 to 127.
    pub bits: [bool; 128],
}

impl Default for Registers {
    fn default() -> Self {
        Self { ints: [0; 48], doubles: [0.0; 48], bits: [false; 128] }
    }
}

/// One register, to be watched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Slot {
    /// `input_int_register_N`.
    Int(usize),
    /// `input_double_register_N`.
    Double(usize),
    /// `input_bit_register_N`.
    Bit(usize),
}

impl Slot {
    /// From an RTDE input's name.
    pub fn parse(name: &str) -> Option<Self> {
        let index = |prefix: &str, end: usize| {
            let i: usize = name.strip_prefix(prefix)?.parse().ok()?;
            (i < end).then_some(i)
        };
        index("input_int_register_", 48)
            .map(Self::Int)
            .or_else(|| index("input_double_register_", 48).map(Self::Double))
            .or_else(|| index("input_bit_register_", 128).map(Self::Bit))
    }
}

/// The input registers, and how often each was written: a watchdog looks at arrivals, not at changes.
#[derive(Debug, Clone, PartialEq)]
pub struct Inputs {
    /// Their values.
    pub registers: Registers,
    arrivals: [u32; 48 + 48 + 128],
}

impl Default for Inputs {
    fn default() -> Self {
        Self { registers: Registers::default(), arrivals: [0; 224] }
    }
}

impl Inputs {
    /// Writes an integer; an index that no controller has is dropped.
    pub fn write_int(&mut self, i: usize, value: i32) {
        if let Some(r) = self.registers.ints.get_mut(i) {
            *r = value;
            self.arrived(Slot::Int(i));
        }
    }

    /// Writes a number.
    pub fn write_double(&mut self, i: usize, value: f64) {
        if let Some(r) = self.registers.doubles.get_mut(i) {
            *r = value;
            self.arrived(Slot::Double(i));
        }
    }

    /// Writes a bit.
    pub fn write_bit(&mut self, i: usize, value: bool) {
        if let Some(r) = self.registers.bits.get_mut(i) {
            *r = value;
            self.arrived(Slot::Bit(i));
        }
    }

    fn index(slot: Slot) -> usize {
        match slot {
            Slot::Int(i) => i,
            Slot::Double(i) => 48 + i,
            Slot::Bit(i) => 96 + i,
        }
    }

    fn arrived(&mut self, slot: Slot) {
        if let Some(n) = self.arrivals.get_mut(Self::index(slot)) {
            *n = n.wrapping_add(1);
        }
    }

    /// How often a register was written.
    pub fn arrivals(&self, slot: Slot) -> u32 {
        self.arrivals.get(Self::index(slot)).copied().unwrap_or(0)
    }
}

/// What a script's `rtde_set_watchdog` does when its register falls silent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WatchdogAction {
    /// Nothing.
    Ignore,
    /// The program pauses.
    Pause,
    /// The program stops.
    Stop,
}

/// A watched register.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Watchdog {
    pub slot: Slot,
    /// Longest silence, s.
    pub period: f64,
    pub action: WatchdogAction,
    pub seen: u32,
    pub silent: f64,
}

/// Digital and analog lines.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Lines {
    /// Inputs: bits 0-7 standard, 8-15 configurable, 16-17 tool.
    pub digital_in: u64,
    /// Outputs, the same.
    pub digital_out: u64,
    /// Standard analog inputs, V.
    pub analog_in: [f64; 2],
    /// Standard analog outputs, share of the range 0..=1.
    pub analog_out: [f64; 2],
    /// Tool output voltage, V: 0, 12 or 24.
    pub tool_voltage: i32,
}

impl Lines {
    /// Sets those of the digital outputs whose bit is in `mask`.
    pub fn set_outputs(&mut self, mask: u64, value: u64) {
        self.digital_out = (self.digital_out & !mask) | (value & mask);
    }
}
