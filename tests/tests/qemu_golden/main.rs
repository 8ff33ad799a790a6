//! The golden traces on the unmodified images of the LM3S6965 board, in virtual time.
//!
//! `cargo xtask test` builds the images, sets `DRIVETWIN_IMAGES` to their folder, and runs these tests.
//! [`machine`] explains how virtual time is controlled, and [`LEFT_OUT`] lists the traces that cannot run
//! here. `DRIVETWIN_TRACE=7.15` plays only the traces with this text in their name.

mod expected;
mod feed;
mod figures;
mod gdb;
mod host;
mod image;
mod lag;
mod machine;
mod noise;
mod patience;
mod pins;
mod place;
mod qtest;
mod replay;
mod stack;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::{env, fs, thread};

use drivetwin_firmware::device::{Device, Duration, Instant};
use drivetwin_sim::board::virtual_board::Done;
use drivetwin_sim::record::trace::{Event, InputRecord, Trace};
use drivetwin_tests::on_shell;

use expected::Expected;
use figures::Figures;
use image::Image;
use pins::Wires;

/// Traces that this board cannot show, each with the reason.
static LEFT_OUT: [(&str, &str); 6] = [
    ("command-format", "the UART of QEMU never receives a character that nobody can read"),
    (
        "serial-2.5.1-silences",
        "its silences are to the tick, and an interrupt stamps a character microseconds late",
    ),
    ("example-2-analogue", "no image measures a voltage"),
    ("p14-analogue-input", "no image measures a voltage"),
    (
        "factory-reset",
        "a pulled-up pin of QEMU forgets a level that it has before the board starts; the Pico's does not",
    ),
    ("power-lost-in-a-save", "the flash of this board can only be read; the Pico's loses power in a save"),
];

/// Duration of an instruction, as a power of two of ns. The first, 16 ns, is about that of the board. The
/// next ones are used if the board [oversleeps](machine::Overslept).
static SHIFTS: [u32; 4] = [4, 3, 2, 1];
/// If a trace has edges closer together than this, the loop cannot follow it at 16 ns an instruction. Inputs
/// change only while the board sleeps, so for such a trace an instruction takes 1 ns.
const CLOSE: Duration = Duration::micros(20);

/// A kind of drive, to replay its traces: a function that makes the drive, and a function that finds the
/// motor orders in a trace.
struct Kind {
    make: fn() -> Box<dyn Device>,
    motion: fn(&Trace) -> Vec<(Instant, Done)>,
}

macro_rules! kinds {
    ($($new:expr,)*) => {
        &[$(Kind { make: || Box::new($new()), motion: |trace| on_shell::motion(trace, $new) },)*]
    };
}

static KINDS: &[Kind] = drivetwin_firmware::devices!(kinds);

/// Finds a kind by its name.
fn kind(name: &str) -> &'static Kind {
    let kind = KINDS.iter().find(|kind| (kind.make)().spec().kind == name);
    kind.unwrap_or_else(|| panic!("tests/traces/{name} has traces of no drive"))
}

/// A trace and the image on which it is played.
struct Job {
    /// The kind of drive, which is the name of the folder and of the image.
    kind: &'static str,
    name: String,
    path: PathBuf,
}

impl Job {
    fn run(&self, images: &Path, wires: &Wires) -> Figures {
        let Self { kind: of, name, path } = self;
        let text = fs::read_to_string(path).expect("a text");
        let make = |name: &str| KINDS.iter().map(|kind| (kind.make)()).find(|made| made.spec().kind == name);
        let trace = Trace::parse(&text, &make).unwrap_or_else(|error| panic!("{name}: {error}"));
        let motion = (kind(of).motion)(&trace);
        let image = Image::read(&images.join(of));
        let shifts: &[u32] = if has_close_edges(&trace) { &[0] } else { &SHIFTS };
        let mut plays = shifts.iter().map(|shift| {
            let expected = Expected::of(&trace, motion.clone(), pins::shared(&trace, wires));
            let played = replay::play(name, &trace, expected, wires, &image, *shift);
            if played.is_err() {
                println!("{name} oversleeps with 2^{shift} ns an instruction");
            }
            played
        });
        plays.find_map(Result::ok).unwrap_or_else(|| panic!("{name} oversleeps at any speed"))
    }
}

