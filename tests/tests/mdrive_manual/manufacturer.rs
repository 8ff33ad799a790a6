//! Functions 65 and 66 with every mnemonic of FB 4.3.1.

use drivetwin_protocol::time::Span;

use crate::rig::{KINDS, Kind, Rig};

/// Mnemonics, reversed and padded as printed.
const S1: &[u8; 4] = b"  1S";
const S2: &[u8; 4] = b"  2S";
const S5: &[u8; 4] = b"  5S";
const S7: &[u8; 4] = b"  7S";
const S8: &[u8; 4] = b"  8S";
const S13: &[u8; 4] = b" 31S";
const CR: &[u8; 4] = b"  RC";
const TR: &[u8; 4] = b"  RT";
const MU: &[u8; 4] = b"  UM";
const EX: &[u8; 4] = b"  XE";
const END: &[u8; 4] = b"   E";
const PS: &[u8; 4] = b"  SP";
const RS: &[u8; 4] = b"  SR";

/// FB 4.3.2: the reply to 41 20 20 52 54 has seven characters, "0, 0, 0".
#[test]
fn a_trip_is_read_as_printed() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let reply = rig.ask(&[0x41, 0x20, 0x20, 0x52, 0x54]);
        assert_eq!(reply, [0x41, 0x07, 0x30, 0x2C, 0x20, 0x30, 0x2C, 0x20, 0x30]);
    }
}

/// FB 4.3.3: S1=0,1,0. In the reply the four bytes of the mnemonic follow 04.
#[test]
fn an_input_is_set_up_as_printed() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let parameters = [0x06, 0x3D, 0x30, 0x2C, 0x31, 0x2C, 0x30];
        let reply = rig.ask(&[&[0x42, 0x20, 0x20, 0x31, 0x53][..], &parameters].concat());
        assert_eq!(reply, [0x42, 0x04, 0x20, 0x20, 0x31, 0x53]);
        assert_eq!(rig.try_read_specific(S1).as_deref(), Ok("0, 1, 0"));
        assert_eq!(rig.show("S1"), "0, 1, 0");
    }
}

/// "A – I/O type", and types 4, 6 and 19, which MCode has in addition (MC 5-63).
#[test]
fn every_type_of_input_and_output_is_taken_at_every_point() {
    let both = [0, 1, 2, 3, 4, 5, 6, 7, 8, 16, 17, 18, 19, 20, 23];
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for mnemonic in [S1, S2, b"  3S", b"  4S"] {
            assert_eq!(rig.try_read_specific(mnemonic).as_deref(), Ok("0, 0, 0"));
            for function in both {
                for (active, source) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    // Types that start, stop or pause something may also cause an error; `ef_er` clears it.
                    let done = rig.try_write_specific(mnemonic, &format!("={function},{active},{source}"));
                    assert_eq!(done, Ok(()), "{function},{active},{source}");
                    let shown = rig.try_read_specific(mnemonic);
                    assert_eq!(shown, Ok(format!("{function}, {active}, {source}")));
                    rig.ef_er();
                }
            }
            let own = if kind == Kind::Hybrid { Ok(()) } else { Err(3) };
            for function in [21, 24, 25] {
                let done = rig.try_write_specific(mnemonic, &format!("={function},0,0"));
                assert_eq!(done, own, "{function} of {kind:?}");
                assert_eq!(rig.ef_er(), if own.is_ok() { (0, 0) } else { (1, 8) }, "{function}");
            }
            assert_eq!(rig.try_write_specific(mnemonic, "=0,0,0"), Ok(()));
        }
    }
}

/// Type 11 resets the drive as Ctrl-C does. Nothing happens while its input is inactive.
#[test]
fn a_reset_input_can_be_set_up() {
    let mut rig = Rig::plus();
    rig.high("IO1");
    assert_eq!(rig.try_write_specific(S1, "=11,0,0"), Ok(()));
    assert_eq!(rig.try_read_specific(S1).as_deref(), Ok("11, 0, 0"));
}

