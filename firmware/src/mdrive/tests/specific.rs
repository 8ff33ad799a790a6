//! Functions 65 and 66 as in FB 4.3, with its examples.

use super::*;

/// Mnemonic as sent in a request: blanks, then the characters in reverse order.
fn mnemonic(name: &str) -> [u8; 4] {
    let mut sent = [b' '; 4];
    for (target, character) in sent.iter_mut().rev().zip(name.bytes()) {
        *target = character;
    }
    sent
}

fn read(name: &str) -> Vec<u8> {
    [&[65][..], &mnemonic(name)].concat()
}

fn write(name: &str, string: &str) -> Vec<u8> {
    [&[66][..], &mnemonic(name), &[string.len() as u8], string.as_bytes()].concat()
}

impl Dut {
    /// Values that function 65 reads.
    fn specific(&mut self, name: &str) -> String {
        let reply = self.ask(&read(name));
        assert_eq!(reply[..2], [65, reply.len() as u8 - 2], "{name}: {reply:02x?}");
        String::from_utf8(reply[2..].to_vec()).unwrap()
    }

    /// Writes with function 66, which must be accepted.
    fn set_specific(&mut self, name: &str, string: &str) {
        let reply = [&[66, 4][..], &mnemonic(name)].concat();
        assert_eq!(self.ask(&write(name, string)), reply, "{name}{string}");
    }
}

#[test]
fn examples_of_the_manual() {
    let mut dut = Dut::plus();
    // FB 4.3.3: S1=0,1,0. The manual prints function 41h.
    let request = [0x42, 0x20, 0x20, 0x31, 0x53, 0x06, 0x3D, 0x30, 0x2C, 0x31, 0x2C, 0x30];
    assert_eq!(dut.ask(&request), [0x42, 0x04, 0x20, 0x20, 0x31, 0x53]);
    assert_eq!(dut.specific("S1"), "0, 1, 0");
    // FB 4.3.2: reading TR.
    let reply = [0x41, 0x07, 0x30, 0x2C, 0x20, 0x30, 0x2C, 0x20, 0x30];
    assert_eq!(dut.ask(&[0x41, 0x20, 0x20, 0x52, 0x54]), reply);
    // Mnemonics of FB 4.3.1.
    assert_eq!(mnemonic("S13"), [0x20, 0x33, 0x31, 0x53]);
    assert_eq!(mnemonic("CR"), [0x20, 0x20, 0x52, 0x43]);
    assert_eq!(mnemonic("MU"), [0x20, 0x20, 0x55, 0x4D]);
    assert_eq!(mnemonic("E"), [0x20, 0x20, 0x20, 0x45]);
    for (name, string, values) in [
        ("S1", "=0,0,0", "0, 0, 0"),
        ("S7", "=34,1", "34, 1"),
        ("CR", "=1.500", "1.500"),
        ("S13", "=60,0", "60, 0"),
        ("TR", "=6500", "6500, 0, 0"),
    ] {
        dut.set_specific(name, string);
        assert_eq!(dut.specific(name), values, "{name}{string}");
    }
    let mut dut = Dut::hybrid();
    dut.set_specific("MU", "=2,0");
    assert_eq!(dut.specific("MU"), "2, 0");
}

#[test]
fn defaults() {
    let mut dut = Dut::plus();
    for (name, values) in [
        ("S1", "0, 0, 0"),
        ("S4", "0, 0, 0"),
        ("S5", "9, 0"),
        ("S7", "33, 0"),
        ("S8", "33, 0"),
        ("S13", "60, 0"),
        ("CR", "1.000"),
        ("TR", "0, 0, 0"),
    ] {
        assert_eq!(dut.specific(name), values, "{name}");
    }
    assert_eq!(Dut::hybrid().specific("MU"), "0, 0");
}

#[test]
fn types_of_inputs_and_outputs() {
    // The types of FB 4.3.1, then those that only MC 5-63 has.
    for (n, kind) in [(1, 0), (2, 1), (3, 2), (4, 3), (1, 5), (2, 7), (3, 8), (4, 11), (1, 4), (2, 6)]
        .into_iter()
        .chain([(1, 16), (2, 17), (3, 18), (4, 19), (1, 20), (2, 23)])
    {
        let mut dut = Dut::plus();
        // The pin is low first: "Ground the input first or a reset will occur" (MC 5-63).
        dut.drive(n, false);
        let (name, string) = (std::format!("S{n}"), std::format!("={kind},1,1"));
        dut.set_specific(&name, &string);
        assert_eq!(dut.specific(&name), std::format!("{kind}, 1, 1"));
    }
    for kind in [9, 10, 12, 15, 22, 26, 33, 60, 255] {
        Dut::plus().refused(&write("S2", &std::format!("={kind},0,0")), 3, 8);
    }
    for kind in [21, 24, 25] {
        let string = std::format!("={kind},0,0");
        Dut::plus().refused(&write("S2", &string), 3, 8);
        Dut::hybrid().set_specific("S2", &string);
    }
    let mut dut = Dut::plus();
    dut.set_specific("S1", "=2,0,0");
    dut.refused(&write("S3", "=2,0,0"), 3, 6);
    assert_eq!(dut.specific("S3"), "0, 0, 0");
    for (name, string, error) in [
        ("S1", "=0,2,0", 21),
        ("S1", "=0,0,2", 21),
        ("S1", "=-1,0,0", 21),
        // Control characters are not allowed in MCode.
        ("S1", "=0,0,0\r", 24),
        ("S1", "=0\0,0,0", 24),
        ("S5", "=8,0", 8),
        ("S5", "=0,0", 8),
        ("S5", "=9,2", 21),
        ("S7", "=36,0", 11),
        ("S8", "=48,0", 11),
        ("S13", "=62,0", 8),
        ("CR", "=0", 21),
        ("CR", "=2.001", 21),
    ] {
        Dut::plus().refused(&write(name, string), 3, error);
    }
}

