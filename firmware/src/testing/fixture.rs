//! A device under test.

use std::vec::Vec;

use drivetwin_protocol::registers::Register;

use super::{Recorder, Rule};
use crate::device::{Boot, Device, Duration, Fault, Input, Instant, Pin, PresetError, advance};

/// A device, the record of its outputs, and the current time.
///
/// ```
/// use drivetwin_firmware::device::{Duration, Input, Port};
/// use drivetwin_firmware::md3::Md3;
/// use drivetwin_firmware::testing::Fixture;
/// use drivetwin_protocol::modbus::rtu;
///
/// let mut dut = Fixture::new(Md3::new()).ready();
/// // A character of 9600 8E1 has 11 bits.
/// let character = Duration::from_ticks(18_333);
/// // A request to read DeviceAddress, register 0x00.
/// let request = rtu::read(1, 0x00, 1);
/// let first = dut.now + character;
/// dut.input(first, Input::Bytes { port: Port(0), bytes: &request });
/// let last = first + character * (request.len() as u64 - 1);
/// // The drive replies after 3.5 characters of silence, and one more character in which no other one ends.
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
    /// The current time.
    pub now: Instant,
}

impl<D: Device> Fixture<D> {
    /// A device without power, with a new memory.
    #[must_use]
    pub fn new(drive: D) -> Self {
        let out = Recorder::new(drive.spec().memory.into());
        Self { drive, out, now: Instant::ZERO }
    }

    /// A device without power, with the memory `memory`.
    #[must_use]
    pub fn with_memory(drive: D, memory: Vec<u8>) -> Self {
        Self { drive, out: Recorder::with_memory(memory), now: Instant::ZERO }
    }

    /// The same fixture, with a rule for the outputs of the device.
    #[must_use]
    pub fn ruled(mut self, rule: Rule) -> Self {
        self.out.rule = rule;
        self
    }

    /// The same fixture, with power switched on now.
    #[must_use]
    pub fn booting(mut self) -> Self {
        self.power_on(Boot::default());
        self
    }

    /// The same fixture, with power switched on and without a start-up delay.
    #[must_use]
    pub fn ready(mut self) -> Self {
        self.power_on_fast();
        self
    }

    /// Switches the power on.
    pub fn power_on(&mut self, boot: Boot) {
        self.drive.power_on(self.now, boot, &mut self.out);
    }

    /// Switches the power on without a start-up delay.
    pub fn power_on_fast(&mut self) {
        self.power_on(Boot { fast: true, ..Boot::default() });
        self.run_until(self.now);
    }

    /// Switches the power off, and on again 1 s later without a start-up delay. Memory and record are kept.
    pub fn cycle(&mut self) {
        self.drive.power_off(self.now);
        self.now += Duration::secs(1);
        self.power_on_fast();
    }

    /// Handles all deadlines up to and including `at`.
    pub fn run_until(&mut self, at: impl Into<Instant>) {
        self.now = at.into();
        advance(&mut self.drive, self.now, core::iter::empty(), &mut self.out);
    }

    /// Lets `span` pass.
    pub fn wait(&mut self, span: Duration) {
        self.run_until(self.now + span);
    }

    /// Passes an input to the device at `at`, after all deadlines before `at`.
    pub fn input(&mut self, at: Instant, input: Input<'_>) {
        self.now = at;
        advance(&mut self.drive, at, core::iter::once((at, input)), &mut self.out);
    }

    /// Passes an input to the device now.
    pub fn feed(&mut self, input: Input<'_>) {
        self.input(self.now, input);
    }

    /// Sets the level of a pin now.
    pub fn edge(&mut self, pin: Pin, high: bool) {
        self.feed(Input::Edge { pin, high });
    }

    /// Sets or clears the cause of a fault of the device now.
    ///
    /// # Panics
    /// The device has no fault of this name.
    #[track_caller]
    pub fn fault(&mut self, name: &str, on: bool) {
        let place = self.drive.spec().faults.iter().position(|known| *known == name).unwrap();
        self.feed(Input::Fault { fault: Fault(place as u8), on });
    }

    /// Value of a register at the current time.
    pub fn get(&self, register: impl Register) -> i64 {
        self.drive.peek(self.now, register.row())
    }

    /// Presets a register now, without the bus.
    ///
    /// # Panics
    /// The device refuses the value.
    #[track_caller]
    pub fn set(&mut self, register: impl Register, value: i64) {
        assert_eq!(self.try_set(register, value), Ok(()), "row {} = {value}", register.row());
    }

    /// Presets a register now, without the bus.
    ///
    /// # Errors
    /// The device refuses the value.
    pub fn try_set(&mut self, register: impl Register, value: i64) -> Result<(), PresetError> {
        self.drive.poke(self.now, register.row(), value, &mut self.out)
    }

    /// Value of a register at the current time, by its name.
    ///
    /// # Panics
    /// There is no register of this name.
    #[track_caller]
    pub fn get_named(&self, name: &str) -> i64 {
        self.drive.peek(self.now, self.row(name))
    }

    /// Presets a register by its name now, without the bus.
    ///
    /// # Panics
    /// There is no register of this name, or the device refuses the value.
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
