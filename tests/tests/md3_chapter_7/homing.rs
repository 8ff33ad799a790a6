//! Sections 7.5 to 7.7: the home cycle. At the defaults a ramp to 5,000/s takes 0.5 s and 1,250 steps. So
//! after 1 s of search the motor has made 3,750 steps.

use drivetwin_firmware::device::Instant;
use drivetwin_protocol::time::{Duration, Span};

use crate::rig::{Rig, at, bit};

/// Value of HomingConfiguration (7.5) for a homing mode.
const fn homing(mode: u16) -> u16 {
    mode << 1
}
const NEGATIVE: u16 = 1 << 4;
const ON_STARTUP: u16 = 1;

/// The pins of the home switch and of the encoder's index.
const FLAG: &str = "J2.2";
const INDEX: &str = "J2.9";

/// A ready MD3 with this HomingConfiguration; pins 4 and 5 have no function.
fn rig(configuration: u16) -> Rig {
    let mut rig = Rig::ready();
    rig.write(at::HOMING, configuration);
    rig.write(at::PINS, 0xf << 4);
    rig
}

/// Mode 0: "Motor will stop immediately (no deceleration) when the flag input is activated."
#[test]
fn section_7_5_mode_0_switch() {
    let mut rig = rig(homing(0));
    rig.command(bit::HOME);
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    rig.low(FLAG);
    rig.after(4.micros()); // the drive samples the flag within this time
    let stopped_at = rig.position();
    assert!((stopped_at - 3_750).abs() <= 1, "{stopped_at}");
    rig.assert_stands(stopped_at);
    assert_eq!((rig.motion_control(), rig.current()), (0, 1_000));
    rig.after(1.secs());
    rig.assert_stands(stopped_at); // MD3-17: homing does not reset the position
}

/// Mode 1: the motor stops with a ramp, which takes another 0.5 s and 1,250 steps.
#[test]
fn section_7_5_mode_1_switch_with_a_ramp() {
    let mut rig = rig(homing(1));
    rig.command(bit::HOME);
    rig.after(1.secs());
    rig.low(FLAG);
    rig.after(4.micros());
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.after(250.millis());
    assert!((rig.speed() - 2_500.0).abs() < 1.0, "{}", rig.speed());
    let rest = rig.until_idle();
    assert!(rest <= 250.millis() && rest >= 249.millis(), "{rest:?}");
    let stopped_at = rig.position();
    assert!((stopped_at - 5_000).abs() <= 1, "{stopped_at}");
    rig.assert_stands(stopped_at);
    assert_eq!(rig.motion_control(), 0);
}

/// The flag is found during the ramp up, at 2,500/s after 0.25 s and 312.5 steps. The ramp down takes the
/// same time and steps.
#[test]
fn section_7_5_mode_1_found_on_the_way_up() {
    let mut rig = rig(homing(1));
    rig.command(bit::HOME);
    rig.after(250.millis());
    rig.low(FLAG);
    let rest = rig.until_idle();
    assert!(rest <= 251.millis() && rest >= 249.millis(), "{rest:?}");
    assert!((rig.position() - 625).abs() <= 1, "{}", rig.position());
}

/// After the flag is found, changes of the flag during the ramp have no effect.
#[test]
fn section_7_5_mode_1_flag_let_go_during_the_ramp() {
    let mut rig = rig(homing(1));
    rig.command(bit::HOME);
    rig.after(1.secs());
    rig.low(FLAG);
    rig.after(100.millis());
    rig.open(FLAG);
    rig.after(100.millis());
    rig.low(FLAG);
    rig.until_idle();
    assert!((rig.position() - 5_000).abs() <= 1, "{}", rig.position());
}

/// Modes 2 and 3 search the index, active high. MD3-27: the search uses the level of the index, with any
/// gating, even if the counter ignores the index.
#[test]
fn section_7_5_mode_2_index() {
    for encoder in [0x0005, 0x0035, 0x0006, 0x0000] {
        let mut rig = rig(homing(2));
        rig.write(at::ENCODER, encoder);
        rig.write(at::CURRENT_CUTBACK, 5);
        rig.command(bit::HOME);
        rig.after(500.millis());
        rig.low(FLAG); // pin 2 is LOWCURRENT in this mode, not the flag
        rig.after(500.millis());
        rig.assert_on_its_way(3_750, 5_000.0);
        rig.high(INDEX);
        rig.after(4.micros());
        let stopped_at = rig.position();
        assert!((stopped_at - 3_750).abs() <= 1, "{stopped_at}");
        rig.assert_stands(stopped_at);
        assert_eq!(rig.motion_control(), 0);
    }
}

