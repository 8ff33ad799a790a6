//! Sections 2 and 4: lights, BUSY, and the start-up at power-on.

use drivetwin_firmware::device::Level;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::Setup;

use crate::rig::{GREEN, RED, Rig, at, bit};

/// States of the red and the green light; true is on.
fn lights(rig: &Rig) -> (bool, bool) {
    (rig.lit(RED), rig.lit(GREEN))
}

/// MD3-13: both lights flash twice, 0.25 s on and 0.25 s off. For the rest of the 2.5 s they alternate every
/// half second.
#[test]
fn section_2_lights_at_power_up() {
    let mut rig = Rig::new("md3", Setup::default());
    rig.after(125.millis());
    for on in [true, false, true, false] {
        assert_eq!(lights(&rig), (on, on));
        rig.after(250.millis());
    }
    let first = lights(&rig); // 1.125 s
    assert_ne!(first.0, first.1);
    rig.after(250.millis());
    assert_eq!(lights(&rig), first); // 1.375 s
    rig.after(250.millis());
    assert_eq!(lights(&rig), (!first.0, !first.1)); // 1.625 s
    rig.after(500.millis());
    assert_eq!(lights(&rig), first); // 2.125 s
    rig.after(374.millis());
    assert_eq!(lights(&rig), first); // 2.499 s
}

/// The lights alternate during the whole start-up delay.
#[test]
fn section_2_lights_during_the_startup_delay() {
    let mut rig = Rig::restarted(&[(at::STARTUP_DELAY, 500)]);
    rig.after(1_250.millis());
    let first = lights(&rig);
    for n in 0..12 {
        // The loop ends at 7.25 s of 7.5 s.
        let swapped = n % 2 == 1;
        assert_eq!(lights(&rig), (first.0 != swapped, first.1 != swapped), "after {n} half seconds");
        assert_ne!(first.0, first.1);
        rig.after(500.millis());
    }
}

/// Number of flashes of a light in 15 s, and number of the 1,500 samples in which it is on.
fn flashes(rig: &mut Rig, light: &str) -> (u32, u32) {
    let (mut flashes, mut lit, mut before) = (0, 0, rig.lit(light));
    for _ in 0..1_500 {
        rig.after(10.millis());
        flashes += u32::from(rig.lit(light) && !before);
        lit += u32::from(rig.lit(light));
        before = rig.lit(light);
    }
    (flashes, lit)
}

/// MD3-13: the heartbeat is a green flash every 1.5 s. Green is D6 in the table of section 2.
#[test]
fn section_2_heartbeat() {
    let mut rig = Rig::ready();
    assert_eq!(flashes(&mut rig, GREEN).0, 10);
    assert_eq!(flashes(&mut rig, RED), (0, 0));
}

/// In a fault the green light is off and the red one flashes.
#[test]
fn section_2_lights_in_a_fault() {
    let mut rig = Rig::ready();
    rig.fault("over_temperature", true);
    assert_eq!(flashes(&mut rig, GREEN), (0, 0));
    let (times, lit) = flashes(&mut rig, RED);
    assert_eq!(times, 10);
    assert!(lit < 1_000);
    rig.fault("over_temperature", false);
    assert_eq!(flashes(&mut rig, GREEN), (0, 0));
    rig.command(bit::FAULT);
    assert_eq!(flashes(&mut rig, GREEN).0, 10);
    assert_eq!(flashes(&mut rig, RED), (0, 0));
}

/// A fault during cutback makes the red light flash. In cutback without a fault it is on.
#[test]
fn section_2_lights_in_a_fault_in_cutback() {
    let mut rig = Rig::ready();
    rig.write(at::CURRENT_CUTBACK, 1 << 8 | 5);
    rig.after(5.secs());
    assert!(rig.lit(RED));
    rig.fault("over_current", true);
    let (times, lit) = flashes(&mut rig, RED);
    assert_eq!(times, 10);
    assert!(lit < 1_000);
}

