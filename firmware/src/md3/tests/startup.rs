//! How a drive starts (sections 2, 4, 7.4, 7.20).

use super::*;

#[test]
fn it_is_deaf_for_two_and_a_half_seconds() {
    let mut bed = Bed::booting();
    bed.run_until(1.secs());
    assert!(bed.ask(&rtu::read(1, 0, 1)).is_empty());
    // The last character that is lost ends with the delay.
    bed.now = Instant::from(2_500.millis()) - CHARACTER;
    assert!(bed.ask(&rtu::read(1, 0, 1)).is_empty());
    let mut bed = Bed::booting();
    bed.now = Instant::from(2_500.millis()) - CHARACTER + Duration::TICK;
    assert_eq!(bed.ask(&rtu::read(1, 0, 1)), rtu::frame(1, &[3, 2, 0, 1]));
}

#[test]
fn a_startup_delay_of_250_makes_five_seconds() {
    let mut bed = Bed::ready();
    bed.write(0x03, 250); // 7.4
    bed.write(0x1a, 1);
    bed.run_until(bed.now + 20.millis());
    let mut bed = Bed::off(bed.world.memory);
    bed.power_on(Boot::default());
    bed.run_until(Instant::from(5.secs()) - Duration::TICK);
    assert_eq!(bed.world.current, [(Instant::ZERO, 0)]);
    bed.run_until(5.secs());
    assert_eq!(bed.world.current[1..], [(bed.now, 1_000)]);
}

const HALF: Duration = Duration::millis(500);
const FLASH: (Duration, Duration) = (HALF, Duration::millis(250));

#[test]
fn lights_of_a_drive_that_starts() {
    let mut bed = Bed::booting();
    bed.run_until(10.secs());
    let (red, green) = (RED, GREEN);
    let second = |n: u64| Instant::from(n.millis());
    let (turn, beat) = ((HALF * 2, HALF), (Duration::millis(1_500), Duration::millis(250)));
    assert_eq!(
        bed.world.waves,
        [
            (second(0), red, FLASH.0, FLASH.1),
            (second(0), green, FLASH.0, FLASH.1),
            (second(1_000), green, turn.0, turn.1),
            (second(1_500), red, turn.0, turn.1),
            (second(2_500), green, beat.0, beat.1),
        ]
    );
    let red: Vec<_> = bed.world.levels.iter().filter(|(_, pin, _)| *pin == red).collect();
    assert_eq!(red, [&(second(1_000), RED, Level::Low), &(second(2_500), RED, Level::Low)]);
}

#[test]
fn a_bad_eeprom_flashes_red_and_starts_with_the_defaults() {
    let garbage: Vec<u8> = (0..MEMORY).map(|n| n as u8).collect();
    let mut bed = Bed::off(garbage.clone());
    bed.power_on(Boot::default());
    // Ten flashes in five seconds, then the built-in delay.
    assert_eq!(bed.world.waves, [(Instant::ZERO, RED, FLASH.0, FLASH.1)]);
    bed.run_until(Instant::from(7_500.millis()) - Duration::TICK);
    assert_eq!(bed.world.current.len(), 1);
    bed.run_until(7_500.millis());
    assert_eq!(bed.world.current.len(), 2);
    assert_eq!(bed.read(0x1a), 0xf100);
    assert_eq!(bed.read(0x15), 0x1388);
    assert_eq!(bed.world.memory, garbage, "it stays as it is until a save");
    bed.write(0x1a, 1);
    bed.run_until(bed.now + 20.millis());
    let mut bed = Bed::off(bed.world.memory);
    bed.power_on(Boot { fast: true, ..Boot::default() });
    assert_eq!(bed.read(0x1a), 0x9a00);
}

#[test]
fn what_pins_are_told_in_the_instant_of_a_fast_start_is_no_edge() {
    let mut bed = Bed::off(vec![0xFF; MEMORY]);
    let mut preset =
        |reg: Reg, value| bed.drive.poke(Instant::ZERO, reg.row(), value, &mut bed.world).unwrap();
    preset(Reg::HomingConfiguration, 1);
    preset(Reg::HomeOffset, 50);
    preset(Reg::PinFunctionAndPolarity, 0b0001 << 4);
    bed.power_on(Boot { fast: true, ..Boot::default() });
    // J2 pins 2, 4, 10 and 9.
    for (pin, high) in [(0, false), (2, false), (5, true), (4, true)] {
        bed.drive.input(Instant::ZERO, Input::Edge { pin: Pin(pin), high }, &mut bed.world);
    }
    bed.run_until(Instant::ZERO);
    assert_eq!((bed.get(Reg::QuadratureEncoderCount), bed.get(Reg::EncoderIndexCount)), (0, 0));
    // The flag is there already: only the offset is left of the home cycle, and pin 4 began no move.
    assert_eq!(bed.control(), HOME);
    bed.run_until(1.secs());
    assert_eq!((bed.control(), bed.position()), (0, 50));
    // Back to A = B = 0, where the index is valid: MaxCount.
    bed.pin(10, false);
    assert_eq!((bed.get(Reg::QuadratureEncoderCount), bed.get(Reg::EncoderIndexCount)), (0x0f9f, -1));
}

#[test]
fn a_command_in_the_instant_of_a_fast_start_is_carried_out() {
    let mut bed = Bed::off(vec![0xFF; MEMORY]);
    bed.power_on(Boot { fast: true, ..Boot::default() });
    bed.input(Instant::ZERO, Input::Bytes { port: Port(0), bytes: &rtu::write(1, 0x11, 1) });
    bed.input(Instant::ZERO, Input::Idle { port: Port(0) });
    assert_eq!(bed.control(), MOVE);
}