#[test]
fn what_is_no_type_is_error_8_and_a_second_of_a_kind_error_6() {
    let mut rig = Rig::plus();
    for function in [9, 10, 12, 13, 14, 15, 21, 22, 24, 25, 26, 33, 60, 255, 1_000] {
        assert_eq!(rig.try_write_specific(S1, &format!("={function},0,0")), Err(3), "{function}");
        assert_eq!(rig.ef_er(), (1, 8), "{function}");
    }
    for text in ["=0,2,0", "=0,0,2", "=0,-1,0", "=16,1,9"] {
        assert_eq!(rig.try_write_specific(S1, text), Err(3), "{text}");
        assert_eq!(rig.ef_er(), (1, 21), "{text}");
    }
    // Characters that the device does not understand (MC 9.2).
    for text in ["=0,0,0\r", "=0,0,0\n", "=0,\t0,0", "=0,0,\u{7F}0"] {
        assert_eq!(rig.try_write_specific(S1, text), Err(3), "{text:?}");
        assert_eq!(rig.ef_er(), (1, 24), "{text:?}");
    }
    for function in [1, 2, 3, 5, 7, 8] {
        assert_eq!(rig.try_write_specific(S1, &format!("={function},0,0")), Ok(()), "{function}");
        assert_eq!(rig.try_write_specific(S2, &format!("={function},0,0")), Err(3), "{function}");
        assert_eq!(rig.ef_er(), (1, 6), "{function}");
        assert_eq!(rig.try_read_specific(S2).as_deref(), Ok("0, 0, 0"), "{function}");
        // The same type at the same point again is accepted.
        assert_eq!(rig.try_write_specific(S1, &format!("={function},1,0")), Ok(()), "{function}");
        rig.ef_er();
    }
}

#[test]
fn the_clock_points_are_those_of_the_plus() {
    let mut rig = Rig::plus();
    for mnemonic in [S7, S8] {
        assert!(rig.try_read_specific(mnemonic).is_ok_and(|text| text.starts_with("33, ")));
    }
    // Clock points are set up in pairs (MC 5-66). The manual prints =34,1 for type 34.
    for function in [33, 34, 35, 49, 50, 51] {
        for active in [0, 1] {
            for mnemonic in [S7, S8] {
                let done = rig.try_write_specific(mnemonic, &format!("={function},{active}"));
                assert_eq!(done, Ok(()), "{function},{active}");
                assert_eq!(rig.try_read_specific(mnemonic), Ok(format!("{function}, {active}")));
            }
        }
    }
    assert_eq!(rig.try_write_specific(S7, "=33,0"), Ok(()));
    assert_eq!(rig.try_read_specific(S8).as_deref(), Ok("33, 1"), "the type is that of both");
    for function in [0, 32, 36, 48, 52, 60] {
        assert_eq!(rig.try_write_specific(S7, &format!("={function},0")), Err(3), "{function}");
        assert_eq!(rig.ef_er(), (1, 11), "{function}");
    }
    let mut hybrid = Rig::hybrid();
    for mnemonic in [S7, S8, CR] {
        assert_eq!(hybrid.try_read_specific(mnemonic), Err(2));
        assert_eq!(hybrid.try_write_specific(mnemonic, "=33,0"), Err(2));
    }
}

/// MC 5-14: CR is 0.001 to 2.000.
#[test]
fn the_clock_ratio_is_in_thousandths() {
    let mut rig = Rig::plus();
    assert_eq!(rig.try_read_specific(CR).as_deref(), Ok("1.000"));
    for (text, shown) in [("=1.500", "1.500"), ("=0.001", "0.001"), ("=2.000", "2.000"), ("=0.5", "0.500")] {
        assert_eq!(rig.try_write_specific(CR, text), Ok(()), "{text}");
        assert_eq!(rig.try_read_specific(CR).as_deref(), Ok(shown));
        assert_eq!(rig.show("CR"), shown);
    }
    for text in ["=0", "=0.000", "=2.001", "=3", "=-1"] {
        assert_eq!(rig.try_write_specific(CR, text), Err(3), "{text}");
        assert_eq!(rig.ef_er(), (1, 21), "{text}");
    }
    assert_eq!(rig.show("CR"), "0.500");
}

