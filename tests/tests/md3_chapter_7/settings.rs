//! Sections 7.1 to 7.4: address, current, microstepping and DC motors, cutback, start-up delay.

use drivetwin_firmware::device::Port;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::Setup;

use crate::rig::{BUSY, GREEN, RED, Rig, at, bit, words};

#[test]
fn section_7_1_device_address() {
    let mut rig = Rig::ready();
    for (value, legal) in [(0, false), (248, false), (256, false), (0xFFFF, false), (1, true)] {
        assert_eq!(rig.accepts(at::DEVICE_ADDRESS, value), legal, "address {value}");
        assert_eq!(rig.read(at::DEVICE_ADDRESS), 1);
    }
    // The reply comes from the old address; the new address applies from the next frame.
    assert!(rig.accepts(at::DEVICE_ADDRESS, 247));
    assert!(rig.ask(&rtu::read(1, 0x00, 1)).is_empty());
    assert_eq!(words(&rig.ask(&rtu::read(247, 0x00, 1))), [247]);
}

/// MODBUS-3: a broadcast changes the address of all drives on the line.
#[test]
fn section_7_1_the_address_can_be_broadcast() {
    let mut rig = Rig::ready();
    assert!(rig.ask(&rtu::write(0, 0x00, 9)).is_empty());
    assert_eq!(words(&rig.ask(&rtu::read(9, 0x00, 1))), [9]);
}

/// Peak currents of the high current version in mA, as section 7.2 prints them from code 0 on. From code 0x15
/// a step is 500 mA instead of 100 mA.
const STANDARD: [u32; 31] = [
    0, 100, 200, 300, 400, 500, 600, 700, 800, 900, // 0x00 … 0x09
    1_000, 1_100, 1_200, 1_300, 1_400, 1_500, 1_600, 1_700, 1_800, 1_900, // 0x0a … 0x13
    2_000, 2_500, 3_000, 3_500, 4_000, 4_500, 5_000, 5_500, 6_000, 6_500, // 0x14 … 0x1d
    7_000, // 0x1e
];

/// Peak currents of the low current version.
const LOW: [u32; 37] = [
    0, 50, 100, 150, 200, 250, 300, 350, 400, 450, // 0x00 … 0x09
    500, 550, 600, 650, 700, 750, 800, 850, 900, 950, // 0x0a … 0x13
    1_000, 1_050, 1_100, 1_150, 1_200, 1_250, 1_300, 1_350, 1_400, 1_450, // 0x14 … 0x1d
    1_500, 1_550, 1_600, 1_650, 1_700, 1_750, 1_800, // 0x1e … 0x24
];

/// Asserts that each code gives the current of its row, and that codes past the table (MD3-10) give that of
/// the last row.
fn codes_give_currents(kind: &str, table: &[u32]) {
    let mut rig = Rig::ready_kind(kind);
    for code in 0..=0xFF {
        let current = table.get(usize::from(code)).or(table.last());
        rig.write(at::CURRENT_AND_MICROSTEPPING, 0x0300 | code);
        assert_eq!(Some(&rig.current()), current, "code {code:#04x}");
        assert_eq!(rig.read(at::CURRENT_AND_MICROSTEPPING), 0x0300 | code);
    }
}

#[test]
fn section_7_2_currents() {
    codes_give_currents("md3", &STANDARD);
}

#[test]
fn section_7_2_currents_of_the_low_current_version() {
    codes_give_currents("md3-low", &LOW);
}

/// The initial value 0x030a is 1 A, or 0.5 A in the low current version.
#[test]
fn section_7_2_initial_currents() {
    assert_eq!(Rig::ready().current(), 1_000);
    assert_eq!(Rig::ready_kind("md3-low").current(), 500);
}

/// MD3-10: code 0, full step, has 71 % of the current. A code that the manual does not print acts as code 8.
#[test]
fn section_7_2_full_step_gives_71_percent() {
    let mut rig = Rig::ready();
    for code in 0..32 {
        rig.write(at::CURRENT_AND_MICROSTEPPING, code << 8 | 0x1e);
        assert_eq!(rig.current(), if code == 0 { 4_970 } else { 7_000 }, "code {code}");
    }
}