#[test]
fn section_7_5_mode_3_index_with_a_ramp() {
    let mut rig = rig(homing(3));
    rig.command(bit::HOME);
    rig.after(1.secs());
    rig.high(INDEX);
    rig.after(1.millis());
    rig.low(INDEX); // the drive has detected the index
    assert_eq!(rig.motion_control(), bit::HOME);
    let rest = rig.until_idle();
    assert!(rest <= 500.millis() && rest >= 498.millis(), "{rest:?}");
    assert!((rig.position() - 5_000).abs() <= 1, "{}", rig.position());
    assert_eq!(rig.motion_control(), 0);
}

/// MD3-18: home cycles with mode codes that the manual does not print end at once.
#[test]
fn section_7_5_modes_4_to_7_complete_at_once() {
    for mode in 4..8 {
        let mut rig = rig(homing(mode));
        assert_eq!(rig.read(at::HOMING), homing(mode));
        rig.write_long(at::HOME_OFFSET, 400);
        rig.command(bit::HOME);
        assert_eq!(rig.motion_control(), 0);
        rig.after(1.secs());
        rig.assert_stands(0);
    }
}

/// "Register 0x09 can be used to invert this pin": then the flag is inactive while low, and active when
/// released.
#[test]
fn section_7_5_an_inverted_flag() {
    let mut rig = rig(homing(0));
    rig.low(FLAG);
    rig.write(at::PINS, 0xf << 4 | 1 << 3);
    rig.command(bit::HOME);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    rig.open(FLAG);
    rig.after(4.micros());
    assert_eq!((rig.speed(), rig.motion_control()), (0.0, 0));
}

/// MD3-26: a flag that is active when the search starts ends the search at once.
#[test]
fn section_7_5_a_flag_that_is_active_already() {
    for mode in [0, 1] {
        let mut rig = rig(homing(mode));
        rig.low(FLAG);
        rig.command(bit::HOME);
        rig.after(4.micros());
        assert_eq!(rig.motion_control(), 0);
        rig.assert_stands(0);
    }
    for mode in [2, 3] {
        let mut rig = rig(homing(mode));
        rig.high(INDEX);
        rig.command(bit::HOME);
        rig.after(4.micros());
        assert_eq!(rig.motion_control(), 0);
        rig.assert_stands(0);
    }
}

/// "The switch input is sampled about every 4 microseconds": the emulated drive samples at multiples of 4 µs.
#[test]
fn section_7_5_the_flag_is_sampled_every_4_us() {
    let mut rig = rig(homing(0));
    rig.command(bit::HOME);
    rig.bench.run_until(Instant::from(4.secs() + 1.micros()));
    rig.low(FLAG);
    rig.after(2.micros());
    rig.open(FLAG); // before 4 s + 4 µs
    rig.after(10.micros());
    assert_eq!((rig.speed(), rig.motion_control()), (5_000.0, bit::HOME));
    rig.bench.run_until(Instant::from(5.secs() + 3.micros()));
    rig.low(FLAG);
    rig.after(2.micros());
    rig.open(FLAG); // after 5 s + 4 µs
    assert_eq!((rig.speed(), rig.motion_control()), (0.0, 0));
}

/// Direction 1 is negative. The sign of Speed does not matter (MD3-26).
#[test]
fn section_7_5_direction() {
    for (direction, speed, goes) in
        [(0, 5_000, 1), (NEGATIVE, 5_000, -1), (0, -5_000, 1), (NEGATIVE, -5_000, -1)]
    {
        let mut rig = rig(homing(0) | direction);
        rig.write_long(at::SPEED, speed);
        rig.command(bit::HOME);
        rig.after(1.secs());
        rig.assert_on_its_way(goes * 3_750, f64::from(goes) * 5_000.0);
    }
}

#[test]
fn section_7_5_speed_divisor() {
    for (divisor, speed) in (0..8).zip([1_280.0, 640.0, 320.0, 160.0, 80.0, 40.0, 20.0, 10.0]) {
        let mut rig = rig(homing(0) | divisor << 5);
        rig.write_long(at::SPEED, 1_280);
        rig.command(bit::HOME);
        rig.after(1.secs());
        assert_eq!(rig.speed(), speed, "divisor {divisor}");
    }
}

