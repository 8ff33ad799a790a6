//! Motors: which drives may have them, and that the order in which parts are added to a bench makes no
//! difference.

use drivetwin_firmware::motor;
use drivetwin_firmware::motor::stepper::StepperParameters;
use drivetwin_firmware::rs434::Rs434;

use super::*;

const NAMES: [&str; 3] = ["x", "a", "y"];

/// A motor that stalls from time to time.
const WEAK: StepperParameters = StepperParameters {
    holding_unm: 200_000,
    rated_ma: 1_000,
    pull_out_rpm: 300,
    friction_unm: 30_000,
    load_unm: 20_000,
    ..StepperParameters::NOMINAL
};

#[derive(Clone, Copy, Debug)]
enum Act {
    Move(usize, i64),
    Command(usize, u16),
    Speed(usize, i64),
    /// Step size and current.
    Setting(usize, i64),
    Power(usize, PowerAction),
}

/// Three MD3s with a motor each. Each motor has an encoder that is wired to the next drive, and switches that
/// are wired to the same pin of every drive.
fn turning(slots: &[usize], motors: &[usize]) -> (Bench, [DriveId; 3], [Motor; 3]) {
    let mut bench = Bench::with(Settings { seed: 7, ..Settings::default() });
    let mut drives = [DriveId(0); 3];
    for &index in slots {
        drives[index] = md3(&mut bench, NAMES[index], 1);
    }
    let mut fitted = [None; 3];
    for &index in motors {
        let is = MotorModel::Stepper(if index == 1 { WEAK } else { StepperParameters::NOMINAL });
        let motor = bench.attach_motor(["m", "l", "k"][index], drives[index], Axis(0), is).unwrap();
        let next = drives[(index + 1) % 3];
        let index_pin = Some((next, Pin(4)));
        bench.encode(
            motor,
            50 + 50 * index as u32,
            [Some((next, ENCODER_A)), Some((next, Pin(6))), index_pin],
        );
        for (n, drive) in drives.into_iter().enumerate() {
            let from = -0.1 + n as f64 / 10.0;
            let closed = Closed { above_rev: Some(from), below_rev: Some(from + 0.3) };
            bench.switch(motor, closed, (drive, J2_4));
        }
        fitted[index] = Some(motor);
    }
    (bench, drives, fitted.map(Option::unwrap))
}

fn perform(acts: &[(u64, Act)], slots: &[usize], motors: &[usize], chunk: Option<u64>) -> String {
    let (mut bench, drives, motors) = turning(slots, motors);
    let mut at = Instant::ZERO;
    let mut turns = Vec::new();
    for (wait, act) in acts.iter().copied().chain([(48_000_000, Act::Command(0, 0))]) {
        at += Duration::from_ticks(wait);
        while let Some(chunk) = chunk
            && bench.now() + Duration::from_ticks(chunk) < at
        {
            bench.run_until(bench.now() + Duration::from_ticks(chunk));
        }
        bench.run_until(at);
        // A drive without power refuses the preset.
        let mut poke = |n: usize, reg: Reg, value| {
            let _ = bench.poke(drives[n], reg as usize, value);
        };
        match act {
            Act::Move(n, steps) => {
                poke(n, Reg::MoveSteps, steps);
                poke(n, Reg::MotionControl, i64::from(MOVE));
            }
            Act::Command(n, bits) => poke(n, Reg::MotionControl, i64::from(bits)),
            Act::Speed(n, speed) => poke(n, Reg::Speed, speed),
            Act::Setting(n, setting) => poke(n, Reg::MotorCurrentAndMicrostepping, setting),
            Act::Power(n, action) => bench.power(drives[n], action),
        }
        turns.push(motors.map(|motor| bench.turn(motor)));
    }
    format!("{}# {turns:?}\n", bench.trace().to_text())
}

