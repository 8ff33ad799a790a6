//! Events of a bench per second of wall time, with few drives and with many.
//!
//! An event is a device that reaches its deadline and sends two characters on its line. Each device does so
//! every 10 ms of bench time, and their deadlines are spread evenly.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;

use drivetwin_tests::busy::Toys;

use support::{line, took};

/// Number of measured events.
const EVENTS: u64 = 1_000_000;

fn main() {
    if let Some((seats, events)) = count::wanted() {
        let seats = seats.parse().expect("a number of seats");
        return Toys::new(seats).run(events);
    }
    println!("a bench of many drives");
    let mut all_counted = true;
    for seats in [1, 1_000, 10_000] {
        let mut toys = Toys::new(seats);
        let seconds = took(|| toys.run(EVENTS)).as_secs_f64();
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
