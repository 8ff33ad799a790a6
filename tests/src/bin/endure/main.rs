//! An endurance run: `endure DRIVETWIN [--hours N | --minutes N] [--rate R]`, by `cargo xtask endure`.
//!
//! Starts `drivetwin run` with drives of every kind in real time, and masters that send `R` requests per second to all
//! of them together. Lines with faults and drives whose power fails are among them. Each reply is compared with the
//! bytes that the manual gives. Meanwhile connections are opened and closed, readers of `/api/live` and `/api/events`
//! come and go, motors turn, and the resources of the process are measured.
//!
//! The measured time begins after a warm-up, when the recordings that are kept in memory are full. The run fails if
//! memory or handles have grown since then, if the clock of the bench is off, if a reply was wrong or missing without a
//! fault, or if there were fewer requests than wanted.

mod clock;
mod control;
mod dialect;
mod layout;
mod masters;
mod process;
mod stimulus;
mod tally;
mod wire;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use clock::Offset;
use masters::Masters;
use process::{Process, Resources};
use tally::{Counts, Gate, Ports, Tally};

/// Most memory that the process may gain between the beginning and the end. An hour of 10,000 requests per second has
/// 36 million of them, so a leak of a byte in eight requests is found. Journals of frames that were corrupt or for no
/// drive are not full after the warm-up, and may gain 2 MiB.
const GROWTH_KIB: u64 = 4 << 10;

/// Greatest difference between the clock of the bench and that of the computer, beyond the error of the measurement. Both
/// are read at rest, while all masters wait.
const CLOCK: Duration = Duration::from_millis(1);

/// Shortest warm-up: the trace and the frames on the wires, 64 MiB each, are full before each drive has got its messages.
const WARM_UP: Duration = Duration::from_secs(60);
/// Longest warm-up.
const LONGEST_WARM_UP: Duration = Duration::from_secs(900);
/// Messages to each drive in the warm-up: more than a journal keeps (BENCH-18).
const MESSAGES: u64 = 11_000;

/// Difference from the expected number of faults that is plausible: a part of it, because a fault may strike a request
/// that another fault has struck, and so many times the square root, which is the spread of a random number.
const FAULTS: (f64, f64) = (0.2, 6.0);

/// Least part of the rate that all ports together must reach between two measurements.
const REACHED: f64 = 0.9;
/// Least part of its rate in the warm-up that each port must reach between two measurements. For ports that fill up the
/// rate it is the part of their mean between the two.
const PORT_REACHED: f64 = 0.5;

/// Longest wait until the handles of closed connections are closed.
const SETTLE: Duration = Duration::from_secs(10);

/// A measurement while all masters wait, with the same connections open.
struct Sample {
    name: &'static str,
    at: Instant,
    resources: Resources,
    offset: Offset,
    /// Counts since the start.
    counts: Counts,
    /// Time for which the masters have worked since the sample before, or the start; counts of each port in this time.
    span: Duration,
    ports: Ports,
}

impl Sample {
    /// Right replies per second since the sample before.
    fn rate(&self) -> f64 {
        self.per_second(self.ports.values().map(|counts| counts.right).sum())
    }

    /// The same of a port.
    fn rate_of(&self, port: &str) -> f64 {
        self.per_second(self.ports.get(port).map_or(0, |counts| counts.right))
    }

    fn per_second(&self, count: u64) -> f64 {
        count as f64 / self.span.as_secs_f64()
    }
}

/// Options of the command line.
struct Options {
    drivetwin: PathBuf,
    span: Duration,
    rate: u32,
}

impl Options {
    fn parse(mut words: impl Iterator<Item = String>) -> Option<Self> {
        let mut options =
            Self { drivetwin: words.next()?.into(), span: Duration::from_secs(3_600), rate: 10_000 };
        while let Some(word) = words.next() {
            let number: u32 = words.next()?.parse().ok().filter(|&number| number > 0)?;
            match word.as_str() {
                "--hours" => options.span = Duration::from_secs(3_600) * number,
                "--minutes" => options.span = Duration::from_secs(60) * number,
                "--rate" => options.rate = number,
                _ => return None,
            }
        }
        Some(options)
    }
}

/// Time of the computer.
#[expect(clippy::disallowed_methods, reason = "the run compares the bench with the wall clock")]
fn now() -> Instant {
    Instant::now()
}

fn main() -> ExitCode {
    let Some(options) = Options::parse(std::env::args().skip(1)) else {
        eprintln!("usage: endure DRIVETWIN [--hours N | --minutes N] [--rate R], whole numbers above 0");
        return ExitCode::from(2);
    };
    match run(&options) {
        Ok(sentences) if sentences.is_empty() => ExitCode::SUCCESS,
        Ok(sentences) => {
            sentences.iter().for_each(|sentence| eprintln!("error: {sentence}"));
            ExitCode::FAILURE
        }
        Err(sentence) => {
            eprintln!("error: {sentence}");
            ExitCode::FAILURE
        }
    }
}

