//! A swarm of random benches: `cargo xtask swarm --minutes 1`.
//!
//! Everything in a run follows from its seed. The program makes a [plan](plan::Plan) of the seed and runs the
//! plan in several ways. The [oracle](oracle::judge) checks the properties that must hold for every run. For
//! a seed that fails the program prints the command that repeats the failure. That command prints the
//! smallest plan it can find that fails in the same way. The design follows FoundationDB's simulation and
//! TigerBeetle's VOPR.

mod behave;
mod dialect;
mod generate;
mod late;
mod oracle;
mod plan;
mod replies;
mod run;
mod shrink;

use std::io::{BufRead as _, BufReader};
use std::process::{Command, ExitCode, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use clap::Parser;

use oracle::Tally;
use plan::Plan;
use run::MOST_EVENTS;

/// Help text about `--planted`, an option of xtask itself.
const PLANTED: &str = "\
`cargo xtask swarm --planted [NAME]...`, without other options, plants the defects of tests/swarm/planted, all or those with these names, in a
copy of the last commit, and prints how soon each is found. A process ends after 20 seeds that fail.";

/// Random benches under an oracle.
#[derive(Parser)]
#[command(name = "cargo xtask swarm", after_help = PLANTED)]
struct Options {
    /// Runs this seed alone, and prints its plan. If the seed fails, prints the smallest plan that fails in
    /// the same way.
    #[arg(long, conflicts_with_all = ["minutes", "count", "first", "jobs"])]
    seed: Option<u64>,
    /// Runs seeds for that many minutes; 1 if there is no `--count`.
    #[arg(long)]
    minutes: Option<f64>,
    /// Runs that many seeds.
    #[arg(long, conflicts_with = "minutes")]
    count: Option<u64>,
    /// The first seed; without it a new one, made from the time of day.
    #[arg(long)]
    first: Option<u64>,
    /// Number of processes, which share the seeds.
    #[arg(long, default_value_t = 1)]
    jobs: u64,
    /// Difference between one seed and the next.
    #[arg(long, default_value_t = 1, hide = true)]
    stride: u64,
    /// Each process ends with its first seed that fails. Without this option it ends after 20 of them.
    #[arg(long)]
    until_failure: bool,
    /// Runs the seeds in this process, and prints each seed before it begins.
    #[arg(long, hide = true)]
    child: bool,
}

/// Most seeds that a process reports. More would show nothing new about a failure that frequent.
const MOST_FAILURES: u64 = 20;

/// Text that a child prints before a seed.
const BEGINS: &str = "begins ";

fn main() -> ExitCode {
    let options = Options::parse();
    oracle::keep_panics();
    let fails = match (options.child, options.seed) {
        (true, Some(seed)) => show(seed),
        (true, None) => hunt(&options),
        (false, Some(seed)) => follow(Command::new(this()).args(["--child", "--seed", &seed.to_string()])),
        (false, None) => spread(&options),
    };
    if fails { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

/// A plan takes a fraction of a second; one that takes longer than this hangs.
const LONGEST: Duration = Duration::from_secs(600);

/// Ends the program if no new seed begins within [`LONGEST`]. Prints the plan of the last seed if `shows` is
/// true.
fn watch(shows: bool) -> Sender<u64> {
    let (begins, seeds) = mpsc::channel();
    std::thread::spawn(move || {
        let mut last = None;
        loop {
            match seeds.recv_timeout(LONGEST) {
                Ok(seed) => last = Some(seed),
                Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) => {
                    let seed = last.unwrap_or_default();
                    println!("seed {seed}: hangs\n  cargo xtask swarm --seed {seed}");
                    if shows {
                        println!("\n{}", generate::plan(seed));
                    }
                    std::process::exit(1);
                }
            }
        }
    });
    begins
}

/// Runs one seed and prints its plan. Returns true if the seed fails.
fn show(seed: u64) -> bool {
    let plan = generate::plan(seed);
    println!("{BEGINS}{seed}");
    let begins = watch(true);
    let _ = begins.send(seed);
    let judged = oracle::judge(&plan);
    drop(begins);
    match judged {
        Ok(tally) => {
            println!("{plan}\nseed {seed} holds: {tally:?}");
            false
        }
        Err(failure) => {
            println!("seed {seed}: {failure}\n\nmade smaller:\n");
            let alike = |plan: &Plan| oracle::judge(plan).is_err_and(|other| other.what == failure.what);
            let small = shrink::shrink(plan, alike);
            println!("{small}");
            if let Err(failure) = oracle::judge(&small) {
                println!("{failure}");
            }
            true
        }
    }
}

/// Runs one seed after the other. Returns true if a seed fails.
#[expect(clippy::disallowed_methods, reason = "the run time and the first seed come from the wall clock")]
fn hunt(options: &Options) -> bool {
    let begun = Instant::now();
    let minutes = options.minutes.unwrap_or(if options.count.is_some() { f64::INFINITY } else { 1.0 });
    let first = options.first.unwrap_or_else(fresh);
    let begins = watch(false);
    let (mut seeds, mut failures, mut all) = (0, 0, Tally::default());
    for seed in
        (0..options.count.unwrap_or(u64::MAX)).map(|n| first.wrapping_add(n.wrapping_mul(options.stride)))
    {
        if begun.elapsed().as_secs_f64() >= 60.0 * minutes || failures >= MOST_FAILURES {
            break;
        }
        seeds += 1;
        let _ = begins.send(seed);
        println!("{BEGINS}{seed}");
        match oracle::judge(&generate::plan(seed)) {
            Ok(tally) => all.add(tally),
            Err(failure) => {
                failures += 1;
                println!("seed {seed}: {failure}\n  cargo xtask swarm --seed {seed}");
                if options.until_failure {
                    break;
                }
            }
        }
    }
    let seconds = begun.elapsed().as_secs_f64();
    let Tally { answered, saved, events, given_up, cut_short, after_cuts: [new, old, factory], bytes } = all;
    println!("swarm: {seeds} seeds from {first} in {seconds:.0} s, {failures} failed");
    println!("  {given_up} given up, {cut_short} ended early after {MOST_EVENTS} events");
    println!("  {answered} answers, {saved} saves, {events} events, at most {} KiB a bench", bytes >> 10);
    println!("  after power cuts: {new} times the new values, {old} the old ones, {factory} the factory's");
    failures > 0
}

/// A seed that was not run before.
#[expect(clippy::disallowed_methods, reason = "another one each second")]
fn fresh() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs() << 24
}

fn this() -> std::path::PathBuf {
    std::env::current_exe().expect("a running program has a file")
}

/// Shares the seeds among processes. Returns true if a seed fails.
fn spread(options: &Options) -> bool {
    let (jobs, first) = (options.jobs.max(1), options.first.unwrap_or_else(fresh));
    let commands = (0..jobs).map(|job| {
        let mut command = Command::new(this());
        let (from, stride) = (first + job * options.stride, jobs * options.stride);
        command.args(["--child", "--first", &from.to_string(), "--stride", &stride.to_string()]);
        if let Some(count) = options.count {
            command.args(["--count", &((count + jobs - 1 - job) / jobs).to_string()]);
        }
        if let Some(minutes) = options.minutes {
            command.args(["--minutes", &minutes.to_string()]);
        }
        if options.until_failure {
            command.arg("--until-failure");
        }
        command
    });
    let children: Vec<_> =
        commands.map(|mut command| std::thread::spawn(move || follow(&mut command))).collect();
    let fails = children.into_iter().map(|child| child.join().unwrap_or(true));
    fails.fold(false, |fails, other| fails | other)
}

/// Runs a child, prints what it prints, and reports the seed at which it ends without a result: a stack
/// overflow ends a process at once. Returns true if a seed fails.
fn follow(command: &mut Command) -> bool {
    let mut child = command.stdout(Stdio::piped()).spawn().expect("a process can be started");
    let mut seed = None;
    for line in BufReader::new(child.stdout.take().expect("a pipe")).lines().map_while(Result::ok) {
        match line.strip_prefix(BEGINS) {
            Some(begins) => seed = Some(begins.to_owned()),
            None => println!("{line}"),
        }
    }
    let status = child.wait().expect("a child that was started");
    if let (None | Some(2..), Some(seed)) = (status.code(), seed) {
        println!("seed {seed}: the process ends: {status}\n  cargo xtask swarm --seed {seed}");
        // The process can print no more, and each attempt to shrink the plan would end it again.
        if command.get_args().any(|argument| argument == "--seed") {
            println!("\n{}", generate::plan(seed.parse().unwrap_or_default()));
        }
    }
    !status.success()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_child_that_dies_is_a_failure() {
        let fails = |script: &str| follow(Command::new("sh").args(["-c", script]));
        assert!(fails("echo begins 7; kill -ABRT $$"));
        assert!(fails("echo begins 7; exit 1"));
        assert!(!fails("echo begins 7; echo swarm: 1 seeds"));
    }
}
