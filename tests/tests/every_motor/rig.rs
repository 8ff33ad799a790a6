//! A drive with its own motor or a motor of the bench.

use drivetwin_firmware::device::{Axis, Device, Duration, Fault, Pin};
use drivetwin_firmware::mdrobot::Mdrobot;
use drivetwin_firmware::motor::Parameters;
use drivetwin_firmware::rs434::Rs434;
use drivetwin_sim::bench::{
    Bench, DriveId, Motor, MotorModel, PinStimulus, PowerAction, Settings, Setup, ShaftState,
};
use drivetwin_sim::line::LineMode;
use drivetwin_sim::record::trace::Retention;

use crate::physics::Limits;

const AXIS: Axis = Axis(0);

/// Bits of CTRL_STATUS (p. 9).
pub(crate) const OVER_LOAD: i64 = 1 << 4;
/// OVER_LOAD, or the alarms that may come before it: CTRL_FAIL, INV_VEL and STALL.
pub(crate) const LIMITED: i64 = OVER_LOAD | 1 << 1 | 1 << 6 | 1 << 7;

/// The drives that turn a DC motor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Drive {
    Rs434544,
    Mdrobot,
}

impl Drive {
    /// REF_CURRENT and MAX_LOAD of a new drive are 20 A. The RS drive uses at most 0.98 of the supply
    /// (section 3). ACC 1,000 is 5,000 rps² (6.5); a VEL_CMD without SLOW_START has no ramp.
    pub(crate) fn limits(self) -> Limits {
        match self {
            Self::Rs434544 => Limits { amps: 20.0, duty: 0.98, ramp: 300_000.0 },
            Self::Mdrobot => Limits { amps: 20.0, duty: 1.0, ramp: 1e9 },
        }
    }

    fn device(self) -> Box<dyn Device> {
        match self {
            Self::Rs434544 => Box::new(Rs434::rs434544()),
            Self::Mdrobot => Box::new(Mdrobot::md400()),
        }
    }

    /// Position counts in a turn: an RS drive has four for each of its 4 pulses, an MDROBOT 3 for each of its
    /// 4 poles.
    fn counts(self) -> f64 {
        match self {
            Self::Rs434544 => 16.0,
            Self::Mdrobot => 12.0,
        }
    }
}

/// A drive with a motor, ready for commands.
pub(crate) struct Rig {
    drive: Drive,
    bench: Bench,
    seat: DriveId,
    /// `None` if the drive turns its own motor.
    motor: Option<Motor>,
}

impl Rig {
    /// A drive with a motor of the bench.
    pub(crate) fn new(drive: Drive, motor: Parameters) -> Self {
        Self::with(drive, Some(motor))
    }

    /// A drive with its own motor.
    pub(crate) fn own(drive: Drive) -> Self {
        Self::with(drive, None)
    }

    fn with(drive: Drive, motor: Option<Parameters>) -> Self {
        let settings = Settings { line: LineMode::Fast, trace: Retention::Off, ..Settings::default() };
        let mut bench = Bench::with(settings);
        let setup = Setup { external_motor: motor.is_some(), boot_fast: true, ..Setup::default() };
        let seat = bench.add_with("x", drive.device(), setup).unwrap();
        let motor = motor.map(|motor| {
            let motor = match drive {
                Drive::Rs434544 => motor,
                // HALL_TYPE 0 means 4 poles.
                Drive::Mdrobot => Parameters { hall_sensors: 3, hall_pulses: 2, ..motor },
            };
            bench.attach_motor("m", seat, AXIS, MotorModel::Brush(motor)).unwrap()
        });
        let mut rig = Self { drive, bench, seat, motor };
        rig.run(0.001);
        let settings: &[(&str, i64)] = match drive {
            Drive::Rs434544 => &[("ACC", 1_000), ("DEC", 1_000)],
            Drive::Mdrobot => &[("UI_COM", 1), ("START_STOP", 1), ("MAX_RPM", 10_000)],
        };
        for &(name, value) in settings {
            rig.write(name, value);
        }
        rig
    }

    /// A drive with a copy of its own motor, changed by `change`, as a motor of the bench.
    pub(crate) fn nominal(drive: Drive, change: impl FnOnce(Parameters) -> Parameters) -> Self {
        let mut bench = Bench::new();
        let setup = Setup { external_motor: true, ..Setup::default() };
        let seat = bench.add_with("x", drive.device(), setup).unwrap();
        Self::new(drive, change(bench.detached_motor(seat).unwrap()))
    }

