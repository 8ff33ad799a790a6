//! Values that a reset does not change.

use super::*;

impl Dut {
    /// Switches power off and on, with nothing connected; the adapter is ready at once.
    fn cycle(&mut self) {
        self.wait(1.secs());
        self.power_on(Boot { fast: true, ..Boot::default() });
        self.wait(10.millis());
    }
}

#[test]
fn command_3_saves_the_parameters() {
    let mut dut = Dut::ready(Qsb::m());
    let rows = [
        ("00", "00000001"),
        ("02", "00000F00"),
        ("01", "0000000A"),
        ("03", "00000063"),
        ("04", "00000100"),
        ("08", "00000064"),
        ("0B", "00000007"),
        ("0C", "00000100"),
        ("0F", "000003E8"),
        ("10", "00001000"),
        ("11", "FFFFFFFE"),
        ("12", "FFFFFF00"),
        ("15", "0000000B"),
    ];
    for (register, value) in rows {
        dut.write(&std::format!("W{register}{value}"));
    }
    dut.write("W0D1");
    dut.write("W163");
    dut.wait(10.millis());
    dut.write("W0C7");
    dut.cycle();
    for (register, value) in rows {
        assert_eq!(dut.ask(&std::format!("R{register}")), std::format!("r {register} {value} !"));
    }
    assert_eq!(dut.level(DIO0), Level::Low, "configuration first, then the outputs");
    assert_eq!(dut.level(DIO3), Level::Float);
}

#[test]
fn without_command_3_the_factory_values_come_back() {
    let mut dut = Dut::ready(Qsb::s());
    dut.write("W0C7");
    dut.cycle();
    assert_eq!(dut.ask("R0C"), "r 0C 0000FFFF !");
}

#[test]
fn a_save_takes_10_ms_and_another_begins_anew() {
    let mut dut = Dut::ready(Qsb::m());
    dut.command_at(100.millis(), "W163");
    dut.command_at(105.millis(), "W163");
    dut.run_until(1.secs());
    let at: Vec<_> = [100_u64, 105, 115].map(|ms| Instant::from(ms.millis())).to_vec();
    assert_eq!(dut.out.stores.iter().map(|(at, ..)| *at).collect::<Vec<_>>(), at);
}

#[test]
fn a_save_that_power_cuts_leaves_the_factory_values() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0C7");
    dut.write("W163");
    dut.power_on(Boot { fast: true, ..Boot::default() });
    assert_eq!(dut.ask("R0C"), "r 0C 0000FFFF !");
}

#[test]
fn a_reset_by_the_host_cuts_no_save() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0C7");
    dut.write("W163");
    dut.feed(Input::HostPresence { port: USB, here: true });
    dut.wait(10.millis());
    assert_eq!(dut.ask("R0C"), "r 0C 00000007 !");
}

#[test]
fn a_rate_saves_itself_and_nothing_else() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0C7");
    dut.write("W163");
    dut.write("W0C8");
    // The save has not ended, but its values are kept.
    dut.write("W1640A");
    dut.character = Duration::from_ticks(1_389);
    dut.cycle();
    assert_eq!(dut.out.lines.last().unwrap().2.to_string(), "115200 8N1");
    assert_eq!(dut.ask("R0C"), "r 0C 00000007 !");
}

#[test]
fn streams_wake_up_after_the_banner() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0C10");
    dut.ask("S0E");
    dut.ask("S01");
    dut.write("W163");
    dut.wait(1.secs());
    let power = dut.now;
    dut.fixture.power_on(Boot::default());
    dut.texts();
    dut.run_until(power + 100.millis());
    dut.pin(DIO0, false);
    dut.run_until(power + 101.millis());
    let texts = dut.texts();
    // The banner is sent within tick 25 (48.8 ms); the interval of 16 ticks starts there.
    assert_eq!(
        texts,
        [
            (power + 50.millis(), "QSB-M  0E!".into()),
            (power + TICK * 41, "s 0E 00000000 !".into()),
            (power + 100.millis(), "s 01 0000000E !".into()),
        ]
    );
}

#[test]
fn the_motor_drive_wakes_up() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W162");
    dut.write("W163");
    dut.cycle();
    assert_eq!(dut.ask("R13"), "r 13 00000011 !");
    dut.write("W160");
    dut.write("W163");
    dut.cycle();
    assert_eq!(dut.ask("R13"), "r 13 00000001 !");
}

#[test]
fn command_0_ends_the_motor_drive_and_brings_the_saved_port_back() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W02E00");
    dut.write("W01D");
    dut.write("W163");
    dut.wait(20.millis());
    dut.write("W162");
    // DIO1 and DIO2 belong to the motor drive: step low, direction low.
    assert_eq!(dut.ask("R01"), "r 01 00000009 !");
    dut.write("W02F00");
    dut.write("W010");
    assert_eq!(dut.ask("R01"), "r 01 00000000 !");
    let from = dut.out.levels.len();
    dut.write("W160");
    assert_eq!(dut.ask("R13"), "r 13 00000001 !");
    assert_eq!(dut.ask("R02"), "r 02 00000E00 !");
    assert_eq!(dut.ask("R01"), "r 01 0000000D !");
    let levels = [DIO0, DIO1, DIO2, DIO3].map(|pin| dut.levels(pin, from).last().map(|(_, level)| *level));
    assert_eq!(levels, [Some(Level::Float), Some(Level::Low), Some(Level::Float), Some(Level::Float)]);
}

