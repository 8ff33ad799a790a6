//! The order of tables, and of keys in a table, does not matter.

use proptest::prelude::*;
use standin_protocol::modbus::rtu;
use standin_protocol::time::Span;

use super::{ask, built};

/// The tables of a file: header, and lines of keys.
const TABLES: [(&str, &[&str]); 12] = [
    ("[[bus]]", &["name = 'line1'", "drives = ['b', 'a.rs485']", "collisions = true"]),
    ("[[drive]]", &["name = 'a'", "kind = 'md3'", "set = { SpeedHigh = 0, MoveSteps = 300, Speed = 4000 }"]),
    ("[[drive]]", &["name = 'b'", "kind = 'md3-low'", "address = 2", "fast_boot = true"]),
    ("[[drive]]", &["name = 'c'", "kind = 'qsb-m'", "faults = []"]),
    ("[[drive]]", &["name = 'd'", "kind = 'rs434544'", "faults = ['current_limit', 'stall']"]),
    ("[[wire]]", &["from = 'a.STEP'", "to = 'c.A'"]),
    ("[[wire]]", &["from = 'a.DIR'", "to = 'c.B'"]),
    ("[[wire]]", &["from = 'b.J3.7'", "to = 'd.IN1'"]),
    ("[[wire]]", &["from = 'a.STEP'", "to = 'd.IN1'"]),
    ("[[wire]]", &["from = 'c.DIO0'", "to = 'd.IN1'"]),
    ("[[fault]]", &["bus = 'line1'", "corrupt = 0.3", "drop = 0.2"]),
    ("[[fault]]", &["bus = 'd.rs485'", "delay_ms = 2", "duplicate = 0.5"]),
];

/// What happens on the bench of such a file.
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
        prop_assert_eq!(perform(&tables), perform(&sorted));
    }
}