/// Runs it all. Returns a sentence for each thing that does not hold.
fn run(options: &Options) -> Result<Vec<String>, String> {
    let process = Process::start(&options.drivetwin, &layout::text())?;
    let tally = Arc::new(Tally::default());
    let [gate, actions] = [(); 2].map(|()| Arc::new(Gate::default()));
    let masters = Masters::start(&process.ready, &tally, &gate, &actions);
    let start = now();
    let rate = options.rate.into();
    let (minute, last, sampled) = (0, (start, 0), (start, Ports::new()));
    let mut run = Run { process, tally, gate, actions, masters, rate, start, minute, last, sampled };

    let minutes = options.span.as_secs() / 60;
    println!("warm-up, until each drive has got {MESSAGES} messages; then {minutes} minutes");
    run.warm_up()?;
    let beginning = run.sample("beginning", None)?;
    run.go_on(beginning.at + options.span / 2)?;
    let middle = run.sample("middle", Some(&beginning))?;
    run.go_on(beginning.at + options.span)?;
    let end = run.sample("end", Some(&beginning))?;

    run.print(&[&beginning, &middle, &end]);
    Ok(run.sentences(&[&beginning, &middle, &end]))
}

/// A run of the bench under its masters.
struct Run {
    process: Process,
    tally: Arc<Tally>,
    /// Gate of the masters.
    gate: Arc<Gate>,
    /// Gate of the actions from outside. It closes first, so that all drives have power when the masters wait.
    actions: Arc<Gate>,
    masters: Masters,
    rate: u64,
    start: Instant,
    /// The last minute about which a line is printed, its end, and the right replies until then.
    minute: u64,
    last: (Instant, u64),
    /// Time at which the masters went on after the last sample, and the counts of each port until then.
    sampled: (Instant, Ports),
}

impl Run {
    /// Lets the masters work until the recordings in memory are full.
    fn warm_up(&mut self) -> Result<(), String> {
        while now() < self.start + WARM_UP || self.tally.slowest().1 < MESSAGES {
            if now() > self.start + LONGEST_WARM_UP {
                let (name, count) = self.tally.slowest();
                return Err(format!(
                    "{name} has got only {count} messages in the warm-up; the machine is too slow"
                ));
            }
            self.second()?;
        }
        Ok(())
    }

    /// Opens the gate, and lets the masters work until `end`.
    fn go_on(&mut self, end: Instant) -> Result<(), String> {
        self.sampled.0 = now();
        self.gate.open();
        self.actions.open();
        while now() < end {
            self.second()?;
        }
        Ok(())
    }

    /// Lets the masters work for a second, and fills up the rate. Each minute a line is printed.
    fn second(&mut self) -> Result<(), String> {
        let (before, filled, since) = (self.tally.counts(), self.masters.filled(), now());
        thread::park_timeout(Duration::from_secs(1));
        self.process.check()?;
        let span = (now() - since).as_secs_f64();
        let (sum, filled) = (self.tally.counts().right - before.right, self.masters.filled() - filled);
        let others = sum.saturating_sub(filled) as f64 / span;
        self.masters.fill(self.rate.saturating_sub(others as u64));
        let minute = (now() - self.start).as_secs() / 60;
        if minute > self.minute {
            self.minute = minute;
            self.line()?;
        }
        Ok(())
    }

    /// Prints a line about the last minute.
    fn line(&mut self) -> Result<(), String> {
        let (resources, counts) = (self.process.resources()?, self.tally.counts());
        let span = (now() - self.last.0).as_secs_f64();
        let rate = (counts.right - self.last.1) as f64 / span;
        let minute = self.minute;
        let Counts { faulty, powerless, wrong, .. } = counts;
        let mib = resources.resident_kib as f64 / 1024.0;
        println!(
            "minute {minute}: {rate:.0} requests/s, {mib:.1} MiB, {} handles, {} threads; so far {faulty} lost by faults, {powerless} without power, {wrong} wrong",
            resources.handles, resources.threads
        );
        self.last = (now(), counts.right);
        Ok(())
    }

