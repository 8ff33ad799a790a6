//! A drive and the motor that it turns, as one device.

use super::{AXIS, HALL_PINS, Motor, Parameters, Rotation};
use crate::device::{
    Axis, Boot, Context, Device, Duration, Fault, Input, Instant, Level, Output, Pin, PresetError, Shaft,
    Spec,
};

/// A drive that turns a motor.
pub trait MotorDrive: Device {
    /// The pins of its Hall sensors, which the motor drives.
    const HALLS: &'static [Pin];
    /// The fault of its list that holds the motor's shaft.
    const STALL: Option<Fault>;

    /// The motor that its registers describe.
    fn motor(&self) -> Parameters;

    /// The same, if it may have become another one since this was last asked.
    fn new_motor(&mut self) -> Option<Parameters> {
        Some(self.motor())
    }
}

/// A drive with its motor, connected by wires with a delay of a tick. The signals stay inside, except the levels of the
/// Hall sensors, which also appear at the drive's pins.
///
/// With the motor [detached](Device::detach_motor) this is the drive alone: current limit and duty are outputs, and the
/// feedback of a motor elsewhere is an input.
#[derive(Clone, Debug)]
pub struct DriveWithMotor<D> {
    drive: D,
    is_detached: bool,
    motor: Motor,
    wires: Wires,
    /// Levels of the Hall sensors that have arrived, and which of their wires are pulled to ground outside: the drive
    /// reads low there, whatever the sensor shows.
    halls: [bool; HALL_PINS.len()],
    pulled: [bool; HALL_PINS.len()],
}

/// Signals that are on their way. All were put at one instant, because earlier ones have arrived by then.
#[derive(Clone, Debug)]
struct Wires {
    due: Instant,
    current: Option<u32>,
    duty: Option<i32>,
    halls: [Option<bool>; HALL_PINS.len()],
    draws: Option<i32>,
    rotation: Option<Rotation>,
    /// The motor is another one.
    other_motor: bool,
}

impl Wires {
    const EMPTY: Self = Self {
        due: Instant::NEVER,
        current: None,
        duty: None,
        halls: [None; HALL_PINS.len()],
        draws: None,
        rotation: None,
        other_motor: false,
    };
}

/// The drive's outputs: those that go to the motor, and all others.
struct DriveOutputs<'a> {
    wires: &'a mut Wires,
    /// All of them go elsewhere.
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

/// The motor's outputs: they go to the drive, and its Hall sensors outside, too.
struct MotorOutputs<'a> {
    wires: &'a mut Wires,
    halls: &'static [Pin],
    out: &'a mut dyn Context,
}

impl Context for MotorOutputs<'_> {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::MotorCurrent { ma, .. } => self.wires.draws = Some(ma),
            Output::Rotation { rotation, .. } => self.wires.rotation = Some(rotation),
            Output::Motor { .. } => self.wires.other_motor = true,
            Output::Level { pin, level } => {
                let Some(place) = HALL_PINS.iter().position(|hall| *hall == pin) else { return };
                let Some(wire) = self.wires.halls.get_mut(place) else { return };
                *wire = Some(level == Level::High);
                if let Some(&pin) = self.halls.get(place) {
                    self.out.put(at, Output::Level { pin, level });
                }
            }
            _ => return,
        }
        self.wires.due = at + Duration::TICK;
    }

    fn memory(&self) -> &[u8] {
        &[]
    }
}

impl<D: MotorDrive> DriveWithMotor<D> {
    /// `drive` and the motor that its registers describe, at standstill.
    // Where it will be: a copy of a drive takes kilobytes of a board's stack.
    #[inline(always)]
    pub fn new(drive: D) -> Self {
        let motor = Motor::new(drive.motor());
        let (halls, pulled) = ([true; HALL_PINS.len()], [false; HALL_PINS.len()]);
        Self { drive, is_detached: false, motor, wires: Wires::EMPTY, halls, pulled }
    }

    /// Delivers the signals that have arrived by `at`.
    fn deliver_signals(&mut self, at: Instant, out: &mut dyn Context) {
        if self.wires.due > at {
            return;
        }
        let wires = core::mem::replace(&mut self.wires, Wires::EMPTY);
        let Wires { current, duty, halls, draws, rotation, other_motor, .. } = wires;
        let current = current.map(|ma| Input::CurrentLimit { axis: AXIS, ma });
        let duty = duty.map(|duty| Input::Duty { axis: AXIS, duty });
        for input in current.into_iter().chain(duty) {
            self.with_motor(out, |motor, out| motor.input(at, input, out));
        }
        let parameters = *self.motor.parameters();
        let motor = other_motor.then_some(Input::Motor { axis: AXIS, parameters: &parameters });
        let rotation = rotation.map(|rotation| Input::Rotation { axis: AXIS, rotation });
        let mut edges = [None; HALL_PINS.len()];
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

    /// The wires are due, or the motor.
    #[inline(never)]
    fn advance_motor(&mut self, at: Instant, out: &mut dyn Context) {
        self.deliver_signals(at, out);
        if self.motor.deadline() <= at {
            self.with_motor(out, |motor, out| motor.timeout(at, out));
        }
    }

    fn with_motor(&mut self, out: &mut dyn Context, does: impl FnOnce(&mut Motor, &mut dyn Context)) {
        does(&mut self.motor, &mut MotorOutputs { wires: &mut self.wires, halls: D::HALLS, out });
    }

    /// Lets the drive do something; the motor becomes the one that its registers describe then.
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

    /// The wire of a Hall sensor is pulled to ground outside, or released.
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

    /// The motor had no power since it was last looked at, and turned on as it was.
    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.wires = Wires::EMPTY;
        (self.halls, self.pulled) = ([true; HALL_PINS.len()], [false; HALL_PINS.len()]);
        if !self.is_detached {
            self.with_motor(out, |motor, out| motor.power_on(at, boot, out));
        }
        self.with_drive(at, out, |drive, out| drive.power_on(at, boot, out));
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        self.deliver_signals(at, out);
        match input {
            // That of a motor elsewhere is held there.
            Input::Fault { fault, .. } if D::STALL == Some(fault) && self.is_detached => {}
            Input::Fault { fault, on } if D::STALL == Some(fault) => {
                let input = Input::Fault { fault: super::STALL, on };
                self.with_motor(out, |motor, out| motor.input(at, input, out));
            }
            Input::Edge { pin, high } if !self.is_detached && D::HALLS.contains(&pin) => {
                self.pull(at, pin, !high, out);
            }
            // Signals between drive and motor stay inside.
            Input::CurrentLimit { axis: AXIS, .. }
            | Input::Duty { axis: AXIS, .. }
            | Input::MotorCurrent { axis: AXIS, .. }
            | Input::Motor { axis: AXIS, .. }
            | Input::Rotation { axis: AXIS, .. }
                if !self.is_detached => {}
            _ => self.with_drive(at, out, |drive, out| drive.input(at, input, out)),
        }
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
        if axis == AXIS && !self.is_detached { self.motor.shaft(at, axis) } else { None }
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
}
