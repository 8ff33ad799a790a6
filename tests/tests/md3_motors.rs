//! An MD3 with a motor of the bench: loads, DC motors, encoders, and its own STEP and DIR (MD3 User Guide V1.7).
#![allow(missing_docs, reason = "a test")]

use standin_protocol::time::Span;
use standin_sim::bench::{Bench, Motor, Seat, Settings};
use standin_sim::file;
use standin_sim::layout::Built;
use standin_sim::trace::TraceKeep;
use standin_tests::md3::{at, bit};

/// A bench of the drive `x`, an MD3 that has just started, with the motor `m`.
struct Rig {
    bench: Bench,
    drive: Seat,
    motor: Motor,
}

impl Rig {
    #[track_caller]
    fn new(text: &str) -> Self {
        let layout = file::parse(text).unwrap_or_else(|error| panic!("{error}"));
        let settings = Settings { trace: TraceKeep::All, ..layout.settings() };
        let built = layout.build(settings, Vec::new()).unwrap_or_else(|error| panic!("{error}"));
        let Built { mut bench, seats, motors, .. } = built;
        bench.run_until(1.millis());
        Self { bench, drive: seats[0], motor: motors[0] }
    }

    #[track_caller]
    fn write(&mut self, address: u16, value: u16) {
        standin_tests::md3::write(&mut self.bench, self.drive, address, value);
    }

    #[track_caller]
    fn write_pair(&mut self, address: u16, value: i32) {
        standin_tests::md3::write_pair(&mut self.bench, self.drive, address, value.cast_unsigned());
    }

    fn wait_ms(&mut self, ms: u64) {
        self.bench.run_until(self.bench.now() + ms.millis());
    }

    fn turns(&self) -> f64 {
        self.bench.turn(self.motor).revolutions
    }
}

/// 1,600 microsteps are a turn of a motor of 200 steps at 1/8 (7.2). At 1 A, the factory's current, this motor holds
/// 100 mN·m.
const WEAK: &str = "holding_mnm = 300\nrated_ma = 3000\npull_out_rpm = 200000\n";

fn loaded(cutback: u16, load: &str) -> Rig {
    Rig::new(&format!(
        "line = 'fast'\n[[drive]]\nname = 'x'\nkind = 'md3'\nfast_boot = true\n\
         set = {{ CurrentCutbackSettings = {cutback} }}\n\
         [[motor]]\nname = 'm'\ndrive = 'x'\n{WEAK}{load}\n",
    ))
}

/// 7.3: the cutback lasts while nothing is commanded; 7.15: Move moves the number of steps.
#[test]
fn a_move_after_the_cutback_has_the_full_current_from_its_first_step() {
    // 0.1 to 0.9 A carry 10 to 90 of the 95 mN·m that the motor needs.
    for level in 1..=9 {
        let mut rig = loaded(0x0100 | level, "friction_mnm = 95");
        for end in [6.25, 12.5] {
            rig.wait_ms(1_000);
            assert_eq!(rig.bench.turn(rig.motor).ma, i32::from(100 * level));
            rig.write(at::MOTION, bit::MOVE);
            rig.wait_ms(4_000);
            assert_eq!(rig.turns(), end, "level {level}");
        }
    }
}

/// Each way in which a motion begins: a jog, a home cycle, and a step of pin 4.
#[test]
fn every_motion_after_the_cutback_has_the_full_current() {
    let mut rig = loaded(0x0105, "friction_mnm = 95");
    rig.wait_ms(1_000);
    rig.write(at::MOTION, bit::JOG);
    rig.wait_ms(1_000);
    rig.write(at::MOTION, bit::DECEL_STOP);
    rig.wait_ms(2_000);
    // 5,000 steps/s after half a second, and half a second to stop.
    assert_eq!((rig.turns() * 1_600.0).round(), 5_000.0);

    let mut rig = loaded(0x0105, "friction_mnm = 95");
    rig.write_pair(at::PRE_HOME_OFFSET, -1_600);
    rig.wait_ms(1_000);
    rig.write(at::MOTION, bit::HOME);
    rig.wait_ms(250);
    assert!(rig.turns() < -0.1, "{}", rig.turns());

    let mut rig = loaded(0x0105, "friction_mnm = 95");
    let pin = rig.bench.spec(rig.drive).pin("J2.4").expect("the manual has that pin");
    for n in 1..=3 {
        rig.wait_ms(1_000);
        rig.bench.set_pin(rig.drive, pin, standin_sim::bench::Driving::Low);
        rig.wait_ms(10);
        rig.bench.set_pin(rig.drive, pin, standin_sim::bench::Driving::Open);
        rig.wait_ms(10);
        assert_eq!((rig.turns() * 1_600.0).round(), f64::from(n));
    }
}
