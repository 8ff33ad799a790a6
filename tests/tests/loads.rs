//! Loads that turn the shaft of a motor at rest, compared with an independent model in f64. Each holding
//! torque is tested with loads slightly below and slightly above it, in both directions.
#![allow(missing_docs, reason = "a test")]
#![expect(clippy::float_arithmetic, reason = "the model")]

use std::f64::consts::TAU;

use drivetwin_firmware::device::Fault;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, DriveId, Motor, PinStimulus, PowerAction};
use drivetwin_sim::config::bench_file;
use drivetwin_tests::md3::{self, at, bit};

/// Bits of QuadratureEncoderConfiguration: x4, counting up to MaxCount (7.11).
const X4_MAX: u16 = 3 << 1;

/// A motor of 1 N·m at 2 A with 20 mN·m of friction, 400 g·cm² and a pull-out speed of 600 rpm. The MD3
/// drives it with 1 A and counts the 500 cycles of its encoder.
struct Fixture {
    bench: Bench,
    x: DriveId,
    motor: Motor,
    began: u16,
}

impl Fixture {
    fn new(kind: &str, steps_per_rev: u32, load_mnm: f64) -> Self {
        let text = format!(
            "line = 'fast'\n\
             [[drive]]\nname = 'x'\nkind = '{kind}'\nfast_boot = true\nlisten = []\n\
             [[motor]]\nname = 'm'\ndrive = 'x'\nsteps_per_rev = {steps_per_rev}\nholding_mnm = 1000\n\
             rated_ma = 2000\npull_out_rpm = 600\ninertia_gcm2 = 400\nfriction_mnm = 20\nload_mnm = {load_mnm}\n\
             [[encoder]]\nmotor = 'm'\ncycles_per_rev = 500\nto = {{ a = 'x.J2.10', b = 'x.J2.12' }}\n"
        );
        let layout = bench_file::parse(&text).unwrap_or_else(|error| panic!("{error}"));
        let built = layout.build(layout.settings(), Vec::new()).unwrap_or_else(|error| panic!("{error}"));
        let mut fixture = Self { bench: built.bench, x: built.drives[0], motor: built.motors[0], began: 0 };
        fixture.wait(1.millis());
        fixture.write(at::ENCODER, X4_MAX);
        fixture.write(at::MAX_COUNT, 0xFFFF);
        fixture.began = fixture.read(at::ENCODER_COUNT);
        fixture
    }

    fn wait(&mut self, span: Duration) {
        self.bench.run_until(self.bench.now() + span);
    }

    fn write(&mut self, address: u16, value: u16) {
        md3::write(&mut self.bench, self.x, address, value);
    }

    fn read(&mut self, address: u16) -> u16 {
        let reply = self.bench.ask(self.x, &rtu::read(1, address, 1));
        u16::from_be_bytes([reply[3], reply[4]])
    }

    fn low(&mut self, name: &str) {
        let pin = self.bench.spec(self.x).pin(name).unwrap();
        self.bench.set_pin(self.x, pin, PinStimulus::Low);
    }

    fn turns(&self) -> f64 {
        self.bench.turn(self.motor).revolutions
    }
}

/// Turns of a shaft that starts at rest, after `seconds`. The load above the holding torque accelerates
/// 4·10⁻⁵ kg·m², up to 10 turns/s.
fn slides(load_mnm: f64, holds_mnm: f64, seconds: f64) -> f64 {
    let by = (load_mnm.abs() - holds_mnm) * 1e-3 / 4e-5 / TAU;
    if by <= 0.0 {
        return 0.0;
    }
    let speeds_up = 10.0 / by;
    let size =
        if seconds < speeds_up { by * seconds * seconds / 2.0 } else { 10.0 * (seconds - speeds_up / 2.0) };
    -load_mnm.signum() * size
}

type Release = fn(&mut Fixture);

/// A change at the drive, and the torque in mN·m that then holds the shaft: 500 at 1 A, plus friction.
const RELEASES: &[(&str, f64, Release)] = &[
    ("cutback to 0.9 A, longer than it takes", 470.0, |fixture| {
        fixture.write(at::CURRENT_CUTBACK, 1 << 8 | 9);
    }),
    ("cutback to 0.4 A", 220.0, |fixture| fixture.write(at::CURRENT_CUTBACK, 1 << 8 | 4)),
    ("cutback to nothing", 20.0, |fixture| fixture.write(at::CURRENT_CUTBACK, 1 << 8)),
    ("0.6 A (7.2)", 320.0, |fixture| fixture.write(at::CURRENT_AND_MICROSTEPPING, 0x0306)),
    ("full steps: 71 % (7.2)", 375.0, |fixture| fixture.write(at::CURRENT_AND_MICROSTEPPING, 0x000a)),
    ("no current (7.2)", 20.0, |fixture| fixture.write(at::CURRENT_AND_MICROSTEPPING, 0x0300)),
    ("Disable (7.15)", 20.0, |fixture| fixture.write(at::MOTION, bit::DISABLE)),
    ("INHIBIT (7.8)", 20.0, |fixture| fixture.low("J2.3")),
    ("LOWCURRENT (7.8)", 270.0, |fixture| {
        fixture.write(at::HOMING, 2 << 1);
        fixture.write(at::CURRENT_CUTBACK, 5);
        fixture.low("J2.2");
    }),
    ("a fault (7.15)", 20.0, |fixture| {
        let faults = fixture.bench.spec(fixture.x).faults;
        let place = faults.iter().position(|name| *name == "over_temperature").unwrap();
        fixture.bench.fault(fixture.x, Fault(place as u8), true);
    }),
    ("power off", 20.0, |fixture| fixture.bench.power(fixture.x, PowerAction::Off)),
];

