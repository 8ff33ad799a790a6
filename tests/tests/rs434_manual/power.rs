//! Sections 6.5 and 7: power-on, restart, saving, factory reset.

use drivetwin_firmware::device::Level;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{PinStimulus, PowerAction, Setup};
use drivetwin_sim::line::LineMode;
use drivetwin_tests::rs434::{BOOT, Rig, at, key};

fn answers(rig: &mut Rig) -> bool {
    !rig.bench.ask(rig.seat, &rtu::read(1, at::SPEED, 1)).is_empty()
}

/// RS434-9: for 500 ms after power-on the drive receives nothing.
#[test]
fn section_6_power_on() {
    let mut rig = Rig::new("rs434544", LineMode::Fast, Setup::default());
    rig.after(BOOT - 1.millis());
    assert!(!answers(&mut rig));
    rig.after(1.millis());
    assert!(answers(&mut rig));
    assert_eq!([at::STATUS, at::ERROR, at::STATUS_USER_PROGRAM].map(|address| rig.read(address)), [0, 0, 1]);
}

/// "Causes the controller reboot": the write is answered, then the drive receives nothing for 500 ms
/// (RS434-9). Then the position is 0, the motor is at rest, and unsaved values are lost.
#[test]
fn section_6_5_restart() {
    let mut rig = Rig::default();
    rig.write(at::START, 1);
    rig.after(1.secs());
    assert!(rig.read_long(at::CURRENT_POSITION) > 100);
    rig.write(at::RESTART, key::RESTART);
    rig.after(BOOT - 2.millis());
    assert!(!answers(&mut rig));
    rig.after(3.millis());
    assert!(answers(&mut rig));
    assert_eq!([at::STATUS, at::ERROR].map(|address| rig.read(address)), [0, 0]);
    rig.after(2.secs());
    assert_eq!(rig.motion().speed, 0);
    // The motor may have coasted, but not far, at 16 counts per turn and 1,000 rpm.
    assert!(rig.read_long(at::CURRENT_POSITION).abs() < 100);
    assert_eq!(rig.try_write(at::RESTART, 0x95AE), Err(3));
}

/// After a restart of a drive at rest the position is 0.
#[test]
fn section_6_5_restart_clears_the_position() {
    let mut rig = Rig::default();
    rig.write(at::MODE_ROTATION, 2);
    rig.write_long(at::OFFSET, 100);
    rig.write(at::START, 1);
    rig.after(5.secs());
    assert_eq!(rig.read_long(at::CURRENT_POSITION), 100);
    rig.restart();
    assert_eq!(rig.read_long(at::CURRENT_POSITION), 0);
}

/// RS434-11: if power fails during a save, the drive uses factory values, sets bit 9, and does not change its
/// memory. A save and a restart repair it.
#[test]
fn section_6_5_power_lost_in_a_save() {
    let mut rig = Rig::default();
    rig.write(at::SPEED, 500);
    rig.save();
    rig.write(at::SPEED, 600);
    rig.write(at::SAVE_INI, key::SAVE);
    rig.after(1.millis());
    rig.bench.power(rig.seat, PowerAction::Off);
    rig.after(1.secs());
    let memory = rig.bench.memory(rig.seat).to_vec();
    rig.bench.power(rig.seat, PowerAction::On);
    rig.after(BOOT + 1.millis());
    assert_eq!((rig.read(at::SPEED), rig.read(at::ERROR)), (1_000, 1 << 9));
    assert_eq!(rig.bench.memory(rig.seat), memory);
    rig.write(at::ERROR, 0);
    assert_eq!(rig.read(at::ERROR), 1 << 9, "RS434-23: until a restart");
    rig.write(at::SPEED, 700);
    rig.save();
    rig.restart();
    assert_eq!((rig.read(at::SPEED), rig.read(at::ERROR)), (700, 0));
}

/// A drive with a saved program, SPEED 500 and address 9, whose power was switched on with CLR_FLASH closed.
fn with_clr_flash_closed() -> Rig {
    let mut rig = Rig::default();
    rig.write(at::SPEED, 500);
    rig.write(at::SLAVE_ADDRESS, 9);
    rig.save();
    rig.load(&[0x0007_0001]);
    rig.bench.power(rig.seat, PowerAction::Off);
    rig.after(1.secs());
    rig.close("CLR_FLASH");
    rig.bench.power(rig.seat, PowerAction::On);
    rig.after(Duration::TICK * 2);
    rig
}