#[test]
fn the_motor_drives_lines_are_left_alone() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W162");
    assert_eq!([dut.level(DIO1), dut.level(DIO2)], [Level::Low; 2]);
    assert_eq!(dut.out.plans.len(), 1);
    let from = dut.out.levels.len();
    for command in ["W02F00", "W010", "W01F", "W020", "W161"] {
        dut.write(command);
    }
    assert_eq!(dut.levels(DIO1, from), []);
    assert_eq!(dut.levels(DIO2, from), []);
    assert_eq!(dut.ask("R13"), "r 13 00000011 !", "command 1 leaves the motor drive");
}

#[test]
fn the_motor_obeys_its_commands() {
    let mut dut = Dut::ready(Qsb::m());
    for (command, answer) in [
        ("W168", "e 16 00000008 !"),
        ("W169", "e 16 00000009 !"),
        ("W164", "w 16 00000004 !"),
        ("W165", "w 16 00000005 !"),
        ("W166", "w 16 00000006 !"),
        ("W167", "w 16 00000007 !"),
        ("W162", "w 16 00000002 !"),
        ("W0F3E8", "w 0F 000003E8 !"),
        ("W10186A0", "w 10 000186A0 !"),
        ("W117D0", "w 11 000007D0 !"),
        ("S13", "s 13 00000011 !"),
        ("R13", "r 13 00000011 !"),
        ("W168", "w 16 00000008 !"),
        ("R13", "r 13 00000012 !"),
        ("W168", "e 16 00000008 !"),
    ] {
        assert_eq!(dut.ask(command), answer);
    }
    dut.ask("S13");
    dut.texts();
    dut.wait(5.secs());
    let texts: Vec<_> = dut.texts().into_iter().map(|(_, text)| text).collect();
    assert_eq!(texts, ["s 13 00000011 !"]);
}

#[test]
fn presets_before_power_are_saved() {
    let mut dut = Dut::off(Qsb::m());
    for (reg, value) in [
        (Reg::IntervalRate, 7),
        (Reg::SerialNumber, 99_999),
        (Reg::BaudRate, 4),
        (Reg::Mdr1, 0x1FF),
        (Reg::Mode, 17),
    ] {
        assert_eq!(dut.try_set(reg, value), Ok(()));
    }
    assert_eq!(dut.try_set(Reg::TimeStamp, 1), Err(PresetError::ReadOnly));
    assert_eq!(dut.try_set(Reg::Streams, 0x1F), Ok(()));
    assert_eq!(dut.try_set(Reg::MotorDrive, 1), Ok(()));
    dut.power_on(Boot { fast: true, ..Boot::default() });
    assert_eq!(dut.out.lines[0].2.to_string(), "115200 8N1");
    dut.character = Duration::from_ticks(1_389);
    assert_eq!(dut.ask("R0C"), "r 0C 00000007 !");
    assert_eq!(dut.ask("R0E"), "r 0E 00000000 !");
    assert_eq!(dut.ask("R14"), "r 14 9999910E !");
    assert_eq!(dut.ask("R04"), "r 04 000001FC !");
    assert_eq!(dut.ask("R00"), "r 00 00000001 !");
    assert_eq!(dut.ask("R13"), "r 13 00000011 !");
}

/// A memory from before the register Firmware existed; its image is one word shorter.
#[test]
fn an_older_memory_is_still_good() {
    let mut dut = Dut::off(Qsb::m());
    assert_eq!(dut.try_set(Reg::SerialNumber, 12_345), Ok(()));
    assert_eq!(dut.try_set(Reg::IntervalRate, 7), Ok(()));
    let image = MEMORY - 4;
    let sum = drivetwin_protocol::modbus::rtu::crc(&dut.out.memory[..image]).to_be_bytes();
    dut.out.memory[image..].fill(0xFF);
    dut.out.memory[image..image + 2].copy_from_slice(&sum);
    dut.power_on(Boot { fast: true, ..Boot::default() });
    assert_eq!((dut.ask("R14").as_str(), dut.ask("R0C").as_str()), ("r 14 1234510E !", "r 0C 00000007 !"));
    // This memory accepts a preset.
    assert_eq!(dut.try_set(Reg::Firmware, 0x10), Ok(()));
    assert_eq!(dut.ask("R14"), "r 14 12345110 !");
}

#[test]
fn a_bad_memory_is_that_of_a_new_adapter_and_refuses_presets() {
    let mut dut = Dut::off(Qsb::d());
    dut.out.memory.fill(0x55);
    assert_eq!(dut.try_set(Reg::IntervalRate, 7), Err(PresetError::BadMemory));
    dut.power_on(Boot { fast: true, ..Boot::default() });
    assert_eq!(dut.ask("R03"), "r 03 0000004F !");
    // Command A saves the baud rate together with the factory values.
    dut.write("W0C7");
    dut.write("W1660A");
    dut.cycle();
    assert_eq!(dut.ask("R0C"), "r 0C 0000FFFF !");
    assert_eq!(dut.ask("R14"), "r 14 0000100E !");
}

#[test]
fn what_a_variant_lacks_does_not_wake_up() {
    let mut dut = Dut::off(Qsb::m());
    assert_eq!(dut.try_set(Reg::Streams, 0x1F), Ok(()));
    assert_eq!(dut.try_set(Reg::MotorDrive, 1), Ok(()));
    let mut other = Dut::off(Qsb::s());
    other.out.memory = dut.fixture.out.memory;
    other.power_on(Boot { fast: true, ..Boot::default() });
    other.write("W163");
    assert_eq!(other.get(Reg::Streams), 0b01110, "CAPTURE, STR and READ ENCODER");
    assert_eq!(other.get(Reg::MotorDrive), 0);
}