/// MC 5-66: both points are set up in pairs.
#[test]
fn a_clock_type_is_that_of_both() {
    let mut dut = Dut::plus();
    dut.set_specific("S8", "=49,1");
    assert_eq!((dut.specific("S7").as_str(), dut.specific("S8").as_str()), ("49, 0", "49, 1"));
    dut.set_specific("S7", "=34,1");
    assert_eq!((dut.specific("S7").as_str(), dut.specific("S8").as_str()), ("34, 1", "34, 1"));
}

#[test]
fn values_that_are_left_out_are_0() {
    let mut dut = Dut::plus();
    dut.set_specific("S1", "=16,1,1");
    dut.set_specific("S1", "=16");
    assert_eq!(dut.specific("S1"), "16, 0, 0");
    dut.set_specific("S5", "=10");
    assert_eq!(dut.specific("S5"), "10, 0");
}

#[test]
fn what_is_no_mnemonic_of_these_functions() {
    for name in ["VM", "S6", "S9", "S", "S0", "S14", "PR", "MU", "TP", ""] {
        let mut dut = Dut::plus();
        dut.refused(&read(name), 2, 0);
        dut.refused(&write(name, "=1"), 2, 0);
    }
    for name in ["S7", "S8", "CR"] {
        Dut::hybrid().refused(&read(name), 2, 0);
    }
    for sent in [*b"S1  ", *b"  s1", *b"1S  ", *b" 1S "] {
        Dut::plus().refused(&[&[65][..], &sent].concat(), 2, 0);
    }
}

#[test]
fn wrong_structure_does_not_reach_mcode() {
    let mut dut = Dut::plus();
    for pdu in [
        &[65][..],
        &[66, b' ', b' ', b'1'],
        &[65, b' ', b' ', b'1', b'S', 0],
        &[66, b' ', b' ', b'1', b'S'],
        &[66, b' ', b' ', b'1', b'S', 0],
        &[66, b' ', b' ', b'1', b'S', 2, b'='],
        &[66, b' ', b' ', b'1', b'S', 1, b'=', b'0'],
        &[65, b' ', b' ', b' ', b'E', 1, b'1'],
        &[65, b' ', b' ', b'X', b'E'],
    ] {
        dut.refused(pdu, 3, 0);
    }
    let long = std::format!("=0,0,{:024}", 0);
    assert_eq!(long.len(), 29);
    dut.refused(&write("S1", &long), 3, 0);
}

#[test]
fn strings_that_are_none() {
    for (name, string, error) in [
        ("S1", "0,0,0", 24),
        ("CR", "1.5", 24),
        ("EX", "ZZ", 30),
        ("EX", "=ZZ", 30),
        ("EX", "768", 42),
        ("EX", "5", 42),
    ] {
        Dut::plus().refused(&write(name, string), 3, error);
    }
    for string in ["=", "=,,", "=,1,0", "=x", "=0,0,0,0", "==", "=0 0", "=\"", "=\u{1}"] {
        let mut dut = Dut::plus();
        assert_eq!(dut.ask(&write("S1", string)), [0xC2, 3], "{string}");
        assert_ne!(dut.error(), 0, "{string}");
        assert_eq!(dut.specific("S1"), "0, 0, 0");
    }
}

#[test]
fn a_program_is_run_and_ended() {
    for function in [65, 66] {
        let mut dut = Dut::plus();
        dut.connect(CLIENT);
        dut.type_in(CLIENT, "PG 100\rLB A3\rIC R1\rBR A3\rE\rPG\r");
        let tell = |dut: &mut Dut, name: &str, data: &[u8]| {
            let reply = dut.ask(&[&[function][..], &mnemonic(name), data].concat());
            let expected =
                if function == 65 { vec![65, 0] } else { [&[66, 4][..], &mnemonic(name)].concat() };
            assert_eq!(reply, expected, "{name}");
        };
        tell(&mut dut, "EX", b"\x02A3");
        assert_eq!(dut.get(Reg::BY), 1);
        dut.wait(100.millis());
        let counted = dut.read(0x5F, 2);
        // Each count takes three lines of 210 µs.
        assert!((155..=160).contains(&counted), "{counted}");
        tell(&mut dut, "PS", &[]);
        let paused = dut.read(0x5F, 2);
        dut.wait(100.millis());
        assert_eq!(dut.read(0x5F, 2), paused);
        tell(&mut dut, "RS", &[0]);
        dut.wait(100.millis());
        assert!(dut.read(0x5F, 2) > paused);
        tell(&mut dut, "E", &[]);
        assert_eq!(dut.get(Reg::BY), 0);
        tell(&mut dut, "EX", b"\x04=100");
        assert_eq!((dut.get(Reg::BY), dut.error()), (1, 0));
    }
}
