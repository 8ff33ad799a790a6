//! Number of instructions of a part of a benchmark. valgrind runs the same program with two numbers of
//! rounds, and the difference belongs to the rounds alone.

use std::process::Command;

/// Number of instructions in a round of the work named `what`; `None` without valgrind. This program is
/// started again with the arguments `count`, `what` and a number of rounds.
pub(crate) fn instructions(what: &str, few: u64, many: u64) -> Option<f64> {
    let collected = |rounds: u64| {
        let this = std::env::current_exe().expect("this program has a path");
        let run = Command::new("valgrind")
            .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
            .arg(this)
            .args(["count", what, &rounds.to_string()])
            .output()
            .ok()?;
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.success(), "valgrind failed:\n{said}");
        let (_, number) = said.split_once("Collected : ").expect("callgrind says what it collected");
        number.split_whitespace().next()?.parse::<u64>().ok()
    };
    Some((collected(many)? - collected(few)?) as f64 / (many - few) as f64)
}

/// Name and number of rounds of the measured work, if this process was started to count its instructions.
pub(crate) fn wanted() -> Option<(String, u64)> {
    let mut words = std::env::args().skip(1);
    if words.next()? != "count" {
        return None;
    }
    let what = words.next()?;
    Some((what, words.next()?.parse().expect("a number of rounds")))
}

/// A number of instructions as text.
pub(crate) fn counted(instructions: Option<f64>) -> String {
    instructions.map_or("not counted".to_owned(), |n| format!("{n:.0} instructions"))
}

/// Prints a warning if valgrind counted nothing.
pub(crate) fn warn_unless(counted: bool) {
    if !counted {
        println!("NO VALGRIND: instructions were not counted; install it with `apt-get install valgrind`");
    }
}
