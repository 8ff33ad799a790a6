//! A request on a line that many drives share: each of them receives the request and the reply.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;

use drivetwin_sim::line::LineMode;
use drivetwin_tests::busy::Party;

use support::{line, took};

/// Number of measured requests.
const REQUESTS: u64 = 2_000;

fn main() {
    let mode = |name: &str| if name == "fast" { LineMode::Fast } else { LineMode::Timed };
    if let Some((what, requests)) = count::wanted() {
        let (name, drives) = what.split_once(' ').expect("a mode and a number of drives");
        let drives = drives.parse().expect("a number of drives");
        return Party::new(drives, mode(name)).ask(requests);
    }
    println!("a request on a line");
    let mut all_counted = true;
    for (name, drives) in ["timed", "fast"].into_iter().flat_map(|name| [1, 32, 247].map(|n| (name, n))) {
        let mut party = Party::new(drives, mode(name));
        let micros = took(|| party.ask(REQUESTS)).as_secs_f64() * 1e6 / REQUESTS as f64;
        let instructions = count::instructions(&format!("{name} {drives}"), 300, 400);
        all_counted &= instructions.is_some();
        line(
            &format!("{name}, {drives} drives"),
            &format!("{micros:.1} µs, {}", count::counted(instructions)),
        );
    }
    count::warn_unless(all_counted);
}