/// Returns true if a trace has edges that are [close](CLOSE) together.
fn has_close_edges(trace: &Trace) -> bool {
    let edges = trace.events().filter(|entry| matches!(entry.event, Event::Input(InputRecord::Edge { .. })));
    let edges: Vec<Instant> = edges.map(|entry| entry.at).collect();
    edges.windows(2).any(|pair| matches!(pair, [one, next] if one < next && next.since(*one) < CLOSE))
}

/// Every trace of every kind.
fn jobs() -> Vec<Job> {
    let files = |path: &Path| {
        let files = fs::read_dir(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut paths: Vec<PathBuf> = files.map(|file| file.expect("a file has a name").path()).collect();
        paths.sort();
        paths
    };
    let stem = |path: &Path| path.file_stem().and_then(|stem| stem.to_str()).expect("UTF-8").to_owned();
    let mut jobs = Vec::new();
    for folder in files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("traces")) {
        let kind = (kind(&stem(&folder)).make)().spec().kind;
        jobs.extend(files(&folder).into_iter().map(|path| {
            let name = format!("{kind}/{}", stem(&path));
            Job { kind, name, path }
        }));
    }
    for kind in KINDS.iter().map(|kind| (kind.make)().spec().kind) {
        assert!(jobs.iter().any(|job| job.kind == kind), "a {kind} has traces");
    }
    jobs
}

/// Keeps this thread, and every QEMU that it starts, on one processor. They wait for each other all the time,
/// and wake each other much faster on the same processor. If this fails, they are slower.
fn stay_on(cpu: usize) {
    let thread = fs::read_link("/proc/thread-self");
    if let Some(thread) = thread.as_ref().ok().and_then(|path| path.file_name()) {
        let _ = Command::new("taskset").arg("-cp").arg(cpu.to_string()).arg(thread).output();
    }
}

/// Folder of the images.
fn images() -> PathBuf {
    PathBuf::from(env::var("DRIVETWIN_IMAGES").expect("DRIVETWIN_IMAGES names the folder of the images"))
}

#[test]
#[ignore = "needs QEMU and the images of the board: `cargo xtask test` brings both"]
fn golden_traces_on_the_board() {
    let images = images();
    let only = env::var("DRIVETWIN_TRACE").ok();
    let (left_out, mut jobs): (Vec<Job>, Vec<Job>) =
        jobs().into_iter().partition(|job| LEFT_OUT.iter().any(|(name, _)| job.name.ends_with(name)));
    for (name, why) in &LEFT_OUT {
        assert!(left_out.iter().any(|job| job.name.ends_with(name)), "{name}, which is left out, is there");
        println!("not here: {name}: {why}");
    }
    jobs.retain(|job| only.as_ref().is_none_or(|only| job.name.contains(only)));

    let waiting = Mutex::new(jobs.iter());
    let done = Mutex::new(0);
    thread::scope(|scope| {
        let (waiting, done, images) = (&waiting, &done, &images);
        for cpu in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(move || {
                stay_on(cpu);
                loop {
                    let next = waiting.lock().expect("no thread panics while it takes a job").next();
                    let Some(job) = next else { return };
                    let figures = job.run(images, &pins::wires(job.kind));
                    println!("{:<40} {figures}", job.name);
                    *done.lock().expect("no thread panics while it adds one") += 1;
                }
            });
        }
    });
    let done = done.into_inner().expect("all threads are over");
    assert_eq!(done, jobs.len(), "every trace was played");
}

/// The names of two pins are exchanged, so that one pin changes when the other should.
#[test]
#[ignore = "needs QEMU and the images of the board: `cargo xtask test` brings both"]
#[should_panic(expected = "J3.8 (PB1) is Low")]
fn two_exchanged_pins_do_not_pass() {
    let job = jobs().into_iter().find(|job| job.name == "md3/7.15-disable").expect("it is there");
    let exchanged = pins::wires(job.kind).into_iter().map(|(name, gpio)| match name {
        "J3.7" => ("J3.8", gpio),
        "J3.8" => ("J3.7", gpio),
        _ => (name, gpio),
    });
    job.run(&images(), &exchanged.collect());
}
