//! A drive and its motor as one device.

use super::{AXIS, Command, HALLS, Motor, Parameters, Plant, Report, Reports, Rotation, Sensor};
use crate::device::{
    Axis, Boot, Context, Device, Duration, Fault, Input, Instant, Level, Output, Pin, Port, PresetError,
    Shaft, Spec,
};

/// A drive with a simulated motor.
pub trait MotorDrive: Device {
    /// Input pins of the drive for the motor's Hall sensors.
    const HALLS: &'static [Pin];
    /// The drive's fault that blocks the motor's shaft.
    const STALL: Option<Fault>;

    /// Parameters of the motor, from the registers of the drive.
    fn motor(&self) -> Parameters;

    /// The parameters, if they may have changed since the last call of this function.
    fn new_motor(&mut self) -> Option<Parameters> {
        Some(self.motor())
    }
}

/// A drive with its motor, connected by wires with a delay of one tick. The signals between them stay inside
/// this device. Only the levels of the Hall sensors also appear at the drive's pins.
///
/// If the motor is [detached](Device::detach_motor), this device is only the drive: current limit and duty
/// are outputs, and the feedback of another motor is an input.
#[derive(Clone, Debug)]
pub struct DriveWithMotor<D> {
    drive: D,
    is_detached: bool,
    motor: Motor,
    wires: Wires,
    /// Levels of the Hall sensors that the drive has received, and true for each wire that is pulled to
    /// ground from outside. The drive reads low on such a wire, whatever the sensor shows.
    halls: [bool; HALLS],
    pulled: [bool; HALLS],
}

/// Signals under way between drive and motor. All of them were put at the same instant, because earlier ones
/// have already arrived.
#[derive(Clone, Debug)]
struct Wires {
    due: Instant,
    current: Option<u32>,
    duty: Option<i32>,
    halls: [Option<bool>; HALLS],
    draws: Option<i32>,
    rotation: Option<Rotation>,
    /// True if the motor's parameters have changed.
    other_motor: bool,
}

impl Wires {
    const EMPTY: Self = Self {
        due: Instant::NEVER,
        current: None,
        duty: None,
        halls: [None; HALLS],
        draws: None,
        rotation: None,
        other_motor: false,
    };
}

/// Receiver of the drive's outputs. Some go to the motor, all others outside.
struct DriveOutputs<'a> {
    wires: &'a mut Wires,
    /// True if all outputs go outside.
    is_detached: bool,
    out: &'a mut dyn Context,
}

impl Context for DriveOutputs<'_> {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::CurrentLimit { axis: AXIS, ma } if !self.is_detached => self.wires.current = Some(ma),
            Output::Duty { axis: AXIS, duty } if !self.is_detached => self.wires.duty = Some(duty),
            _ => return self.out.put(at, output),
        }
        self.wires.due = at + Duration::TICK;
    }

    fn memory(&self) -> &[u8] {
        self.out.memory()
    }
}

/// Receiver of the motor's reports. All of them go to the drive; the Hall levels also go to the drive's pins.
struct MotorReports<'a> {
    wires: &'a mut Wires,
    halls: &'static [Pin],
    out: &'a mut dyn Context,
}

impl Reports for MotorReports<'_> {
    fn report(&mut self, at: Instant, report: Report<'_>) {
        match report {
            Report::MotorCurrent(ma) => self.wires.draws = Some(ma),
            Report::Rotation(rotation) => self.wires.rotation = Some(rotation),
            Report::Motor(_) => self.wires.other_motor = true,
            Report::Level(Sensor::Hall(hall), high) => {
                let Some(wire) = self.wires.halls.get_mut(usize::from(hall)) else { return };
                *wire = Some(high);
                if let Some(&pin) = self.halls.get(usize::from(hall)) {
                    self.out
                        .put(at, Output::Level { pin, level: if high { Level::High } else { Level::Low } });
                }
            }
            Report::Level(..) => return,
        }
        self.wires.due = at + Duration::TICK;
    }
}

impl<D: MotorDrive> DriveWithMotor<D> {
    /// `drive` with the motor that its registers describe, at standstill.
    // Inlined, so that the drive is built in its final place: a copy of a drive takes kilobytes of a board's
    // stack.
    #[inline(always)]
    pub fn new(drive: D) -> Self {
        let motor = Motor::new(drive.motor());
        let (halls, pulled) = ([true; HALLS], [false; HALLS]);
        Self { drive, is_detached: false, motor, wires: Wires::EMPTY, halls, pulled }
    }

    /// Passes on the signals that have arrived by `at`.
    fn deliver_signals(&mut self, at: Instant, out: &mut dyn Context) {
        if self.wires.due > at {
            return;
        }
        let wires = core::mem::replace(&mut self.wires, Wires::EMPTY);
        let Wires { current, duty, halls, draws, rotation, other_motor, .. } = wires;
        for command in current.map(Command::CurrentLimit).into_iter().chain(duty.map(Command::Duty)) {
            self.with_motor(out, |motor, out| motor.command(at, command, out));
        }
        let parameters = *self.motor.parameters();
        let motor = other_motor.then_some(Input::Motor { axis: AXIS, parameters: &parameters });
        let rotation = rotation.map(|rotation| Input::Rotation { axis: AXIS, rotation });
        let mut edges = [None; HALLS];
        for (place, high) in halls.into_iter().enumerate() {
            let (Some(high), Some(level), Some(edge)) =
                (high, self.halls.get_mut(place), edges.get_mut(place))
            else {
                continue;
            };
            *level = high;
            if self.pulled.get(place) == Some(&false) {
                *edge = D::HALLS.get(place).map(|&pin| Input::Edge { pin, high });
            }
        }
        let draws = draws.map(|ma| Input::MotorCurrent { axis: AXIS, ma });
        for input in motor.into_iter().chain(rotation).chain(edges.into_iter().flatten()).chain(draws) {
            self.with_drive(at, out, |drive, out| drive.input(at, input, out));
        }
    }

