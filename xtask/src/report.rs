//! Result and duration of each check.

use std::io::Write;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The checks of a run that have ended.
pub(crate) struct Report {
    began: Instant,
    rows: Mutex<Vec<Row>>,
}

/// Result of a check.
pub(crate) struct Row {
    /// Index in the list of all checks.
    pub(crate) place: usize,
    pub(crate) name: &'static str,
    pub(crate) took: Duration,
    pub(crate) outcome: Outcome,
}

pub(crate) enum Outcome {
    Passed,
    Failed(String),
    Skipped(String),
}

impl Report {
    /// A report without results.
    pub(crate) fn new() -> Self {
        Self { began: now(), rows: Mutex::new(Vec::new()) }
    }

    /// Reports the start of a check.
    pub(crate) fn begin(&self, name: &str) {
        let minutes = (now() - self.began).as_secs_f64() / 60.0;
        print(&format!("{:>15} {name}, after {minutes:.1} min\n", "begins"));
    }

    /// Adds a check and prints its whole output, which is not mixed with that of other checks.
    pub(crate) fn end(&self, output: &str, row: Row) {
        print(&format!("\n=== {}\n{}\n{}\n\n", row.name, output.trim_end(), row.line()));
        self.rows().push(row);
    }

    /// Prints the summary, with skipped checks last. Returns whether no check failed.
    pub(crate) fn finish(&self) -> bool {
        let mut rows = self.rows();
        rows.sort_by_key(|row| row.place);
        println!("\n=== summary");
        let (mut passed, mut failed, mut skipped) = (0, 0, 0);
        for row in rows.iter() {
            println!("{}", row.line());
            match row.outcome {
                Outcome::Passed => passed += 1,
                Outcome::Failed(_) => failed += 1,
                Outcome::Skipped(_) => skipped += 1,
            }
        }
        for row in rows.iter() {
            if let Outcome::Skipped(remedy) = &row.outcome {
                println!("\nNOT CHECKED: {}: {remedy}", row.name);
            }
        }
        let all: Duration = rows.iter().map(|row| row.took).sum();
        let [took, all] = [now() - self.began, all].map(|time| time.as_secs_f64() / 60.0);
        println!("\nchecks: {passed} passed, {failed} failed, {skipped} skipped");
        println!("time: {took:.1} min; one after the other they take {all:.1} min");
        failed == 0
    }

    fn rows(&self) -> MutexGuard<'_, Vec<Row>> {
        self.rows.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Row {
    fn line(&self) -> String {
        let (word, why) = match &self.outcome {
            Outcome::Passed => ("ok", ""),
            Outcome::Failed(why) => ("FAILED", why.as_str()),
            Outcome::Skipped(why) => ("SKIPPED", why.as_str()),
        };
        let line = format!("{word:>7} {:>7.1} s  {:<31} {why}", self.took.as_secs_f64(), self.name);
        line.trim_end().to_owned()
    }
}

/// Prints the text with one write, because other threads print, too.
fn print(text: &str) {
    let mut stdout = std::io::stdout().lock();
    // If standard output is closed, the error cannot be reported.
    let _ = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush());
}

#[expect(clippy::disallowed_methods, reason = "the report has the wall-clock time of each check")]
pub(crate) fn now() -> Instant {
    Instant::now()
}