    /// Measures while all masters wait at the closed gate. Reads the handles until they are those of `beginning`, or for a
    /// while: a connection that a client has closed is open until the bench has seen that.
    fn sample(&mut self, name: &'static str, beginning: Option<&Sample>) -> Result<Sample, String> {
        if !self.actions.close(self.masters.actions) || !self.gate.close(self.masters.count) {
            return Err(format!("a master has ended or hangs; the {name} cannot be measured"));
        }
        let span = now() - self.sampled.0;
        let (mut last, end) = (0, now() + SETTLE);
        while now() < end {
            thread::park_timeout(SETTLE / 20);
            let handles = self.process.handles();
            let is_settled = beginning
                .map_or(handles == last && now() > end - SETTLE / 2, |it| it.resources.handles == handles);
            if is_settled {
                break;
            }
            last = handles;
        }
        let resources = self.process.resources()?;
        let offset = Offset::measure(&self.process.ready.control(), self.start)?;
        let before = std::mem::replace(&mut self.sampled.1, self.tally.ports());
        let since = |(port, counts): (&&'static str, &Counts)| {
            (*port, counts.since(before.get(port).copied().unwrap_or_default()))
        };
        let ports = self.sampled.1.iter().map(since).collect();
        Ok(Sample { name, at: now(), resources, offset, counts: self.tally.counts(), span, ports })
    }

    /// Prints the table of the measurements.
    fn print(&self, samples: &[&Sample; 3]) {
        let row = |name: &str, value: &dyn Fn(&Sample) -> String| {
            let values: Vec<String> = samples.iter().map(|sample| format!("{:>18}", value(sample))).collect();
            println!("{name:<38}{}", values.concat());
        };
        let beginning = samples[0];
        let mib = |kib: u64| format!("{:.2} MiB", kib as f64 / 1024.0);
        println!();
        row("", &|it| it.name.to_owned());
        row("time", &|it| format!("{:.1} min", (it.at - self.start).as_secs_f64() / 60.0));
        row("resident memory", &|it| mib(it.resources.resident_kib));
        row("its peak", &|it| mib(it.resources.peak_kib));
        row("open handles", &|it| it.resources.handles.to_string());
        row("threads", &|it| it.resources.threads.to_string());
        row("clock of the bench at rest is ahead by", &|it| {
            let (difference, error) = it.offset.since(beginning.offset);
            format!("{:.3} ± {:.3} ms", 1e3 * difference, 1e3 * error)
        });
        row("requests/s since the one before", &|it| format!("{:.0}", it.rate()));
        let ms = |microseconds: u64| format!("{:.1} ms", microseconds as f64 / 1e3);
        row("longest time to a reply", &|it| ms(it.counts.longest));
        row("answered as the manual says", &|it| it.counts.right.to_string());
        row("lost or changed by faults", &|it| it.counts.faulty.to_string());
        row("without power or starting", &|it| it.counts.powerless.to_string());
        row("wrong or missing without reason", &|it| it.counts.wrong.to_string());
        println!(
            "\n{:<18}{:>18}{:>18}{:>18}{:>18}{:>18}",
            "port", "answered", "lost by faults", "expected", "without power", "longest to reply"
        );
        for (name, Counts { right, faulty, powerless, longest, .. }) in self.tally.ports() {
            let expected = layout::fault_share(name) * (right + faulty) as f64;
            println!("{name:<18}{right:>18}{faulty:>18}{expected:>18.0}{powerless:>18}{:>18}", ms(longest));
        }
    }

    /// A sentence for each thing that does not hold.
    fn sentences(&self, samples: &[&Sample; 3]) -> Vec<String> {
        let [beginning, later @ ..] = samples;
        let mut sentences: Vec<String> = later.iter().flat_map(|sample| grown(beginning, sample)).collect();
        sentences.extend(samples.iter().flat_map(|sample| implausible(sample)));
        sentences.extend(later.iter().flat_map(|sample| too_slow(self.rate, beginning, sample)));
        let wrong = self.tally.counts().wrong;
        if wrong > 0 {
            sentences.push(format!(
                "{wrong} replies were wrong or missing without a fault; the first ones are above"
            ));
        }
        sentences
    }
}

/// A sentence for each resource that has grown, and for a clock that is off.
fn grown(beginning: &Sample, later: &Sample) -> Vec<String> {
    let mut sentences = Vec::new();
    let Sample { name, resources, offset, .. } = later;
    let gained = resources.resident_kib.saturating_sub(beginning.resources.resident_kib);
    if gained > GROWTH_KIB {
        sentences.push(format!(
            "memory has grown by {gained} KiB from the beginning to the {name}; at most {GROWTH_KIB} KiB are allowed"
        ));
    }
    let (handles, before) = (resources.handles, beginning.resources.handles);
    if handles != before {
        sentences.push(format!(
            "{handles} handles are open at the {name}, and {before} at the beginning, with the same connections"
        ));
    }
    let off = offset.at_least_since(beginning.offset);
    if off > CLOCK {
        sentences.push(format!(
            "the clock of the bench, at rest, is off by {off:?} at the {name}; at most {CLOCK:?} are allowed"
        ));
    }
    sentences
}