#[test]
fn the_analogue_input_measures_volts_or_milliamperes() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        assert_eq!(rig.try_read_specific(S5).as_deref(), Ok("9, 0"));
        for text in ["9,1", "10,0", "10,1", "9,0"] {
            assert_eq!(rig.try_write_specific(S5, &format!("={text}")), Ok(()), "{text}");
            assert_eq!(rig.try_read_specific(S5), Ok(text.replace(',', ", ")));
        }
        for text in ["=8,0", "=11,0", "=0,0"] {
            assert_eq!(rig.try_write_specific(S5, text), Err(3), "{text}");
            assert_eq!(rig.ef_er(), (1, 8), "{text}");
        }
    }
}

#[test]
fn the_high_speed_point_captures_or_trips() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        assert_eq!(rig.try_read_specific(S13).as_deref(), Ok("60, 0"));
        for text in ["60,1", "61,0", "61,1", "60,0"] {
            assert_eq!(rig.try_write_specific(S13, &format!("={text}")), Ok(()), "{text}");
            assert_eq!(rig.try_read_specific(S13), Ok(text.replace(',', ", ")));
        }
        assert!(rig.try_write_specific(S13, "=62,0").is_err());
        let (flag, error) = rig.ef_er();
        assert_eq!(flag, 1);
        assert!([8, 12].contains(&error), "{error}");
    }
}

/// A value has up to 11 characters: =6500, or with a sign and ten digits.
#[test]
fn a_relative_trip_is_defined() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for (text, shown) in
            [("=6500", "6500, 0, 0"), ("=-200000000", "-200000000, 0, 0"), ("=500,0,3", "500, 0, 3")]
        {
            assert_eq!(rig.try_write_specific(TR, text), Ok(()), "{text}");
            assert_eq!(rig.try_read_specific(TR).as_deref(), Ok(shown));
            assert_eq!(rig.show("TR"), shown);
        }
    }
}

/// The value =2,0 is the printed one. MCode does not save the parameter (MC 5-50).
#[test]
fn make_up_is_of_the_hybrid() {
    let mut rig = Rig::hybrid();
    assert_eq!(rig.try_read_specific(MU).as_deref(), Ok("0, 0"));
    for text in ["=2,0", "=1,1", "=0,0"] {
        assert_eq!(rig.try_write_specific(MU, text), Ok(()), "{text}");
        let mode = u16::from(text.as_bytes()[1] - b'0');
        assert_eq!(rig.word(0x00A0), mode, "MU");
    }
    for text in ["=3,0", "=0,2"] {
        assert_eq!(rig.try_write_specific(MU, text), Err(3), "{text}");
        assert_eq!(rig.ef_er(), (1, 21), "{text}");
    }
    let mut plus = Rig::plus();
    assert_eq!(plus.try_read_specific(MU), Err(2));
    assert_eq!(plus.try_write_specific(MU, "=2,0"), Err(2));
}

const SLOW: &str = "PG 100\nLB A3\nVA V1\nMR 1000000\nLB A4\nIC V1\nH 100\nBR A4\nE\nPG";

/// FB 4.3.1: EX, PS, RS and E work with function 66, and with function 65, under which the manual has their
/// table.
#[test]
fn a_program_is_run_paused_resumed_and_ended() {
    for kind in KINDS {
        for function in [65_u8, 66] {
            let mut rig = Rig::new(kind);
            rig.program(SLOW);
            let order = |rig: &mut Rig, mnemonic: &[u8; 4], label: Option<&[u8]>| {
                let mut pdu = vec![function];
                pdu.extend(mnemonic);
                if let Some(label) = label {
                    pdu.push(label.len() as u8);
                    pdu.extend(label);
                } else if function == 66 {
                    pdu.push(0);
                }
                let reply = rig.ask(&pdu);
                if function == 65 {
                    assert_eq!(reply, [65, 0], "{mnemonic:?}");
                } else {
                    assert_eq!(reply, [&[66, 4], &mnemonic[..]].concat());
                }
            };
            assert_eq!(rig.value("BY"), 0);
            order(&mut rig, EX, Some(b"A3"));
            rig.after(1.secs());
            assert_eq!((rig.value("BY"), rig.word(0x004A)), (1, 1), "BY and MV");
            let counted = rig.long(0x00A8);
            assert!((8..=11).contains(&counted), "{counted} times in 1 s");
            // PS also pauses the motion (MC 5-57), with a ramp down to standstill.
            order(&mut rig, PS, None);
            rig.after(2.secs());
            assert_eq!(rig.word(0x004A), 0, "MV");
            let (paused, position) = (rig.long(0x00A8), rig.long(0x0057));
            assert!(position < 1_000_000);
            rig.after(1.secs());
            assert_eq!((rig.long(0x00A8), rig.long(0x0057)), (paused, position));
            order(&mut rig, RS, None);
            rig.after(1.secs());
            assert!(rig.long(0x00A8) > paused);
            order(&mut rig, END, None);
            assert_eq!(rig.value("BY"), 0);
            let ended = rig.long(0x00A8);
            rig.after(5.secs());
            assert_eq!(rig.long(0x00A8), ended, "V1 is as the program left it");
            // E does not stop the motion (MC 5-20).
            assert_eq!(rig.long(0x0057), 1_000_000);
            rig.assert_no_error();
        }
    }
}

