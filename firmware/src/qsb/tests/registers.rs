//! Registers: factory values, the registers of each variant, effects of writes.

use super::*;

/// Factory values of the registers, as a new QSB-M reads them.
const FACTORY: [(&str, u32); 18] = [
    ("00", 0),
    ("01", 0xF),
    ("02", 0),
    ("03", 0x4F),
    ("04", 0),
    ("05", 0),
    ("06", 0x0A),
    ("07", 0),
    ("08", 0x1F3),
    ("0B", 0),
    ("0C", 0xFFFF),
    ("0E", 0),
    ("0F", 0x20),
    ("10", 0x186A0),
    ("11", 0),
    ("12", 0x20),
    ("13", 1),
    ("15", 0xB),
];

#[test]
fn factory_values_by_variant() {
    let variants = [
        (Qsb::d as fn() -> Qsb, &["0F", "10", "11", "12", "13"][..], "r 14 0000100E !"),
        (Qsb::m, &[], "r 14 0000110E !"),
        (Qsb::s, &["01", "02", "0F", "10", "11", "12", "13"], "r 14 0000120E !"),
    ];
    for (make, lacks, version) in variants {
        let mut dut = Dut::ready(make());
        for (register, value) in FACTORY {
            let answer = dut.ask(&std::format!("R{register}"));
            if lacks.contains(&register) {
                assert_eq!(answer, std::format!("x {register} 00000000 !"));
            } else {
                assert_eq!(answer, std::format!("r {register} {value:08X} !"));
            }
        }
        assert_eq!(dut.ask("R14"), version);
    }
}

#[test]
fn a_variant_refuses_what_it_lacks() {
    for (make, commands) in [
        (Qsb::d as fn() -> Qsb, &["W0F20", "W1040", "W110", "W1220", "S13"][..]),
        (Qsb::s, &["W01F", "S01", "W020", "W0F20", "W1040", "W110", "W1220", "S13"]),
    ] {
        let mut dut = Dut::ready(make());
        for command in commands {
            assert_eq!(dut.ask(command), std::format!("x {} 00000000 !", &command[1..3]));
        }
        for number in ["0", "2", "4", "5", "6", "7", "8", "9"] {
            let answer = dut.ask(&std::format!("W16{number}"));
            assert_eq!(answer, std::format!("e 16 0000000{number} !"));
        }
        assert_eq!(dut.ask("W161"), "w 16 00000001 !");
        assert_eq!(dut.ask("W163"), "w 16 00000003 !");
        assert_eq!(dut.ask("W1660A"), "w 16 0000060A !");
    }
}

#[test]
fn writes_read_back() {
    let mut dut = Dut::ready(Qsb::m());
    for (write, read, value) in [
        ("W0001", "R00", "r 00 00000001 !"),
        // Bits 2 and 3 have no meaning, bit 4 is read only.
        ("W0012", "R00", "r 00 00000002 !"),
        ("W000C", "R00", "r 00 00000000 !"),
        ("W0010", "R00", "r 00 00000000 !"),
        ("W021FFF", "R02", "r 02 00001FFF !"),
        ("W0363", "R03", "r 03 00000063 !"),
        ("W041FF", "R04", "r 04 000001FC !"),
        ("W08ffffffff", "R08", "r 08 FFFFFFFF !"),
        ("W0BFFFF", "R0B", "r 0B 0000FFFF !"),
        ("W0C5", "R0C", "r 0C 00000005 !"),
        ("W0F32C8", "R0F", "r 0F 000032C8 !"),
        ("W1057E40", "R10", "r 10 00057E40 !"),
        ("W1180000001", "R11", "r 11 80000001 !"),
        ("W117FFFFFFF", "R11", "r 11 7FFFFFFF !"),
        ("W12FFFFCD38", "R12", "r 12 FFFFCD38 !"),
        ("W1232C8", "R12", "r 12 000032C8 !"),
    ] {
        assert!(dut.ask(write).starts_with("w "), "{write}");
        assert_eq!(dut.ask(read), value);
    }
}

#[test]
fn clear_and_load_move_the_counter() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W081F4");
    dut.write("W0A0");
    assert_eq!(dut.ask("R07"), "r 07 000001F4 !");
    assert_eq!(dut.ask("R0E"), "r 0E 000001F4 !");
    dut.write("W092");
    assert_eq!(dut.ask("R07"), "r 07 00000000 !");
    dut.write("W0A1");
    dut.write("W041F0");
    dut.write("W090");
    dut.write("W091");
    assert_eq!(dut.ask("R03"), "r 03 00000000 !", "0, and not the factory's value");
    assert_eq!(dut.ask("R04"), "r 04 00000000 !");
}

