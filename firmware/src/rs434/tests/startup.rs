//! Tests of power-on, restart, reset to the factory values, and lights (4, 6.5, 7).

use super::*;

/// Changes of the lights: time in ms, "red" or "green", true for on.
fn lights(dut: &Fixture<DriveWithMotor<Rs434>>) -> Vec<(u64, &'static str, bool)> {
    let name = |pin| if pin == RED { "red" } else { "green" };
    let lit = dut.out.levels.iter().filter(|(_, pin, _)| [RED, GREEN].contains(pin));
    lit.map(|(at, pin, level)| (at.ticks() / 16_000, name(*pin), *level == Level::High)).collect()
}

#[test]
fn it_is_deaf_for_half_a_second() {
    let mut dut = booting();
    dut.run_until(200.millis());
    assert!(dut.ask(&rtu::read(1, 0x500B, 1)).is_empty());
    assert_eq!(dut.out.noted(), [LogEvent::Dropped { port: Port(0), why: DropReason::Starting }]);
    // A character that ends exactly at the end of the start is the last one that is lost.
    dut.run_until(Instant::from(500.millis()) - CHARACTER);
    assert!(dut.ask(&rtu::read(1, 0x500B, 1)).is_empty());
    let mut dut = booting();
    dut.run_until(Instant::from(500.millis()) - CHARACTER + Duration::TICK);
    assert_eq!(dut.read(0x500B), 1_000);
    assert_eq!(lights(&dut), [(500, "green", true)]);
}

#[test]
fn a_fast_start_hears_in_its_own_instant() {
    let mut dut = without_power();
    dut.power_on(Boot { fast: true, ..Boot::default() });
    dut.input(Instant::ZERO, Input::Bytes { port: Port(0), bytes: &rtu::write(1, 0x500B, 2_000) });
    dut.input(Instant::ZERO, Input::Idle { port: Port(0) });
    assert_eq!(dut.get(Reg::SPEED), 2_000);
}

#[test]
fn contacts_of_a_fast_start_are_told_before_it() {
    let mut dut = without_power();
    dut.power_on(Boot { fast: true, ..Boot::default() });
    dut.contact(HARD_STOP, false);
    dut.run_until(Instant::ZERO);
    assert_eq!(dut.get(Reg::ERROR), 1 << 5);
}

#[test]
fn a_restart_is_answered_and_then_it_is_deaf() {
    let mut dut = booting();
    dut.run_until(1.secs());
    dut.write(0x500B, 2_000);
    dut.write(0x7000, 5);
    dut.write(0x5026, 0x95AF);
    let restart = dut.now;
    assert_eq!((dut.get(Reg::SPEED), dut.get(Reg::AX_REG)), (1_000, 0), "it was not saved");
    assert!(dut.ask(&rtu::read(1, 0x500B, 1)).is_empty());
    dut.run_until(restart + 500.millis());
    assert_eq!(dut.read(0x5026), 0);
    let lights = lights(&dut);
    assert_eq!(lights.len(), 3);
    assert_eq!((lights[0].2, lights[1].2, lights[2].2), (true, false, true));
}

#[test]
fn the_line_changes_with_a_save_and_a_restart() {
    let mut dut = ready();
    assert_eq!(dut.try_write_all(0x5000, &[7, 4, 4, 0])[0], 16);
    assert_eq!(dut.read(0x5000), 7, "at the old address, on the old line");
    dut.write(0x5026, 0x95AF);
    assert_eq!(dut.read(0x5000), 1, "not saved");
    assert_eq!(dut.try_write_all(0x5000, &[7, 4, 4, 0])[0], 16);
    dut.write(0x5024, 0x37FA);
    dut.write(0x5026, 0x95AF);
    // The save is not complete at the restart, which finishes it.
    dut.wait(1.millis());
    let line = dut.out.lines.last().unwrap().2;
    assert_eq!((line.baud, line.bits()), (9_600, 11));
    assert_eq!((dut.get(Reg::SLAVE_ADDRESS_MODBUS), dut.get(Reg::ERROR)), (7, 0));
    let frame = rtu::read(7, 0x5000, 1);
    let at = dut.now + line.character();
    dut.input(at, Input::Bytes { port: Port(0), bytes: &frame });
    dut.wait(1.secs());
    assert_eq!(dut.out.sent(Port(0)).last().unwrap().1, rtu::frame(7, &[3, 2, 0, 7]).to_vec());
}

#[test]
fn clr_flash_for_five_seconds_is_the_factory() {
    let mut dut = without_power();
    for (reg, value) in [(Reg::SPEED, 5_000), (Reg::BITRATE_MODBUS, 4), (Reg::USE_HALL, 0)] {
        dut.set(reg, value);
    }
    let program = vec![0x5A; MEMORY - SETTINGS];
    dut.out.memory[SETTINGS..].copy_from_slice(&program);
    dut.power_on(Boot::default());
    dut.contact(CLR_FLASH, true);
    dut.run_until(Instant::from(5.secs()) - Duration::TICK);
    assert_eq!(dut.get(Reg::SPEED), 5_000);
    let shown = lights(&dut);
    assert_eq!(shown[..4], [(0, "red", true), (250, "red", false), (250, "green", true), (500, "red", true)]);
    dut.run_until(5.secs());
    assert_eq!((dut.get(Reg::SPEED), dut.get(Reg::USE_HALL)), (1_000, 2));
    assert_eq!(dut.out.lines.last().unwrap().2.baud, 115_200);
    dut.run_until(Instant::from(5_500.millis()) - Duration::TICK);
    assert_eq!((dut.light(RED), dut.light(GREEN)), (false, false));
    dut.run_until(5_500.millis());
    assert_eq!((dut.light(RED), dut.light(GREEN)), (false, true));
    assert_eq!(dut.out.memory[SETTINGS..], program, "the program stays");
    // The contact is open at the next start, so there is no reset.
    dut.cycle();
    assert_eq!((dut.get(Reg::SPEED), dut.get(Reg::ERROR)), (1_000, 1 << 7));
}

#[test]
fn the_motor_goes_by_the_factory_after_a_reset() {
    let mut dut = without_power();
    for (reg, value) in [(Reg::SPEED, 3_000), (Reg::RATED_SPEED, 6_000), (Reg::USE_HALL, 0)] {
        dut.set(reg, value);
    }
    dut.power_on(Boot::default());
    dut.contact(CLR_FLASH, true);
    dut.run_until(6.secs());
    dut.coil(0x2000);
    dut.wait(1.secs());
    let rpm = dut.get(Reg::SPEED_VALID);
    assert!((950..=1_050).contains(&rpm), "{rpm} rpm");
    assert!(dut.get(Reg::CURRENT_POSITION) > 200, "16 counts a turn");
}

#[test]
fn clr_flash_that_opens_earlier_changes_nothing() {
    let mut dut = without_power();
    dut.set(Reg::SPEED, 5_000);
    dut.power_on(Boot::default());
    dut.contact(CLR_FLASH, true);
    dut.run_until(Instant::from(4_999.millis()));
    dut.contact(CLR_FLASH, false);
    dut.wait(499.millis());
    assert_eq!((dut.light(RED), dut.light(GREEN)), (false, false));
    dut.wait(1.millis());
    assert!(dut.light(GREEN));
    assert_eq!(dut.read(0x500B), 5_000);
    // During operation the contact has no effect.
    dut.contact(CLR_FLASH, true);
    dut.wait(6.secs());
    assert_eq!(dut.read(0x500B), 5_000);
}
