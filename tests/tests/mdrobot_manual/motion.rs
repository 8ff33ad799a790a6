//! Gains, currents, open loop, torque, poles, and the contents of MONITOR (p. 8, p. 12 to 16; MDROBOT-18,
//! MDROBOT-27 to MDROBOT-30). The tolerances are those of a controller of this size with factory gains,
//! without load, at 24 V.

use drivetwin_protocol::time::{Duration, Span};

use crate::pid;
use crate::rig::Rig;

/// Coasting takes at least twice as long as braking, and draws no current.
#[test]
fn page_6_coasting_and_braking() {
    let stops = |pid: u16| {
        let mut rig = Rig::armed(&[]);
        rig.velocity(1_500);
        rig.assert_turns(1_500.0);
        rig.write(pid, 0);
        rig.after(1.millis());
        let (mut stopped, mut current) = (None, 0.0_f64);
        rig.watch(30.secs(), 2.millis(), |rig, t| {
            current = current.max(rig.amperes());
            if stopped.is_none() && rig.shaft() == 0.0 {
                stopped = Some(t);
            }
        });
        (stopped.expect("it stops"), current)
    };
    let (coasting, none) = stops(pid::TQ_OFF);
    let (braking, some) = stops(pid::BRAKE);
    assert!(coasting > braking * 2, "{coasting:?}, {braking:?}");
    assert!(none == 0.0 && some > 1.0, "{none} A, {some} A");
}

/// "Max. current available" (p. 15): the current exceeds MAX_LOAD by at most a tenth and 0.1 A. A lower
/// MAX_LOAD accelerates more slowly.
#[test]
fn page_15_max_load() {
    let mut before = Duration::ZERO;
    for tenths in [200_u16, 100, 50, 20, 10] {
        let mut rig = Rig::armed(&[(pid::MAX_LOAD, tenths)]);
        let limit = f64::from(tenths) / 10.0;
        let mut reached = None;
        let mut look = |rig: &mut Rig, t: Duration| {
            assert!(rig.amperes() <= limit * 1.1 + 0.1, "{} A of {limit}", rig.amperes());
            if reached.is_none() && rig.rpm() >= 900.0 {
                reached = Some(t);
            }
        };
        rig.velocity(1_000);
        rig.watch(6.secs(), 1.millis(), &mut look);
        let reached = reached.expect("900 rpm");
        assert!(reached > before, "{reached:?} with {limit} A, {before:?} with more");
        before = reached;
        // A reversal needs more current than a start.
        rig.velocity(-1_000);
        rig.watch(1.secs(), 1.millis(), |rig, _| {
            assert!(rig.amperes() <= limit * 1.1 + 0.1, "{} A of {limit}", rig.amperes());
        });
    }
    // A MAX_LOAD above 20 A limits at 20 A (MDROBOT-8).
    let mut rig = Rig::armed(&[(pid::MAX_LOAD, 1_000)]);
    assert_eq!(rig.read(pid::MAX_LOAD), 1_000);
    rig.velocity(2_500);
    rig.watch(1.secs(), 1.millis(), |rig, _| assert!(rig.amperes() <= 22.1, "{} A", rig.amperes()));
}

/// A larger gain has a larger effect; the manual gives no unit (p. 15).
#[test]
fn page_15_gains() {
    // Without gains the motor does not move.
    let mut rig = Rig::armed(&[(pid::P_GAIN, 0), (pid::I_GAIN, 0)]);
    rig.velocity(1_000);
    rig.after(2_500.millis());
    assert_eq!((rig.position(), rig.motion().position), (0, 0));
    // With P_GAIN alone an error remains, and a larger gain makes it smaller. Measured after 2.5 s, before a
    // speed that is too low raises an alarm.
    let steady = |p: u16, i: u16| {
        let mut rig = Rig::armed(&[(pid::P_GAIN, p), (pid::I_GAIN, i)]);
        rig.velocity(1_000);
        rig.after(2_500.millis());
        rig.rpm()
    };
    let [least, less, more, most] = [1, 3_000, 6_000, 20_000].map(|p| steady(p, 0));
    assert!(least < 900.0, "{least}");
    assert!(least < less && less < more && more < most && most <= 1_010.0, "{least} {less} {more} {most}");
    // With I_GAIN no error remains.
    for p in [3_000, 6_000] {
        let rpm = steady(p, 6_000);
        assert!((rpm - 1_000.0).abs() <= 10.0, "P {p}: {rpm}");
    }
}

