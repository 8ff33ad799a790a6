//! Events of a bench per second of wall time, with few drives and with many.
//!
//! An event is a device that reaches its deadline and sends two characters on its line. Each device does so
//! every 10 ms of bench time, and their deadlines are spread evenly.

#[path = "support/count.rs"]
mod count;
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

/// A bench of `seats` devices whose deadlines are spread evenly.
fn bench(seats: u64) -> Bench {
    let mut bench = Bench::with(Settings { trace: Retention::Off, ..Settings::default() });
    for seat in 0..seats {
        bench.run_until((seat * 10_000 / seats).micros());
        bench.add::<Toy>(&format!("toy{seat}"));
    }
    bench.run_until(1.secs());
    bench
}

/// Runs the bench for `events` events.
fn run(bench: &mut Bench, seats: u64, events: u64) {
    bench.run_until(bench.now() + (events * 1_000_000 / (seats * RATE)).micros());
}

fn main() {
    if let Some((seats, events)) = count::wanted() {
        let seats = seats.parse().expect("a number of seats");
        return run(&mut bench(seats), seats, events);
    }
    println!("a bench of many drives");
    let mut all_counted = true;
    for seats in [1, 1_000, 10_000] {
        let mut bench = bench(seats);
        let seconds = took(|| run(&mut bench, seats, EVENTS)).as_secs_f64();
        let ns = seconds * 1e9 / EVENTS as f64;
        let instructions = count::instructions(&seats.to_string(), 10_000, 110_000);
        let counted = count::counted(instructions);
        line(
            &format!("{seats} seats"),
            &format!("{:.2} million events/s, {ns:.0} ns, {counted} each", 1e3 / ns),
        );
        all_counted &= instructions.is_some();
    }
    count::warn_unless(all_counted);
}
