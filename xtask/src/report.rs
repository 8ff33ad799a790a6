//! What became of each check, and how long it took.

use std::time::{Duration, Instant};

use anyhow::Result;
use xshell::Shell;

use crate::tools::Missing;
use crate::tools::Tool;

/// The checks of a run, in their order.
pub(crate) struct Report<'a> {
    sh: &'a Shell,
    missing: Missing,
    /// In continuous integration nothing is skipped.
    ci: bool,
    rows: Vec<Row>,
}

struct Row {
    name: &'static str,
    took: Duration,
    outcome: Outcome,
}

enum Outcome {
    Passed,
    Failed(String),
    Skipped(String),
}

impl<'a> Report<'a> {
    /// A report with nothing in it yet, of checks that must do without `missing`.
    pub(crate) fn new(sh: &'a Shell, missing: Missing, ci: bool) -> Self {
        Self { sh, missing, ci, rows: Vec::new() }
    }

    /// Runs a check, or skips it where a tool that it needs is missing.
    pub(crate) fn check(
        &mut self,
        name: &'static str,
        needs: &[Tool],
        run: impl FnOnce(&Shell) -> Result<()>,
    ) {
        println!("\n=== {name}");
        let start = now();
        let outcome = match self.missing.of(needs) {
            Some(remedy) if self.ci => Outcome::Failed(remedy),
            Some(remedy) => Outcome::Skipped(remedy),
            None => match run(self.sh) {
                Ok(()) => Outcome::Passed,
                Err(error) => Outcome::Failed(format!("{error:#}")),
            },
        };
        let row = Row { name, took: now() - start, outcome };
        row.print();
        self.rows.push(row);
    }

    /// Sums up, skipped checks last; whether none failed.
    pub(crate) fn finish(self) -> bool {
        println!("\n=== summary");
        let (mut passed, mut failed, mut skipped) = (0, 0, 0);
        for row in &self.rows {
            row.print();
            match row.outcome {
                Outcome::Passed => passed += 1,
                Outcome::Failed(_) => failed += 1,
                Outcome::Skipped(_) => skipped += 1,
            }
        }
        for row in &self.rows {
            if let Outcome::Skipped(remedy) = &row.outcome {
                println!("\nNOT CHECKED: {}: {remedy}", row.name);
            }
        }
        println!("\nchecks: {passed} passed, {failed} failed, {skipped} skipped");
        failed == 0
    }
}

impl Row {
    fn print(&self) {
        let (word, why) = match &self.outcome {
            Outcome::Passed => ("ok", ""),
            Outcome::Failed(why) => ("FAILED", why.as_str()),
            Outcome::Skipped(why) => ("SKIPPED", why.as_str()),
        };
        let line = format!("{word:>7} {:>7.1} s  {:<28} {why}", self.took.as_secs_f64(), self.name);
        println!("{}", line.trim_end());
    }
}

#[expect(clippy::disallowed_methods, reason = "whoever waits for a check is told how long it took")]
fn now() -> Instant {
    Instant::now()
}
