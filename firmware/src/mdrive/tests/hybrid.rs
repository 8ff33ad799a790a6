//! Behaviour of a Hybrid's circuitry, with times.

use proptest::prelude::*;
use proptest::sample::select;

use super::*;

/// Bits of AF.
const LEAD: i64 = 1;
const LAG: i64 = 2;
const LOCKED: i64 = 8;
const ACTIVE: i64 = 16;
const HARDWARE: i64 = 32;
const AT_ZERO: i64 = 64;
const CALIBRATED: i64 = 128;
const FAILED: i64 = 256;

/// Counts of C2 in a full step: 1,000 lines, 200 steps.
const COUNTS: i64 = 20;
/// Steps in a full step, with MS = 256.
const STEPS: i64 = 256;

fn dut() -> Dut {
    Dut::hybrid()
}

impl Dut {
    /// AF as MCode reads it.
    fn flags(&self) -> i64 {
        self.drive.drive.reader(self.now).read_mcode(Reg::AF).into()
    }

    /// Runs for as long as `is_so` is true, a minute at most, and finds the end to the tick. Returns the
    /// duration.
    fn lasts(&mut self, is_so: impl Fn(&Self) -> bool) -> Duration {
        let begin = self.now;
        let mut step = Duration::secs(1);
        while step > Duration::ZERO {
            // A copy of the drive looks ahead.
            let mut ahead = Self::off(self.drive.clone(), self.out.memory.clone());
            ahead.now = self.now;
            ahead.wait(step);
            assert!(ahead.now.since(begin) < 60.secs(), "it lasts");
            if is_so(&ahead) {
                self.wait(step);
            } else {
                step = Duration::from_ticks(step.ticks() / 2);
            }
        }
        self.wait(Duration::TICK);
        self.now.since(begin)
    }
}

#[test]
fn a_calibration_turns_the_shaft_but_c1() {
    // MC 5-9: pause, 6 full steps forward, wait, 3 full steps back, pause; 3.12 s with CT = 250.
    let mut dut = dut();
    dut.set(Reg::CT, 250);
    let counts = dut.get(Reg::C2);
    dut.set(Reg::SC, 1);
    assert_eq!(dut.get(Reg::AF), 0);
    for (ms, full_steps) in [(249, 0), (250 + 1_581, 6), (250 + 1_580 + 249, 6), (250 + 1_580 + 250 + 791, 3)]
    {
        let at = Instant::from(Duration::millis(ms));
        dut.run_until(at);
        assert_eq!(dut.get(Reg::C2) - counts, full_steps * COUNTS, "{ms} ms");
        assert_eq!((dut.get(Reg::C1), dut.get(Reg::P)), (0, 0));
        assert_eq!((dut.get(Reg::MV), dut.get(Reg::V), dut.get(Reg::VC)), (0, 0, 0));
    }
    dut.run_until(Instant::from_ticks(Duration::millis(3_120).ticks() - 1));
    assert_eq!(dut.get(Reg::AF), 0);
    dut.run_until(Duration::millis(3_120));
    assert_eq!(dut.get(Reg::AF), AT_ZERO | CALIBRATED, "192 (MC 5-2)");
    assert_eq!((dut.get(Reg::C1), dut.get(Reg::C2) - counts), (0, 3 * COUNTS));
    assert_eq!(dut.error(), 0);
    // C1 counts the steps of a move from there on.
    dut.set(Reg::MR, 2 * 51_200);
    dut.wait(10.secs());
    assert_eq!((dut.get(Reg::C1), dut.get(Reg::C2) - counts), (2 * 51_200, 3 * COUNTS + 8_000));
}

#[test]
fn power_on_calibrates_before_the_sign_on() {
    let mut dut = Dut::off(Mdrive::hybrid(), vec![0xFF; MEMORY]);
    dut.power_on(false);
    dut.wait(400.millis());
    assert_eq!(dut.get(Reg::AF), 0);
    // With CT = 200 a calibration takes 150 ms less than with CT = 250.
    dut.run_until(Duration::millis(300 + 2_969));
    assert_eq!(dut.get(Reg::AF), 0);
    dut.run_until(Duration::millis(300 + 2_970));
    assert_eq!(dut.get(Reg::AF), AT_ZERO | CALIBRATED);
}

#[test]
fn what_calibrates() {
    let calibrates = |prepare: &dyn Fn(&mut Dut), reg, value| {
        let mut dut = dut();
        prepare(&mut dut);
        dut.wait(10.secs());
        dut.set(reg, value);
        dut.get(Reg::AF) & CALIBRATED == 0
    };
    assert!(calibrates(&|_| {}, Reg::SC, 1));
    assert!(calibrates(&|_| {}, Reg::CF, 1));
    assert!(calibrates(&|dut| dut.set(Reg::AS, 0), Reg::AS, 1));
    assert!(!calibrates(&|_| {}, Reg::AS, 1));
    assert!(calibrates(&|dut| dut.set(Reg::DE, 0), Reg::DE, 1));
    assert!(!calibrates(&|_| {}, Reg::DE, 1));
    assert!(calibrates(&|_| {}, Reg::MS, 128));
    assert!(!calibrates(&|_| {}, Reg::MS, 256));
    // Ctrl-C calibrates, too, and takes as long as power-on.
    let mut dut = Dut::off(Mdrive::hybrid(), vec![0xFF; MEMORY]);
    dut.power_on(false);
    dut.wait(5.secs());
    assert_eq!(dut.get(Reg::AF) & CALIBRATED, CALIBRATED);
    dut.connect(Link(0));
    dut.type_in(Link(0), "\x03");
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::AF) & CALIBRATED, 0);
}

