//! Moves and velocities of an MDROBOT with its motor, commanded by its PIDs. With any values a move ends on
//! its count, and the motor turns at the commanded speed. The same holds for other motors.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Axis, Device, Duration, Fault, Instant};
use drivetwin_firmware::mdrobot::Mdrobot;
use drivetwin_firmware::motor::Parameters;
use drivetwin_firmware::testing::{Fixture, Treatment};
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, DriveId, Motor, MotorModel, Settings, Setup};
use drivetwin_sim::line::LineMode;
use proptest::prelude::*;

/// A controller that has been on for half a second after its start-up.
fn controller() -> Fixture<impl Device> {
    let mut dut = Fixture::new(Mdrobot::md400()).ruled(|_| Treatment::Ignore).ready();
    dut.wait(Duration::millis(500));
    dut
}

/// Position of the shaft, in counts.
fn counts_of(dut: &Fixture<impl Device>) -> i64 {
    dut.drive.shaft(dut.now, Axis(0)).unwrap().position.into()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, max_shrink_iters: 50, ..ProptestConfig::default() })]

    /// Near the goal the speed is PV_GAIN, 20 rpm, per count of error. With 4 poles the error falls by the
    /// factor e in 60/(20·3·4) s.
    #[test]
    fn a_move_ends_on_its_count(count in -2_000..2_001_i64, rpm in 60..3_001_i64, load in 50..201_i64) {
        let mut dut = controller();
        dut.set_named("MAX_RPM", rpm);
        dut.set_named("MAX_LOAD", load);
        dut.set_named("UI_COM", 1);
        let shaft = counts_of(&dut);
        dut.set_named("POSI_CMD", count);
        let turns = count.unsigned_abs() / 12;
        dut.wait(Duration::millis(60_000 * turns / rpm.unsigned_abs() + 60_000 / rpm.unsigned_abs() + 5_000));
        let position = dut.get_named("POSI_DATA");
        prop_assert!((position - count).abs() <= 1, "{} for {}", position, count);
        prop_assert_eq!(counts_of(&dut) - shaft, position);
        prop_assert_eq!((dut.get_named("RPM_DATA"), dut.get_named("CTRL_STATUS")), (0, 0));
    }

    /// The reported speed is the commanded one in every ms, and the distance turned agrees. A turn is 12
    /// counts.
    #[test]
    fn the_reported_speed_is_the_commanded_one(rpm in 100..2_501_i64, back in any::<bool>(), slow in 0..300_i64) {
        let rpm = if back { -rpm } else { rpm };
        let mut dut = controller();
        for (name, value) in [("SLOW_START", slow), ("UI_COM", 1), ("START_STOP", 1), ("VEL_CMD", rpm)] {
            dut.set_named(name, value);
        }
        // SLOW_START 1,023 is 15 s for MAX_RPM, 3,000.
        dut.wait(Duration::millis((rpm.unsigned_abs() * slow.unsigned_abs() * 5).div_ceil(1_023) + 2_000));
        let shaft = counts_of(&dut);
        for _ in 0..2_000 {
            dut.wait(Duration::millis(1));
            let off = (dut.get_named("RPM_DATA") - rpm).abs();
            prop_assert!(off <= (rpm.abs() / 100).max(2), "{} for {}", dut.get_named("RPM_DATA"), rpm);
        }
        let ideal = rpm * 12 * 2 / 60;
        prop_assert!((counts_of(&dut) - shaft - ideal).abs() <= ideal.abs() / 100 + 2);
        prop_assert_eq!(dut.get_named("CTRL_STATUS"), 0);
    }
}

/// Motors for which the gains were chosen (MDROBOT-30), each with its HALL_TYPE.
fn motors() -> impl Strategy<Value = (i64, Parameters)> {
    (2_u16..11, 2_000..10_001_u32, 5_000..60_001_u32, 200..601_u32).prop_map(
        |(hall_pulses, inertia_gcm2, friction_unm, resistance_mohm)| {
            // p. 8 lists the numbers for 4, 6, 8 and 10 poles. For more poles HALL_TYPE is half of the poles.
            let hall_type = match hall_pulses {
                2 => 0,
                3 => 5,
                4 => 1,
                5 => 2,
                pairs => pairs.into(),
            };
            let motor = Parameters {
                // At 24 V this is 0.06 Nm/A.
                no_load_rpm: 3_820,
                hall_pulses,
                hall_sensors: 3,
                inertia_gcm2,
                friction_unm,
                resistance_mohm,
                ..Parameters::NOMINAL
            };
            (hall_type, motor)
        },
    )
}

/// The fault that blocks the shaft.
fn held(bench: &Bench, drive: DriveId) -> Fault {
    let place = bench.spec(drive).faults.iter().position(|fault| *fault == "stall").unwrap();
    Fault(place as u8)
}

