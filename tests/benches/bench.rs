//! Events of a bench per second of wall time, with few drives and with many.
//!
//! An event is a device that reaches its deadline and sends two characters on its line. Each device does so
//! every 10 ms of bench time, and their deadlines are spread evenly.

#[path = "support/mod.rs"]
mod support;

use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, Settings};
use drivetwin_sim::record::trace::Retention;
use drivetwin_tests::toy::Toy;

use support::{line, took};

/// Number of measured events.
const EVENTS: u64 = 1_000_000;
/// Events of one device per second of bench time.
const RATE: u64 = 100;

fn main() {
    println!("a bench of many drives");
    for seats in [1, 1_000, 10_000] {
        let mut bench = Bench::with(Settings { trace: Retention::Off, ..Settings::default() });
        for seat in 0..seats {
            bench.run_until((seat * 10_000 / seats).micros());
            bench.add::<Toy>(&format!("toy{seat}"));
        }
        bench.run_until(1.secs());
        let span = (EVENTS * 1_000_000 / (seats * RATE)).micros();
        let end = bench.now() + span;
        let seconds = took(|| bench.run_until(end)).as_secs_f64();
        let ns = seconds * 1e9 / EVENTS as f64;
        line(&format!("{seats} seats"), &format!("{:.2} million events/s, {ns:.0} ns each", 1e3 / ns));
    }
}