/// MD3-17: positions count microsteps. A change of microstepping does not change the position.
#[test]
fn section_7_2_microstepping_changes_no_counts() {
    let mut rig = Rig::ready();
    for (n, code) in (1..).zip(0..=8) {
        rig.write(at::CURRENT_AND_MICROSTEPPING, code << 8 | 0x0a);
        rig.command(bit::MOVE);
        assert_eq!(rig.until_idle(), 2_500.millis(), "code {code}");
        rig.assert_stands(n * 10_000);
    }
}

/// A drive with a DC motor; `code` selects the PWM frequency.
fn dc(code: u16) -> Rig {
    let mut rig = Rig::ready();
    rig.write(at::CURRENT_AND_MICROSTEPPING, 0x2000 | code << 8 | 0x0a);
    rig
}

/// PWM frequencies in Hz, and the Speed that gives full duty (7.2). The frequencies times the full scales are
/// 20 MHz (codes 0 and 1) or 80 MHz.
const PWM: [(u64, i32); 9] = [
    (500, 40_000),
    (1_000, 20_000),
    (2_000, 40_000),
    (5_000, 16_000),
    (10_000, 8_000),
    (16_000, 5_000),
    (20_000, 4_000),
    (25_000, 3_200),
    (40_000, 2_000),
];

/// MD3-32: duty = Speed / full scale, clamped.
#[test]
fn section_7_2_dc_duties() {
    for (code, (hz, full)) in (0..).zip(PWM) {
        assert_eq!(hz * full as u64, if code < 2 { 20_000_000 } else { 80_000_000 });
        let mut rig = dc(code);
        rig.write_long(at::ACCEL_DECEL, 1_000_000);
        for (speed, duty) in [
            (full / 2, 32_768),
            (full, 65_536),
            (full + 1, 65_536),
            (-full / 4, -16_384),
            (-full, -65_536),
            (-100_000, -65_536),
        ] {
            rig.write_long(at::SPEED, speed);
            rig.command(bit::JOG);
            rig.after(500.millis());
            assert_eq!(rig.duty(), duty, "code {code}, speed {speed}");
        }
    }
}

/// Codes past the table act as the last one, ±2,000 counts.
#[test]
fn section_7_2_dc_codes_that_the_manual_does_not_print() {
    for code in 9..32 {
        let mut rig = dc(code);
        rig.write_long(at::SPEED, 1_000);
        rig.command(bit::JOG);
        rig.after(1.secs());
        assert_eq!(rig.duty(), 32_768, "code {code}");
    }
}

/// The example of section 7.17 means code 5 (16 kHz, 5,000): 2,500 gives 50 %.
#[test]
fn section_7_17_dc_example() {
    let mut rig = dc(5);
    rig.write_long(at::SPEED, 2_500);
    rig.command(bit::JOG);
    rig.after(1.secs());
    assert_eq!(rig.duty(), 32_768);
}

/// MD3-32: a ramp from 0 to 20,000 of 40,000 counts at 10,000 counts/s takes 2 s. The duty changes once in
/// each PWM period: at 2 kHz every 0.5 ms, by 5 counts or 8/65,536.
#[test]
fn section_7_2_dc_ramps() {
    let mut rig = dc(2);
    rig.write_long(at::SPEED, 20_000);
    rig.command(bit::JOG);
    assert_eq!(rig.motion_control(), bit::JOG);
    rig.after(1.secs());
    assert!((rig.duty() - 16_384).abs() <= 9, "{}", rig.duty());
    assert!(rig.moving() && rig.busy());
    rig.after(1_001.millis());
    assert_eq!(rig.duty(), 32_768);
    rig.command(bit::DECEL_STOP);
    rig.after(1.secs());
    assert!((rig.duty() - 16_384).abs() <= 9, "{}", rig.duty());
    let rest = rig.until_idle();
    assert!(rest <= 1_001.millis() && rest >= 999.millis(), "{rest:?}");
    assert_eq!((rig.duty(), rig.moving()), (0, false));
    rig.after(500.micros()); // the ramp ends inside a PWM period
    assert_eq!((rig.motion_control(), rig.position()), (0, 0));
}