fn acts() -> impl Strategy<Value = Vec<(u64, Act)>> {
    let n = 0..3_usize;
    let power = prop_oneof![Just(PowerAction::Off), Just(PowerAction::On), Just(PowerAction::Cycle)];
    let act = prop_oneof![
        6 => (n.clone(), -700_i64..700).prop_map(|(n, steps)| Act::Move(n, steps)),
        3 => (n.clone(), prop_oneof![Just(JOG), Just(STOP), Just(1 << 4)]).prop_map(|(n, bits)| Act::Command(n, bits)),
        2 => (n.clone(), -9_000_i64..9_000).prop_map(|(n, speed)| Act::Speed(n, speed)),
        1 => (n.clone(), prop_oneof![Just(0x030a_i64), Just(0x000a), Just(0x0403), Just(0x200a), Just(0x0300)])
            .prop_map(|(n, setting)| Act::Setting(n, setting)),
        1 => (n, power).prop_map(|(n, power)| Act::Power(n, power)),
    ];
    let wait = prop_oneof![2 => Just(0_u64), 1 => 0..3_u64, 2 => 0..2_000_000_u64];
    proptest::collection::vec((wait, act), 1..12)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn the_order_of_drives_and_motors_changes_nothing(
        acts in acts(), slots in Just([0, 1, 2]).prop_shuffle(), motors in Just([0, 1, 2]).prop_shuffle(),
    ) {
        prop_assert_eq!(perform(&acts, &slots, &motors, None), perform(&acts, &[0, 1, 2], &[0, 1, 2], None));
    }

    #[test]
    fn polling_more_often_changes_no_motor(acts in acts(), chunk in 2_000_u64..900_000) {
        let places = [0, 1, 2];
        prop_assert_eq!(perform(&acts, &places, &places, Some(chunk)), perform(&acts, &places, &places, None));
    }

    #[test]
    fn what_motors_did_replays_without_them(acts in acts()) {
        let text = perform(&acts, &[0, 1, 2], &[0, 1, 2], None);
        let trace = Trace::parse(&text, &make).unwrap();
        prop_assert_eq!(replay::run(&trace, &make), Ok(None));
    }
}

#[test]
fn a_motor_fits_its_drive() {
    let (mut bench, [x, ..], _) = turning(&[0, 1, 2], &[0, 1, 2]);
    let add = |bench: &mut Bench, name: &str, external_motor| {
        bench
            .add_with(name, Box::new(Rs434::rs434544()), Setup { external_motor, ..Setup::default() })
            .unwrap()
    };
    let (rig, external) = (add(&mut bench, "rig", false), add(&mut bench, "apart", true));
    assert_eq!(bench.detached_motor(rig), None);
    let own = bench.detached_motor(external).unwrap();
    let brush = MotorModel::Brush(own);
    let three = MotorModel::Brush(motor::Parameters { hall_sensors: 3, ..own });
    let stepper = MotorModel::Stepper(StepperParameters::NOMINAL);
    for (name, drive, axis, is, why) in [
        (
            "two words",
            rig,
            0,
            stepper,
            "\"two words\" is not a valid name for a motor: use one word without dots",
        ),
        ("m", external, 0, brush, "the name m is in use already"),
        ("x", external, 0, brush, "the name x is in use already"),
        ("n", x, 0, stepper, "x turns a motor already, so it cannot turn n"),
        ("n", x, 1, stepper, "x has no axis 1, so it cannot turn n"),
        ("n", rig, 0, brush, "rig does not turn brush motors of a bench, and n is one"),
        ("n", external, 0, stepper, "apart turns a brush motor, and n is a stepper motor"),
        ("n", external, 0, three, "apart turns a motor with 2 Hall sensors, and n has 3"),
    ] {
        assert_eq!(bench.attach_motor(name, drive, Axis(axis), is), Err(why.to_owned()));
    }
    let motor = bench.attach_motor("n", external, Axis(0), brush).unwrap();
    assert_eq!((bench.motor_name(motor), bench.turned_by(motor)), ("n", (external, Axis(0))));
    assert_eq!(bench.motors().len(), 4);
}

#[test]
fn a_switch_has_two_ends() {
    let mut bench = Bench::with(Settings::default());
    let drive = md3(&mut bench, "x", 1);
    let motor =
        bench.attach_motor("m", drive, Axis(0), MotorModel::Stepper(StepperParameters::NOMINAL)).unwrap();
    bench.switch(motor, Closed { above_rev: Some(0.05), below_rev: Some(0.1) }, (drive, J2_4));
    bench.run_until(start());
    bench.poke(drive, Reg::MoveSteps as usize, 1_600).unwrap();
    bench.poke(drive, Reg::Speed as usize, 40_000).unwrap();
    // The switch points are 80 and 160 of 1,600 steps. At 10,000 steps/s² the motor reaches them after
    // √(2·80/10,000) s = 2,023,857.7 ticks, and after √2 times that, 2,862,167.0. The motor receives the plan
    // one tick later, and the drive receives the edges another tick later.
    bench.poke(drive, Reg::MotionControl as usize, MOVE.into()).unwrap();
    let began = bench.now();
    bench.run_until(2.secs());
    let edges: Vec<(u64, bool)> = edges(&bench, drive, began)
        .into_iter()
        .filter(|edge| edge.1 == J2_4)
        .map(|edge| (edge.0, edge.2))
        .collect();
    let low = 2_023_858 + 2_u64;
    let high = 2_862_168 + 2_u64;
    assert_eq!(edges.len(), 2, "{edges:?}");
    assert!(edges[0] == (low, false), "{edges:?}, {low}");
    assert!(edges[1] == (high, true), "{edges:?}, {high}");
}