#[test]
fn a_load_turns_the_shaft_of_an_md3_when_it_exceeds_what_holds_it() {
    for &(what, holds, release) in RELEASES {
        for (kind, steps_per_rev) in [("md3", 200), ("md3-low", 400)] {
            // In the low current version the same codes mean half the current (7.2).
            let holds = if kind == "md3" { holds } else { (holds - 20.0) / 2.0 + 20.0 };
            for more in [-0.5, 0.5, 20.0] {
                for way in [1.0, -1.0] {
                    let load = way * (holds + more);
                    let mut fixture = Fixture::new(kind, steps_per_rev, load);
                    fixture.wait(200.millis());
                    assert_eq!(
                        (fixture.turns(), fixture.read(at::ENCODER_COUNT)),
                        (0.0, fixture.began),
                        "{what}: held"
                    );
                    release(&mut fixture);
                    if what.starts_with("cutback") {
                        // The cutback delay has run since power-on, so it is already over.
                        fixture.wait(1.micros());
                    }
                    let start = fixture.turns();
                    fixture.wait(100.millis());
                    let turns = fixture.turns();
                    let expected = slides(load, holds, 0.1);
                    // The drive rounds accelerations to whole steps/s², and currents to whole mA.
                    assert!(
                        (turns - expected).abs() < 0.02 * expected.abs() + 1e-4 && start.abs() < 1e-4,
                        "{kind}, {what}, {load} mN·m: {turns} turns, not {expected}"
                    );
                    assert_eq!(turns == 0.0, more < 0.0, "{kind}, {what}, {load} mN·m");
                    if what == "power off" {
                        continue;
                    }
                    let counted =
                        f64::from(fixture.read(at::ENCODER_COUNT).wrapping_sub(fixture.began).cast_signed());
                    assert!(
                        (counted.abs() - turns.abs() * 2_000.0).abs() <= 1.0,
                        "{counted} of {turns} turns"
                    );
                }
            }
        }
    }
}

/// A load that exceeds the torque at the full current turns the shaft without a change at the drive.
#[test]
fn a_load_that_is_too_heavy_turns_a_motor_at_its_current() {
    for (load, holds) in [(519.0, true), (521.0, false), (5_000.0, false), (100_000.0, false)] {
        for load in [load, -load] {
            let mut fixture = Fixture::new("md3", 200, load);
            fixture.wait(199.millis());
            let (turn, expected) = (fixture.bench.turn(fixture.motor), slides(load, 520.0, 0.2));
            assert!(
                (turn.revolutions - expected).abs() < 0.02 * expected.abs() + 1e-4,
                "{load} mN·m: {turn:?}"
            );
            assert_eq!(turn.stalled, !holds);
            // Over a longer time, too, the shaft turns at most at the pull-out speed.
            fixture.wait(5.secs());
            let rpm = fixture.bench.turn(fixture.motor).rpm;
            let fastest = if holds { 0.0 } else { -600.0 * load.signum() };
            assert!((rpm - fastest).abs() < 0.01, "{load} mN·m: {rpm} rpm");
        }
    }
}

/// After Disable ends, the current of 1 A brakes the shaft with 520 mN·m minus the load. Then the shaft
/// follows steps from the position at which it stopped.
#[test]
fn current_that_comes_back_holds_the_shaft_where_it_is() {
    for load in [120.0, -120.0] {
        let mut fixture = Fixture::new("md3", 200, load);
        fixture.wait(1.secs());
        fixture.write(at::MOTION, bit::DISABLE);
        fixture.wait(100.millis());
        let released = fixture.turns();
        assert!((released - slides(load, 20.0, 0.1)).abs() < 1e-3);
        fixture.write(at::MOTION, 0);
        fixture.wait(1.secs());
        // The load accelerates the shaft by 2,500 rad/s² for 0.1 s, to at most 10 turns/s. Then 400 mN·m
        // brake it by 10,000 rad/s², and it stops at the nearest multiple of four full steps, a fiftieth of a
        // turn.
        let speed = 2_500.0_f64 * 0.1;
        let speed = speed.min(10.0 * TAU);
        let braked = released - load.signum() * speed * speed / (2.0 * 10_000.0) / TAU;
        let stands = fixture.turns();
        assert!((stands - braked).abs() <= 0.0101, "{stands}, not {braked}");
        assert!((stands * 50.0 - (stands * 50.0).round()).abs() < 1e-6, "{stands}");
        // 1,600 microsteps of 1/8 step make a turn.
        md3::write_pair(&mut fixture.bench, fixture.x, at::MOVE_STEPS, 1_600);
        fixture.write(at::MOTION, bit::MOVE);
        fixture.wait(5.secs());
        assert!((fixture.turns() - stands - 1.0).abs() < 1e-6, "{}", fixture.turns());
        assert!(!fixture.bench.turn(fixture.motor).stalled);
    }
}

/// Every kind lists the limits of the model that a test with motor and load could notice. Limits of MCode and
/// of the Hybrid's circuitry do not apply to an MD3.
#[test]
fn each_kind_lists_the_limits_of_its_motor_model() {
    let says = |kind: &str, what: &str| {
        let device = drivetwin_sim::catalog::make(kind).unwrap();
        device.spec().not_modelled.iter().any(|line| line.contains(what))
    };
    for kind in ["md3", "md3-low", "mdrive", "mdrive-hybrid"] {
        for what in
            ["resonance", "ripple of speed", "the angle by which a load", "momentum", "detent", "the supply"]
        {
            assert!(says(kind, what), "{kind}: {what}");
        }
        for what in ["AS 2", "CA = 0,1", "SC = 1", "make-up steps", "IT, MC 5-38"] {
            assert_eq!(says(kind, what), kind == "mdrive-hybrid", "{kind}: {what}");
        }
    }
}
