//! Every row of the register map (FB 5) over port 502, for both products.

use drivetwin_protocol::time::Span;

use crate::rig::{CALIBRATION, KINDS, Kind, Rig, SAVE, halves};
use crate::table::{Access, RESERVED, Row, TABLE, find};

/// Exception codes of FB 4: illegal address, illegal value. (04 is used if the drive's state forbids the
/// request.)
const ADDRESS: u8 = 2;
const VALUE: u8 = 3;

impl Rig {
    fn try_row(&mut self, row: &Row) -> Result<i64, u8> {
        let words = self.try_words(row.address, row.count)?;
        let value = words.iter().fold(0_i64, |value, &word| value << 16 | i64::from(word));
        Ok(if row.bytes == 4 { i64::from(value as i32) } else { value })
    }

    #[track_caller]
    fn row(&mut self, row: &Row) -> i64 {
        self.try_row(row).unwrap_or_else(|code| panic!("{}: exception {code:02X}", row.name))
    }

    fn try_set(&mut self, row: &Row, value: i64) -> Result<(), u8> {
        let done = self.try_write(row.address, &row.words(value));
        // AS, DE and MS calibrate a Hybrid (MC 5-8).
        if self.kind == Kind::Hybrid && matches!(row.name, "AS" | "DE" | "MS") {
            self.after(CALIBRATION);
        }
        done
    }
}

/// Readable and writable rows of a product, without EE, which another test writes.
fn plain(kind: Kind) -> impl Iterator<Item = &'static Row> {
    let written = |row: &&Row| matches!(row.access, Access::Kept | Access::Passing) && row.name != "EE";
    TABLE.iter().filter(move |row| row.is_on(kind)).filter(written)
}

#[test]
fn a_new_drive_has_the_defaults_of_the_table() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for row in TABLE.iter().filter(|row| row.is_on(kind) && row.access != Access::User) {
            let value = rig.row(row);
            if let Some(default) = row.default {
                assert_eq!(value, default, "{} of {kind:?}", row.name);
            }
        }
        rig.assert_no_error();
    }
}

#[test]
fn what_is_legal_is_taken_and_read_back() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for row in plain(kind) {
            let before = rig.row(row);
            for value in row.samples() {
                if row.name == "HT" && value == 1 {
                    continue;
                }
                assert_eq!(rig.try_set(row, value), Ok(()), "{} = {value} of {kind:?}", row.name);
                assert_eq!(rig.row(row), value, "{} of {kind:?}", row.name);
                assert_eq!(rig.ef_er(), (0, 0), "EF and ER after {} = {value}", row.name);
            }
            assert_eq!(rig.try_set(row, before), Ok(()), "{} = {before} again", row.name);
        }
    }
}

#[test]
fn what_is_not_legal_is_refused_with_03_notes_mcodes_error_and_changes_nothing() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for row in plain(kind) {
            let before = rig.row(row);
            for value in row.others() {
                assert_eq!(rig.try_set(row, value), Err(VALUE), "{} = {value} of {kind:?}", row.name);
                let (flag, error) = rig.ef_er();
                // Error 22: VI is not below VM, or above all speeds; 23: VM is not above VI (MC 9.2).
                let expected = match row.name {
                    "VI" if value > 767_999 => 22,
                    "VM" if value < 1_001 => 23,
                    _ => 21,
                };
                assert_eq!((flag, error), (1, expected), "EF and ER after {} = {value}", row.name);
                assert_eq!(rig.row(row), before, "{} after {value} was refused", row.name);
                rig.assert_no_error();
            }
        }
    }
}

#[test]
fn initial_and_maximum_velocity_bound_each_other() {
    let mut rig = Rig::plus();
    let (vi, vm) = (find("VI"), find("VM"));
    assert_eq!(rig.try_set(vi, 768_000), Err(VALUE));
    assert_eq!(rig.ef_er(), (1, 22));
    assert_eq!(rig.try_set(vm, 1_000), Err(VALUE));
    assert_eq!(rig.ef_er(), (1, 23));
    // The new VI is above the old VM and below the new VM. A request of four registers is checked as a whole.
    let [[a, b], [c, d]] = [halves(1_000_000), halves(2_000_000)];
    assert_eq!(rig.try_write(0x0089, &[a, b, c, d]), Ok(()));
    assert_eq!((rig.row(vi), rig.row(vm)), (1_000_000, 2_000_000));
    let [[a, b], [c, d]] = [halves(3_000_000), halves(3_000_000)];
    assert_eq!(rig.try_write(0x0089, &[a, b, c, d]), Err(VALUE));
    assert_eq!((rig.row(vi), rig.row(vm)), (1_000_000, 2_000_000));
}

