//! A device under test.

use std::vec::Vec;

use drivetwin_protocol::registers::Register;

use super::{Recorder, Rule};
use crate::device::{Boot, Device, Duration, Fault, Input, Instant, Pin, PresetError, advance};

/// A device, the record of its outputs, and the time.
///
/// ```
/// use drivetwin_firmware::device::{Duration, Input, Port};
/// use drivetwin_firmware::md3::Md3;
/// use drivetwin_firmware::testing::Fixture;
/// use drivetwin_protocol::modbus::rtu;
///
/// let mut dut = Fixture::new(Md3::new()).ready();
/// // A character of 9600 8E1 are 11 bits.
/// let character = Duration::from_ticks(18_333);
/// // CommandVersion, address 0.
/// let request = rtu::read(1, 0x00, 1);
/// let first = dut.now + character;
/// dut.input(first, Input::Bytes { port: Port(0), bytes: &request });
/// let last = first + character * (request.len() as u64 - 1);
/// // It replies when the line has been silent for 3.5 characters, and nobody has begun to speak in the next one.
/// let reply = last + Duration::from_ticks(64_166 + 18_333);
/// dut.run_until(reply - Duration::TICK);
/// assert_eq!(dut.out.bytes, []);
/// dut.run_until(reply);
/// assert_eq!(dut.out.bytes, [(reply, Port(0), rtu::frame(1, &[3, 2, 0, 1]).to_vec())]);
/// ```
#[derive(Clone, Debug)]
pub struct Fixture<D> {
    /// The device.
    pub drive: D,
    /// Outputs and memory of the device.
    pub out: Recorder,
    /// The time.
    pub now: Instant,
}

impl<D: Device> Fixture<D> {
    /// A device without power, with a new memory.
    #[must_use]
    pub fn new(drive: D) -> Self {
        let out = Recorder::new(drive.spec().memory.into());
        Self { drive, out, now: Instant::ZERO }
    }

    /// A device without power, with this memory.
    #[must_use]
    pub fn with_memory(drive: D, memory: Vec<u8>) -> Self {
        Self { drive, out: Recorder::with_memory(memory), now: Instant::ZERO }
    }

    /// The same, with a rule of what it may put.
    #[must_use]
    pub fn ruled(mut self, rule: Rule) -> Self {
        self.out.rule = rule;
        self
    }

    /// The same, with power from now on.
    #[must_use]
    pub fn booting(mut self) -> Self {
        self.power_on(Boot::default());
        self
    }

    /// The same, with power, and without the start-up delay.
    #[must_use]
    pub fn ready(mut self) -> Self {
        self.power_on_fast();
        self
    }

    /// Power comes.
    pub fn power_on(&mut self, boot: Boot) {
        self.drive.power_on(self.now, boot, &mut self.out);
    }

    /// Power comes, and the device is ready at once.
    pub fn power_on_fast(&mut self) {
        self.power_on(Boot { fast: true, ..Boot::default() });
        self.run_until(self.now);
    }

    /// Power goes, and comes again 1 s later; the device is ready at once. Memory and record stay.
    pub fn cycle(&mut self) {
        self.now += Duration::secs(1);
        self.power_on_fast();
    }

    /// All that is due until `at`, and at it.
    pub fn run_until(&mut self, at: impl Into<Instant>) {
        self.now = at.into();
        advance(&mut self.drive, self.now, core::iter::empty(), &mut self.out);
    }

    /// Time passes.
    pub fn wait(&mut self, span: Duration) {
        self.run_until(self.now + span);
    }

    /// Gives the device an input at that time, after all deadlines before it.
    pub fn input(&mut self, at: Instant, input: Input<'_>) {
        self.now = at;
        advance(&mut self.drive, at, core::iter::once((at, input)), &mut self.out);
    }

    /// Gives the device an input now.
    pub fn feed(&mut self, input: Input<'_>) {
        self.input(self.now, input);
    }

    /// A level at a pin, now.
    pub fn edge(&mut self, pin: Pin, high: bool) {
        self.feed(Input::Edge { pin, high });
    }

    /// A fault of its list comes or goes, now.
    ///
    /// # Panics
    /// It has none of that name.
    #[track_caller]
    pub fn fault(&mut self, name: &str, on: bool) {
        let place = self.drive.spec().faults.iter().position(|known| *known == name).unwrap();
        self.feed(Input::Fault { fault: Fault(place as u8), on });
    }

    /// A register as it reads now.
    pub fn get(&self, register: impl Register) -> i64 {
        self.drive.peek(self.now, register.row())
    }

    /// Presets a register, past the bus, now.
    ///
    /// # Panics
    /// The device refuses it.
    #[track_caller]
    pub fn set(&mut self, register: impl Register, value: i64) {
        assert_eq!(self.try_set(register, value), Ok(()), "row {} = {value}", register.row());
    }

    /// The same, if the device accepts it.
    ///
    /// # Errors
    /// The device refuses it.
    pub fn try_set(&mut self, register: impl Register, value: i64) -> Result<(), PresetError> {
        self.drive.poke(self.now, register.row(), value, &mut self.out)
    }

    /// A register as it reads now, by its name.
    ///
    /// # Panics
    /// There is none of that name.
    #[track_caller]
    pub fn get_named(&self, name: &str) -> i64 {
        self.drive.peek(self.now, self.row(name))
    }

    /// Presets a register by its name, past the bus, now.
    ///
    /// # Panics
    /// There is none of that name, or the device refuses the value.
    #[track_caller]
    pub fn set_named(&mut self, name: &str, value: i64) {
        let row = self.row(name);
        assert_eq!(self.drive.poke(self.now, row, value, &mut self.out), Ok(()), "{name} = {value}");
    }

    #[track_caller]
    fn row(&self, name: &str) -> usize {
        self.drive.spec().find(name).unwrap_or_else(|| panic!("{name}")).row
    }
}