/// MD3-26: the divided speed keeps its fraction. 100/128 steps/s are 78.125 steps in 100 s.
#[test]
fn section_7_5_slow_searches() {
    let mut rig = rig(homing(0) | 7 << 5);
    rig.write_long(at::SPEED, 100);
    rig.command(bit::HOME);
    rig.after(100.secs());
    rig.assert_on_its_way(78, 0.781_25);
    assert_eq!(rig.position(), 78);
}

/// The divisor does not affect the acceleration. To 2,500/s at 10,000/s²: 0.25 s, 312.5 steps.
#[test]
fn section_7_5_the_acceleration_is_not_divided() {
    let mut rig = rig(homing(1) | 1 << 5);
    rig.command(bit::HOME);
    rig.after(125.millis());
    rig.assert_on_its_way(78, 1_250.0);
    rig.after(125.millis());
    rig.assert_on_its_way(312, 2_500.0);
    rig.after(750.millis());
    rig.assert_on_its_way(2_187, 2_500.0); // 312.5 + 1,875
    rig.low(FLAG);
    rig.until_idle();
    assert!((rig.position() - 2_500).abs() <= 1);
}

/// 400 steps back are a triangle: 0.2 s up to −2,000/s and 0.2 s down. The drive ignores the flag meanwhile.
#[test]
fn section_7_6_pre_home_offset() {
    let mut rig = rig(homing(0));
    rig.write_long(at::PRE_HOME_OFFSET, -400);
    rig.low(FLAG);
    rig.command(bit::HOME);
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.after(200.millis());
    rig.assert_on_its_way(-200, -2_000.0);
    rig.after(100.millis());
    rig.open(FLAG);
    rig.after(100.millis());
    assert!((rig.position() + 400).abs() <= 1);
    assert!(rig.busy());
    rig.after(1.secs()); // 1 s of search
    rig.assert_on_its_way(3_350, 5_000.0);
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.low(FLAG);
    rig.after(4.micros());
    assert_eq!(rig.motion_control(), 0);
}

/// While pin 9 is an output, the drive has no index.
#[test]
fn section_7_5_no_index_while_pin_9_is_an_output() {
    let mut rig = rig(homing(2));
    rig.write(at::PINS, 1 << 12 | 0xf << 4);
    rig.command(bit::HOME);
    rig.after(500.millis());
    rig.write(at::IO_PORT, 1 << 6);
    rig.high(INDEX);
    rig.after(500.millis());
    rig.assert_on_its_way(3_750, 5_000.0);
}

/// An index pulse that ends during the pre-home offset does not end the search.
#[test]
fn section_7_6_no_index_during_the_pre_home_offset() {
    let mut rig = rig(homing(2));
    rig.write_long(at::PRE_HOME_OFFSET, -400);
    rig.command(bit::HOME);
    rig.after(200.millis());
    rig.high(INDEX);
    rig.low(INDEX);
    rig.after(1_200.millis()); // 1 s of search
    rig.assert_on_its_way(3_350, 5_000.0);
    rig.high(INDEX);
    assert_eq!((rig.speed(), rig.motion_control()), (0.0, 0));
}

/// Offsets of 0 take no time.
#[test]
fn section_7_6_and_7_7_offsets_of_0_take_no_time() {
    let mut rig = rig(homing(0));
    rig.command(bit::HOME);
    rig.after(500.millis());
    rig.assert_on_its_way(1_250, 5_000.0);
    rig.low(FLAG);
    rig.after(4.micros());
    assert_eq!(rig.motion_control(), 0);
}

/// The home offset of 900 steps is a triangle of 2·√(900/10,000) = 0.6 s, from the position at which the
/// search stopped.
#[test]
fn section_7_7_home_offset() {
    for (mode, found_at) in [(0, 3_750), (1, 5_000)] {
        for offset in [900, -900] {
            let mut rig = rig(homing(mode));
            rig.write_long(at::HOME_OFFSET, offset);
            rig.command(bit::HOME);
            rig.after(1.secs());
            rig.low(FLAG);
            rig.after(4.micros());
            assert_eq!(rig.motion_control(), bit::HOME);
            let ramp = if mode == 1 { 500.millis() } else { Duration::ZERO };
            let rest = rig.until_idle();
            let expected = ramp + 600.millis();
            assert!(rest <= expected && rest + 1.millis() >= expected, "{rest:?}");
            assert!((rig.position() - found_at - offset).abs() <= 1, "{}", rig.position());
            assert_eq!(rig.motion_control(), 0);
        }
    }
}

