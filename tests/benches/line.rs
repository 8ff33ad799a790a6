//! A request on a line that many drives share: each of them receives the request and the reply.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;

use drivetwin_firmware::device::{Device as _, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, Settings, Setup};
use drivetwin_sim::line::LineMode;

use support::{line, took};

/// Number of measured requests.
const REQUESTS: u64 = 2_000;

/// A bench with `drives` MD3s on one line, started, with the addresses 1 and up.
fn bench(drives: u8, mode: LineMode) -> Bench {
    let mut bench = Bench::with(Settings { line: mode, ..Settings::default() });
    let mut ports = Vec::new();
    for address in 1..=drives {
        let md3 = Box::new(Md3::default());
        let row = md3.spec().find("DeviceAddress").expect("an MD3 has an address").row;
        let setup = Setup { presets: vec![(row, address.into())], boot_fast: true, ..Setup::default() };
        let drive = bench.add_with(&format!("x{address}"), md3, setup).expect("the address is valid");
        ports.push((drive, Port(0)));
    }
    bench.share("line", &ports);
    bench.run_until(1.secs());
    bench
}

/// Asks the drives in turn.
fn ask(bench: &mut Bench, drives: u8, requests: u64) {
    let all: Vec<_> = bench.drives().collect();
    for (address, drive) in (1..=drives).zip(all).cycle().take(requests as usize) {
        assert_eq!(bench.ask(drive, &rtu::read(address, 0, 1)).len(), 7);
    }
}

fn main() {
    let mode = |name: &str| if name == "fast" { LineMode::Fast } else { LineMode::Timed };
    if let Some((what, requests)) = count::wanted() {
        let (name, drives) = what.split_once(' ').expect("a mode and a number of drives");
        let drives = drives.parse().expect("a number of drives");
        return ask(&mut bench(drives, mode(name)), drives, requests);
    }
    println!("a request on a line");
    let mut all_counted = true;
    for (name, drives) in ["timed", "fast"].into_iter().flat_map(|name| [1, 32, 247].map(|n| (name, n))) {
        let mut bench = bench(drives, mode(name));
        let ns = took(|| ask(&mut bench, drives, REQUESTS)).as_secs_f64() * 1e6 / REQUESTS as f64;
        let instructions = count::instructions(&format!("{name} {drives}"), 300, 400);
        all_counted &= instructions.is_some();
        line(&format!("{name}, {drives} drives"), &format!("{ns:.1} µs, {}", count::counted(instructions)));
    }
    count::warn_unless(all_counted);
}
