//! A device unlike any Modbus drive, to show that the contract fits other devices: every 10 ms it sends the
//! level of its input, and single characters set its output.

use drivetwin_firmware::device::{
    Boot, Context, Device, Duration, Framing, Input, Instant, Level, Line, Output, Pin, PinSpec, Port,
    PortSpec, PresetError, Role, Spec,
};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::registers::Register;

drivetwin_protocol::registers! {
    /// The toy's only register.
    pub enum Reg: HighFirst {
        /// Level of the output.
        Output = rw(0, "1").range(0, 1),
    }
}

static SPEC: Spec = Spec {
    kind: "toy",
    product: "a toy",
    manual: "tests/src/toy.rs",
    ports: &[PortSpec {
        name: "usb",
        framing: Framing::Character,
        line: Some(Line::new(115_200, 8, Parity::None, 1)),
    }],
    pins: &[PinSpec::new("IN", Role::Input, Level::High), PinSpec::new("OUT", Role::Output, Level::Low)],
    registers: Reg::TABLE,
    ..Spec::EMPTY
};

/// A device with one port for characters, an input and an output.
#[derive(Debug, Default)]
pub struct Toy {
    input: bool,
    output: bool,
    due: Option<Instant>,
}

const INTERVAL: Duration = Duration::millis(10);

impl Device for Toy {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }

    fn power_on(&mut self, at: Instant, _boot: Boot, _out: &mut dyn Context) {
        *self = Self { input: true, output: false, due: Some(at + INTERVAL) };
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        match input {
            Input::Bytes { bytes, .. } => {
                for level in bytes {
                    self.output = *level == b'1';
                    let level = if self.output { Level::High } else { Level::Low };
                    out.put(at, Output::Level { pin: Pin(1), level });
                }
            }
            Input::Edge { high, .. } => self.input = high,
            _ => {}
        }
    }

    fn deadline(&self) -> Instant {
        self.due.unwrap_or(Instant::NEVER)
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if let Some(due) = self.due.filter(|due| *due <= at) {
            out.put(due, Output::Bytes { port: Port(0), bytes: if self.input { b"1\n" } else { b"0\n" } });
            self.due = Some(due + INTERVAL);
        }
    }

    fn peek(&self, _at: Instant, _row: usize) -> i64 {
        i64::from(self.output)
    }

    fn poke(
        &mut self,
        _at: Instant,
        _row: usize,
        value: i64,
        _out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        self.output = value == 1;
        Ok(())
    }
}