#[test]
fn what_a_calibration_forbids_and_what_forbids_it() {
    let mut dut = dut();
    dut.set(Reg::SC, 1);
    // MC 9.6: error 88 for moves, error 87 for AS.
    dut.refused(&[16, 0, 0x46, 0, 2, 4, 0, 0, 0x10, 0], 4, 88);
    dut.refused(&[16, 0, 0x78, 0, 2, 4, 0, 0, 0x10, 0], 4, 88);
    dut.refused(&[16, 0, 0x8E, 0, 1, 2, 0, 1], 4, 87);
    dut.wait(4.secs());
    dut.write(0x78, 2, 5_000);
    dut.wait(1.secs());
    // In motion: error 89 for SC, error 94 for CF.
    dut.refused(&[16, 0, 0xA1, 0, 1, 2, 0, 1], 4, 89);
    dut.refused(&[16, 0, 0x93, 0, 1, 2, 0, 1], 4, 94);
    assert_eq!(dut.get(Reg::AF) & CALIBRATED, CALIBRATED);
}

#[test]
fn a_rotor_that_cannot_be_calibrated_is_given_up_after_10_s() {
    // MC 5-9: error 109, the flag is set, and the bridge is off.
    for (fault, held) in [("calibration", false), ("stall", true), ("locked_rotor", false)] {
        let mut dut = dut();
        dut.fault(fault, true);
        dut.error();
        let counts = dut.get(Reg::C2);
        let begin = dut.now;
        dut.set(Reg::CF, 1);
        assert_eq!(dut.lasts(|dut| dut.flags() & FAILED == 0), 10.secs(), "{fault}");
        assert_eq!(dut.now.since(begin), 10.secs());
        assert_eq!(dut.flags(), LOCKED | CALIBRATED | FAILED);
        // On the bus AF has one byte (FB 5.1).
        assert_eq!(dut.get(Reg::AF), LOCKED | CALIBRATED);
        assert_eq!(dut.ask(&[3, 0, 0x8F, 0, 1]), [3, 2, 0, 136]);
        assert_eq!((dut.get(Reg::LR), dut.error()), (1, 109));
        if held {
            assert_eq!(dut.get(Reg::C2), counts);
        }
        // With the bridge off the indexer runs, but the motor does not.
        let counts = dut.get(Reg::C2);
        dut.set(Reg::MR, 51_200);
        dut.wait(5.secs());
        assert_eq!((dut.get(Reg::C1), dut.get(Reg::C2)), (51_200, counts));
        // After the cause has disappeared, CF is enough.
        dut.fault(fault, false);
        dut.set(Reg::CF, 1);
        dut.wait(5.secs());
        assert_eq!((dut.get(Reg::AF), dut.get(Reg::LR)), (AT_ZERO | CALIBRATED, 0));
    }
}

#[test]
fn a_rotor_at_its_bounds_is_locked_after_lt() {
    // MC 5-10, 5-44: bounds of 1.1, 1.3, 1.5 and 1.7 full steps.
    for (bounds, tenths) in [(0, 11), (1, 13), (2, 15), (3, 17)] {
        let mut dut = dut();
        dut.set(Reg::CB, bounds);
        dut.set(Reg::LT, 65_535);
        dut.fault("stall", true);
        dut.write(0x78, 2, 1_000);
        let reaches = dut.lasts(|dut| dut.get(Reg::AF) & ACTIVE == 0);
        // The speed is 1,000 steps/s from the first tick on, because VI is the same.
        assert_eq!(dut.get(Reg::C1), STEPS * tenths / 10);
        assert_eq!(dut.get(Reg::LL), STEPS * tenths / 10);
        assert_eq!(reaches, (STEPS as u64 * tenths as u64 / 10).millis());
        dut.set(Reg::LT, 500);
        assert_eq!(dut.lasts(|dut| dut.get(Reg::LR) == 0), 500.millis());
        assert_eq!(dut.get(Reg::AF), LOCKED | CALIBRATED);
        assert_eq!(dut.error(), 104);
        // "Clear Locked Rotor Fault not allowed while in Motion"; after the stop CF calibrates.
        dut.fault("stall", false);
        dut.write(0x78, 2, 0);
        dut.wait(1.secs());
        dut.set(Reg::CF, 1);
        dut.wait(5.secs());
        assert_eq!((dut.get(Reg::AF), dut.get(Reg::LL)), (AT_ZERO | CALIBRATED, 0));
    }
}