/// MD3-26: both offsets and their ramps use the undivided speed. 5,000 steps take 0.5 s, 0.5 s at 5,000/s,
/// and 0.5 s.
#[test]
fn section_7_6_and_7_7_offsets_run_at_the_undivided_speed() {
    let mut rig = rig(homing(0) | 7 << 5 | NEGATIVE);
    rig.write_long(at::PRE_HOME_OFFSET, 5_000);
    rig.write_long(at::HOME_OFFSET, 5_000);
    rig.command(bit::HOME);
    rig.after(750.millis());
    rig.assert_on_its_way(2_500, 5_000.0);
    rig.after(750.millis());
    rig.after(1.secs());
    // The speed of the search is 5,000/128 = 39.0625 steps/s, which is reached in 4 ms.
    rig.assert_on_its_way(5_000 - 39, -39.0625);
    rig.low(FLAG);
    rig.after(4.micros());
    rig.after(750.millis());
    rig.assert_on_its_way(4_961 + 2_500, 5_000.0);
    rig.until_idle();
    assert!((rig.position() - 9_961).abs() <= 1);
}

/// MD3-26: an active flag ends the search at once; the drive still makes both offsets.
#[test]
fn section_7_6_and_7_7_offsets_with_an_active_flag() {
    let mut rig = rig(homing(0));
    rig.write_long(at::PRE_HOME_OFFSET, -400); // 0.4 s
    rig.write_long(at::HOME_OFFSET, 900); // 0.6 s
    rig.low(FLAG);
    rig.command(bit::HOME);
    let took = rig.until_idle();
    assert!(took >= 1.secs() && took <= 1.secs() + 8.micros(), "{took:?}");
    rig.assert_stands(500);
}

/// MD3-26: an acceleration that is written in a home cycle applies from the next part. The offset of −400
/// steps still takes 0.4 s, then the search ramps with 5,000/s² in 1 s.
#[test]
fn section_7_19_an_acceleration_written_in_a_home_cycle() {
    let mut rig = rig(homing(0));
    rig.write_long(at::PRE_HOME_OFFSET, -400);
    rig.command(bit::HOME);
    rig.after(100.millis());
    rig.write(at::ACCEL_DECEL + 1, 5_000);
    rig.after(100.millis());
    rig.assert_on_its_way(-200, -2_000.0);
    rig.after(200.millis());
    rig.after(500.millis());
    rig.assert_on_its_way(-400 + 625, 2_500.0);
}

/// A speed that is written in a home cycle applies from the next part as well (7.17 ignores it in a move).
/// The offset still reaches 2,000/s; the search runs at 1,000/s, reached in 0.1 s and 50 steps.
#[test]
fn section_7_17_a_speed_written_in_a_home_cycle() {
    let mut rig = rig(homing(0));
    rig.write_long(at::PRE_HOME_OFFSET, -400);
    rig.command(bit::HOME);
    rig.after(100.millis());
    rig.write(at::SPEED + 1, 1_000);
    rig.after(100.millis());
    rig.assert_on_its_way(-200, -2_000.0);
    rig.after(200.millis());
    rig.after(1.secs());
    rig.assert_on_its_way(-400 + 950, 1_000.0);
    rig.write(at::SPEED + 1, 3_000);
    rig.after(1.secs());
    rig.assert_on_its_way(-400 + 1_950, 1_000.0);
}

/// MD3-4: Stop and Decel-stop end the whole home cycle, without its remaining parts.
#[test]
fn section_7_15_stops_end_a_home_cycle() {
    for (seconds, begun) in [(300, "pre-home offset"), (1_400, "search")] {
        for stop in [bit::STOP, bit::DECEL_STOP, bit::DISABLE] {
            let mut rig = rig(homing(0));
            rig.write_long(at::PRE_HOME_OFFSET, -400);
            rig.write_long(at::HOME_OFFSET, 900);
            rig.command(bit::HOME);
            rig.after(seconds.millis());
            rig.command(stop);
            rig.until_idle();
            let stopped_at = rig.position();
            rig.low(FLAG);
            rig.after(5.secs());
            assert_eq!((rig.position(), rig.moving()), (stopped_at, false), "{stop:#06x} in the {begun}");
            assert_eq!(rig.motion_control(), stop & bit::DISABLE);
        }
    }
}