    /// Handles a deadline of the wires or of the motor.
    #[inline(never)]
    fn advance_motor(&mut self, at: Instant, out: &mut dyn Context) {
        self.deliver_signals(at, out);
        if self.motor.deadline() <= at {
            self.with_motor(out, |motor, out| motor.timeout(at, out));
        }
    }

    fn with_motor(&mut self, out: &mut dyn Context, does: impl FnOnce(&mut Motor, &mut dyn Reports)) {
        does(&mut self.motor, &mut MotorReports { wires: &mut self.wires, halls: D::HALLS, out });
    }

    /// Calls the drive with `does`. If the drive's registers then describe another motor, changes the motor's
    /// parameters.
    fn with_drive<T>(
        &mut self,
        at: Instant,
        out: &mut dyn Context,
        does: impl FnOnce(&mut D, &mut dyn Context) -> T,
    ) -> T {
        let is_detached = self.is_detached;
        let done = does(&mut self.drive, &mut DriveOutputs { wires: &mut self.wires, is_detached, out });
        if let Some(parameters) = self.drive.new_motor()
            && !is_detached
        {
            self.set_parameters(at, parameters, out);
        }
        done
    }

    /// Handles a Hall sensor wire that is pulled to ground from outside, or released.
    #[inline(never)]
    fn pull(&mut self, at: Instant, pin: Pin, pulled: bool, out: &mut dyn Context) {
        let Some(place) = D::HALLS.iter().position(|hall| *hall == pin) else { return };
        let Some(was) = self.pulled.get_mut(place) else { return };
        if core::mem::replace(was, pulled) != pulled && self.halls.get(place) == Some(&true) {
            self.with_drive(at, out, |drive, out| drive.input(at, Input::Edge { pin, high: !pulled }, out));
        }
    }

    #[inline(never)]
    fn set_parameters(&mut self, at: Instant, parameters: Parameters, out: &mut dyn Context) {
        self.with_motor(out, |motor, out| motor.set_parameters(at, parameters, out));
    }
}

impl<D: MotorDrive> Device for DriveWithMotor<D> {
    fn spec(&self) -> &'static Spec {
        self.drive.spec()
    }

    /// Switches the power on. The motor had no power since its last call and coasted until now.
    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.wires = Wires::EMPTY;
        (self.halls, self.pulled) = ([true; HALLS], [false; HALLS]);
        if !self.is_detached {
            self.with_motor(out, |motor, out| motor.power_on(at, out));
        }
        self.with_drive(at, out, |drive, out| drive.power_on(at, boot, out));
    }

    fn power_off(&mut self, at: Instant) {
        self.wires = Wires::EMPTY;
        self.drive.power_off(at);
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        self.deliver_signals(at, out);
        match input {
            // The shaft of a detached motor is blocked by that motor's own fault.
            Input::Fault { fault, .. } if D::STALL == Some(fault) && self.is_detached => {}
            Input::Fault { fault, on } if D::STALL == Some(fault) => {
                self.with_motor(out, |motor, out| motor.set_blocked(at, on, out));
            }
            Input::Edge { pin, high } if !self.is_detached && D::HALLS.contains(&pin) => {
                self.pull(at, pin, !high, out);
            }
            // Signals between drive and motor do not come from outside.
            Input::MotorCurrent { axis: AXIS, .. }
            | Input::Motor { axis: AXIS, .. }
            | Input::Rotation { axis: AXIS, .. }
                if !self.is_detached => {}
            _ => self.with_drive(at, out, |drive, out| drive.input(at, input, out)),
        }
    }

    fn receives_from(&self) -> Instant {
        self.drive.receives_from()
    }

    fn is_for_others(&self, at: Instant, port: Port, address: u8) -> bool {
        self.drive.is_for_others(at, port, address)
    }

    fn deadline(&self) -> Instant {
        // A detached motor stands still, so its deadline does not matter.
        self.wires.due.min(self.drive.deadline()).min(self.motor.deadline())
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.wires.due <= at || self.motor.deadline() <= at {
            self.advance_motor(at, out);
        }
        self.with_drive(at, out, |drive, out| drive.timeout(at, out));
    }

    fn peek(&self, at: Instant, row: usize) -> i64 {
        self.drive.peek(at, row)
    }

    fn peek_word(&self, at: Instant, row: usize, word: usize) -> u16 {
        self.drive.peek_word(at, row, word)
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        self.deliver_signals(at, out);
        self.with_drive(at, out, |drive, out| drive.poke(at, row, value, out))
    }

    fn shaft(&self, at: Instant, axis: Axis) -> Option<Shaft> {
        if axis == AXIS && !self.is_detached { self.motor.shaft(at) } else { None }
    }

    fn internal_motor(&self) -> Option<Parameters> {
        Some(self.drive.motor())
    }

    fn detach_motor(&mut self) -> Option<&'static [Pin]> {
        self.is_detached = true;
        Some(D::HALLS)
    }

    fn microsteps(&self, axis: Axis) -> u16 {
        self.drive.microsteps(axis)
    }

    fn program_line(&self) -> Option<u16> {
        self.drive.program_line()
    }
}
