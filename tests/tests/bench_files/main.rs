//! Bench files: the examples behave as documented, wrong files give errors, and the order of tables and keys
//! does not matter.
#![allow(missing_docs, reason = "a test")]

mod errors;
mod examples;
mod identity;
mod order;
mod ranges;
mod scenarios;
mod values;
mod written;

use drivetwin_firmware::device::Instant;
use drivetwin_sim::bench::{Bench, Client, DriveId, Settings};
use drivetwin_sim::config::bench_file;
use drivetwin_sim::config::layout::{Built, Layout};
use drivetwin_sim::record::trace::Retention;

#[track_caller]
fn layout(text: &str) -> Layout {
    bench_file::parse(text).unwrap_or_else(|error| panic!("{error}"))
}

/// The bench of a file, with a trace of all events.
#[track_caller]
fn built(text: &str) -> Built {
    let layout = layout(text);
    let settings = Settings { trace: Retention::All, ..layout.settings() };
    layout.build(settings, Vec::new()).unwrap_or_else(|error| panic!("{error}"))
}

/// The bench of an example file.
#[track_caller]
fn example(name: &str) -> Built {
    let path = format!("{}/../examples/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    built(&std::fs::read_to_string(path).unwrap())
}

fn seat(bench: &Bench, name: &str) -> DriveId {
    bench.find_drive(name).unwrap_or_else(|| panic!("there is no drive {name}"))
}

/// Present value of a register.
fn register(bench: &Bench, seat: DriveId, name: &str) -> i64 {
    let row =
        bench.spec(seat).registers.find(name).unwrap_or_else(|| panic!("there is no register {name}")).row;
    bench.peek(seat, row)
}

/// Sends a client's message, runs until the bench is idle, and returns the reply.
fn ask(bench: &mut Bench, client: Client, message: &[u8]) -> Vec<u8> {
    bench.send(client, message);
    bench.run_until_idle();
    let mut reply = Vec::new();
    bench.receive(client, &mut reply);
    reply
}

/// Instants of an event in the trace.
fn moments(bench: &Bench, event: &str) -> Vec<Instant> {
    let text = bench.trace().to_text();
    let lines = text.lines().filter(|line| line.ends_with(event));
    let millis = lines.filter_map(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    millis.map(|ms| Instant::from_ticks((ms * 16_000.0).round() as u64)).collect()
}