/// A stop in the home offset ends the home cycle, too.
#[test]
fn section_7_15_stops_end_a_home_offset() {
    let mut rig = rig(homing(0));
    rig.write_long(at::HOME_OFFSET, 900);
    rig.low(FLAG);
    rig.command(bit::HOME);
    rig.after(100.millis());
    rig.command(bit::DECEL_STOP); // at 1,000/s after 50 steps
    let rest = rig.until_idle();
    assert!(rest <= 100.millis() && rest >= 99.millis(), "{rest:?}");
    assert!((rig.position() - 100).abs() <= 1, "{}", rig.position());
}

/// MD3-26: SPEEDSEL has no effect while homing.
#[test]
fn section_7_5_speedsel_does_not_matter() {
    let mut rig = rig(homing(2));
    rig.write(at::PINS, 1 << 10 | 0xf << 4);
    rig.low("J2.2");
    rig.command(bit::HOME);
    rig.after(1.secs());
    rig.assert_on_its_way(3_750, 5_000.0);
    rig.open("J2.2");
    rig.low("J2.2");
    rig.after(1.secs());
    rig.assert_on_its_way(8_750, 5_000.0);
}

/// "Modbus serial commands still work during the home cycle" (7.8).
#[test]
fn section_7_8_commands_work_during_a_home_cycle() {
    let mut rig = rig(homing(0));
    rig.command(bit::HOME);
    rig.after(1.secs());
    rig.write(at::USER, 0x1234);
    assert_eq!(rig.read(at::USER), 0x1234);
    rig.command(bit::MOVE); // another kind of motion: ignored (MD3-4)
    rig.after(1.secs());
    rig.assert_on_its_way(8_750, 5_000.0);
    assert_eq!(rig.motion_control(), bit::HOME);
}

/// "Note that the entire homing process will take place automatically" (section 4).
#[test]
fn section_7_5_home_on_startup() {
    let mut rig = Rig::restarted(&[(at::HOMING, homing(0) | ON_STARTUP)]);
    rig.after(2_499.millis());
    assert!(!rig.moving());
    rig.after(1_001.millis());
    assert_eq!(rig.motion_control(), bit::HOME);
    assert!((rig.position() - 3_750).abs() <= 5, "{}", rig.position());
    assert!(rig.busy());
    rig.low(FLAG);
    rig.after(4.micros());
    assert_eq!(rig.motion_control(), 0);
    assert!(!rig.busy());
}

/// A home cycle at start-up begins after the whole start-up delay and makes its offsets: 400 steps back, then
/// the flag is already active.
#[test]
fn section_7_5_home_on_startup_after_the_delay() {
    let mut rig = Rig::restarted(&[
        (at::HOMING, homing(0) | ON_STARTUP),
        (at::STARTUP_DELAY, 100),
        (at::PRE_HOME_OFFSET, 0xFFFF),
        (at::PRE_HOME_OFFSET + 1, (-400_i16).cast_unsigned()),
    ]);
    rig.low(FLAG);
    rig.after(3_499.millis());
    assert!(!rig.moving());
    rig.after(201.millis());
    assert!((rig.speed() + 2_000.0).abs() < 20.0, "{}", rig.speed());
    rig.until_idle();
    rig.assert_stands(-400);
}

/// Section 4 accepts commands only after homing, 7.8 during homing. The emulated drive follows 7.8, because
/// else a flag that never becomes active would lock the drive up.
#[test]
fn section_7_5_home_on_startup_can_be_stopped() {
    let mut rig = Rig::restarted(&[(at::HOMING, homing(0) | ON_STARTUP)]);
    rig.after(3.secs());
    assert_eq!(rig.motion_control(), bit::HOME);
    rig.command(bit::STOP);
    assert_eq!(rig.motion_control(), 0);
    let stopped_at = rig.position();
    rig.assert_stands(stopped_at);
}

/// No home cycle at start-up if Disable was saved, or with a DC motor.
#[test]
fn section_7_5_no_home_on_startup() {
    let homing = (at::HOMING, homing(0) | ON_STARTUP);
    for other in [(at::MOTION, bit::DISABLE), (at::CURRENT_AND_MICROSTEPPING, 0x230a), (at::USER, 0)] {
        let mut rig = Rig::restarted(&[homing, other]);
        rig.after(3.secs());
        let runs = other.0 == at::USER;
        assert_eq!((rig.moving(), rig.motion_control() & bit::HOME != 0), (runs, runs));
        assert_eq!(rig.duty(), 0);
        assert_eq!(rig.motion_control() & bit::DISABLE != 0, other.0 == at::MOTION);
    }
    let mut rig = Rig::restarted(&[(at::HOMING, 0)]);
    rig.after(3.secs());
    assert!(!rig.moving());
}
