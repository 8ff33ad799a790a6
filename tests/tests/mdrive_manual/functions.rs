//! Functions 1, 2, 3, 5 and 16 with the bytes printed in FB 4.2, and all functions that a drive does not
//! have.

use drivetwin_firmware::device::Level;

use crate::rig::{KINDS, Rig, request};

/// FB 4.2.1: I1 = 1, I2 = 1, I3 = 0, I4 = 1 reads as 0B. Inputs of a new drive are active low (FB 6.4.3).
#[test]
fn inputs_are_read_as_printed() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for (name, low) in [("IO1", true), ("IO2", true), ("IO3", false), ("IO4", true)] {
            if low {
                rig.low(name);
            } else {
                rig.high(name);
            }
        }
        assert_eq!(rig.ask(&[0x02, 0x00, 0x2D, 0x00, 0x04]), [0x02, 0x01, 0x0B]);
        // The lowest bit is the input at the requested address.
        assert_eq!(rig.ask(&[0x02, 0x00, 0x2E, 0x00, 0x03]), [0x02, 0x01, 0b101]);
        assert_eq!(rig.ask(&[0x02, 0x00, 0x2F, 0x00, 0x01]), [0x02, 0x01, 0]);
        assert_eq!(rig.ask(&[0x02, 0x00, 0x30, 0x00, 0x01]), [0x02, 0x01, 1]);
        assert_eq!(rig.try_words(0x002D, 4), Ok(vec![1, 1, 0, 1]), "the holding registers");
        // IL and IN show levels: 1 is a voltage (MC 5-36).
        assert_eq!((rig.word(0x003A), rig.word(0x003B)), (0b0100, 0b0100), "IL and IN");
    }
}

/// FB 4.2.2: O1 = 1, O2 = 0, O3 = 1, O4 = 0 reads as 05. FB 4.2.3: function 5 switches output 3 on.
#[test]
fn outputs_are_written_and_read_as_printed() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.set(&["S1=16,1,0", "S2=16,1,0", "S3=16,1,0", "S4=16,1,0"]);
        let on = [0x05, 0x00, 0x4D, 0xFF, 0x00];
        assert_eq!(rig.ask(&on), on);
        assert_eq!(rig.ask(&[0x05, 0x00, 0x4B, 0xFF, 0x00])[0], 5);
        assert_eq!(rig.ask(&[0x01, 0x00, 0x4B, 0x00, 0x04]), [0x01, 0x01, 0x05]);
        assert_eq!(rig.ask(&[0x01, 0x00, 0x4C, 0x00, 0x02]), [0x01, 0x01, 0b10]);
        assert_eq!(rig.try_words(0x004B, 4), Ok(vec![1, 0, 1, 0]), "the holding registers");
        let off = [0x05, 0x00, 0x4D, 0x00, 0x00];
        assert_eq!(rig.ask(&off), off);
        assert_eq!(rig.ask(&[0x01, 0x00, 0x4B, 0x00, 0x04]), [0x01, 0x01, 0x01]);
        // These outputs are active high and sinking: an output that is on has high impedance (MC 5-64).
        assert_eq!((rig.level("IO1"), rig.level("IO3")), (Level::Float, Level::Low));
        // Outputs can also be written as holding registers, one by one and as a group.
        rig.write(0x004E, 1);
        assert_eq!(rig.ask(&[0x01, 0x00, 0x4B, 0x00, 0x04]), [0x01, 0x01, 0b1001]);
        for group in [0x0055, 0x0056] {
            rig.write(group, 0b0110);
            assert_eq!(rig.ask(&[0x01, 0x00, 0x4B, 0x00, 0x04]), [0x01, 0x01, 0b0110]);
            rig.write(group, 0);
        }
        rig.assert_no_error();
    }
}

/// All other values are illegal and return exception 03 (FB 4.2.3).
#[test]
fn a_coil_is_ff00_or_0000() {
    let mut rig = Rig::plus();
    rig.set(&["S1=16,1,0"]);
    for value in [0x0001, 0x00FF, 0x0100, 0xFF01, 0xFFFF, 0xFE00] {
        assert_eq!(rig.try_ask(&request(5, 0x004B, value)), Err(3), "{value:#06X}");
    }
    rig.assert_no_error();
}

/// A write to a point that is not an output gives error 9 (MC 9.1). The exception is 04, because the state of
/// the drive is wrong, not the value.
#[test]
fn what_is_no_general_output_is_not_written() {
    let mut rig = Rig::plus();
    rig.set(&["S2=17,1,0"]);
    for address in [0x004B, 0x004C] {
        assert_eq!(rig.try_ask(&request(5, address, 0xFF00)), Err(4), "{address:#06X}");
        assert_eq!(rig.ef_er(), (1, 9), "{address:#06X}");
        assert_eq!(rig.try_write(address, &[1]), Err(4), "{address:#06X}");
        assert_eq!(rig.ef_er(), (1, 9), "{address:#06X}");
    }
    rig.refused("O1=1", 9);
    rig.set(&["S1=16,1,0"]);
    assert_eq!(rig.try_write(0x004B, &[2]), Err(3));
    assert_eq!(rig.ef_er(), (1, 21));
    assert_eq!(rig.try_write(0x0055, &[16]), Err(3));
    assert_eq!(rig.ef_er(), (1, 21));
}