/// PWM frequencies: a duty is constant for one period, and during a ramp each period has a different duty.
#[test]
fn section_7_2_dc_frequencies() {
    for (code, (hz, full)) in (0..).zip(PWM) {
        let mut rig = dc(code);
        rig.write_long(at::ACCEL_DECEL, 100_000); // at least 2.5 counts in a period
        rig.write_long(at::SPEED, full);
        rig.command(bit::JOG);
        let period = 16_000_000 / hz;
        let mut changes = Vec::new();
        while changes.len() < 10 {
            let (next, before) = (rig.bench.next(), rig.duty());
            rig.bench.run_until(next);
            if rig.duty() != before {
                changes.push(next.ticks());
            }
        }
        assert!(changes.windows(2).all(|pair| pair[1] - pair[0] == period), "code {code}: {changes:?}");
        assert_eq!(changes[0] % period, 0, "code {code}");
    }
}

/// A change of the frequency changes the full scale: Speed 5,000 is a duty of 5,000/40,000, of 5,000/20,000,
/// or of 5,000/4,000, which acts as 1.
#[test]
fn section_7_2_dc_another_frequency() {
    let mut rig = dc(2);
    rig.command(bit::JOG);
    for (code, duty) in [(2, 8_192), (1, 16_384), (6, 65_536), (0, 8_192)] {
        rig.write(at::CURRENT_AND_MICROSTEPPING, 0x200a | code << 8);
        rig.after(1.secs());
        assert_eq!(rig.duty(), duty, "code {code}");
    }
}

#[test]
fn section_7_2_dc_stop_is_immediate() {
    for stop in [bit::STOP, bit::DISABLE] {
        let mut rig = dc(2);
        rig.command(bit::JOG);
        rig.after(1.secs());
        assert_eq!(rig.duty(), 8_192); // 5,000 of 40,000
        rig.command(stop);
        assert_eq!(rig.duty(), 0);
        assert!(!rig.moving() && !rig.busy());
    }
}

/// "Jog mode only": Move and Home end at once.
#[test]
fn section_7_2_dc_only_jogs() {
    let mut rig = dc(0);
    for command in [bit::MOVE, bit::HOME] {
        rig.command(command);
        assert_eq!(rig.motion_control(), 0);
        rig.after(1.secs());
        assert_eq!((rig.duty(), rig.busy()), (0, false));
    }
}

/// MD3-32: AlternateSpeed is in counts, too.
#[test]
fn section_7_2_dc_alternate_speed() {
    let mut rig = dc(2);
    rig.write(at::HOMING, 2 << 1);
    rig.write(at::PINS, 1 << 10);
    rig.low("J2.2");
    rig.write_long(at::SPEED, -5_000);
    rig.command(bit::JOG);
    rig.after(1.secs());
    assert_eq!(rig.duty(), -4_096); // 2,500 of 40,000
    rig.open("J2.2");
    rig.after(1.secs());
    assert_eq!(rig.duty(), -8_192);
}

/// MD3-32: a change of Motor Mode in either direction stops the motor at once.
#[test]
fn section_7_2_a_change_of_the_motor_mode_stops() {
    let mut rig = dc(2);
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.write(at::CURRENT_AND_MICROSTEPPING, 0x030a);
    assert_eq!((rig.duty(), rig.motion_control()), (0, 0));
    rig.assert_stands(0);
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.write(at::CURRENT_AND_MICROSTEPPING, 0x230a);
    let stopped_at = rig.position();
    assert!((stopped_at - 3_750).abs() <= 1);
    rig.after(1.secs());
    rig.assert_stands(stopped_at);
    assert_eq!((rig.duty(), rig.motion_control()), (0, 0));
}

/// A drive with cutback to code 5, 0.5 A, after `tenths` of a second. Pins 4 and 5 have no function.
fn with_cutback(tenths: u16) -> Rig {
    let mut rig = Rig::ready();
    rig.write(at::PINS, 0xf << 4);
    rig.write(at::CURRENT_CUTBACK, tenths << 8 | 5);
    rig.command(0);
    rig
}

#[test]
fn section_7_3_cutback() {
    let mut rig = with_cutback(30);
    rig.after(3.secs() - 1.millis());
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
    rig.after(2.millis());
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
    rig.after(100.secs());
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
    // The heartbeat continues (section 2): the light is on for a quarter of every 1.5 s.
    let beats = (0..15).filter(|_| {
        rig.after(100.millis());
        rig.lit(GREEN)
    });
    assert!((2..=3).contains(&beats.count()));
}

/// "Maximum timeout is 25.5 seconds."
#[test]
fn section_7_3_longest_timeout() {
    let mut rig = with_cutback(255);
    rig.after(25_500.millis() - 1.millis());
    assert_eq!(rig.current(), 1_000);
    rig.after(2.millis());
    assert_eq!(rig.current(), 500);
}