/// A sentence for each rate that was not reached since the sample before.
fn too_slow(wanted: u64, beginning: &Sample, later: &Sample) -> Vec<String> {
    let (name, rate) = (later.name, later.rate());
    let all = (rate < REACHED * wanted as f64).then(|| {
        format!("the masters got only {rate:.0} of {wanted} replies/s before the {name}; the machine is too slow or too busy, or the bench is")
    });
    let fillers = || later.ports.keys().filter(|port| layout::fills_up(port));
    let filled = fillers().map(|port| later.rate_of(port)).sum::<f64>() / fillers().count() as f64;
    let ports = beginning.ports.keys().filter_map(|port| {
        let rate = later.rate_of(port);
        // What fills up the rate depends on the others.
        let usual = if layout::fills_up(port) { filled } else { beginning.rate_of(port) };
        (rate < PORT_REACHED * usual).then(|| {
            format!(
                "{port}: only {rate:.1} replies/s before the {name}, less than half of the usual {usual:.1}"
            )
        })
    });
    all.into_iter().chain(ports).collect()
}

/// A sentence for each port whose number of faults since the sample before is not plausible.
fn implausible(sample: &Sample) -> Vec<String> {
    let sentence = |(port, &Counts { right, faulty, .. }): (&&str, &Counts)| {
        let (name, exchanges) = (sample.name, right + faulty);
        let expected = layout::fault_share(port) * exchanges as f64;
        let allowed = FAULTS.0 * expected + FAULTS.1 * expected.sqrt();
        let is_plausible = (faulty as f64 - expected).abs() <= allowed;
        (!is_plausible).then(|| {
            format!("{port}: before the {name}, {faulty} of {exchanges} requests were lost by faults; {expected:.0} ± {allowed:.0} is plausible")
        })
    };
    sample.ports.iter().filter_map(sentence).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(resident_kib: u64, handles: usize, milliseconds: f64) -> Sample {
        let resources = Resources { resident_kib, peak_kib: resident_kib, handles, threads: 3 };
        let offset = Offset::new(milliseconds / 1e3 - 1e-4, milliseconds / 1e3 + 1e-4);
        let (counts, span, ports) = (Counts::default(), Duration::from_secs(10), Ports::new());
        Sample { name: "end", at: now(), resources, offset, counts, span, ports }
    }

    #[test]
    fn a_run_without_its_load_fails() {
        let with = |replies: [u64; 4]| {
            let ports = ["bad", "shared", "f5.modbus", "f6.modbus"];
            let counts = replies.map(|right| Counts { right, ..Counts::default() });
            Sample { ports: ports.into_iter().zip(counts).collect(), ..sample(0, 0, 0.0) }
        };
        // 10 s with 100 requests/s wanted. The last two fill up the rate, and have got less to do.
        let beginning = with([400, 400, 200, 200]);
        assert_eq!(too_slow(100, &beginning, &with([600, 200, 50, 50])), [""; 0]);
        let sentences = too_slow(100, &beginning, &with([600, 199, 60, 19]));
        assert_eq!(sentences.len(), 3, "{sentences:?}");
        assert!(sentences[0].contains("only 88 of 100"), "{sentences:?}");
        assert!(sentences[1].starts_with("f6.modbus: only 1.9 "), "{sentences:?}");
        assert!(sentences[2].starts_with("shared: only 19.9 "), "{sentences:?}");
    }

    #[test]
    fn what_grows_beyond_its_bound_fails() {
        let beginning = sample(100_000, 110, 20.0);
        assert_eq!(grown(&beginning, &sample(104_096, 110, 21.15)), [""; 0]);
        // Each offset has an error of 0.1 ms, so a difference of 1.25 ms is at least 1.05 ms.
        let sentences = grown(&beginning, &sample(104_097, 111, 21.25));
        assert_eq!(sentences.len(), 3, "{sentences:?}");
        assert!(sentences[2].starts_with("the clock of the bench, at rest, is off by 1.05"), "{sentences:?}");
        assert_eq!(grown(&beginning, &sample(90_000, 109, 18.7)).len(), 2);
    }

    #[test]
    fn more_faults_or_fewer_than_expected_fail() {
        // 90 of 10,000 are expected at this port: 900 ± 360.
        let is_plausible = |port, faulty| {
            let counts = Counts { right: 100_000 - faulty, faulty, ..Counts::default() };
            implausible(&Sample { ports: Ports::from([(port, counts)]), ..sample(0, 0, 0.0) }).is_empty()
        };
        assert_eq!(
            [539, 541, 1_259, 1_261].map(|faulty| is_plausible("bad", faulty)),
            [false, true, true, false]
        );
        assert!(is_plausible("shared", 0) && !is_plausible("shared", 1));
    }
}
