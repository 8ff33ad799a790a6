//! Budgets of the bench on this machine: bytes and allocations of idle drives, instructions and allocations of events and
//! messages.
//!
//! The program is built like the tests, with the drives and the bench optimised and with checks of overflow, so that the
//! check compiles nothing of its own. The numbers of a release build are about half of these.

use anyhow::{Context, Result, ensure};
use xshell::{Shell, cmd};

use crate::checks::{host, target_dir};

/// Maximum of each value that `host-costs` prints: what has been reached, and 3 % for another compiler. A value that is
/// lower by more than [`SLACK`] fails, too, so that the budget follows what becomes better.
const BUDGETS: &[(&str, u64)] = &[
    ("idle md3, bytes", 5_400),
    ("idle md3, allocations", 27),
    ("idle md3-low, bytes", 5_400),
    ("idle md3-low, allocations", 28),
    ("idle qsb-d, bytes", 3_500),
    ("idle qsb-d, allocations", 28),
    ("idle qsb-m, bytes", 4_300),
    ("idle qsb-m, allocations", 30),
    ("idle qsb-s, bytes", 3_400),
    ("idle qsb-s, allocations", 30),
    ("idle rs434544, bytes", 9_700),
    ("idle rs434544, allocations", 30),
    ("idle rs434546, bytes", 9_700),
    ("idle rs434546, allocations", 31),
    ("idle mdrobot, bytes", 6_000),
    ("idle mdrobot, allocations", 33),
    ("idle mdrive, bytes", 14_600),
    ("idle mdrive, allocations", 25),
    ("idle mdrive-hybrid, bytes", 14_600),
    ("idle mdrive-hybrid, allocations", 26),
    ("event, 1 seat, instructions", 2_410),
    ("event, 1 seat, allocations", 0),
    ("event, 1,000 seats, instructions", 2_900),
    ("event, 1,000 seats, allocations", 0),
    ("edge from a motor to a counter, instructions", 2_910),
    ("edge from a motor to a counter, allocations", 0),
    ("request to a drive alone, instructions", 8_670),
    ("request to a drive alone, allocations", 0),
    ("request, a drive on a line, instructions", 32_400),
    ("request, a drive on a line, allocations", 10),
    ("request, 247 drives on a line, instructions", 1_761_000),
    ("request, 247 drives on a line, allocations", 13),
    ("request, 247 drives on a fast line, instructions", 339_100),
    ("request, 247 drives on a fast line, allocations", 13),
    ("request, Modbus/TCP, instructions", 19_500),
    ("request, Modbus/TCP, allocations", 5),
    ("line of MCode, instructions", 53_500),
    ("line of MCode, allocations", 16),
];

/// Largest difference between a budget and its value, in percent of the budget.
const SLACK: u64 = 10;

/// Measures everything, prints the values, and fails if one exceeds its budget, is far below it, or has none.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    let host = host();
    cmd!(sh, "cargo build --quiet {host...} --test '*' --bin host-costs").run()?;
    let program = target_dir(sh).join("debug/host-costs");
    let printed = cmd!(sh, "{program}").read()?;
    let values = printed.lines().map(|line| {
        let (what, value) = line.rsplit_once(": ").with_context(|| format!("`{line}` is no value"))?;
        Ok((what, value.parse()?))
    });
    let values = values.collect::<Result<Vec<(&str, u64)>>>()?;
    let mut wrong = Vec::new();
    for &(what, value) in &values {
        let most = BUDGETS.iter().find(|(budget, _)| *budget == what).map(|&(_, most)| most);
        println!("{what:<56} {value:>9} of {:>9}", most.map_or("none".to_owned(), |most| most.to_string()));
        if most.is_none_or(|most| value > most || value < most * (100 - SLACK) / 100) {
            wrong.push(what);
        }
    }
    let unused =
        BUDGETS.iter().map(|&(what, _)| what).filter(|&what| values.iter().all(|&(other, _)| other != what));
    wrong.extend(unused);
    ensure!(
        wrong.is_empty(),
        "too much, far below the budget, without a budget, or not measured: {}",
        wrong.join("; ")
    );
    Ok(())
}