#[test]
fn a_status_is_not_written() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for row in TABLE.iter().filter(|row| row.is_on(kind) && row.access == Access::ReadOnly) {
            for value in row.samples() {
                let before = rig.row(row);
                assert_eq!(rig.try_set(row, value), Err(ADDRESS), "{} of {kind:?}", row.name);
                assert_eq!(rig.row(row), before);
            }
        }
        rig.assert_no_error();
    }
}

#[test]
fn reserved_addresses_and_what_is_behind_the_map_are_refused() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let reserved = RESERVED.iter().flat_map(|&(first, last)| first..=last);
        for address in reserved.chain([0x00B8, 0x0100, 0x7FFF, 0x8000, 0xFFFF]) {
            assert_eq!(rig.try_words(address, 1), Err(ADDRESS), "{address:#06X}");
            assert_eq!(rig.try_write(address, &[1]), Err(ADDRESS), "{address:#06X}");
        }
        // Reads that include a reserved address: A and 0x02, D5 and 0x14, 0x17 and D, R4 and RC and 0x68, the
        // last user variable and the address after it.
        for (address, count) in [(0x0013, 2), (0x0017, 3), (0x0065, 4), (0x0000, 3), (0x00B6, 3), (0xFFFF, 2)]
        {
            assert_eq!(rig.try_words(address, count), Err(ADDRESS), "{address:#06X}, {count}");
        }
        rig.assert_no_error();
    }
}

#[test]
fn each_product_lacks_the_registers_of_the_other() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for row in TABLE.iter().filter(|row| !row.is_on(kind)) {
            assert_eq!(rig.try_row(row), Err(ADDRESS), "{} of {kind:?}", row.name);
            for value in row.samples() {
                assert_eq!(rig.try_set(row, value), Err(ADDRESS), "{} of {kind:?}", row.name);
            }
        }
        rig.assert_no_error();
    }
}

#[test]
fn several_values_are_read_and_written_together() {
    let mut rig = Rig::plus();
    // D1 to D4.
    assert_eq!(rig.try_write(0x000F, &[1, 2, 3, 4]), Ok(()));
    assert_eq!(rig.try_words(0x000F, 4), Ok(vec![1, 2, 3, 4]));
    // One value is refused, so none of the values changes.
    assert_eq!(rig.try_write(0x000F, &[5, 6, 256, 8]), Err(VALUE));
    assert_eq!(rig.ef_er(), (1, 21));
    assert_eq!(rig.try_words(0x000F, 4), Ok(vec![1, 2, 3, 4]));
    // R1 and R2.
    assert_eq!(rig.try_write(0x005F, &[0x1234, 0x5678, 0xFFFF, 0xFFFE]), Ok(()));
    rig.assert_values(&[("R1", 0x1234_5678), ("R2", -2)]);
}

/// FB 4.2.4 and 4.2.5: a request has 1 to 4 registers.
#[test]
fn one_to_four_registers_are_read_or_written_at_a_time() {
    let mut rig = Rig::plus();
    for count in 1..=4 {
        assert!(rig.try_words(0x005F, count).is_ok(), "{count}");
        assert_eq!(rig.try_write(0x000F, &vec![0; usize::from(count)]), Ok(()), "{count}");
    }
    for count in [0, 5, 8, 125, 126, 0xFFFF] {
        assert_eq!(rig.try_words(0x005F, count), Err(VALUE), "{count}");
    }
    for count in [0, 5, 8] {
        assert_eq!(rig.try_write(0x005F, &vec![0; count]), Err(VALUE), "{count}");
    }
    rig.assert_no_error();
}