/// A program can also be started by its address, and with the `=` that the other strings have.
#[test]
fn a_program_is_run_by_address_too() {
    let mut rig = Rig::plus();
    rig.program(SLOW);
    for label in ["100", "A3", "=A3", "a3"] {
        assert_eq!(rig.try_write_specific(EX, label), Ok(()), "{label}");
        rig.after(10.millis());
        assert_eq!(rig.value("BY"), 1, "{label}");
        assert_eq!(rig.try_write_specific(END, ""), Ok(()));
        assert_eq!(rig.value("BY"), 0);
        rig.set(&["SL 0"]);
        rig.after(3.secs());
    }
}

#[test]
fn a_program_that_is_not_there_is_not_run() {
    let mut rig = Rig::plus();
    assert_eq!(rig.try_write_specific(EX, "ZZ"), Err(3));
    assert_eq!(rig.ef_er(), (1, 30));
    assert_eq!(rig.try_write_specific(EX, "600"), Err(3));
    assert_eq!(rig.ef_er(), (1, 42));
    assert_eq!(rig.try_write_specific(EX, "768"), Err(3));
    assert_eq!(rig.ef_er(), (1, 42));
    assert_eq!(rig.value("BY"), 0);
}

#[test]
fn unknown_mnemonics_are_illegal_addresses() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for mnemonic in
            [b"    ", b"  9S", b" 21S", b"  ZZ", b"S1  ", b"  S1", b"  MV", b"\0\0\0\0", b"\xFF\xFF\xFF\xFF"]
        {
            assert_eq!(rig.try_read_specific(mnemonic), Err(2), "{mnemonic:02X?}");
            assert_eq!(rig.try_write_specific(mnemonic, "=0,0,0"), Err(2), "{mnemonic:02X?}");
        }
        rig.assert_no_error();
    }
}

#[test]
fn strings_that_say_nothing_are_illegal_values() {
    let mut rig = Rig::plus();
    for text in ["", "=", "x", "=x", "=,,", "=0,1,0,0", "=0;1;0", "=0,1,x", "=99999999999,0,0", "=\0,0,0"] {
        assert_eq!(rig.try_write_specific(S1, text), Err(3), "{text:?}");
        rig.ef_er();
        assert_eq!(rig.try_read_specific(S1).as_deref(), Ok("0, 0, 0"), "{text:?}");
    }
    // More than 28 characters (FB 4.3.3).
    assert_eq!(rig.try_write_specific(S1, "=0,1,0                       "), Err(3));
    // Byte counts that are not the length of the string.
    for count in [0, 5, 7, 255] {
        let pdu = [&[66][..], S1, &[count], b"=0,1,0"].concat();
        assert_eq!(rig.try_ask(&pdu), Err(3), "{count}");
    }
    for length in 1..6 {
        assert_eq!(rig.try_ask(&[&[66][..], S1, &[6]].concat()[..length]), Err(3), "{length} bytes");
    }
    for length in 1..5 {
        assert_eq!(rig.try_ask(&[&[65][..], S1].concat()[..length]), Err(3), "{length} bytes");
    }
}