#[test]
fn bits_have_bounds() {
    let mut rig = Rig::plus();
    for (function, first) in [(1, 0x004B), (2, 0x002D)] {
        for quantity in [0, 5, 8, 2_000, 0xFFFF] {
            assert_eq!(rig.try_ask(&request(function, first, quantity)), Err(3), "{function}, {quantity}");
        }
        for (address, quantity) in [(first - 1, 1), (first + 4, 1), (first + 1, 4), (first + 3, 2), (0, 1)] {
            assert_eq!(
                rig.try_ask(&request(function, address, quantity)),
                Err(2),
                "{function}, {address:#X}"
            );
        }
    }
    // Function 1 does not read inputs, and function 2 does not read outputs.
    assert_eq!(rig.try_ask(&request(1, 0x002D, 1)), Err(2));
    assert_eq!(rig.try_ask(&request(2, 0x004B, 1)), Err(2));
    for address in [0x004A, 0x004F, 0x002D, 0xFFFF] {
        assert_eq!(rig.try_ask(&request(5, address, 0xFF00)), Err(2), "{address:#X}");
    }
    rig.assert_no_error();
}

/// FB 4.2.4 and 4.2.5, with VM at its address in the register map.
#[test]
fn maximum_velocity_is_read_and_written_as_printed() {
    let mut rig = Rig::plus();
    assert_eq!(rig.ask(&[0x03, 0x00, 0x8B, 0x00, 0x02]), [0x03, 0x04, 0x00, 0x0B, 0xB8, 0x00]);
    let write = [0x10, 0x00, 0x8B, 0x00, 0x02, 0x04, 0x00, 0x09, 0x27, 0xC0];
    assert_eq!(rig.ask(&write), [0x10, 0x00, 0x8B, 0x00, 0x02]);
    assert_eq!(rig.long(0x008B), 600_000);
    rig.assert_values(&[("VM", 600_000)]);
}

/// FB 4, table 4.1: all other functions give exception 01.
#[test]
fn other_functions_are_not_there() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let there = [1, 2, 3, 5, 16, 43, 65, 66];
        for function in (1..=127).filter(|function| !there.contains(function)) {
            assert_eq!(rig.try_ask(&[function, 0, 0, 0, 1]), Err(1), "{function}");
            assert_eq!(rig.try_ask(&[function]), Err(1), "{function}");
        }
        rig.assert_no_error();
    }
}

#[test]
fn a_pdu_of_a_wrong_length_is_refused() {
    let mut rig = Rig::plus();
    rig.set(&["S1=16,1,0"]);
    let good: [&[u8]; 5] = [
        &[1, 0, 0x4B, 0, 1],
        &[2, 0, 0x2D, 0, 1],
        &[3, 0, 0x5F, 0, 2],
        &[5, 0, 0x4B, 0xFF, 0],
        &[16, 0, 0x5F, 0, 2, 4, 0, 0, 0, 1],
    ];
    for pdu in good {
        for length in 1..pdu.len() {
            assert_eq!(rig.try_ask(&pdu[..length]), Err(3), "{:02X?}", &pdu[..length]);
        }
        assert_eq!(rig.try_ask(&[pdu, &[0]].concat()), Err(3), "a byte more than {pdu:02X?}");
        assert!(rig.try_ask(pdu).is_ok(), "{pdu:02X?}");
    }
    // Byte counts that do not fit the quantity.
    for count in [0, 2, 3, 5, 6, 255] {
        assert_eq!(rig.try_ask(&[16, 0, 0x5F, 0, 2, count, 0, 0, 0, 9]), Err(3), "{count}");
    }
    assert_eq!(rig.long(0x005F), 1);
    rig.assert_no_error();
}

/// EF and ER stay set until a master reads ER or writes 0 to it (FB 5, MC 5-23).
#[test]
fn an_error_is_there_until_it_is_read_or_set_to_0() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        rig.assert_no_error();
        assert_eq!(rig.try_write(0x0067, &[101]), Err(3));
        assert_eq!(rig.word(0x001F), 1);
        assert_eq!(rig.word(0x001F), 1, "reading EF does not clear it");
        assert_eq!(rig.word(0x0021), 21);
        rig.assert_no_error();
        assert_eq!(rig.try_write(0x0067, &[0]), Err(3));
        rig.write(0x0021, 0);
        rig.assert_no_error();
        // Modbus reads errors that MCode caused, and the other way round.
        rig.say("VM=1");
        assert_eq!(rig.ef_er(), (1, 23));
        assert_eq!(rig.try_write(0x0067, &[101]), Err(3));
        assert_eq!((rig.value("EF"), rig.value("ER"), rig.value("EF")), (1, 21, 0));
    }
}