/// I_GAIN compensates a load. Without I_GAIN the speed drops.
#[test]
fn page_15_gains_against_a_load() {
    let loaded = |p: u16, i: u16| {
        // A load of 0.12 Nm, which takes 2 A.
        let (mut rig, _) =
            Rig::turning(&[(pid::P_GAIN, p), (pid::I_GAIN, i)], |motor| motor.load_unm = 120_000);
        rig.velocity(1_000);
        rig.after(2_500.millis());
        rig.rpm()
    };
    let (alone, both) = (loaded(6_000, 0), loaded(6_000, 6_000));
    let mut rig = Rig::armed(&[(pid::I_GAIN, 0)]);
    rig.velocity(1_000);
    rig.after(2_500.millis());
    assert!((both - 1_000.0).abs() <= 10.0, "{both}");
    assert!(alone < rig.rpm() - 10.0, "{alone} with a load, {} without", rig.rpm());
}

/// "Range: -1023~1023": 1,023 is the supply voltage (MDROBOT-28). Both directions are symmetric. Twice the
/// output makes 1.6 to 2.6 times the speed.
#[test]
fn page_12_open_loop() {
    let speed = |output: i16| {
        let mut rig = Rig::armed(&[(pid::MAX_RPM, 5_000)]);
        rig.write_signed(pid::OPEN_VEL_CMD, output);
        rig.after(3.secs());
        let rpm = rig.rpm();
        assert!((rpm - rig.shaft()).abs() <= rpm.abs() * 0.02 + 2.0, "{rpm} is shown, {} is", rig.shaft());
        let shown = rig.words(pid::MONITOR, 6)[2].cast_signed();
        assert!(shown.abs_diff(output) <= 1, "the output is shown as {shown}, not {output}");
        rpm
    };
    for output in [100, 200, 400] {
        let (once, twice) = (speed(output), speed(2 * output));
        let ratio = twice / once;
        assert!((1.6..=2.6).contains(&ratio), "{once} and {twice} rpm with {output} and twice that");
        let mirrored = speed(-output);
        assert!((once + mirrored).abs() <= once * 0.01, "{once} and {mirrored}");
    }
    // 24 V at 0.06 Nm/A make 3,820 rpm, minus the effect of friction.
    let full = speed(1_023);
    assert!((3_500.0..3_820.0).contains(&full), "{full}");
    let mut rig = Rig::armed(&[]);
    rig.write_signed(pid::OPEN_VEL_CMD, 0);
    rig.assert_stands();
    // Gains have no effect on open loop.
    let mut rig = Rig::armed(&[(pid::P_GAIN, 0), (pid::I_GAIN, 0)]);
    rig.write_signed(pid::OPEN_VEL_CMD, 400);
    rig.after(3.secs());
    assert!(rig.rpm() > 800.0);
}

/// TQ_CMD 1,023 is MAX_LOAD (MDROBOT-28). TQ_DATA is in 0.1 A, with the sign of the torque (p. 12).
#[test]
fn page_12_torque() {
    let mut rig = Rig::armed(&[(pid::MAX_LOAD, 60)]);
    rig.fault("stall", true);
    for (command, tenths) in [(1_023_i16, 60_i16), (512, 30), (-512, -30), (102, 6), (-1_023, -60), (0, 0)] {
        rig.write_signed(pid::TQ_CMD, command);
        rig.after(100.millis());
        assert!(rig.signed(pid::TQ_DATA).abs_diff(tenths) <= 1, "{command}: {}", rig.signed(pid::TQ_DATA));
        assert!(
            (rig.amperes() - f64::from(tenths.abs()) / 10.0).abs() <= 0.1,
            "{command}: {} A",
            rig.amperes()
        );
    }
    // Twice the torque makes twice the acceleration, except for friction: 3 A make 0.18 Nm, minus 0.01 Nm of
    // friction, on 5e-4 kg m².
    for (command, expected) in [(512_i16, 0.17 / 5e-4), (1_023, 0.35 / 5e-4), (-512, -0.17 / 5e-4)] {
        let mut rig = Rig::armed(&[(pid::MAX_LOAD, 60)]);
        rig.write_signed(pid::TQ_CMD, command);
        rig.after(20.millis());
        let from = rig.shaft();
        rig.after(100.millis());
        let is = (rig.shaft() - from) / 0.1 * std::f64::consts::TAU / 60.0;
        assert!(
            (is - expected).abs() <= expected.abs() * 0.05,
            "{command}: {is:.0} rad/s², not {expected:.0}"
        );
    }
}

/// Speeds above MAX_RPM are read back as written. The drive limits them when it uses them (MDROBOT-18).
#[test]
fn page_16_max_rpm() {
    let mut rig = Rig::armed(&[(pid::MAX_RPM, 1_000)]);
    for rpm in [3_000, -3_000, 32_767, -32_768] {
        rig.velocity(rpm);
        assert_eq!(rig.signed(pid::VEL_CMD), rpm);
        rig.assert_turns(f64::from(rpm.signum()) * 1_000.0);
    }
    rig.write(pid::COM_TAR_SPEED, 60_000);
    assert_eq!(rig.read(pid::COM_TAR_SPEED), 60_000);
    rig.assert_turns(1_000.0);
    rig.write(pid::COM_TAR_SPEED, 0);
    rig.velocity(600);
    rig.assert_turns(600.0);
    rig.write(pid::MAX_RPM, 400);
    rig.assert_turns(400.0);
    rig.write(pid::MAX_RPM, 2_000);
    rig.assert_turns(600.0);
}