#[test]
fn half_a_value_is_read_but_not_written() {
    let mut rig = Rig::plus();
    rig.write_long(0x005F, 0x1234_5678);
    assert_eq!(rig.try_words(0x005F, 1), Ok(vec![0x1234]));
    assert_eq!(rig.try_words(0x0060, 1), Ok(vec![0x5678]));
    // Reads the low word of R1 and the high word of R2.
    assert_eq!(rig.try_words(0x0060, 2), Ok(vec![0x5678, 0]));
    for (address, words) in [(0x005F, &[7][..]), (0x0060, &[7]), (0x0060, &[7, 7]), (0x005F, &[7, 7, 7])] {
        assert!(rig.try_write(address, words).is_err(), "{address:#06X} {words:?}");
        assert_eq!(rig.long(0x005F), 0x1234_5678);
        assert_eq!(rig.long(0x0061), 0);
    }
    rig.assert_no_error();
}

#[test]
fn a_save_keeps_what_is_a_setting() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let other = |row: &Row| {
            let legal = row.samples().into_iter().rev();
            legal.into_iter().find(|&value| Some(value) != row.default).expect("another value")
        };
        // Unsaved values are lost. Jog mode and clock mode exclude each other.
        for row in plain(kind) {
            if !matches!(row.name, "ER" | "JE" | "MT") {
                assert_eq!(rig.try_set(row, other(row)), Ok(()), "{} = {}", row.name, other(row));
            }
        }
        rig.power_cycle();
        for row in plain(kind) {
            if let Some(default) = row.default {
                assert_eq!(rig.row(row), default, "{} of {kind:?} without a save", row.name);
            }
        }
        // Saved values are restored; the counters start at 0. HT and MT are at most 65535 together.
        let kept =
            || plain(kind).filter(|row| row.access == Access::Kept && !matches!(row.name, "JE" | "MT"));
        for row in kept() {
            assert_eq!(rig.try_set(row, other(row)), Ok(()), "{} = {}", row.name, other(row));
        }
        rig.write_long(0x0057, 4_711);
        rig.write(0x0076, 1);
        rig.after(SAVE);
        rig.assert_no_error();
        rig.power_cycle();
        rig.after(CALIBRATION);
        for row in kept() {
            assert_eq!(rig.row(row), other(row), "{} of {kind:?} after a save", row.name);
        }
        assert_eq!((rig.long(0x0005), rig.long(0x0057)), (0, 0), "C1 and P");
    }
}

/// MC 5-32, 5-49: HT is 0, or from 2 to 65535 − MT.
#[test]
fn both_delays_are_65535_ms_at_most() {
    let mut rig = Rig::plus();
    let (ht, mt) = (find("HT"), find("MT"));
    assert_eq!(rig.try_set(ht, 1), Err(VALUE));
    assert_eq!(rig.ef_er(), (1, 21));
    assert_eq!(rig.try_set(mt, 65_000), Ok(()));
    assert_eq!(rig.try_set(ht, 536), Err(VALUE));
    assert_eq!(rig.ef_er(), (1, 21));
    assert_eq!(rig.try_set(ht, 535), Ok(()));
    assert_eq!(rig.try_set(mt, 0), Ok(()));
    assert_eq!(rig.try_set(ht, 65_535), Ok(()));
    assert_eq!(rig.try_set(mt, 1), Err(VALUE));
    assert_eq!(rig.ef_er(), (1, 21));
}

/// FB 5: IC and DC take the address of the variable that they count.
#[test]
fn a_variable_is_counted_up_and_down_by_its_address() {
    let mut rig = Rig::plus();
    rig.write_long(0x005F, 41);
    rig.write(0x0037, 0x5F);
    assert_eq!(rig.long(0x005F), 42);
    rig.write(0x001B, 0x5F);
    rig.write(0x001B, 0x5F);
    assert_eq!(rig.long(0x005F), 40);
    // I1 is read-only; 0x02 is reserved; 0xA8 is V1, which is not declared.
    for address in [0x2D, 0x02, 0xA8] {
        assert_eq!(rig.try_write(0x0037, &[address]), Err(VALUE), "{address:#X}");
        assert_eq!(rig.ef_er(), (1, 26), "{address:#X}");
    }
    assert_eq!((rig.word(0x0037), rig.word(0x001B)), (0, 0), "commands read 0");
}

