//! Test device with features that an MD3 does not have: timed characters, a stream, a save of two stores,
//! waves, steps and an analogue input.

use drivetwin_firmware::device::{
    Axis, AxisSpec, Boot, Context, Device, Duration, Fault, Framing, Input, Instant, Level, Line, Output,
    Pin, PinSpec, Port, PortSpec, PresetError, Role, Spec,
};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::registers::Register;

use crate::signals::pin_waveform::level_of;

drivetwin_protocol::registers! {
    /// Registers of the test device.
    pub enum Reg: HighFirst {
        /// Sent in the answer to `r`; 7 is refused.
        Volume = rw(0, "1").range(0, 250),
        /// The first byte of the memory.
        Number = rw(1, "2").range(0, 250).saved(),
    }
}

static SPEC: Spec = Spec {
    kind: "toy",
    product: "a toy",
    manual: "this file",
    ports: &[
        PortSpec {
            name: "usb",
            framing: Framing::Character,
            line: Some(Line::new(115_200, 8, Parity::None, 1)),
        },
        PortSpec { name: "net", framing: Framing::Return, line: None },
    ],
    pins: &[
        PinSpec::new("IN", Role::Input, Level::High),
        PinSpec::new("LEVEL", Role::Analogue, Level::Low),
        PinSpec::new("OUT", Role::Output, Level::Low),
        PinSpec::new("LED", Role::Led, Level::Low),
    ],
    axes: &[AxisSpec { name: "motor", step_dir: None }],
    faults: &["stall"],
    memory: 10,
    registers: Reg::TABLE,
    ..Spec::EMPTY
};

/// The digital input.
pub const IN: Pin = Pin(0);
/// The analogue input.
pub const LEVEL: Pin = Pin(1);
/// The output.
pub const OUT: Pin = Pin(2);
/// The light.
pub const LED: Pin = Pin(3);
/// The axis.
pub const MOTOR: Axis = Axis(0);
/// The only fault.
pub const STALL: Fault = Fault(0);
/// The serial port.
pub const USB: Port = Port(0);

/// Interval between two values of the stream.
pub const INTERVAL: Duration = Duration::millis(3);
/// Time between the two stores of a save.
pub const SAVE: Duration = Duration::millis(20);

/// The test device, of the kind `toy`: `r` sends a random letter and the volume, `s` starts or stops the
/// stream, `w` saves, `1` and `0` set the output. A preset of the volume sets the output low.
#[derive(Debug, Default)]
pub struct TestDevice {
    letter: u8,
    volume: u8,
    next: Option<Instant>,
    saved: Option<Instant>,
    /// Deadline of the output going high, which is the instant of power-on.
    started: Option<Instant>,
    /// Last state of the fault `stall`.
    stalled: bool,
}

impl Device for TestDevice {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        *self = Self { letter: b'a' + (boot.seed % 26) as u8, started: Some(at), ..Self::default() };
        out.put(at, Output::Wave { pin: LED, period: Duration::millis(4), high: Duration::millis(1) });
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        match input {
            Input::Bytes { bytes: &[byte], .. } => match byte {
                b'r' => out.put(at, Output::Bytes { port: USB, bytes: &[self.letter, self.volume, b'\n'] }),
                b's' => self.next = if self.next.is_some() { None } else { Some(at + INTERVAL) },
                b'w' if self.saved.is_none() => {
                    out.put(at, Output::Store { offset: 0, bytes: &[self.volume, 1, 2, 3, 4, 5, 6, 7] });
                    self.saved = Some(at + SAVE);
                }
                b'0' | b'1' => out.put(at, Output::Level { pin: OUT, level: level_of(byte == b'1') }),
                _ => {}
            },
            Input::Bytes { bytes, .. } => panic!("{bytes:?} at once where each has its time"),
            Input::Edge { pin: IN, high } => {
                out.put(at, Output::Step { axis: MOTOR, steps: if high { 1 } else { 2 } });
            }
            Input::Millivolts { mv, .. } => out.put(at, Output::Duty { axis: MOTOR, duty: mv }),
            Input::Fault { on, .. } => {
                self.stalled = on;
                out.put(at, Output::CurrentLimit { axis: MOTOR, ma: u32::from(on) });
            }
            _ => {}
        }
    }

    fn deadline(&self) -> Instant {
        let deadlines = [self.next, self.saved, self.started];
        deadlines.into_iter().flatten().min().unwrap_or(Instant::NEVER)
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.started.take_if(|due| *due <= at).is_some() {
            out.put(at, Output::Level { pin: OUT, level: Level::High });
        }
        if self.saved.is_some_and(|due| due <= at) {
            self.saved = None;
            out.put(at, Output::Store { offset: 8, bytes: &[0xC0, self.volume] });
        }
        if let Some(due) = self.next.filter(|due| *due <= at) {
            self.next = Some(due + INTERVAL);
            out.put(at, Output::Bytes { port: USB, bytes: b"." });
        }
    }

    fn peek(&self, _at: Instant, row: usize) -> i64 {
        if row == Reg::Volume as usize { i64::from(self.volume) } else { 0 }
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let value = u8::try_from(value).map_err(|_| PresetError::OutOfRange)?;
        match Reg::from_row(row) {
            Some(Reg::Volume) if value == 7 => return Err(PresetError::OutOfRange),
            Some(Reg::Volume) => {
                self.volume = value;
                out.put(at, Output::Level { pin: OUT, level: Level::Low });
            }
            Some(Reg::Number) => out.put(at, Output::Store { offset: 0, bytes: &[value] }),
            None => return Err(PresetError::NoSuchRegister),
        }
        Ok(())
    }
}