/// "Pole 4 8 10 12 2 6: no. 0 1 2 3 4 5"; from 6 on the poles are twice the number (p. 8). A turn has three
/// counts per pole.
#[test]
fn page_8_poles() {
    for (hall_type, poles) in
        [(0, 4.0), (1, 8.0), (2, 10.0), (3, 12.0), (4, 2.0), (5, 6.0), (6, 12.0), (7, 14.0), (20, 40.0)]
    {
        let mut rig = Rig::with_poles(hall_type, poles, &[]);
        rig.velocity(600);
        rig.assert_turns(600.0);
        let from = rig.position();
        rig.after(6.secs());
        let counts = f64::from(rig.position() - from);
        let expected = 60.0 * 3.0 * poles;
        assert!((counts - expected).abs() <= expected * 0.02 + 2.0, "HALL_TYPE {hall_type}: {counts} counts");
    }
}

/// HALL_TYPE does not change the motor, but what the drive assumes of the motor, from the next power-on
/// (MDROBOT-27).
#[test]
fn page_8_a_wrong_hall_type() {
    let mut rig = Rig::armed(&[]);
    rig.write(pid::HALL_TYPE, 2);
    rig.velocity(400);
    rig.after(3.secs());
    // The drive assumes 10 poles, but the motor has 4. The shaft turns 2.5 times as fast, and the drive does
    // not notice.
    assert!((rig.rpm() - 400.0).abs() <= 4.0, "{}", rig.rpm());
    let from = rig.position();
    rig.after(6.secs());
    let counts = f64::from(rig.position() - from);
    // 1,000 rpm for 6 s: 100 turns of 12 counts.
    assert!((counts - 1_200.0).abs() <= 26.0, "{counts}");
}

/// A motor with 8 poles on the bench, and a drive that is set to 8 poles.
#[test]
fn page_8_a_motor_of_the_bench() {
    let (mut rig, motor) = Rig::turning(&[(pid::HALL_TYPE, 1)], |motor| motor.hall_pulses = 4);
    rig.velocity(900);
    rig.assert_turns(900.0);
    let (counts, turns) = (rig.position(), rig.bench.turn(motor).revolutions);
    rig.after(4.secs());
    assert!((rig.bench.turn(motor).revolutions - turns - 60.0).abs() <= 1.2);
    assert!((rig.position() - counts - 60 * 24).abs() <= 30);
}

/// MONITOR has speed, current, output, low and high word of the position, and status (reported from real
/// controllers). The values are equal to those of the single PIDs.
#[test]
fn page_21_monitor() {
    let mut rig = Rig::armed(&[]);
    for rpm in [800, -800] {
        rig.velocity(rpm);
        rig.after(3.secs());
        let words = rig.words(pid::MONITOR, 6);
        assert_eq!(words[0], rig.read(pid::RPM_DATA));
        assert_eq!(words[1], rig.read(pid::TQ_DATA));
        // 1,023 makes 3,820 rpm, so 800 rpm need about 214, and a little for friction. The sign is that of
        // the speed.
        let output = words[2].cast_signed() * rpm.signum();
        assert!((200..=250).contains(&output), "{output}");
        let position = rig.words(pid::POSI_DATA, 2);
        assert_eq!(words[3..5], position[..]);
        assert_eq!(words[5], 0);
    }
    // The position needs its high word: at 40 poles 65,536 counts are 546 turns.
    let mut rig = Rig::with_poles(20, 40.0, &[]);
    rig.velocity(-2_500);
    rig.after(20.secs());
    let words = rig.words(pid::MONITOR, 6);
    assert!((words[4].cast_signed()) < -1, "{words:?}");
    let position = (u32::from(words[4]) << 16 | u32::from(words[3])).cast_signed();
    assert_eq!(position, rig.position());
    assert!((position + 100_000).abs() <= 2_500, "{position}");
}

/// RPM_DATA saturates at ±5,000 (MDROBOT-18), here because a load drives the motor faster.
#[test]
fn page_12_rpm_data_saturates() {
    for load in [-2_000_000, 2_000_000] {
        // 2 Nm on 5e-4 kg m² accelerate by 38,000 rpm/s, until the supply limits the speed at about 5,403
        // rpm.
        let (mut rig, _) = Rig::turning(&[], |motor| motor.load_unm = load);
        rig.after(5.secs());
        let sign = f64::from(-load.signum());
        assert!(rig.shaft() * sign > 5_300.0, "{}", rig.shaft());
        assert_eq!(rig.rpm(), sign * 5_000.0);
    }
}
