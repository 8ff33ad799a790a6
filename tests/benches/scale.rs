//! Many drives in one process: resources of an idle drive, and the time until all of them have answered.
//!
//! The benchmark builds the binary and starts it as users do. It reads the used resources from `/proc`.

#[path = "support/running.rs"]
mod running;
mod support;

use std::fmt::Write as _;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::Duration;

use drivetwin_protocol::modbus::rtu;
use running::{Running, build, wait};
use support::{line, took};

/// Observation time of idle drives.
const WATCH: Duration = Duration::from_secs(5);
/// Number of requests to each drive.
const ROUNDS: u32 = 10;
/// Number of drives, spread over all kinds.
const DRIVES: usize = 1_000;

fn main() {
    let drivetwin = build();
    let kinds = ["md3", "md3-low", "qsb-d", "qsb-m", "qsb-s", "rs434544", "rs434546"];
    let mut all = String::new();
    for number in 0..DRIVES {
        let kind = kinds[number % kinds.len()];
        let _ = write!(all, "[[drive]]\nname = 'd{number}'\nkind = '{kind}'\nfast_boot = true\n");
    }
    println!("{DRIVES} drives of all kinds, each on its own TCP port");
    let bench = Running::start(&drivetwin, &all, &["--line", "fast"]);
    idle(&bench);
    let mut lines: Vec<TcpStream> = bench.places.iter().map(connect).collect();
    // Drives with Modbus, each with a read of a register that it has.
    let asked: Vec<_> = (0..DRIVES)
        .filter_map(|number| match kinds[number % kinds.len()] {
            "md3" | "md3-low" => Some((number, rtu::read(1, 0, 1))),
            "rs434544" | "rs434546" => Some((number, rtu::read(1, 0x5000, 1))),
            _ => None,
        })
        .collect();
    let all_at_once = took(|| {
        for _ in 0..ROUNDS {
            for (number, request) in &asked {
                lines[*number].write_all(request).expect("the drive is there");
            }
            for (number, _) in &asked {
                reply(&mut lines[*number]);
            }
        }
    });
    let requests = f64::from(ROUNDS) * asked.len() as f64;
    line("all at once", &format!("{:.0} requests/s", requests / all_at_once.as_secs_f64()));
    latency(asked.iter().map(|(number, request)| (*number, &request[..])), &mut lines);
    drop(bench);

    println!("247 drives on one line");
    let mut shared = String::new();
    for address in 1..=247 {
        let drive = format!("name = 'd{address}'\nkind = 'md3'\naddress = {address}\nfast_boot = true");
        let _ = write!(shared, "[[drive]]\n{drive}\n");
    }
    let names: Vec<String> = (1..=247).map(|address| format!("'d{address}'")).collect();
    let _ = write!(shared, "[[bus]]\nname = 'line'\ndrives = [{}]\n", names.join(", "));
    let bench = Running::start(&drivetwin, &shared, &["--line", "fast"]);
    idle(&bench);
    let mut connection = [connect(&bench.places[0])];
    let requests: Vec<_> = (1..=247).map(|address| rtu::read(address, 0, 1)).collect();
    latency(requests.iter().map(|request| (0, &request[..])), &mut connection);
}

/// Sends requests to one drive after the other, and prints the median and the 99th percentile of the time to
/// a reply.
fn latency<'a>(requests: impl Iterator<Item = (usize, &'a [u8])>, lines: &mut [TcpStream]) {
    let mut times: Vec<Duration> = requests
        .map(|(number, request)| {
            took(|| {
                lines[number].write_all(request).expect("the drive is there");
                reply(&mut lines[number]);
            })
        })
        .collect();
    times.sort_unstable();
    let (median, late) = (times[times.len() / 2], times[times.len() * 99 / 100]);
    line("one by one", &format!("{median:.0?} in the median, {late:.0?} for 99 of 100"));
}

/// Prints the resources of drives that get no requests.
fn idle(bench: &Running) {
    // Waits until the work of the start is over.
    wait(Duration::from_secs(1));
    let before = bench.cpu();
    wait(WATCH);
    let cpu = (bench.cpu() - before) / WATCH.as_secs_f64() / bench.places.len() as f64;
    let memory = bench.memory() / bench.places.len() as f64;
    line("an idle drive", &format!("{memory:.1} KiB of the process, {:.4} % of a core", 100.0 * cpu));
}

fn connect(place: &String) -> TcpStream {
    let connection = TcpStream::connect(place).expect("the port is there");
    connection.set_nodelay(true).expect("it is TCP");
    connection.set_read_timeout(Some(Duration::from_secs(10))).expect("it is TCP");
    connection
}

/// Reads a reply with one register.
fn reply(connection: &mut TcpStream) {
    let mut bytes = [0; 7];
    connection.read_exact(&mut bytes).expect("a drive answers");
    assert_eq!(bytes[1..3], [3, 2], "a drive refuses");
}