#[test]
fn a_rotor_that_is_free_again_goes_on_and_lags() {
    let mut dut = dut();
    let counts = dut.get(Reg::C2);
    dut.fault("stall", true);
    dut.write(0x78, 2, 10_000);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::AF), ACTIVE | CALIBRATED);
    dut.fault("stall", false);
    dut.wait(1.secs());
    dut.write(0x78, 2, 0);
    dut.wait(1.secs());
    // The rotor is in step again where the field's torque repeats: every four full steps.
    let lag = dut.get(Reg::LL);
    assert_eq!(lag % (4 * STEPS), 0);
    assert!((lag - 9_500).abs() <= 2 * STEPS + 600, "{lag}");
    assert_eq!(dut.get(Reg::AF), CALIBRATED);
    assert_eq!(dut.get(Reg::C2) - counts, (dut.get(Reg::C1) - lag) * COUNTS / STEPS);
    assert_eq!(dut.error(), 0);
    // MU = n,1 clears the lag.
    dut.connect(Link(0));
    dut.type_in(Link(0), "MU=0,1\r");
    assert_eq!((dut.get(Reg::LL), dut.get(Reg::AF)), (0, AT_ZERO | CALIBRATED));
}

#[test]
fn missed_steps_are_made_up_for_at_mf_or_ss() {
    // MC 5-46, 5-50: MU 1 makes up at MF, MU 2 at SS: 10 MHz/(255 + 2) = 38,910.
    for (mode, reg, value, frequency) in [(1, Reg::MF, 1_000, 1_000), (2, Reg::SS, 255, 38_910)] {
        let mut dut = dut();
        let counts = dut.get(Reg::C2);
        dut.set(reg, value);
        dut.set(Reg::VM, 30_000);
        dut.fault("stall", true);
        dut.set(Reg::MR, 2_048);
        dut.wait(500.millis());
        assert_eq!((dut.get(Reg::LL), dut.get(Reg::C1)), (2_048, 2_048));
        dut.fault("stall", false);
        dut.wait(10.millis());
        assert_eq!((dut.get(Reg::LL), dut.get(Reg::C2) - counts), (2_048, 0), "MU is 0");
        dut.set(Reg::MU, mode);
        assert_eq!(dut.get(Reg::AF), ACTIVE | CALIBRATED);
        let took = dut.lasts(|dut| dut.get(Reg::AF) & ACTIVE != 0);
        let expected = Duration::from_ticks(16_000_000 * 2_048 / frequency);
        let off = took.max(expected) - took.min(expected);
        assert!(off <= 10.micros(), "{took:?}, {expected:?}");
        assert_eq!((dut.get(Reg::LL), dut.get(Reg::C1)), (0, 2_048));
        assert_eq!(dut.get(Reg::C2) - counts, 8 * COUNTS);
        assert_eq!(dut.get(Reg::AF), AT_ZERO | CALIBRATED);
    }
}

/// "Make up mode will be cleared when bridges are disabled and Hybrid is enabled" (MC 5-50): by DE, a locked
/// rotor and heat.
#[test]
fn make_up_is_cleared_when_the_bridge_is_disabled() {
    for mode in [1, 2] {
        for (circuitry, disables) in [
            (0, "DE"),
            (1, "DE"),
            (2, "DE"),
            (2, "DC"),
            (3, "DE"),
            (1, "locked_rotor"),
            (2, "over_temperature"),
        ] {
            let mut dut = dut();
            dut.set(Reg::AS, circuitry);
            dut.wait(5.secs());
            dut.set(Reg::MU, mode);
            dut.wait(1.secs());
            assert_eq!(dut.get(Reg::MU), mode);
            match disables {
                "DE" => dut.set(Reg::DE, 0),
                "DC" => dut.set(Reg::DC, 0x1C),
                fault => dut.fault(fault, true),
            }
            dut.wait(100.secs());
            let left = if circuitry == 0 { mode } else { 0 };
            assert_eq!(dut.get(Reg::MU), left, "AS {circuitry}, {disables}");
            // A value of MU that is written afterwards stays.
            dut.set(Reg::MU, mode);
            dut.set(Reg::HC, 6);
            assert_eq!(dut.get(Reg::MU), mode);
        }
    }
}

/// A motor of 400 mN·m holds 100 mN·m at HC 25 %, and 10 mN·m of friction help: together 110 mN·m. A load of
/// 1 mN·m more accelerates 4·10⁻⁵ kg·m² by 25 rad/s², and turns the shaft by 50 rad, or 8 revolutions, in 2
/// s. The limits of lag and lead are two revolutions. A rotor that moves at its bounds is not locked, but the
/// time counts.
#[test]
fn a_load_turns_a_rotor_at_rest() {
    for (load, way, limit) in [(109, 0, 0), (-109, 0, 0), (111, 1, 107), (-111, -1, 106)] {
        let mut dut = dut();
        dut.set(Reg::HoldingTorque, 400);
        dut.set(Reg::HC, 25);
        dut.set(Reg::LT, 5_000);
        dut.wait(3.secs());
        dut.set(Reg::Load, load);
        dut.wait(1.secs());
        // 12.5 rad, at 51,200/2π steps per radian. If the load turns the rotor back, the rotor lags.
        let lag = way * 101_859;
        assert!((dut.get(Reg::LL) - lag).abs() <= 60, "{load}: {}", dut.get(Reg::LL));
        assert_eq!(dut.get(Reg::LR), 0);
        dut.wait(1.secs());
        assert_eq!(dut.error(), limit);
        // With a lighter load MU brings the rotor back.
        dut.set(Reg::Load, 0);
        dut.set(Reg::MU, 1);
        dut.wait(3.secs());
        assert_eq!((dut.get(Reg::LL), dut.get(Reg::LR), dut.get(Reg::C1)), (0, 0, 0));
        // Without the bridge friction alone holds the rotor.
        dut.set(Reg::DE, 0);
        dut.set(Reg::Load, load.signum() * 9);
        assert_eq!(dut.turned(1.secs()), 0);
        dut.set(Reg::Load, load.signum() * 12);
        assert_eq!(dut.turned(1.secs()).signum(), -load.signum());
    }
}

