//! FB 5, row by row: addresses, defaults, ranges, and MCode errors of refused values.

use super::*;

/// Name, address, number of registers, default, accepted values, refused values with their errors.
type Row = (&'static str, u8, u8, i64, &'static [i64], &'static [(i64, i64)]);

const FLAG: (&[i64], &[(i64, i64)]) = (&[1, 0], &[(2, 21), (256, 21), (0xFFFF, 21)]);
const BYTE: (&[i64], &[(i64, i64)]) = (&[1, 255, 0], &[(256, 21), (0xFFFF, 21)]);
const ANY: (&[i64], &[(i64, i64)]) = (&[1, -1, 2_147_483_647, -2_147_483_648, 0], &[]);
const MOVED: (&[i64], &[(i64, i64)]) = (&[40, -2_000_000_000, 0], &[]);
const PERCENT: (&[i64], &[(i64, i64)]) = (&[1, 100], &[(0, 21), (101, 21)]);

/// Rows of both products.
const COMMON: &[Row] = &[
    ("A", 0x00, 2, 1_000_000, &[91, 1_525_878_997], &[(90, 21), (1_525_878_998, 21), (-1, 21)]),
    ("C1", 0x05, 2, 0, MOVED.0, MOVED.1),
    ("C2", 0x07, 2, 0, MOVED.0, MOVED.1),
    ("CE", 0x09, 1, 1, &[0, 1], FLAG.1),
    ("D1", 0x0F, 1, 0, BYTE.0, BYTE.1),
    ("D2", 0x10, 1, 0, BYTE.0, BYTE.1),
    ("D3", 0x11, 1, 0, BYTE.0, BYTE.1),
    ("D4", 0x12, 1, 0, BYTE.0, BYTE.1),
    ("D5", 0x13, 1, 0, BYTE.0, BYTE.1),
    ("D", 0x18, 2, 1_000_000, &[91, 1_525_878_997], &[(90, 21), (1_525_878_998, 21), (-1, 21)]),
    ("EE", 0x1E, 1, 0, FLAG.0, FLAG.1),
    ("HC", 0x29, 1, 5, &[0, 100], &[(101, 21), (0xFFFF, 21)]),
    ("HT", 0x2C, 1, 500, &[0, 2, 65_535], &[(1, 21)]),
    ("JE", 0x3F, 1, 0, FLAG.0, FLAG.1),
    ("LM", 0x42, 1, 1, &[6, 2, 3, 4, 5, 1], &[(0, 21), (7, 21)]),
    (
        "MS",
        0x48,
        1,
        256,
        &[1, 2, 4, 5, 8, 10, 16, 25, 32, 50, 64, 100, 125, 128, 200, 250, 180, 108, 127, 256],
        &[(0, 21), (3, 21), (255, 21), (257, 21), (512, 21)],
    ),
    ("MT", 0x49, 1, 0, &[65_000, 0], &[(65_001, 21), (65_535, 21)]),
    ("P", 0x57, 2, 0, MOVED.0, MOVED.1),
    ("R1", 0x5F, 2, 0, ANY.0, ANY.1),
    ("R2", 0x61, 2, 0, ANY.0, ANY.1),
    ("R3", 0x63, 2, 0, ANY.0, ANY.1),
    ("R4", 0x65, 2, 0, ANY.0, ANY.1),
    ("RC", 0x67, 1, 25, PERCENT.0, PERCENT.1),
    ("VI", 0x89, 2, 1_000, &[1, 767_999], &[(0, 21), (-1, 21), (768_000, 22), (5_000_001, 22)]),
    ("VM", 0x8B, 2, 768_000, &[1_001, 5_000_000], &[(1_000, 23), (1, 23), (0, 23), (5_000_001, 21)]),
];

const PLUS: &[Row] = &[
    ("CM", 0x0B, 1, 0, FLAG.0, FLAG.1),
    ("DB", 0x1A, 1, 10, &[0, 65_000], &[(65_001, 21)]),
    ("PM", 0x5C, 1, 0, FLAG.0, FLAG.1),
    ("SF", 0x77, 1, 15, &[0, 65_000], &[(65_001, 21)]),
    ("SM", 0x7A, 1, 0, FLAG.0, FLAG.1),
];

const HYBRID: &[Row] = &[
    ("CA", 0x90, 1, 1, FLAG.0, FLAG.1),
    ("CB", 0x91, 1, 1, &[0, 3], &[(4, 21)]),
    ("CC", 0x92, 1, 100, PERCENT.0, PERCENT.1),
    ("CT", 0x94, 1, 200, &[2, 65_535], &[(0, 21), (1, 21)]),
    ("LD", 0x95, 2, 102_400, &[0, 2_147_483_647], &[(-1, 21)]),
    ("LG", 0x97, 2, 102_400, &[0, 2_147_483_647], &[(-1, 21)]),
    ("LT", 0x9C, 2, 2_000, &[2, 65_535], &[(1, 21), (65_536, 21), (-1, 21)]),
    ("MF", 0x9E, 2, 768_000, &[306, 5_000_000], &[(305, 21), (5_000_001, 21)]),
    ("MU", 0xA0, 1, 0, &[1, 2, 0], &[(3, 21)]),
    ("SS", 0xA2, 1, 0, BYTE.0, BYTE.1),
    ("TD", 0xA5, 1, 1, FLAG.0, FLAG.1),
    ("TQ", 0xA6, 1, 25, PERCENT.0, PERCENT.1),
    ("TS", 0xA7, 1, 0, BYTE.0, BYTE.1),
];

fn obeys(fresh: fn() -> Dut, rows: &[Row]) {
    for &(name, address, words, default, legal, illegal) in rows {
        let mut dut = fresh();
        assert_eq!(dut.read(address, words), default, "{name} by default");
        for &(value, error) in illegal {
            assert_eq!(dut.try_write(address, words, value), [0x90, 3], "{name} = {value}");
            assert_eq!(dut.error(), error, "{name} = {value}");
            assert_eq!(dut.read(address, words), default, "{name} after {value}");
        }
        for &value in legal {
            dut.write(address, words, value);
            let read = dut.read(address, words);
            assert_eq!(read, if words == 1 { value & 0xFFFF } else { value }, "{name}");
            assert_eq!(dut.error(), 0, "{name} = {value}");
        }
    }
}

fn is_missing(dut: &mut Dut, rows: &[Row]) {
    for &(_, address, words, ..) in rows {
        dut.refused(&[3, 0, address, 0, words], 2, 0);
        assert_eq!(dut.try_write(address, words, 1), [0x90, 2], "{address:#04x}");
        assert_eq!(dut.error(), 0);
    }
}

#[test]
fn what_both_products_have() {
    obeys(Dut::plus, COMMON);
    obeys(Dut::hybrid, COMMON);
}

#[test]
fn what_only_one_product_has() {
    obeys(Dut::plus, PLUS);
    obeys(Dut::hybrid, HYBRID);
    is_missing(&mut Dut::plus(), HYBRID);
    is_missing(&mut Dut::hybrid(), PLUS);
    for address in [0x32, 0x7B] {
        Dut::hybrid().refused(&[3, 0, address, 0, 1], 2, 0);
        Dut::plus().read(address, 1);
    }
    for address in [0x8E, 0x8F, 0x93, 0x9B, 0xA1] {
        Dut::plus().refused(&[3, 0, address, 0, 1], 2, 0);
        Dut::hybrid().read(address, 1);
    }
}

#[test]
fn the_line_count_of_the_encoder() {
    // Values from MC 5-22.
    assert_eq!(Dut::plus().get(Reg::EL), 512);
    assert_eq!(Dut::hybrid().get(Reg::EL), 1_000);
}

#[test]
fn reserved_addresses() {
    let reserved =
        [2, 3, 4, 0xA, 0xC, 0xE, 0x14, 0x17, 0x1D, 0x20, 0x22, 0x28, 0x2A, 0x33, 0x36, 0x38, 0x39, 0x3C]
            .into_iter()
            .chain([
                0x3E, 0x40, 0x41, 0x4F, 0x54, 0x5B, 0x5D, 0x5E, 0x68, 0x75, 0x7C, 0x7E, 0x84, 0x87, 0x8D,
                0xA3, 0xA4,
            ]);
    for (dut, address) in reserved.flat_map(|address| [(Dut::plus(), address), (Dut::hybrid(), address)]) {
        let mut dut = dut;
        dut.refused(&[3, 0, address, 0, 1], 2, 0);
        dut.refused(&[16, 0, address, 0, 1, 2, 0, 0], 2, 0);
    }
    let mut dut = Dut::plus();
    dut.refused(&[3, 0, 0xB8, 0, 1], 2, 0);
    dut.refused(&[3, 0xFF, 0xFF, 0, 2], 2, 0);
    dut.refused(&[3, 0, 0x09, 0, 2], 2, 0);
}

#[test]
fn what_can_only_be_read() {
    let mut dut = Dut::plus();
    for address in [0x1F, 0x2D, 0x2E, 0x2F, 0x30, 0x31, 0x32, 0x3A, 0x3B, 0x45, 0x4A, 0x88] {
        dut.read(address, 1);
        dut.refused(&[16, 0, address, 0, 1, 2, 0, 0], 2, 0);
    }
    for address in [0x59, 0x85] {
        dut.read(address, 2);
        dut.refused(&[16, 0, address, 0, 2, 4, 0, 0, 0, 0], 2, 0);
    }
    let mut dut = Dut::hybrid();
    dut.refused(&[16, 0, 0x8F, 0, 1, 2, 0, 0], 2, 0);
    dut.refused(&[16, 0, 0x99, 0, 2, 4, 0, 0, 0, 0], 2, 0);
    dut.refused(&[16, 0, 0x9B, 0, 1, 2, 0, 0], 2, 0);
}

#[test]
fn commands_can_be_read() {
    let mut dut = Dut::plus();
    assert_eq!([0x43, 0x46, 0x78].map(|address| dut.read(address, 2)), [0, 0, 0], "MA, MR, SL");
    assert_eq!(dut.read(0x2B, 1), 1, "HM");
    dut.write(0x76, 1, 200);
    dut.write(0x37, 1, 0x5F);
    assert_eq!([0x1B, 0x37, 0x55, 0x56, 0x76].map(|address| dut.read(address, 1)), [0; 5]);
    assert_eq!(dut.read(0x5F, 2), 1, "R1");
    dut.write(0x43, 2, 1_000);
    assert_eq!(dut.read(0x43, 2), 1_000);
    let mut dut = Dut::plus();
    dut.write(0x46, 2, -70_000);
    assert_eq!(dut.read(0x46, 2), -70_000);
    let mut dut = Dut::plus();
    dut.write(0x78, 2, -5_000_000);
    assert_eq!(dut.read(0x78, 2), -5_000_000);
    for value in [-5_000_001, 5_000_001] {
        assert_eq!((dut.try_write(0x78, 2, value), dut.error()), (vec![0x90, 3], 21));
    }
    for value in [0, 5, 256] {
        let mut dut = Dut::plus();
        assert_eq!((dut.try_write(0x2B, 1, value), dut.error()), (vec![0x90, 3], 81), "HM {value}");
    }
}

#[test]
fn an_error_is_cleared_by_reading_it_or_by_writing_0() {
    let mut dut = Dut::plus();
    dut.try_write(0x67, 1, 101);
    assert_eq!((dut.read(0x1F, 1), dut.get(Reg::ER)), (1, 21));
    assert_eq!((dut.read(0x1F, 1), dut.get(Reg::ER)), (1, 21), "not by looking");
    dut.write(0x21, 1, 0);
    assert_eq!((dut.read(0x1F, 1), dut.read(0x21, 1)), (0, 0));
    dut.try_write(0x21, 1, 5);
    assert_eq!(dut.error(), 21);
}

#[test]
fn delays_together_have_65535_ms() {
    let mut dut = Dut::plus();
    dut.write(0x49, 1, 65_000);
    // The largest HT for MT = 65,000: 65,535 - 65,000 = 535.
    dut.write(0x2C, 1, 535);
    assert_eq!((dut.try_write(0x2C, 1, 536), dut.error()), (vec![0x90, 3], 21));
    dut.write(0x49, 1, 0);
    dut.write(0x2C, 1, 65_535);
    assert_eq!((dut.try_write(0x49, 1, 1), dut.error()), (vec![0x90, 3], 21));
    assert_eq!((dut.read(0x2C, 1), dut.read(0x49, 1)), (65_535, 0));
}

#[test]
fn the_encoder_has_other_units() {
    // MC 7-22: 51,200 steps and 4 x 512 counts are a revolution, so 25 steps are a count.
    let mut dut = Dut::plus();
    dut.write(0x1E, 1, 1);
    let counts = [(0x00, 40_000), (0x18, 40_000), (0x89, 40), (0x8B, 30_720)];
    assert_eq!(counts.map(|(address, _)| (address, dut.read(address, 2))), counts);
    dut.write(0x1E, 1, 1);
    assert_eq!(dut.read(0x8B, 2), 30_720, "it was so already");
    dut.write(0x00, 2, 61_035_160);
    dut.write(0x8B, 2, 200_000);
    for (address, value, error) in [
        (0x00, 61_035_161, 21),
        (0x18, 61_035_161, 21),
        (0x8B, 200_001, 21),
        (0x78, 200_001, 21),
        (0x78, -200_001, 21),
    ] {
        assert_eq!((dut.try_write(address, 2, value), dut.error()), (vec![0x90, 3], error), "{address:#04x}");
    }
    assert_eq!((dut.try_write(0x48, 1, 128), dut.error()), (vec![0x90, 3], 36), "MS is locked");
    dut.write(0x48, 1, 256);
    dut.write(0x1E, 1, 0);
    // 61,035,160 x 25 is more than the maximum of A.
    let steps = [(0x00, 1_525_878_997), (0x18, 1_000_000), (0x89, 1_000), (0x8B, 5_000_000)];
    assert_eq!(steps.map(|(address, _)| (address, dut.read(address, 2))), steps);
}

/// MC 7-16: EE = 1 sets MS to 256. The speed of the motor stays the same.
#[test]
fn the_encoder_takes_ms_to_256() {
    let mut dut = Dut::plus();
    dut.write(0x48, 1, 128);
    dut.write(0x1E, 1, 1);
    assert_eq!(dut.read(0x48, 1), 256);
    // 25,600 steps and 2,048 counts are a revolution.
    assert_eq!([0x00, 0x18, 0x89, 0x8B].map(|address| dut.read(address, 2)), [80_000, 80_000, 80, 61_440]);
    dut.write(0x1E, 1, 0);
    assert_eq!((dut.read(0x48, 1), dut.read(0x8B, 2)), (256, 1_536_000));
    // On a Hybrid another MS calibrates (FB 5.1, CA), which is refused in motion.
    let mut dut = Dut::hybrid();
    dut.write(0x48, 1, 128);
    dut.wait(4.secs());
    dut.write(0x78, 2, 5_000);
    dut.refused(&[16, 0, 0x1E, 0, 1, 2, 0, 1], 4, 89);
    dut.write(0x78, 2, 0);
    dut.wait(1.secs());
    dut.write(0x1E, 1, 1);
    assert_eq!((dut.read(0x48, 1), dut.read(0x8F, 1)), (256, 0));
    dut.wait(4.secs());
    dut.write(0x46, 2, 4_000);
    dut.wait(4.secs());
    assert_eq!(dut.get(Reg::C1), 51_200);
}

#[test]
fn what_does_not_go_with_the_encoder() {
    let mut dut = Dut::plus();
    // The minimum of MS is EL x 8 / 200 (MC 5-21): 20.48 for 512 lines.
    dut.write(0x48, 1, 16);
    assert_eq!((dut.try_write(0x1E, 1, 1), dut.error()), (vec![0x90, 3], 36));
    assert_eq!((dut.read(0x1E, 1), dut.read(0x48, 1)), (0, 16));
    dut.write(0x48, 1, 256);
    // 24 steps are less than a whole count.
    dut.write(0x89, 2, 24);
    assert_eq!((dut.try_write(0x1E, 1, 1), dut.error()), (vec![0x90, 3], 90));
    assert_eq!((dut.read(0x1E, 1), dut.read(0x89, 2), dut.read(0x8B, 2)), (0, 24, 768_000));
    dut.write(0x89, 2, 25);
    // 26 to 49 steps are one count, like VI.
    dut.write(0x8B, 2, 49);
    assert_eq!((dut.try_write(0x1E, 1, 1), dut.error()), (vec![0x90, 3], 90));
    dut.write(0x8B, 2, 50);
    dut.write(0x1E, 1, 1);
    assert_eq!((dut.read(0x89, 2), dut.read(0x8B, 2)), (1, 2));
    // EL x 8 / 200 is at most 256 (MC 5-22).
    assert_eq!(dut.try_set(Reg::EL, 6_401), Err(PresetError::OutOfRange));
    dut.set(Reg::EL, 6_400);
}

#[test]
fn jog_and_clock_exclude_each_other() {
    let mut dut = Dut::plus();
    dut.write(0x0B, 1, 1);
    assert_eq!((dut.try_write(0x3F, 1, 1), dut.error()), (vec![0x90, 4], 87));
    dut.write(0x0B, 1, 0);
    dut.write(0x3F, 1, 1);
    assert_eq!((dut.try_write(0x0B, 1, 1), dut.error()), (vec![0x90, 4], 87));
}

#[test]
fn counting_by_address() {
    let mut dut = Dut::plus();
    // R1 is at 5Fh, RC at 67h.
    dut.write(0x37, 1, 0x5F);
    dut.write(0x37, 1, 0x5F);
    dut.write(0x1B, 1, 0x5F);
    assert_eq!(dut.read(0x5F, 2), 1);
    dut.write(0x5F, 2, 2_147_483_647);
    dut.write(0x37, 1, 0x5F);
    assert_eq!(dut.read(0x5F, 2), -2_147_483_648, "wraps");
    dut.write(0x67, 1, 100);
    assert_eq!((dut.try_write(0x37, 1, 0x67), dut.error()), (vec![0x90, 3], 21));
    dut.write(0x1B, 1, 0x67);
    assert_eq!(dut.read(0x67, 1), 99);
    // In order: read only, two commands, the second half of a value, reserved, V1 that is not declared, a
    // register that only a Hybrid has, and more than a byte.
    for address in [0x4A, 0x43, 0x76, 0x60, 0x02, 0xA8, 0x8E, 0x15F] {
        for command in [0x1B, 0x37] {
            assert_eq!(
                (dut.try_write(command, 1, address), dut.error()),
                (vec![0x90, 3], 26),
                "{address:#04x}"
            );
        }
    }
}

#[test]
fn outputs_that_are_inputs_or_typed_cannot_be_written() {
    let mut dut = Dut::plus();
    for address in [0x4B, 0x4C, 0x4D, 0x4E] {
        dut.refused(&[16, 0, address, 0, 1, 2, 0, 1], 4, 9);
        dut.refused(&[5, 0, address, 0, 0], 4, 9);
    }
    dut.refused(&[16, 0, 0x55, 0, 1, 2, 0, 0], 4, 9);
    dut.refused(&[16, 0, 0x56, 0, 1, 2, 0, 0x10], 3, 21);
}

#[test]
fn the_bus_takes_less_than_mcode() {
    let mut dut = Dut::plus();
    assert_eq!((dut.try_write(0x09, 1, 2), dut.error()), (vec![0x90, 3], 21), "CE");
    assert_eq!((dut.try_write(0x7D, 1, 44), dut.error()), (vec![0x90, 3], 21), "TE");
    assert_eq!((dut.try_write(0x7D, 1, 64), dut.error()), (vec![0x90, 3], 21), "TE");
    dut.write(0x7D, 1, 0);
}

#[test]
fn user_variables_are_there_once_declared() {
    let mut dut = Dut::plus();
    for n in 0..8 {
        let address = 0xA8 + 2 * n;
        dut.refused(&[3, 0, address, 0, 2], 2, 0);
        dut.refused(&[16, 0, address, 0, 2, 4, 0, 0, 0, 7], 2, 0);
        let name = [b'V', b'1' + n];
        let value = crate::mdrive::mcode::names::Meaning::Global(-i32::from(n));
        dut.drive.drive.mcode.names.add(name, value).unwrap();
        assert_eq!(dut.read(address, 2), -i64::from(n));
        dut.write(address, 2, 123_456_789);
        assert_eq!(dut.read(address, 2), 123_456_789);
        dut.write(0x1B, 1, address.into());
        assert_eq!(dut.read(address, 2), 123_456_788, "DC");
    }
    let label = crate::mdrive::mcode::names::Meaning::Label(1);
    let mut dut = Dut::plus();
    dut.drive.drive.mcode.names.add(*b"V1", label).unwrap();
    dut.refused(&[3, 0, 0xA8, 0, 2], 2, 0);
}

#[test]
fn frequencies_are_in_hz_in_mcode() {
    let mut dut = Dut::hybrid();
    dut.connect(CLIENT);
    for (reg, name, address) in [(Reg::SS, "SS", 0xA2), (Reg::TS, "TS", 0xA7)] {
        let print = |dut: &mut Dut| {
            let said = dut.type_in(CLIENT, &std::format!("PR {name}\r"));
            said.lines().nth(1).unwrap().parse::<i64>().unwrap()
        };
        assert_eq!(print(&mut dut), 5_000_000);
        // 10 MHz/(n + 2), rounded down.
        for n in 0..=255 {
            dut.write(address, 1, n);
            let hz = print(&mut dut);
            assert_eq!(hz, 10_000_000 / (n + 2));
            dut.type_in(CLIENT, &std::format!("{name}=5000000\r{name}={hz}\r"));
            assert_eq!((dut.get(reg), dut.error()), (n, 0), "{hz} Hz are {n} again");
        }
        for hz in [38_909, 5_000_001, 0, -5, 1, 2_147_483_647] {
            dut.type_in(CLIENT, &std::format!("{name}={hz}\r"));
            assert_eq!((dut.error(), dut.get(reg)), (21, 255), "{hz} Hz");
        }
    }
}

#[test]
fn mcode_takes_more_than_the_bus() {
    let mut dut = Dut::plus();
    dut.connect(CLIENT);
    dut.type_in(CLIENT, "CE=2\rS4=16,1,0\rOT=255\r");
    assert_eq!((dut.get(Reg::CE), dut.get(Reg::O4), dut.error()), (2, 0, 9), "1 to 3 are no outputs");
    dut.type_in(CLIENT, "OT=248\r");
    assert_eq!((dut.get(Reg::O4), dut.error()), (1, 0));
    dut.type_in(CLIENT, "OT=256\r");
    assert_eq!(dut.error(), 21);
    dut.type_in(CLIENT, "CE=3\r");
    assert_eq!(dut.error(), 21);
}

#[test]
fn by_and_it_can_only_be_read() {
    let dut = Dut::hybrid();
    for row in dut.drive.spec().registers.rows.iter().filter(|row| ["BY", "IT"].contains(&row.name)) {
        assert_eq!(row.access.as_str(), "R", "{}", row.name);
    }
}