#[test]
fn section_7_3_timeout_0_is_no_cutback() {
    let mut rig = with_cutback(0);
    rig.after(100.secs());
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
}

/// Full step reduces the cutback level to 71 %, too: 355 of 500 mA.
#[test]
fn section_7_3_full_step() {
    let mut rig = with_cutback(10);
    rig.write(at::CURRENT_AND_MICROSTEPPING, 0x000a);
    assert_eq!(rig.current(), 710);
    rig.after(2.secs());
    assert_eq!(rig.current(), 355);
}

/// MD3-31: the red light is lit even if the current stays the same.
#[test]
fn section_7_3_red_lights_at_the_same_current() {
    let mut rig = with_cutback(10);
    rig.write(at::CURRENT_CUTBACK, 10 << 8 | 0x0a);
    rig.after(1_001.millis());
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, true));
}

/// A new timeout counts from the start of the old one. Here 1 s is written after 3 s and expires at once.
#[test]
fn section_7_3_a_new_timeout() {
    let mut rig = with_cutback(100);
    rig.after(3.secs());
    rig.write(at::CURRENT_CUTBACK, 10 << 8 | 5);
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
    rig.write(at::CURRENT_CUTBACK, 40 << 8 | 5);
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
    rig.after(1_001.millis());
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
    rig.write(at::CURRENT_CUTBACK, 0);
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
}

/// "The cutback level uses the same table."
#[test]
fn section_7_3_levels() {
    let mut rig = with_cutback(1);
    rig.after(200.millis());
    for (code, current) in (0..).zip(STANDARD) {
        rig.write(at::CURRENT_CUTBACK, 1 << 8 | code);
        rig.command(0);
        rig.after(200.millis());
        assert_eq!(rig.current(), current, "code {code:#04x}");
    }
}

/// MD3-31: any edge on J2 pins 2 to 5 is an input change and restores the current.
#[test]
fn section_7_3_an_input_change_restores_the_current() {
    for pin in ["J2.2", "J2.4", "J2.5"] {
        let mut rig = with_cutback(10);
        rig.after(2.secs());
        assert_eq!(rig.current(), 500);
        for change in [Rig::low, Rig::open] {
            change(&mut rig, pin);
            assert_eq!((rig.current(), rig.lit(RED)), (1_000, false), "{pin}");
            rig.after(1.secs() - 1.millis());
            assert_eq!(rig.current(), 1_000, "{pin}");
            rig.after(2.millis());
            assert_eq!((rig.current(), rig.lit(RED)), (500, true), "{pin}");
        }
    }
}

/// An edge on pin 3 restores the current, too, if the pin does not switch the current itself (function 3:
/// none).
#[test]
fn section_7_3_a_change_of_pin_3_restores_the_current() {
    let mut rig = with_cutback(10);
    rig.write(at::PINS, 0xf << 4 | 3 << 8);
    rig.after(2.secs());
    assert_eq!(rig.current(), 500);
    rig.low("J2.3");
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
}

/// MD3-31: neither the encoder's pins nor frames for other addresses restore the current.
#[test]
fn section_7_3_other_pins_restore_nothing() {
    let mut rig = with_cutback(10);
    rig.after(2.secs());
    for pin in ["J2.9", "J2.10", "J2.12"] {
        rig.high(pin);
        rig.open(pin);
        assert_eq!((rig.current(), rig.lit(RED)), (500, true), "{pin}");
    }
    assert!(rig.ask(&rtu::write(2, at::MOTION, 0)).is_empty()); // for another drive
    assert_eq!(rig.current(), 500);
    assert!(rig.ask(&rtu::write(0, at::MOTION, 0)).is_empty()); // broadcast
    assert_eq!(rig.current(), 1_000);
}

/// MD3-31: step pulses restore the current, too.
#[test]
fn section_7_3_step_pulses_restore_the_current() {
    let mut rig = with_cutback(10);
    rig.write(at::PINS, 0);
    rig.after(2.secs());
    rig.low("J2.4");
    assert_eq!((rig.current(), rig.position()), (1_000, 1));
}