#[test]
fn a_move_does_not_wait_for_make_up() {
    let mut dut = dut();
    dut.fault("stall", true);
    dut.set(Reg::MR, 2_048);
    dut.wait(500.millis());
    dut.fault("stall", false);
    dut.set(Reg::MF, 306);
    dut.set(Reg::MU, 1);
    dut.wait(1.secs());
    let left = dut.get(Reg::LL);
    assert!((2_048 - left - 306).abs() <= 2, "{left}");
    let begin = dut.get(Reg::C1);
    dut.set(Reg::MR, 51_200);
    dut.wait(100.millis());
    assert_eq!(dut.get(Reg::MV), 1);
    assert!((dut.get(Reg::LL) - left).abs() <= 1);
    dut.wait(20.secs());
    assert_eq!((dut.get(Reg::C1), dut.get(Reg::LL)), (begin + 51_200, 0));
}

#[test]
fn lag_and_lead_limits() {
    // MC 5-41: errors 107 and 106.
    for (reg, address, speed, error, bit) in
        [(Reg::LG, 0x97, 1_000, 107, LAG), (Reg::LD, 0x95, -1_000, 106, LEAD)]
    {
        let mut dut = dut();
        dut.write(address, 2, 300);
        assert_eq!(dut.get(reg), 300);
        dut.set(Reg::LT, 60_000);
        dut.fault("stall", true);
        dut.write(0x78, 2, speed);
        let took = dut.lasts(|dut| dut.get(Reg::AF) & bit == 0);
        assert_eq!(took, 300.millis());
        assert_eq!(dut.get(Reg::LL), 300 * speed.signum());
        assert_eq!(dut.error(), error);
        // The error is reported only once.
        dut.wait(100.millis());
        assert_eq!(dut.error(), 0);
    }
}

#[test]
fn faults_without_a_cause_in_the_model() {
    for (fault, bit, error) in [("lead_limit", LEAD, 106), ("lag_limit", LAG, 107)] {
        let mut dut = dut();
        dut.fault(fault, true);
        assert_eq!(dut.get(Reg::AF), AT_ZERO | CALIBRATED | bit);
        assert_eq!(dut.error(), error);
        dut.fault(fault, true);
        assert_eq!(dut.error(), 0);
        dut.fault(fault, false);
        assert_eq!(dut.get(Reg::AF), AT_ZERO | CALIBRATED);
    }
    let mut dut = dut();
    dut.fault("locked_rotor", true);
    assert_eq!((dut.get(Reg::AF), dut.get(Reg::LR), dut.error()), (LOCKED | CALIBRATED, 1, 104));
    dut.fault("locked_rotor", false);
    assert_eq!(dut.get(Reg::LR), 1, "until CF");
    dut.set(Reg::CF, 1);
    assert_eq!(dut.get(Reg::LR), 0);
}

#[test]
fn torque_mode_turns_the_rotor_without_steps() {
    let mut dut = dut();
    // 10 MHz/(198 + 2) = 50,000 steps/s.
    dut.set(Reg::TS, 198);
    dut.set(Reg::TD, 0);
    let counts = dut.get(Reg::C2);
    dut.set(Reg::AS, 3);
    assert_eq!(dut.get(Reg::AF), ACTIVE | CALIBRATED);
    dut.wait(1.secs());
    let before = dut.get(Reg::C2);
    assert!(before < counts);
    dut.wait(1.secs());
    let turned = before - dut.get(Reg::C2);
    assert!((turned - 50_000 * 4_000 / 51_200).abs() <= 1, "{turned}");
    assert_eq!((dut.get(Reg::V), dut.get(Reg::MV), dut.get(Reg::C1), dut.get(Reg::LL)), (0, 0, 0, 0));
    // "Takes effect when torque mode starts" (MC 5-72).
    dut.set(Reg::TD, 1);
    let before = dut.get(Reg::C2);
    dut.wait(100.millis());
    assert!(dut.get(Reg::C2) < before);
    // A stopped rotor is locked after LT, but the bridge stays on (MC 5-44).
    dut.fault("stall", true);
    assert_eq!(dut.lasts(|dut| dut.get(Reg::LR) == 0), 2.secs());
    assert_eq!((dut.error(), dut.get(Reg::AF)), (0, LOCKED | ACTIVE | CALIBRATED));
    dut.fault("stall", false);
    let before = dut.get(Reg::C2);
    dut.wait(100.millis());
    assert!(dut.get(Reg::C2) < before);
    assert_eq!(dut.get(Reg::LR), 0);
    // At the end of torque mode the rotor comes to standstill, and there neither lags nor leads.
    dut.set(Reg::AS, 2);
    dut.wait(100.millis());
    let counts = dut.get(Reg::C2);
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::C2), dut.get(Reg::AF)), (counts, AT_ZERO | CALIBRATED));
    dut.set(Reg::MR, 51_200);
    dut.wait(5.secs());
    assert_eq!((dut.get(Reg::C1), dut.get(Reg::C2)), (51_200, counts + 4_000));
}