    /// Pulls a pin to ground, or releases it.
    pub(crate) fn ground(&mut self, pin: &str, on: bool) {
        let pins = self.bench.spec(self.seat).pins;
        let pin = Pin(pins.iter().position(|spec| spec.name == pin).unwrap() as u8);
        self.bench.set_pin(self.seat, pin, if on { PinStimulus::Low } else { PinStimulus::Open });
    }

    /// Holds the shaft, or releases it.
    pub(crate) fn hold(&mut self, on: bool) {
        let stall = self.bench.spec(self.seat).faults.iter().position(|fault| *fault == "stall").unwrap();
        self.bench.fault(self.seat, Fault(stall as u8), on);
    }

    /// Switches the power off for `seconds`, and on again.
    pub(crate) fn cycle(&mut self, seconds: f64) {
        self.bench.power(self.seat, PowerAction::Off);
        self.run(seconds);
        self.bench.power(self.seat, PowerAction::On);
        self.run(0.001);
    }

    fn turn(&self) -> ShaftState {
        self.bench.turn(self.motor.expect("a motor of the bench"))
    }

    /// Speed of the shaft, in rpm.
    pub(crate) fn rpm(&self) -> f64 {
        self.turn().rpm
    }

    fn row(&self, name: &str) -> usize {
        self.bench.spec(self.seat).find(name).unwrap().row
    }

    pub(crate) fn write(&mut self, name: &str, value: i64) {
        let row = self.row(name);
        self.bench.poke(self.seat, row, value).unwrap_or_else(|why| panic!("{name} = {value}: {why:?}"));
    }

    pub(crate) fn read(&self, name: &str) -> i64 {
        self.bench.peek(self.seat, self.row(name))
    }

    pub(crate) fn run(&mut self, seconds: f64) {
        let until = self.bench.now() + Duration::from_ticks((seconds * 16e6) as u64);
        self.bench.run_until(until);
    }

    /// Turns forward at `rpm`.
    pub(crate) fn rotate(&mut self, rpm: i64) {
        match self.drive {
            Drive::Rs434544 => {
                self.write("SPEED", rpm);
                self.write("START_bit", 1);
            }
            Drive::Mdrobot => self.write("VEL_CMD", rpm),
        }
    }

    /// Moves by `counts`, at most at `rpm`.
    pub(crate) fn go(&mut self, counts: i64, rpm: i64) {
        match self.drive {
            Drive::Rs434544 => {
                self.write("SPEED", rpm);
                self.write("MODE_ROTATION", 2);
                self.write("OFFSET", counts);
                self.write("START_bit", 1);
            }
            Drive::Mdrobot => {
                self.write("MAX_RPM", rpm);
                let position = self.read("POSI_DATA");
                self.write("POSI_CMD", position + counts);
            }
        }
    }

    /// Longest duration of a move by `counts` at `rpm`. An MDROBOT is slow at the last counts: PV_GAIN 20 is
    /// 20 rpm, 4 counts a second, for each remaining count.
    pub(crate) fn longest(&self, counts: i64, rpm: f64) -> f64 {
        let at_speed = counts.abs() as f64 / self.drive.counts() / rpm * 60.0;
        at_speed + if self.drive == Drive::Mdrobot { 4.0 } else { 1.0 }
    }

    pub(crate) fn revolutions(&self) -> f64 {
        self.turn().revolutions
    }

    /// Position of the shaft in counts; the shaft starts in the middle of a count.
    pub(crate) fn revolutions_in_counts(&self) -> i64 {
        (self.revolutions() * self.drive.counts()).round() as i64
    }

    pub(crate) fn amps(&self) -> f64 {
        f64::from(self.turn().ma) / 1e3
    }

    pub(crate) fn position(&self) -> i64 {
        match self.drive {
            Drive::Rs434544 => self.read("CURRENT_POSITION"),
            Drive::Mdrobot => self.read("POSI_DATA"),
        }
    }

    pub(crate) fn is_moving(&self) -> bool {
        match self.drive {
            Drive::Rs434544 => self.read("STATUS") != 0,
            Drive::Mdrobot => self.read("RPM_DATA") != 0,
        }
    }

    pub(crate) fn errors(&self) -> i64 {
        match self.drive {
            Drive::Rs434544 => self.read("ERROR"),
            Drive::Mdrobot => self.read("CTRL_STATUS"),
        }
    }
}