/// "The red and green LEDs on the unit will light up alternately."
#[test]
fn section_7_lights() {
    let mut rig = with_clr_flash_closed();
    let (mut changes, mut before) = (0, None);
    rig.after(125.millis());
    for _ in 0..19 {
        let lit = ["RED", "GREEN"].map(|light| rig.level(light) == Level::High);
        assert!(lit[0] != lit[1], "one of them, not both");
        changes += u32::from(before.is_some_and(|before| before != lit));
        before = Some(lit);
        assert!(!answers(&mut rig));
        rig.after(250.millis());
    }
    assert_eq!(changes, 18);
}

/// "Keep CLR_FLASH_CON and GND closed for 5s. After that, the controller parameters will be reset to the
/// factory values." The user program stays (RS434-10).
#[test]
fn section_7_factory_reset() {
    let mut rig = with_clr_flash_closed();
    rig.after(4_990.millis());
    assert!(!answers(&mut rig));
    rig.after(BOOT + 100.millis());
    assert_eq!([at::SPEED, at::SLAVE_ADDRESS].map(|address| rig.read(address)), [1_000, 1]);
    rig.open("CLR_FLASH");
    rig.power_cycle();
    assert_eq!([at::SPEED, at::SLAVE_ADDRESS, at::ERROR].map(|address| rig.read(address)), [1_000, 1, 0]);
    rig.run();
    rig.after(1.millis());
    assert_eq!(rig.read(at::AX), 7);
}

/// After a factory reset the motor obeys the factory values, although other settings were saved before.
#[test]
fn section_7_the_motor_after_a_factory_reset() {
    let mut rig = Rig::default();
    for (address, value) in
        [(at::USE_HALL, 0), (at::SPEED, 2_000), (at::DIRECTION, 2), (at::ACC, 10), (at::REF_CURRENT, 1_000)]
    {
        rig.write(address, value);
    }
    rig.save();
    rig.bench.power(rig.seat, PowerAction::Off);
    rig.after(1.secs());
    rig.close("CLR_FLASH");
    rig.bench.power(rig.seat, PowerAction::On);
    rig.after(5.secs() + BOOT + 1.millis());
    rig.write(at::START, 1);
    // A ramp to 1,000 rpm takes 31 ms with ACC 100 (545 rps²), and 167 ms with ACC 10 (100 rps²).
    rig.after(60.millis());
    let rpm = rig.motion().speed.to_num::<f64>() / 16.0 * 60.0;
    assert!((980.0..1_020.0).contains(&rpm), "{rpm} rpm");
    rig.after(6.secs());
    let counts = rig.read_long(at::CURRENT_POSITION);
    assert!((1_550..1_650).contains(&counts), "{counts} counts of 100 turns");
    assert_eq!((rig.read(at::STATUS), rig.read(at::SPEED_VALID).abs_diff(1_000) < 30), (1, true));
}

/// RS434-10: if CLR_FLASH opens before 5 s are over, the drive starts with unchanged settings.
#[test]
fn section_7_opened_too_early() {
    let mut rig = with_clr_flash_closed();
    rig.after(4_900.millis());
    rig.open("CLR_FLASH");
    rig.after(BOOT + 10.millis());
    assert!(!answers(&mut rig), "its address is 9");
    let reply = rig.bench.ask(rig.seat, &rtu::read(9, at::SPEED, 1));
    assert_eq!(reply, rtu::frame(9, &[3, 2, 0x01, 0xF4])[..]);
}

/// CLR_FLASH has an effect only at power-on.
#[test]
fn section_7_not_while_it_runs() {
    let mut rig = Rig::default();
    rig.write(at::SPEED, 500);
    rig.close("CLR_FLASH");
    rig.after(10.secs());
    assert_eq!(rig.read(at::SPEED), 500);
}

/// 4: "LED indicator of device operation": green while the drive is ready, and red, too, during an error that
/// stops the motor.
#[test]
fn section_4_lights() {
    let mut rig = Rig::default();
    assert_eq!(["GREEN", "RED"].map(|light| rig.level(light)), [Level::High, Level::Low]);
    rig.drive("HARD_STOP", PinStimulus::High);
    rig.after(1.millis());
    assert_eq!(rig.level("RED"), Level::High);
}