/// A drive whose rotor turns at 3,000 rpm. 25 % of the torque take 1.024 s for that: 9,765 full steps/s².
fn at_full_speed() -> Dut {
    let mut dut = dut();
    dut.set(Reg::AS, 3);
    dut.wait(2.secs());
    assert_eq!(dut.turned(10.millis()), 2_000, "counts: 4,000 a turn, 50 turns/s");
    dut
}

impl Dut {
    /// Counts of C2 during this time.
    fn turned(&mut self, time: Duration) -> i64 {
        let before = self.get(Reg::C2);
        self.wait(time);
        self.get(Reg::C2) - before
    }

    /// Speed that the axis shows, in steps/s.
    fn speed(&self) -> i64 {
        self.drive.drive.motion.shaft().plan().speed_at(self.now).to_num()
    }
}

#[test]
fn a_rotor_that_was_held_begins_anew() {
    let mut dut = at_full_speed();
    dut.fault("stall", true);
    let position = dut.drive.drive.motion.shaft().plan().position_at(dut.now);
    assert_eq!((dut.turned(3.secs()), dut.speed(), dut.get(Reg::LR)), (0, 0, 1));
    assert_eq!(dut.drive.drive.motion.shaft().plan().position_at(dut.now), position);
    dut.fault("stall", false);
    assert_eq!((dut.speed(), dut.get(Reg::LR)), (0, 0));
    // 9,765 full steps/s²: 2.4 counts in 5 ms, 976 in 100 ms, and full speed after 1.024 s.
    assert!((1..=4).contains(&dut.turned(5.millis())));
    let turned = dut.turned(95.millis());
    assert!((970..=977).contains(&turned), "{turned}");
    dut.wait(930.millis());
    assert_eq!((dut.turned(10.millis()), dut.speed()), (2_000, 2_560_000));
}

#[test]
fn what_ends_torque_mode_brakes_the_rotor() {
    for mode in [2, 1, 0] {
        let mut dut = at_full_speed();
        dut.set(Reg::AS, mode);
        assert_eq!(dut.get(Reg::AF), ACTIVE | CALIBRATED);
        // RC is 25 %: the rotor stops in 1.024 s, after 102,400 counts.
        assert!((1_955..=2_000).contains(&dut.turned(10.millis())));
        dut.refused(&[16, 0, 0xA1, 0, 1, 2, 0, 1], 4, 89);
        dut.refused(&[16, 0, 0x93, 0, 1, 2, 0, 1], 4, 94);
        dut.refused(&[16, 0, 0x76, 0, 1, 2, 0, 1], 4, 73);
        dut.refused(&[16, 0, 0x48, 0, 1, 2, 0, 128], 4, 89);
        let turned = dut.turned(1_020.millis());
        assert!((100_390..=100_450).contains(&turned), "{turned}");
        let at_zero = if mode == 0 { 0 } else { AT_ZERO };
        assert_eq!((dut.turned(1.secs()), dut.get(Reg::AF), dut.get(Reg::LL)), (0, at_zero | CALIBRATED, 0));
        dut.set(Reg::S, 1);
    }
}

#[test]
fn a_move_waits_for_the_rotor() {
    let mut dut = at_full_speed();
    dut.set(Reg::MR, 51_200);
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::MV), dut.get(Reg::C1)), (0, 0), "torque mode makes no steps");
    dut.set(Reg::AS, 2);
    dut.set(Reg::MR, 51_200);
    assert_eq!((dut.get(Reg::MV), dut.get(Reg::MP)), (1, 1));
    dut.wait(1_030.millis());
    let counts = dut.get(Reg::C2);
    dut.wait(2.secs());
    assert_eq!((dut.get(Reg::C1), dut.get(Reg::MV)), (51_200, 0));
    assert!((3_990..=4_000).contains(&(dut.get(Reg::C2) - counts)));
}

#[test]
fn without_a_bridge_the_rotor_coasts() {
    let mut dut = at_full_speed();
    dut.set(Reg::DE, 0);
    // 10 mN·m at 400 g·cm²: 7,950 full steps/s², standstill in 1.258 s, after 125,786 counts.
    assert!((1_960..=2_000).contains(&dut.turned(10.millis())));
    dut.refused(&[16, 0, 0x1C, 0, 1, 2, 0, 1], 4, 89);
    let turned = dut.turned(1_260.millis());
    assert!((123_780..=123_850).contains(&turned), "{turned}");
    assert_eq!(dut.turned(1.secs()), 0);
    dut.set(Reg::DE, 1);
    assert_eq!(dut.get(Reg::AF), 0, "it calibrates");
    // With more friction the rotor stops earlier.
    let mut dut = at_full_speed();
    dut.set(Reg::Friction, 100);
    dut.set(Reg::DE, 0);
    dut.wait(130.millis());
    assert_eq!(dut.turned(1.secs()), 0);
}

