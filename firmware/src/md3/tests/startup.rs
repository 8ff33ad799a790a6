//! Start-up of a drive (sections 2, 4, 7.4, 7.20).

use super::*;

#[test]
fn it_is_deaf_for_two_and_a_half_seconds() {
    let mut dut = booting();
    dut.run_until(1.secs());
    assert!(dut.ask(&rtu::read(1, 0, 1)).is_empty());
    // The drive still loses a character that ends at the same time as the delay.
    dut.now = Instant::from(2_500.millis()) - CHARACTER;
    assert!(dut.ask(&rtu::read(1, 0, 1)).is_empty());
    let mut dut = booting();
    dut.now = Instant::from(2_500.millis()) - CHARACTER + Duration::TICK;
    assert_eq!(dut.ask(&rtu::read(1, 0, 1)), rtu::frame(1, &[3, 2, 0, 1]));
}

#[test]
fn a_startup_delay_of_250_makes_five_seconds() {
    let mut dut = ready();
    dut.write(0x03, 250); // 7.4
    dut.write(0x1a, 1);
    dut.run_until(dut.now + 20.millis());
    let mut dut = off(dut.out.memory);
    dut.power_on(Boot::default());
    dut.run_until(Instant::from(5.secs()) - Duration::TICK);
    assert_eq!(dut.out.currents, [(Instant::ZERO, AXIS, 0)]);
    dut.run_until(5.secs());
    assert_eq!(dut.out.currents[1..], [(dut.now, AXIS, 1_000)]);
}

const HALF: Duration = Duration::millis(500);
const FLASH: (Duration, Duration) = (HALF, Duration::millis(250));

#[test]
fn lights_of_a_drive_that_starts() {
    let mut dut = booting();
    dut.run_until(10.secs());
    let (red, green) = (RED, GREEN);
    let second = |n: u64| Instant::from(n.millis());
    let (turn, beat) = ((HALF * 2, HALF), (Duration::millis(1_500), Duration::millis(250)));
    assert_eq!(
        dut.out.waves,
        [
            (second(0), red, FLASH.0, FLASH.1),
            (second(0), green, FLASH.0, FLASH.1),
            (second(1_000), green, turn.0, turn.1),
            (second(1_500), red, turn.0, turn.1),
            (second(2_500), green, beat.0, beat.1),
        ]
    );
    let red: Vec<_> = dut.out.levels.iter().filter(|(_, pin, _)| *pin == red).collect();
    assert_eq!(red, [&(second(1_000), RED, Level::Low), &(second(2_500), RED, Level::Low)]);
}

#[test]
fn a_bad_eeprom_flashes_red_and_starts_with_the_defaults() {
    let garbage: Vec<u8> = (0..MEMORY).map(|n| n as u8).collect();
    let mut dut = off(garbage.clone());
    dut.power_on(Boot::default());
    // The lights flash ten times in five seconds, then the built-in delay starts.
    assert_eq!(dut.out.waves, [(Instant::ZERO, RED, FLASH.0, FLASH.1)]);
    dut.run_until(Instant::from(7_500.millis()) - Duration::TICK);
    assert_eq!(dut.out.currents.len(), 1);
    dut.run_until(7_500.millis());
    assert_eq!(dut.out.currents.len(), 2);
    assert_eq!(dut.read(0x1a), 0xf100);
    assert_eq!(dut.read(0x15), 0x1388);
    assert_eq!(dut.out.memory, garbage, "it stays as it is until a save");
    dut.write(0x1a, 1);
    dut.run_until(dut.now + 20.millis());
    let mut dut = off(dut.out.memory);
    dut.power_on(Boot { fast: true, ..Boot::default() });
    assert_eq!(dut.read(0x1a), 0x9a00);
}

#[test]
fn what_pins_are_told_in_the_instant_of_a_fast_start_is_no_edge() {
    let mut dut = off(vec![0xFF; MEMORY]);
    let mut preset = |reg: Reg, value| dut.try_set(reg, value).unwrap();
    preset(Reg::HomingConfiguration, 1);
    preset(Reg::HomeOffset, 50);
    preset(Reg::PinFunctionAndPolarity, 0b0001 << 4);
    dut.power_on(Boot { fast: true, ..Boot::default() });
    // J2 pins 2, 4, 10 and 9.
    for (pin, high) in [(0, false), (2, false), (5, true), (4, true)] {
        dut.drive.input(Instant::ZERO, Input::Edge { pin: Pin(pin), high }, &mut dut.out);
    }
    dut.run_until(Instant::ZERO);
    assert_eq!((dut.get(Reg::QuadratureEncoderCount), dut.get(Reg::EncoderIndexCount)), (0, 0));
    // The flag is active already, so only the offset of the home cycle is left. Pin 4 started no move.
    assert_eq!(dut.control(), HOME);
    dut.run_until(1.secs());
    assert_eq!((dut.control(), dut.position()), (0, 50));
    // A and B return to 0, where the index is valid: the count becomes `MaxCount`.
    dut.pin(10, false);
    assert_eq!((dut.get(Reg::QuadratureEncoderCount), dut.get(Reg::EncoderIndexCount)), (0x0f9f, -1));
}

#[test]
fn a_command_in_the_instant_of_a_fast_start_is_carried_out() {
    let mut dut = off(vec![0xFF; MEMORY]);
    dut.power_on(Boot { fast: true, ..Boot::default() });
    dut.input(Instant::ZERO, Input::Bytes { port: Port(0), bytes: &rtu::write(1, 0x11, 1) });
    dut.input(Instant::ZERO, Input::Idle { port: Port(0) });
    assert_eq!(dut.control(), MOVE);
}
