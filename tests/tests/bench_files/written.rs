//! Values of `when` in a scenario: those that a drive can accept.

use drivetwin_firmware::device::{Instant, PresetError};
use drivetwin_protocol::registers::{Shape, Space};
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, Setup};
use drivetwin_sim::catalog;
use drivetwin_sim::config::bench_file;

/// Reads a scenario that waits for a write. Returns the error message, if there is one.
fn error(kind: &str, register: &str, value: i64) -> Option<String> {
    let text = format!(
        "drive = [{{ name = 'd', kind = '{kind}' }}]\n[[scenario]]\nsteps = [\n{{ drive = 'd', power = 'off',\n\
         when = {{ drive = 'd', register = '{register}', value =\n{value} }} }}]"
    );
    bench_file::parse(&text).err().map(|error| error.to_string())
}

#[test]
fn a_value_that_the_manual_forbids_is_an_error() {
    for (kind, register, forbidden, why) in [
        ("mdrive", "VM", 1, "it takes 2 to 5000000"),
        ("mdrive", "VM", 6_000_000, "it takes 2 to 5000000"),
        (
            "mdrive",
            "MS",
            3,
            "it takes 1, 2, 4, 5, 8, 10, 16, 25, 32, 50, 64, 100, 108, 125, 127, 128, 180, 200, 250, 256",
        ),
        ("mdrive", "HM", 9, "it takes 1 to 4"),
        ("mdrive", "DE", 2, "it takes 0 to 1"),
        ("mdrive", "RC", 0, "it takes 1 to 100"),
        ("mdrive", "RC", 101, "it takes 1 to 100"),
        ("mdrive", "EM", 4, "it takes 0 to 3"),
        ("mdrive", "BD", 57, "it takes 48, 96, 19, 38, 11"),
        ("mdrive", "CE", 3, "it takes 0 to 1, in MCode 0 to 2"),
        ("mdrive", "TE", 64, "it takes 0 to 43, in MCode 0 to 63"),
        ("mdrive", "HT", 1, "mdrive refuses it"),
        ("mdrive", "DN", 37, "mdrive refuses it"),
        // Address of ER, which IC cannot count.
        ("mdrive", "IC", 0x21, "mdrive refuses it"),
        ("mdrive-hybrid", "AS", 9, "it takes 0 to 3"),
        ("mdrive-hybrid", "SS", 38_909, "it takes 0 to 255, in MCode 38910 to 5000000"),
        ("mdrobot", "FUNC_CMD_TYPE", 5, "mdrobot refuses it"),
        // The id 254 with the key.
        ("mdrobot", "ID", 0xFEAA, "mdrobot refuses it"),
        ("qsb-d", "Command", 8, "qsb-d refuses it"),
    ] {
        let expected = format!("line 6, column 1: {register} never has the value {forbidden}: {why}");
        assert_eq!(error(kind, register, forbidden), Some(expected), "{kind}");
    }
    for (kind, register, allowed) in [
        ("mdrive", "VM", 5_000_000),
        ("mdrive", "MS", 108),
        ("mdrive", "CE", 2),
        ("mdrive", "ER", 255),
        ("mdrive", "TE", 63),
        ("mdrive", "OT", 255),
        ("mdrive", "HT", 2),
        ("mdrive", "DN", 65),
        ("mdrive", "DN", 33),
        ("mdrive", "IC", 0x57),
        ("mdrive-hybrid", "AS", 3),
        ("mdrive-hybrid", "SS", 255),
        ("mdrive-hybrid", "SS", 38_910),
        ("mdrobot", "FUNC_CMD_TYPE", 0x104),
        ("mdrobot", "ID", 0xFDAA),
        ("qsb-d", "Command", 0x70A),
        ("qsb-m", "Command", 8),
    ] {
        assert_eq!(error(kind, register, allowed), None, "{kind} {register}");
    }
}

#[test]
fn no_master_writes_a_setting_of_the_emulated_drive() {
    assert_eq!(
        error("mdrive", "HoldingTorque", 5),
        Some("line 5, column 34: no master writes HoldingTorque of mdrive".to_owned())
    );
    assert_eq!(
        error("rs434544", "SUPPLY", 5),
        Some("line 5, column 34: no master writes SUPPLY of rs434544".to_owned())
    );
}

/// The drives themselves accept what `when` takes.
#[test]
fn a_drive_accepts_these_values_and_no_others() {
    let values = [-1, 0, 1, 2, 3, 4, 9, 15, 43, 44, 63, 64, 100, 101, 255, 256, 1_001, 65_535];
    let (mut accepted, mut refused) = (0, 0);
    for spec in catalog::specs() {
        for (index, row) in spec.rows() {
            // Variables of an MDrive's user exist once they are declared.
            let is_left_out =
                row.space == Space::Setting || matches!(row.shape, Shape::Words(_)) || row.optional;
            if !row.access.writes() || is_left_out {
                continue;
            }
            let (least, greatest) = row.shape.limits();
            for value in values.into_iter().chain([least, greatest, 5_000_000, 5_000_001]) {
                let mut bench = Bench::new();
                let drive = catalog::make(spec.kind).unwrap();
                let drive = bench.add_with("d", drive, Setup::default()).unwrap();
                bench.run_until(Instant::ZERO + 6.secs());
                let error = error(spec.kind, row.name, value);
                let what = format!("{} {} {value}: {error:?}", spec.kind, row.name);
                match bench.poke(drive, index, value) {
                    Ok(()) => {
                        assert_eq!(error, None, "{what}");
                        accepted += 1;
                    }
                    Err(PresetError::OutOfRange) => {
                        let depends_on_state = match row.name {
                            // VI is 1,000.
                            "VM" => value <= 1_000,
                            // The variable at this address is 0.
                            "DC" => true,
                            // The jog rate is 0.
                            "Command" => value == 9 && spec.kind == "qsb-m",
                            // In steps/s, in MCode only.
                            "SS" | "TS" => value >= 38_910,
                            _ => false,
                        };
                        assert!(error.is_some() || depends_on_state, "{what}");
                        refused += 1;
                    }
                    // The state of the drive forbids the write.
                    Err(_) => {}
                }
            }
        }
    }
    assert!(accepted > 1_000 && refused > 1_000, "{accepted} {refused}");
}