/// The motor reaches the speed at which its torque is used up. TQ 25 of 400 mN·m is 100 mN·m. Friction takes
/// 10 mN·m of this, a tenth, so the speed is nine tenths of 3,000 rpm.
#[test]
fn a_motor_of_the_bench_turns_as_fast_as_its_torque_allows() {
    let mut dut = dut();
    dut.set(Reg::HoldingTorque, 400);
    dut.set(Reg::AS, 3);
    dut.wait(3.secs());
    let turned = dut.turned(100.millis());
    assert!((14_000..=18_000).contains(&turned), "{turned}");
    // A load that is too heavy stops the rotor, and the rotor is locked after LT. Without the load it starts
    // again.
    dut.set(Reg::Load, 105);
    assert_eq!((dut.turned(1_999.millis()), dut.get(Reg::LR)), (0, 0));
    assert_eq!((dut.turned(2.millis()), dut.get(Reg::LR)), (0, 1));
    dut.set(Reg::Load, 0);
    assert!((1..=4).contains(&dut.turned(5.millis())));
    assert_eq!(dut.get(Reg::LR), 0);
    dut.wait(3.secs());
    assert_eq!(dut.turned(100.millis()), turned);
    dut.set(Reg::AS, 2);
    dut.wait(5.secs());
    assert_eq!((dut.turned(1.secs()), dut.get(Reg::AF)), (0, AT_ZERO | CALIBRATED));
}

/// A command that waits until the rotor stands is dropped if torque mode begins again (MDRIVE-28).
#[test]
fn a_command_that_waits_ends_with_the_next_torque_mode() {
    for again in [false, true] {
        let mut dut = dut();
        dut.set(Reg::AS, 3);
        dut.wait(400.millis());
        dut.set(Reg::AS, 1);
        dut.set(Reg::SL, 5_000);
        if again {
            dut.set(Reg::AS, 3);
            dut.wait(1.secs());
            dut.set(Reg::AS, 1);
        }
        dut.wait(10.secs());
        assert_eq!(dut.get(Reg::V), if again { 0 } else { 5_000 });
    }
}

/// A move that waits for RS is not one that waits for the rotor: torque mode leaves it.
#[test]
fn torque_mode_leaves_what_a_pause_holds() {
    let ends = [false, true].map(|waits| {
        let mut dut = dut();
        dut.connect(Link(0));
        dut.set(Reg::MR, 1_000_000);
        if waits {
            dut.set(Reg::MR, 500_000);
        }
        dut.wait(300.millis());
        dut.type_in(Link(0), "PS\r");
        dut.wait(5.secs());
        for (reg, value) in [(Reg::AS, 3), (Reg::TQ, 50), (Reg::AS, 0)] {
            dut.set(reg, value);
            dut.wait(5.secs());
        }
        dut.type_in(Link(0), "RS\r");
        // The target is far from where torque has turned the rotor.
        dut.wait(200.secs());
        assert_eq!(dut.get(Reg::MV), 0);
        dut.get(Reg::C1)
    });
    assert_eq!(ends[1] - ends[0], 500_000);
}

/// The load is heavier than torque and friction. The surplus of 1 mN·m at 4·10⁻⁵ kg·m² is 25 rad/s²: in 0.2 s
/// half a radian, 318 of 4,000 counts. After the load is removed, 110 mN·m stop its 5 rad/s within 2 ms, and
/// torque turns the rotor again.
#[test]
fn a_load_turns_the_rotor_back_in_torque_mode() {
    let mut dut = dut();
    dut.set(Reg::HoldingTorque, 400);
    dut.set(Reg::Load, 105);
    dut.set(Reg::AS, 3);
    dut.wait(5.secs());
    assert_eq!(dut.turned(100.millis()), 0);
    dut.set(Reg::Load, 111);
    let turned_back = -dut.turned(200.millis());
    assert!((315..=320).contains(&turned_back), "{turned_back}");
    dut.set(Reg::Load, 0);
    dut.wait(5.millis());
    assert!(dut.turned(100.millis()) > 100);
}

/// FB 5.1: with AS 1 and 2 the rotor responds at 10 MHz/(SS + 2) at most, 38,910 steps/s with SS = 255.
#[test]
fn a_rotor_that_is_slower_than_the_motion_lags() {
    for mode in [1, 2] {
        let mut dut = dut();
        dut.set(Reg::AS, mode);
        dut.set(Reg::SS, 255);
        dut.set(Reg::VM, 100_000);
        dut.set(Reg::LG, 20_000);
        let counts = dut.get(Reg::C2);
        dut.set(Reg::MR, 100_000);
        assert_eq!(dut.get(Reg::AF), AT_ZERO | CALIBRATED);
        dut.wait(200.millis());
        let turned = dut.turned(100.millis());
        assert!((turned - 3_891 * 4_000 / 51_200).abs() <= 1, "{turned}");
        assert_eq!(dut.get(Reg::AF), ACTIVE | CALIBRATED);
        dut.wait(2.secs());
        // 61,090 steps/s for 0.90001 s, and the two ramps of 61.09 ms up to that.
        let lag = dut.get(Reg::LL);
        assert!((lag - 58_715).abs() <= 10, "{lag}");
        assert_eq!((dut.get(Reg::AF), dut.get(Reg::LR), dut.error()), (LAG | CALIBRATED, 0, 107));
        assert_eq!(dut.get(Reg::C2) - counts, (100_000 - lag) * 4_000 / 51_200);
        // Make-up is at 38,910 steps/s, too, whatever MF is.
        dut.set(Reg::MU, 1);
        let took = dut.lasts(|dut| dut.get(Reg::AF) & ACTIVE != 0);
        assert!((1_500..=1_520).contains(&(took.ticks() / 16_000)), "{took:?}");
        assert_eq!((dut.get(Reg::LL), dut.get(Reg::C2) - counts), (0, 100_000 * 4_000 / 51_200));
    }
    // Without the circuitry SS has no effect. SS = 0 is as fast as the fastest motion.
    for (mode, system) in [(0, 255), (2, 0)] {
        let mut dut = dut();
        dut.set(Reg::AS, mode);
        dut.set(Reg::SS, system);
        dut.set(Reg::VM, 5_000_000);
        dut.set(Reg::A, 50_000_000);
        dut.set(Reg::SL, 5_000_000);
        dut.wait(1.secs());
        assert_eq!(dut.turned(100.millis()), 39_063);
    }
}