/// A controller on a bench, with a motor other than its own.
struct Other {
    bench: Bench,
    seat: DriveId,
    motor: Motor,
    most_ma: u32,
}

impl Other {
    fn new((hall_type, motor): (i64, Parameters)) -> Self {
        let mut bench = Bench::with(Settings { line: LineMode::Fast, ..Settings::default() });
        let setup = Setup { external_motor: true, ..Setup::default() };
        let seat = bench.add_with("x", Box::new(Mdrobot::md400()), setup).unwrap();
        let motor = bench.attach_motor("m", seat, Axis(0), MotorModel::Brush(motor)).unwrap();
        // Blocks the shaft, because the load would turn it while the drive starts.
        bench.fault(seat, held(&bench, seat), true);
        bench.run_until(Instant::ZERO + 301.millis());
        let mut other = Self { bench, seat, motor, most_ma: 0 };
        other.write("HALL_TYPE", hall_type);
        other.write("UI_COM", 1);
        other.write("START_STOP", 1);
        other
    }

    /// Writes a command and unblocks the shaft, so that only the drive holds it.
    fn order(&mut self, name: &str, value: i64) {
        self.write(name, value);
        self.bench.fault(self.seat, held(&self.bench, self.seat), false);
    }

    fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            let until = self.bench.now() + 1.millis();
            self.bench.run_until(until);
            self.most_ma = self.most_ma.max(self.bench.motion(self.seat, Axis(0)).current_ma);
        }
    }

    fn row(&self, name: &str) -> usize {
        self.bench.spec(self.seat).find(name).unwrap().row
    }

    fn write(&mut self, name: &str, value: i64) {
        let row = self.row(name);
        self.bench.poke(self.seat, row, value).unwrap();
    }

    fn read(&self, name: &str) -> i64 {
        self.bench.peek(self.seat, self.row(name))
    }

    fn turns(&self) -> f64 {
        self.bench.turn(self.motor).revolutions
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, max_shrink_iters: 50, ..ProptestConfig::default() })]

    /// Loads are up to 0.6 Nm, half of what 20 A can carry.
    #[test]
    fn other_motors_turn_as_commanded(
        motor in motors(),
        load_unm in -600_000..600_001_i32,
        rpms in prop::collection::vec((100..2_501_i64, any::<bool>()), 3),
    ) {
        let mut other = Other::new((motor.0, Parameters { load_unm, ..motor.1 }));
        for (rpm, back) in rpms {
            let rpm = if back { -rpm } else { rpm };
            other.order("VEL_CMD", rpm);
            other.run_ms(3_000);
            let begin = other.turns();
            for _ in 0..1_000 {
                other.run_ms(1);
                let off = (other.read("RPM_DATA") - rpm).abs();
                prop_assert!(off <= (rpm.abs() / 100).max(2), "{} for {}", other.read("RPM_DATA"), rpm);
            }
            let real = (other.turns() - begin) * 60.0;
            prop_assert!((real - rpm as f64).abs() <= (rpm as f64 / 100.0).abs().max(2.0), "{} for {}", real, rpm);
            prop_assert_eq!(other.read("CTRL_STATUS"), 0);
        }
        prop_assert!(other.most_ma <= 20_000, "{} mA", other.most_ma);
    }

    /// From power-on a count of POSI_DATA is a count of the shaft, with 3 counts per pole and turn.
    #[test]
    fn other_motors_go_where_they_are_sent(
        motor in motors(),
        load_unm in prop_oneof![-600_000..600_001_i32, -5_000..5_001_i32],
        moves in prop::collection::vec((-1_000..1_001_i64, 100..2_501_i64), 3),
    ) {
        let counts = f64::from(6 * motor.1.hall_pulses);
        let mut other = Other::new((motor.0, Parameters { load_unm, ..motor.1 }));
        for (count, rpm) in moves {
            other.write("MAX_RPM", rpm);
            other.order("POSI_CMD", count);
            let way = (count - other.read("POSI_DATA")).unsigned_abs();
            // Twice the time at that speed, and time for the last counts, which PV_GAIN slows down.
            other.run_ms(2 * way * 60_000 / (6 * u64::from(motor.1.hall_pulses) * rpm.unsigned_abs()) + 4_000);
            let position = other.read("POSI_DATA");
            prop_assert!((position - count).abs() <= 1, "{} for {}", position, count);
            prop_assert!((other.turns() * counts - position as f64).abs() <= 1.0, "{} turns for {}", other.turns(), position);
            prop_assert_eq!((other.read("RPM_DATA"), other.read("CTRL_STATUS")), (0, 0));
            other.run_ms(1_000);
            prop_assert_eq!(other.read("POSI_DATA"), position);
        }
        prop_assert!(other.most_ma <= 20_000, "{} mA", other.most_ma);
    }
}