#[test]
fn quadrature_counts_in_both_directions() {
    let mut dut = Dut::ready(Qsb::s());
    dut.turn(8);
    assert_eq!(dut.ask("R0E"), "r 0E 00000008 !");
    // MDR0 4F is modulo-n with DTR + 1 = 500 values.
    dut.turn(-12);
    assert_eq!(dut.ask("R0E"), "r 0E 000001F0 !");
    assert_eq!(dut.ask("R06"), "r 06 00000049 !", "BW, CEN and S; down");
    dut.write("W093");
    assert_eq!(dut.ask("R06"), "r 06 00000008 !");
    dut.write("W0343");
    dut.write("W04100");
    dut.write("W092");
    dut.turn(4);
    assert_eq!(dut.ask("R0E"), "r 0E FFFFFFFC !", "count down");
}

#[test]
fn presetting_works_while_counting_down() {
    // Example 11.1: firmware 11 and older did this wrong.
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0343");
    dut.write("W04100");
    dut.write("W0864");
    dut.write("W0A0");
    dut.write("W081F3");
    assert_eq!(dut.ask("R0E"), "r 0E 00000064 !");
    dut.turn(4);
    assert_eq!(dut.ask("R0E"), "r 0E 00000060 !");
}

#[test]
fn the_index_is_active_high_or_inverted() {
    let mut dut = Dut::ready(Qsb::d());
    dut.write("W0323");
    dut.turn(4);
    dut.pin(I, true);
    dut.wait(1.micros());
    assert_eq!(dut.ask("R0E"), "r 0E 00000000 !", "reset by the index");
    dut.turn(4);
    dut.pin(I, false);
    dut.wait(1.micros());
    assert_eq!(dut.ask("R0E"), "r 0E 00000004 !");
    dut.pin(I, true);
    dut.wait(1.micros());
    dut.write("W0408");
    dut.turn(4);
    dut.pin(I, false);
    dut.wait(1.micros());
    assert_eq!(dut.ask("R0E"), "r 0E 00000000 !");
    assert_eq!(dut.ask("R06").as_bytes()[11], b'1', "IDX");
}

#[test]
fn the_time_stamp_counts_1_512_s() {
    let mut dut = Dut::ready(Qsb::s());
    dut.command_at(tick(3) - Duration::TICK, "R0D");
    dut.command_at(tick(4), "R0D");
    let numbers: Vec<_> = dut.texts().into_iter().map(|(_, text)| text).collect();
    assert_eq!(numbers, ["r 0D 00000002 !", "r 0D 00000004 !"]);
    // Only the value 1 clears TIME STAMP. The phase of the clock does not change.
    dut.command_at(tick(5) + TICK - Duration::TICK * 10, "W0D1");
    dut.run_until(tick(6));
    assert_eq!(dut.get(Reg::TimeStamp), 1);
    for (command, answer) in [("W0D2", "w 0D 00000002 !"), ("W0D0", "w 0D 00000000 !")] {
        assert_eq!(dut.ask(command), answer);
    }
    dut.run_until(tick(12));
    assert_eq!(dut.get(Reg::TimeStamp), 7);
    assert_eq!(dut.try_set(Reg::TimeStamp, 0xFFFF_FFFF), Ok(()));
    dut.run_until(tick(13));
    assert_eq!(dut.get(Reg::TimeStamp), 0, "it rolls over");
}

#[test]
fn presets_act_like_the_bus() {
    let mut dut = Dut::ready(Qsb::m());
    assert_eq!(dut.try_set(Reg::IntervalRate, 7), Ok(()));
    assert_eq!(dut.ask("R0C"), "r 0C 00000007 !");
    assert_eq!(dut.try_set(Reg::IntervalRate, 0x1_0000), Err(PresetError::OutOfRange));
    for reg in [Reg::Capture, Reg::Str, Reg::Otr, Reg::ReadEncoder, Reg::MdStatus, Reg::Version] {
        assert_eq!(dut.try_set(reg, 1), Err(PresetError::ReadOnly));
    }
    assert_eq!(dut.try_set(Reg::Streams, 1), Err(PresetError::ReadOnly));
    assert_eq!(dut.try_set(Reg::MotorDrive, 1), Err(PresetError::ReadOnly));
    assert_eq!(dut.try_set(Reg::Command, 8), Err(PresetError::OutOfRange), "no move without the motor drive");
    let Fixture { drive, out, now } = &mut dut.fixture;
    assert_eq!(drive.poke(*now, 999, 0, out), Err(PresetError::NoSuchRegister));
    assert_eq!(dut.try_set(Reg::SerialNumber, 12_345), Ok(()));
    assert_eq!(dut.ask("R14"), "r 14 1234510E !");
    let mut dut = Dut::ready(Qsb::s());
    assert_eq!(dut.try_set(Reg::DigIO, 1), Err(PresetError::NoSuchRegister));
}

#[test]
fn looking_ends_no_stream() {
    let mut dut = Dut::ready(Qsb::m());
    dut.ask("S01");
    assert_eq!(dut.get(Reg::DigIO), 0xF);
    dut.pin(DIO3, false);
    dut.wait(Duration::ZERO);
    assert_eq!(dut.texts(), [(dut.now, "s 01 00000007 !".into())]);
}