/// A locked rotor ends the motion like a stall, and drops the waiting move.
#[test]
fn a_locked_rotor_ends_the_motion() {
    let mut dut = dut();
    dut.set(Reg::MR, 512_000);
    dut.wait(200.millis());
    dut.set(Reg::MR, 1_000);
    dut.fault("locked_rotor", true);
    assert_eq!((dut.get(Reg::MV), dut.error()), (0, 104));
    let steps = dut.get(Reg::C1);
    dut.wait(5.secs());
    assert_eq!((dut.get(Reg::C1), dut.get(Reg::MV), dut.get(Reg::V)), (steps, 0, 0));
}

#[test]
fn an_overheated_drive_warns_and_switches_itself_off() {
    let mut dut = dut();
    assert_eq!(dut.get(Reg::IT), 40);
    dut.set(Reg::WT, 60);
    dut.fault("over_temperature", true);
    // The temperature rises by 10 °C/s: it is above 60 °C after 2.1 s, and 90 °C after 5 s.
    dut.wait(2_099.millis());
    assert_eq!((dut.get(Reg::IT), dut.error()), (60, 0));
    dut.wait(1.millis());
    assert_eq!((dut.get(Reg::IT), dut.error()), (61, 71));
    dut.wait(2_899.millis());
    assert_eq!((dut.get(Reg::AF), dut.error()), (AT_ZERO | CALIBRATED, 0));
    dut.wait(1.millis());
    assert_eq!((dut.get(Reg::IT), dut.get(Reg::AF), dut.error()), (90, HARDWARE | CALIBRATED, 72));
    dut.wait(10.secs());
    assert_eq!(dut.get(Reg::IT), 95);
    // CF has no effect while the electronics are hot.
    dut.set(Reg::CF, 1);
    dut.wait(10.secs());
    assert_eq!(dut.get(Reg::AF), HARDWARE);
    dut.fault("over_temperature", false);
    dut.wait(10.secs());
    assert_eq!(dut.get(Reg::IT), 40);
    dut.set(Reg::CF, 1);
    dut.wait(5.secs());
    assert_eq!((dut.get(Reg::AF), dut.error()), (AT_ZERO | CALIBRATED, 0));
}

#[test]
fn without_the_circuitry_nobody_looks_after_the_rotor() {
    let mut dut = dut();
    dut.set(Reg::AS, 0);
    dut.fault("stall", true);
    dut.write(0x78, 2, 100_000);
    dut.wait(10.secs());
    assert_eq!((dut.get(Reg::AF), dut.get(Reg::LL), dut.get(Reg::LR)), (CALIBRATED, 0, 0));
    assert_eq!(dut.error(), 0);
}

#[test]
fn outputs_show_the_circuitry() {
    let mut dut = dut();
    // Types for locked rotor, Hybrid active, and make-up active (MC 5-64).
    dut.set(Reg::S1, 21 << 32);
    dut.set(Reg::S2, 24 << 32);
    dut.set(Reg::S3, 25 << 32);
    dut.fault("stall", true);
    dut.set(Reg::MR, 2_048);
    dut.wait(500.millis());
    assert_eq!([Reg::O1, Reg::O2, Reg::O3].map(|reg| dut.get(reg)), [0, 1, 0]);
    dut.fault("stall", false);
    dut.set(Reg::MF, 1_000);
    dut.set(Reg::MU, 1);
    dut.wait(100.millis());
    assert_eq!([Reg::O1, Reg::O2, Reg::O3].map(|reg| dut.get(reg)), [0, 1, 1]);
    dut.wait(5.secs());
    dut.fault("locked_rotor", true);
    assert_eq!([Reg::O1, Reg::O2, Reg::O3].map(|reg| dut.get(reg)), [1, 0, 0]);
}

#[test]
fn a_status_trips_instead_of_an_error() {
    // TA (MC 5-71) with a locked rotor.
    let mut dut = dut();
    dut.connect(Link(0));
    dut.type_in(Link(0), "PG 1\rLB K1\rR1=R1+1\rRT\rPG\rTA=4,K1\rTE=32\r");
    dut.error();
    dut.fault("locked_rotor", true);
    dut.wait(100.millis());
    assert_eq!((dut.get(Reg::R1), dut.error(), dut.get(Reg::TE)), (1, 0, 0));
    // TA for a completed calibration.
    dut.fault("locked_rotor", false);
    dut.type_in(Link(0), "TA=1,K1\rTE=32\rCF\r");
    dut.wait(5.secs());
    assert_eq!((dut.get(Reg::R1), dut.error()), (2, 0));
}

