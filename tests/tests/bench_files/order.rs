//! The order of tables in a file, and of keys in a table, does not matter.

use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use proptest::prelude::*;

use super::{ask, built};

/// The tables of a file: each has a header and lines with keys.
const TABLES: [(&str, &[&str]); 18] = [
    ("[[bus]]", &["name = 'line1'", "drives = ['b', 'a.rs485']", "collisions = true"]),
    ("[[drive]]", &["name = 'a'", "kind = 'md3'", "set = { SpeedHigh = 0, MoveSteps = 300, Speed = 4000 }"]),
    ("[[drive]]", &["name = 'b'", "kind = 'md3-low'", "address = 2", "fast_boot = true"]),
    ("[[drive]]", &["name = 'c'", "kind = 'qsb-m'", "faults = []"]),
    ("[[drive]]", &["name = 'd'", "kind = 'rs434544'", "faults = ['current_limit']"]),
    ("[[wire]]", &["from = 'a.STEP'", "to = 'c.A'"]),
    ("[[wire]]", &["from = 'a.DIR'", "to = 'c.B'"]),
    ("[[wire]]", &["from = 'b.J3.7'", "to = 'd.IN1'"]),
    ("[[wire]]", &["from = 'a.STEP'", "to = 'd.IN1'"]),
    ("[[wire]]", &["from = 'c.DIO0'", "to = 'd.IN1'"]),
    ("[[motor]]", &["name = 'm'", "drive = 'a'", "steps_per_rev = 40", "holding_mnm = 200"]),
    ("[[motor]]", &["name = 'n'", "drive = 'd'", "friction_mnm = 30", "load_mnm = 0"]),
    ("[[encoder]]", &["motor = 'm'", "cycles_per_rev = 100", "to = { b = 'c.B', a = 'c.A' }"]),
    ("[[encoder]]", &["motor = 'm'", "cycles_per_rev = 70", "to = { index = 'd.IN2', a = 'c.A' }"]),
    ("[[switch]]", &["motor = 'm'", "closed = { above_rev = 0.5, below_rev = 0.6 }", "to = 'b.J2.2'"]),
    ("[[switch]]", &["motor = 'n'", "closed = { above_rev = 1 }", "to = 'b.J2.3'"]),
    ("[[fault]]", &["bus = 'line1'", "corrupt = 0.1", "drop = 0.1"]),
    ("[[fault]]", &["bus = 'd.rs485'", "delay_ms = 2", "duplicate = 0.5"]),
];

/// Trace of a bench with these tables, while clients send requests.
fn perform(tables: &[(&str, Vec<&str>)]) -> String {
    let tables = tables.iter().map(|(header, keys)| format!("{header}\n{}\n", keys.join("\n")));
    let mut built = built(&format!("seed = 7\n{}", tables.collect::<String>()));
    let bench = &mut built.bench;
    bench.run_until(2_500.millis());
    let [line1, single] = ["line1", "d.rs485"].map(|name| {
        let bus = bench.find_bus(name).unwrap();
        bench.connect(bus)
    });
    for request in [rtu::write(1, 0x11, 1), rtu::read(2, 0, 9), rtu::write(2, 0x11, 1), rtu::read(1, 0, 32)] {
        ask(bench, line1, &request);
        ask(bench, single, &request);
    }
    // Sets START of the RS drive.
    ask(bench, single, &rtu::frame(1, &[5, 0x20, 0x00, 0xFF, 0x00]));
    bench.run_until(5.secs());
    bench.trace().to_text()
}

fn shuffled() -> impl Strategy<Value = Vec<(&'static str, Vec<&'static str>)>> {
    let tables = TABLES.map(|(header, keys)| (Just(header), Just(keys.to_vec()).prop_shuffle()));
    tables.to_vec().prop_shuffle()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn shuffled_tables_and_keys_are_the_same_bench(tables in shuffled()) {
        let sorted = TABLES.map(|(header, keys)| (header, keys.to_vec()));
        let trace = perform(&sorted);
        for happens in ["a > rx", "b > rx", "c > pin A", "d > pin IN1", "d > pin IN2", "b > pin J2.2", "b > pin J2.3"] {
            prop_assert!(trace.contains(happens), "{} does not happen", happens);
        }
        prop_assert_eq!(perform(&tables), trace);
    }
}