/// FB 5.2: a user variable exists only after a program has declared it.
#[test]
fn user_variables_are_there_once_they_are_declared() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for (n, row) in TABLE.iter().filter(|row| row.access == Access::User).enumerate() {
            assert_eq!(rig.try_row(row), Err(ADDRESS), "{}", row.name);
            assert_eq!(rig.try_set(row, 1), Err(ADDRESS), "{}", row.name);
            rig.set(&[&format!("VA {}={}", row.name, n + 10)]);
            assert_eq!(rig.row(row), n as i64 + 10, "{}", row.name);
            for value in row.samples() {
                assert_eq!(rig.try_set(row, value), Ok(()), "{} = {value}", row.name);
                assert_eq!(rig.value(row.name), value, "{}", row.name);
            }
        }
        // One request can read two user variables.
        assert!(rig.try_words(0x00A8, 4).is_ok());
        rig.assert_no_error();
    }
}

/// FB 5: EE converts between 51,200 steps and 2,048 counts a turn (MC 7.3.4), in both directions.
#[test]
fn encoder_mode_converts_speeds_and_ramps() {
    let mut rig = Rig::plus();
    let shown = |rig: &mut Rig| ["A", "D", "VI", "VM"].map(|name| rig.row(find(name)));
    rig.write(0x001E, 1);
    assert_eq!(shown(&mut rig), [40_000, 40_000, 40, 30_720]);
    // The legal ranges with EE = 1 (MC 5-1, 5-80).
    for (name, most) in [("A", 61_035_160), ("D", 61_035_160), ("VM", 200_000)] {
        assert_eq!(rig.try_set(find(name), most + 1), Err(VALUE), "{name}");
        assert_eq!(rig.ef_er(), (1, 21), "{name}");
        let before = rig.row(find(name));
        assert_eq!(rig.try_set(find(name), most), Ok(()), "{name}");
        assert_eq!(rig.try_set(find(name), before), Ok(()), "{name}");
    }
    assert_eq!(rig.try_write(0x0078, &halves(200_001)), Err(VALUE));
    assert_eq!(rig.ef_er(), (1, 21), "SL (MC 5-68)");
    rig.write(0x001E, 0);
    assert_eq!(shown(&mut rig), [1_000_000, 1_000_000, 1_000, 768_000]);
    // VI 24 would become 24/25, which is less than 1: error 90 (MC 9.6).
    rig.write_long(0x0089, 24);
    assert_eq!(rig.try_write(0x001E, &[1]), Err(VALUE));
    assert_eq!(rig.ef_er(), (1, 90));
    assert_eq!(rig.word(0x001E), 0);
    assert_eq!(rig.long(0x0089), 24);
}

/// MC 7.3.4: MS cannot be changed while EE is 1.
#[test]
fn microsteps_are_256_with_the_encoder() {
    let mut rig = Rig::plus();
    rig.write(0x001E, 1);
    assert_eq!(rig.try_write(0x0048, &[128]), Err(VALUE));
    assert_eq!(rig.ef_er(), (1, 36));
    // MS is at least EL * 8 / 200 (MC 5-21).
    rig.refused("EL=6401", 36);
    // "the MS value is defaulted to 256" (MC 7-16).
    rig.write(0x001E, 0);
    rig.write(0x0048, 128);
    rig.write(0x001E, 1);
    assert_eq!(rig.word(0x0048), 256);
}

/// MC 5-21: an encoder with 1,000 lines needs at least MS 40. The next legal values are 32 and 50.
#[test]
fn microsteps_go_with_the_lines_of_the_encoder() {
    let mut rig = Rig::plus();
    rig.set(&["EL=1000", "MS=50", "EE=1", "EE=0", "MS=32"]);
    rig.refused("EE=1", 36);
    rig.assert_values(&[("EE", 0), ("MS", 32)]);
}

/// Both ports show the same values.
#[test]
fn registers_and_variables_are_the_same() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        for row in plain(kind).filter(|row| !matches!(row.name, "ER" | "SS" | "TS" | "MU" | "CA")) {
            assert_eq!(rig.value(row.name), rig.row(row), "{} of {kind:?}", row.name);
        }
        rig.set(&["A=123456", "HC=7", "R4=-9"]);
        assert_eq!((rig.long(0x0000), rig.word(0x0029), rig.long(0x0065)), (123_456, 7, -9));
        rig.after(1.millis());
    }
}
