//! The reference of bench files has the same ranges as the code.

use drivetwin_firmware::motor::{self, stepper};
use drivetwin_sim::bench::{CYCLES_PER_REV, FURTHEST_REV};
use drivetwin_sim::catalog;

const REFERENCE: &str = include_str!("../../../docs/reference/bench-files.md");

/// Text of a number with thousands separators: 10,000,000.
fn written(number: f64) -> String {
    let whole = number.trunc().to_string();
    let groups = whole.as_bytes().rchunks(3).rev().map(|group| str::from_utf8(group).unwrap());
    let fraction = number.to_string();
    let fraction = fraction.find('.').map_or("", |place| &fraction[place..]);
    groups.collect::<Vec<_>>().join(",") + fraction
}

/// Rows of the reference for keys with this name.
fn rows(key: &str) -> Vec<&'static str> {
    let rows = REFERENCE
        .split_inclusive('\n')
        .filter(|row| row.starts_with(&format!("| `{key}`")) || row.starts_with(&format!("| **`{key}`**")));
    rows.collect()
}

#[track_caller]
fn assert_says(key: &str, range: &str) {
    let rows = rows(key);
    assert!(!rows.is_empty(), "there is no {key}");
    for row in rows {
        let at = row.find(range).unwrap_or_else(|| panic!("not {range}: {row}"));
        let (before, after) = (&row[..at], &row[at + range.len()..]);
        let goes_on = |next: Option<char>| next.is_some_and(|next| next.is_ascii_digit());
        assert!(
            !goes_on(before.chars().next_back()) && !goes_on(after.trim_start_matches(',').chars().next()),
            "{row}"
        );
    }
}

fn range(key: &str, least: impl Into<f64>, most: impl Into<f64>) {
    assert_says(key, &format!("{} to {}", written(least.into()), written(most.into())));
}

fn thousandths(key: &str, least: u32, most: u32) {
    range(key, f64::from(least) / 1_000.0, f64::from(most) / 1_000.0);
}

#[test]
fn the_reference_has_the_ranges_of_motors() {
    let (least, most) = (stepper::StepperParameters::LEAST, stepper::StepperParameters::MOST);
    range("steps_per_rev", least.steps_per_rev, most.steps_per_rev);
    thousandths("holding_mnm", least.holding_unm, most.holding_unm);
    range("rated_ma", least.rated_ma, most.rated_ma);
    range("pull_out_rpm", least.pull_out_rpm, most.pull_out_rpm);

    // The reference has one table for both kinds of motors, so their ranges must be the same.
    let both = (least, most);
    let (least, most) = (motor::Parameters::LEAST, motor::Parameters::MOST);
    assert_eq!((both.0.inertia_gcm2, both.1.inertia_gcm2), (least.inertia_gcm2, most.inertia_gcm2));
    assert_eq!((both.0.friction_unm, both.1.friction_unm), (least.friction_unm, most.friction_unm));
    assert_eq!((both.0.load_unm, both.1.load_unm), (least.load_unm, most.load_unm));
    range("inertia_gcm2", least.inertia_gcm2, most.inertia_gcm2);
    thousandths("friction_mnm", least.friction_unm, most.friction_unm);
    assert_eq!(least.load_unm, -most.load_unm);
    assert_says("load_mnm", &format!("±{}", written(f64::from(most.load_unm) / 1_000.0)));
    range("no_load_rpm", least.no_load_rpm, most.no_load_rpm);
    thousandths("supply_v", least.supply_mv, most.supply_mv);
    thousandths("resistance_ohm", least.resistance_mohm, most.resistance_mohm);
    range("hall_pulses", least.hall_pulses, most.hall_pulses);
    range("poles", 2 * least.hall_pulses, 2 * most.hall_pulses);
}

#[test]
fn the_reference_has_the_ranges_of_parts_on_a_shaft() {
    range("cycles_per_rev", *CYCLES_PER_REV.start(), *CYCLES_PER_REV.end());
    assert_says("closed", &format!("±{}", written(FURTHEST_REV)));
}

/// The defaults in the reference, printed after the ranges, are the values of a new drive.
#[test]
fn the_reference_has_the_defaults_of_motors() {
    let default = |key: &str, value: f64| assert_says(key, &format!("| {} |", written(value)));
    let nominal = stepper::StepperParameters::NOMINAL;
    default("steps_per_rev", nominal.steps_per_rev.into());
    default("holding_mnm", f64::from(nominal.holding_unm) / 1_000.0);
    default("rated_ma", nominal.rated_ma.into());
    default("pull_out_rpm", nominal.pull_out_rpm.into());
    let both = nominal;
    let nominal = motor::Parameters::NOMINAL;
    assert_eq!(
        (both.inertia_gcm2, both.friction_unm, both.load_unm),
        (nominal.inertia_gcm2, nominal.friction_unm, nominal.load_unm)
    );
    default("inertia_gcm2", nominal.inertia_gcm2.into());
    default("friction_mnm", f64::from(nominal.friction_unm) / 1_000.0);
    default("load_mnm", f64::from(nominal.load_unm) / 1_000.0);
    default("no_load_rpm", nominal.no_load_rpm.into());
    default("supply_v", f64::from(nominal.supply_mv) / 1_000.0);
    default("resistance_ohm", f64::from(nominal.resistance_mohm) / 1_000.0);
    default("hall_pulses", nominal.hall_pulses.into());

    let own = catalog::make("mdrobot").unwrap().internal_motor().unwrap();
    let last = |key: &str, value: f64| assert_says(key, &format!("| {} |\n", written(value)));
    last("inertia_gcm2", own.inertia_gcm2.into());
    last("friction_mnm", f64::from(own.friction_unm) / 1_000.0);
    last("load_mnm", f64::from(own.load_unm) / 1_000.0);
    last("no_load_rpm", own.no_load_rpm.into());
    last("supply_v", f64::from(own.supply_mv) / 1_000.0);
    last("resistance_ohm", f64::from(own.resistance_mohm) / 1_000.0);
    last("poles", (2 * own.hall_pulses).into());
}