/// MD3-31: only a write of 0x11 counts as a command; reads and other writes do not.
#[test]
fn section_7_3_what_counts_as_a_command() {
    let mut rig = with_cutback(10);
    rig.after(900.millis());
    rig.write(at::USER, 1);
    rig.read(at::MOTION);
    rig.after(101.millis());
    assert_eq!(rig.current(), 500);
    rig.write(at::USER, 2);
    rig.read(at::MOTION);
    assert_eq!(rig.current(), 500);
    rig.command(0);
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
}

/// MD3-31: no cutback while the motor moves. The end of a motion restarts the timeout, and a motion restores
/// the current before its first step.
#[test]
fn section_7_3_not_while_moving() {
    let mut rig = with_cutback(5);
    rig.after(1.secs());
    rig.command(bit::MOVE);
    assert_eq!((rig.current(), rig.lit(RED)), (1_000, false));
    rig.after(2_499.millis());
    assert_eq!((rig.busy(), rig.current()), (true, 1_000));
    rig.after(500.millis()); // the move has been over for 499 ms
    assert_eq!((rig.busy(), rig.current()), (false, 1_000));
    rig.after(2.millis());
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
}

/// The timeout also starts when the drive becomes ready.
#[test]
fn section_7_3_after_start_up() {
    let mut rig = Rig::restarted(&[(at::CURRENT_CUTBACK, 10 << 8 | 5)]);
    rig.after(2_500.millis() + 999.millis());
    assert_eq!(rig.current(), 1_000);
    rig.after(2.millis());
    assert_eq!((rig.current(), rig.lit(RED)), (500, true));
}

/// Cutback does not switch on the current of a disabled drive.
#[test]
fn section_7_3_disabled_stays_without_current() {
    let mut rig = with_cutback(5);
    rig.command(bit::DISABLE);
    rig.after(10.secs());
    assert_eq!(rig.current(), 0);
}

/// 250 · 10 ms + 2.5 s = 5 s (7.4). Only the saved value applies.
#[test]
fn section_7_4_startup_delay() {
    let mut rig = Rig::restarted(&[(at::STARTUP_DELAY, 250)]);
    rig.after(4_999.millis());
    assert!(rig.ask(&rtu::read(1, 0, 1)).is_empty());
    assert_eq!(rig.current(), 0);
    rig.after(2.millis());
    assert_eq!(rig.read(at::STARTUP_DELAY), 250);
    assert_eq!(rig.current(), 1_000);
}

#[test]
fn section_7_4_a_delay_that_was_not_saved_does_not_count() {
    let mut rig = Rig::ready();
    rig.write(at::STARTUP_DELAY, 250);
    rig.power_cycle();
    rig.after(2_501.millis());
    assert_eq!(rig.read(at::STARTUP_DELAY), 0);
}

/// More than 65,435 acts as 65,435: 2.5 s + 654.35 s.
#[test]
fn section_7_4_the_longest_delay() {
    for delay in [65_435, 65_535] {
        let mut rig = Rig::restarted(&[(at::STARTUP_DELAY, delay)]);
        rig.after(656_850.millis() - 1.millis());
        assert!(rig.ask(&rtu::read(1, 0, 1)).is_empty());
        rig.after(2.millis());
        assert_eq!(rig.read(at::STARTUP_DELAY), delay); // reads back as written
    }
}

/// `--fast-boot` skips the whole start-up delay.
#[test]
fn section_7_4_without_any_delay() {
    let mut rig = Rig::new("md3", Setup { boot_fast: true, ..Setup::default() });
    rig.after(Duration::TICK);
    assert_eq!(rig.read(at::USER), 0);
    assert_eq!(rig.current(), 1_000);
    rig.command(bit::MOVE);
    assert_eq!(rig.until_idle(), 2_500.millis());
}

/// Frames that arrive during the start-up delay are counted but not executed (MD3-13).
#[test]
fn section_7_4_no_frame_is_executed_before_the_end_of_the_delay() {
    let mut rig = Rig::new("md3", Setup::default());
    rig.after(1.secs());
    assert!(rig.ask(&rtu::write(1, at::MOTION, bit::MOVE)).is_empty());
    rig.low("J2.4");
    rig.open("J2.4");
    rig.after(2.secs());
    assert_eq!((rig.motion_control(), rig.position()), (0, 0));
    assert_eq!(rig.level(BUSY), drivetwin_firmware::device::Level::Float);
    assert!(rig.bench.statistics(rig.seat, Port(0)).starting > 0);
}
