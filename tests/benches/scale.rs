//! Many drives in one process: what an idle one takes, and how fast all of them answer.
//!
//! The binary runs as people start it, and is built before. `/proc` tells what it takes.

mod support;

use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::time::Duration;

use standin_protocol::modbus::rtu;
use support::{line, took};

/// How long idle drives are watched.
const WATCH: Duration = Duration::from_secs(5);
/// Clock ticks of the system in a second, as `/proc` counts.
const TICKS: f64 = 100.0;
/// How often each drive is asked.
const ROUNDS: u32 = 10;
/// Of all kinds that there are, as many drives as that.
const DRIVES: usize = 1_000;

fn main() {
    let standin = build();
    let kinds = ["md3", "md3-low", "qsb-d", "qsb-m", "qsb-s", "rs434544", "rs434546"];
    let mut all = String::new();
    for number in 0..DRIVES {
        let kind = kinds[number % kinds.len()];
        let _ = write!(all, "[[drive]]\nname = 'd{number}'\nkind = '{kind}'\nfast_boot = true\n");
    }
    println!("{DRIVES} drives of all kinds, each on its own TCP port");
    let bench = Running::start(&standin, &all, &["--line", "fast"]);
    idle(&bench);
    let mut lines: Vec<TcpStream> = bench.places.iter().map(connect).collect();
    // Those on Modbus: a register that each of them has.
    let asked: Vec<_> = (0..DRIVES)
        .filter_map(|number| match kinds[number % kinds.len()] {
            "md3" | "md3-low" => Some((number, rtu::read(1, 0, 1))),
            "rs434544" | "rs434546" => Some((number, rtu::read(1, 0x3000, 1))),
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
    let bench = Running::start(&standin, &shared, &["--line", "fast"]);
    idle(&bench);
    let mut connection = [connect(&bench.places[0])];
    let requests: Vec<_> = (1..=247).map(|address| rtu::read(address, 0, 1)).collect();
    latency(requests.iter().map(|request| (0, &request[..])), &mut connection);
}

/// Asks one drive after the other, and says how long one takes to answer.
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

/// Says what drives take to which nobody talks.
fn idle(bench: &Running) {
    // What is left of starting.
    wait(Duration::from_secs(1));
    let before = bench.cpu();
    wait(WATCH);
    let cpu = (bench.cpu() - before) / WATCH.as_secs_f64() / bench.places.len() as f64;
    let memory = bench.memory() / bench.places.len() as f64;
    line("an idle drive", &format!("{memory:.1} KiB, {:.4} % of a core", 100.0 * cpu));
}

/// A benchmark measures the wall clock, and this is how it lets it pass.
fn wait(span: Duration) {
    let (_open, never) = mpsc::channel::<()>();
    let _ = never.recv_timeout(span);
}

fn connect(place: &String) -> TcpStream {
    let connection = TcpStream::connect(place).expect("the port is there");
    connection.set_nodelay(true).expect("it is TCP");
    connection.set_read_timeout(Some(Duration::from_secs(10))).expect("it is TCP");
    connection
}

/// Reads a reply of one register.
fn reply(connection: &mut TcpStream) {
    let mut bytes = [0; 7];
    connection.read_exact(&mut bytes).expect("a drive answers");
    assert_eq!(bytes[1..3], [3, 2], "a drive refuses");
}

/// Builds the binary; where it is.
fn build() -> PathBuf {
    let built = Command::new(env!("CARGO")).args(["build", "--release", "-p", "standin-sim"]).status();
    assert!(built.is_ok_and(|status| status.success()), "standin cannot be built");
    let here = std::env::current_exe().expect("a benchmark is a file");
    // …/release/deps/scale-…
    here.ancestors().nth(2).map(|release| release.join("standin")).expect("it is in a target directory")
}

/// A bench that runs, and is killed with this.
struct Running {
    child: Child,
    /// Where each drive is reached.
    places: Vec<String>,
}

impl Running {
    fn start(standin: &Path, text: &str, options: &[&str]) -> Self {
        let file = std::env::temp_dir().join(format!("standin-scale-{}.toml", std::process::id()));
        std::fs::write(&file, text).expect("there is room for a file");
        let mut child = Command::new(standin)
            .arg("run")
            .arg(&file)
            .args(["--json"])
            .args(options)
            .stdout(Stdio::piped())
            .spawn()
            .expect("standin starts");
        let mut ready = String::new();
        let stdout = child.stdout.take().expect("it is piped");
        BufReader::new(stdout).read_line(&mut ready).expect("standin says where the drives are");
        let _ = std::fs::remove_file(&file);
        let places = ready.split("tcp:").skip(1).filter_map(|rest| Some(rest.split('"').next()?.to_owned()));
        Self { child, places: places.collect() }
    }

    /// Seconds of a core that it has taken.
    fn cpu(&self) -> f64 {
        let text = self.proc("stat");
        // The name of the program may hold anything but is in brackets.
        let after = text.rsplit(')').next().unwrap_or("");
        let ticks = after.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok());
        ticks.sum::<f64>() / TICKS
    }

    /// KiB of memory that it has.
    fn memory(&self) -> f64 {
        let text = self.proc("status");
        let rss = text.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        rss.and_then(|rss| rss.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(f64::NAN)
    }

    fn proc(&self, name: &str) -> String {
        std::fs::read_to_string(format!("/proc/{}/{name}", self.child.id())).expect("it runs")
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