/// BUSY is low during moves, jogs and home cycles, and in a fault.
#[test]
fn section_2_busy() {
    for command in [bit::MOVE, bit::JOG, bit::HOME] {
        let mut rig = Rig::ready();
        assert!(!rig.busy());
        rig.command(command);
        assert!(rig.busy());
        rig.after(1.secs());
        assert!(rig.busy());
        rig.command(bit::STOP);
        assert!(!rig.busy());
    }
    let mut rig = Rig::ready();
    for fault in ["over_temperature", "over_current"] {
        rig.fault(fault, true);
        assert!(rig.busy() && !rig.moving());
        rig.fault(fault, false);
        assert!(rig.busy());
        rig.command(bit::FAULT);
        assert!(!rig.busy());
    }
}

/// "The motor current will be turned off and no input signals or serial commands will be processed."
#[test]
fn section_4_start_up() {
    let mut rig = Rig::new("md3", Setup::default());
    for _ in 0..24 {
        rig.after(100.millis());
        assert!(rig.ask(&rtu::read(1, 0, 1)).is_empty());
        rig.low("J2.4");
        rig.open("J2.4");
        assert_eq!((rig.current(), rig.position()), (0, 0));
    }
    rig.after(101.millis());
    assert_eq!((rig.current(), rig.position()), (1_000, 0));
    assert_eq!(rig.read(at::DEVICE_ADDRESS), 1);
    rig.low("J2.4");
    assert_eq!(rig.position(), 1);
}

/// The drive is ready after 2.5 s, and not a tick earlier.
#[test]
fn section_4_ready_after_2_5_s() {
    let mut rig = Rig::new("md3", Setup::default());
    rig.after(2_500.millis() - Duration::TICK);
    assert_eq!(rig.current(), 0);
    rig.after(Duration::TICK);
    assert_eq!(rig.current(), 1_000);
}

/// A pin that is low before and after start-up makes no edge when the drive becomes ready.
#[test]
fn section_4_levels_are_no_edges() {
    let mut rig = Rig::ready();
    rig.write(at::PINS, 0b0001 << 4 | 1 << 8);
    rig.save();
    rig.low("J2.3");
    rig.command(bit::STOP);
    rig.low("J2.4");
    rig.command(bit::STOP);
    rig.power_cycle();
    rig.after(4.secs());
    assert_eq!(rig.motion_control(), 0);
    rig.assert_stands(0);
}

/// Without a start-up delay, too, a pin that is active before power-on makes no edge.
#[test]
fn section_4_levels_are_no_edges_without_a_delay() {
    for (function, pin) in [(0b0000 << 4, "J2.4"), (0b0001 << 4, "J2.4"), (0xf << 4 | 1 << 8, "J2.3")] {
        let mut rig = Rig::ready();
        rig.write(at::PINS, function);
        rig.save();
        let memory = Some(rig.bench.memory(rig.seat).to_vec());
        let mut rig = Rig::new("md3", Setup { memory, boot_fast: true, ..Setup::default() });
        rig.low(pin);
        rig.command(bit::STOP);
        rig.power_cycle();
        rig.after(1.secs());
        assert_eq!((rig.motion_control(), rig.position()), (0, 0), "{function:#06x}");
    }
}

/// Without power the drive has no current, releases its outputs and sends no reply.
#[test]
fn section_4_without_power() {
    let mut rig = Rig::ready();
    rig.command(bit::JOG);
    rig.after(1.secs());
    rig.bench.power(rig.seat, drivetwin_sim::bench::PowerAction::Off);
    rig.after(1.secs());
    assert_eq!((rig.current(), rig.speed(), rig.level("J3.7")), (0, 0.0, Level::Float));
    assert!(rig.ask(&rtu::read(1, 0, 1)).is_empty());
    rig.bench.power(rig.seat, drivetwin_sim::bench::PowerAction::On);
    rig.after(3.secs());
    assert_eq!((rig.motion_control(), rig.position()), (0, 0)); // MD3-17: the position counts from power-on
}