const FAULTS: [&str; 6] =
    ["stall", "locked_rotor", "lead_limit", "lag_limit", "over_temperature", "calibration"];

/// Actions of the random test.
#[derive(Clone, Debug)]
enum Act {
    Set(Reg, i64),
    Fault(&'static str, bool),
}

fn acts() -> impl Strategy<Value = Act> {
    let set = |reg, values: &'static [i64]| select(values).prop_map(move |value| Act::Set(reg, value));
    prop_oneof![
        2 => set(Reg::AS, &[0, 1, 2, 3]),
        1 => set(Reg::DE, &[0, 1]),
        1 => set(Reg::MS, &[1, 127, 256]),
        1 => set(Reg::MU, &[0, 1, 2]),
        1 => set(Reg::CB, &[0, 3]),
        1 => set(Reg::LT, &[2, 500]),
        1 => set(Reg::LG, &[0, 1, 5_000]),
        1 => set(Reg::LD, &[0, 1, 5_000]),
        1 => set(Reg::TQ, &[1, 100]),
        1 => set(Reg::TS, &[0, 255]),
        1 => set(Reg::CT, &[2, 200]),
        1 => set(Reg::P, &[0, i32::MIN as i64, i32::MAX as i64]),
        1 => set(Reg::SC, &[1]),
        1 => set(Reg::CF, &[1]),
        3 => set(Reg::SL, &[0, 5_000, -200_000, 5_000_000]),
        2 => set(Reg::MR, &[1, -10_000, 1_000_000]),
        4 => (select(&FAULTS[..]), any::<bool>()).prop_map(|(fault, on)| Act::Fault(fault, on)),
    ]
}

proptest! {
    #[test]
    fn whatever_happens_time_goes_on_and_a_healthy_rotor_is_where_the_steps_are(
        script in prop::collection::vec((0..20_000_000_u64, acts()), 0..30)
    ) {
        let mut dut = dut();
        for (later, act) in script {
            dut.wait(Duration::from_ticks(later));
            match act {
                Act::Set(reg, value) => drop(dut.try_set(reg, value)),
                Act::Fault(fault, on) => dut.fault(fault, on),
            }
            prop_assert!(dut.drive.deadline() > dut.now);
        }
        for fault in FAULTS {
            dut.fault(fault, false);
        }
        for reg in [Reg::SL, Reg::AS, Reg::DE, Reg::P] {
            // A drive that moves or calibrates refuses some of these.
            let _ = dut.try_set(reg, 0);
            dut.wait(20.secs());
        }
        for (reg, value) in [(Reg::CB, 1), (Reg::CT, 200), (Reg::MS, 256), (Reg::AS, 2), (Reg::DE, 1)] {
            dut.set(reg, value);
            dut.wait(20.secs());
        }
        prop_assert_eq!(dut.get(Reg::AF) & !(LEAD | LAG), AT_ZERO | CALIBRATED);
        let (steps, counts) = (dut.get(Reg::C1), dut.get(Reg::C2));
        dut.set(Reg::MR, 51_200);
        dut.wait(20.secs());
        prop_assert_eq!((dut.get(Reg::C1) - steps, dut.get(Reg::C2) - counts), (51_200, 4_000));
        prop_assert_eq!(dut.get(Reg::LL), 0);
    }
}

/// A load that is too heavy locks the rotor after LT (MC 5-44). If the load becomes lighter, the circuitry
/// continues.
#[test]
fn a_load_locks_the_rotor() {
    for lightens in [false, true] {
        let mut dut = dut();
        dut.set(Reg::HoldingTorque, 1_000);
        // 250 mN·m and friction hold this load at rest, but cannot turn it.
        dut.set(Reg::HC, 25);
        dut.set(Reg::Load, 255);
        dut.set(Reg::SL, 51_200);
        dut.wait(1.secs());
        assert_eq!(dut.get(Reg::AF) & (ACTIVE | LOCKED), ACTIVE);
        if lightens {
            dut.set(Reg::Load, 100);
            let counts = dut.get(Reg::C2);
            dut.wait(1.secs());
            assert!(dut.get(Reg::C2) - counts >= 3_950, "a turn in a second, from where it stands");
        }
        dut.wait(2.secs());
        assert_eq!((dut.get(Reg::LR), dut.error()), if lightens { (0, 0) } else { (1, 104) });
    }
}

/// DC and DE are neighbours. If DC counts DE down to 0, DE = 1 would calibrate (FB 5.1, CA), which is refused
/// in motion (89).
#[test]
fn one_write_does_not_calibrate_in_motion() {
    let mut dut = dut();
    let both = [16, 0, 0x1B, 0, 2, 4, 0, 0x1C, 0, 1];
    dut.set(Reg::SL, 51_200);
    dut.wait(100.millis());
    dut.refused(&both, 4, 89);
    assert_eq!((dut.get(Reg::DE), dut.get(Reg::AF) & CALIBRATED), (1, CALIBRATED), "nothing has changed");
    dut.set(Reg::SL, 0);
    dut.wait(1.secs());
    assert_eq!(dut.ask(&both), both[..5]);
    assert_eq!((dut.get(Reg::DE), dut.get(Reg::AF) & CALIBRATED), (1, 0));
}
