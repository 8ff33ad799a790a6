//! The golden traces on the unmodified images of the LM3S6965 board, in virtual time.
//!
//! `cargo xtask test` builds the images, names their folder in `STANDIN_IMAGES`, and runs this. See
//! [`machine`] for how time is held, and [`LEFT_OUT`] for what cannot be shown here. `STANDIN_TRACE=7.15`
//! plays only the traces that have this in their name.
//!
//! What it measures goes to `board-figures/lm3s6965.txt` beside what cargo builds: a name and a number a
//! line, the worst of all traces of a kind.

mod expected;
mod gdb;
mod image;
mod machine;
mod pins;
mod qtest;
mod replay;

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::{env, fs, thread};

use standin_firmware::device::{Device, Instant};
use standin_sim::hal::Done;
use standin_sim::trace::Trace;
use standin_tests::on_shell;

use expected::Expected;
use image::Image;
use replay::Figures;

/// Traces that this board cannot show, and why.
static LEFT_OUT: [(&str, &str); 2] = [
    (
        "serial-2.5.1-silences",
        "its silences are to the tick, and an interrupt stamps a character microseconds late",
    ),
    (
        "7.20-power-lost-in-a-save",
        "the flash of this board can only be read; the Pico's loses power in a save",
    ),
];

/// What an instruction takes, as a power of two of ns: 16 ns, about what it takes on the board; other
/// times if the board [oversleeps](machine::Overslept).
static SHIFTS: [u32; 4] = [4, 3, 2, 1];
/// Traces with edges closer together than the loop takes for one. The board is only touched while it
/// sleeps, so there an instruction takes 1 ns.
static FAST: [&str; 2] = ["7.8-step-and-direction", "7.11-encoder-and-index"];

/// At least what any drive's memory takes.
const MEMORY: usize = 8 << 10;

/// A kind of drive, as its traces need it.
struct Kind {
    make: fn() -> Box<dyn Device>,
    motion: fn(&Trace) -> Vec<(Instant, Done)>,
}

macro_rules! kinds {
    ($($new:expr,)*) => {
        &[$(Kind { make: || Box::new($new()), motion: |trace| on_shell::motion::<_, MEMORY>(trace, $new) },)*]
    };
}

static KINDS: &[Kind] = standin_firmware::devices!(kinds);

/// A trace, and the image that it is played on.
struct Job {
    name: String,
    path: PathBuf,
    kind: &'static Kind,
}

impl Job {
    fn run(&self, images: &Path) -> Figures {
        let text = fs::read_to_string(&self.path).expect("a text");
        let make = |name: &str| KINDS.iter().map(|kind| (kind.make)()).find(|made| made.spec().kind == name);
        let trace = Trace::parse(&text, &make).unwrap_or_else(|error| panic!("{}: {error}", self.name));
        let image = Image::read(&images.join((self.kind.make)().spec().kind));
        let shifts: &[u32] = if FAST.iter().any(|name| self.name.ends_with(name)) { &[0] } else { &SHIFTS };
        let mut plays = shifts.iter().map(|shift| {
            let expected = Expected::of(&trace, (self.kind.motion)(&trace));
            replay::play(&self.name, &trace, expected, &image, *shift)
        });
        plays.find_map(Result::ok).unwrap_or_else(|| panic!("{} oversleeps at any speed", self.name))
    }
}

/// Every trace of every kind.
fn jobs() -> Vec<Job> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("traces");
    let mut jobs = Vec::new();
    for kind in KINDS {
        let of = (kind.make)().spec().kind;
        let folder = folder.join(of);
        let files = fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
        jobs.extend(files.map(|file| {
            let path = file.expect("a file has a name").path();
            let stem = path.file_stem().and_then(|stem| stem.to_str()).expect("a name in UTF-8");
            Job { name: format!("{of}/{stem}"), path: path.clone(), kind }
        }));
    }
    jobs.sort_by(|a, b| a.name.cmp(&b.name));
    jobs
}

#[test]
#[ignore = "needs QEMU and the images of the board: `cargo xtask test` brings both"]
fn golden_traces_on_the_board() {
    let images =
        PathBuf::from(env::var("STANDIN_IMAGES").expect("STANDIN_IMAGES names the folder of the images"));
    let only = env::var("STANDIN_TRACE").ok();
    let (left_out, mut jobs): (Vec<Job>, Vec<Job>) =
        jobs().into_iter().partition(|job| LEFT_OUT.iter().any(|(name, _)| job.name.ends_with(name)));
    jobs.retain(|job| only.as_ref().is_none_or(|only| job.name.contains(only)));
    assert_eq!(left_out.len(), LEFT_OUT.len(), "what is left out is there");
    for (name, why) in &LEFT_OUT {
        println!("not here: {name}: {why}");
    }

    let waiting = Mutex::new(jobs.iter());
    let done = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(|| {
                loop {
                    let next = waiting.lock().expect("nobody panics while it takes a job").next();
                    let Some(job) = next else { return };
                    let figures = job.run(&images);
                    println!(
                        "{:<44} {:>8.1} ms, {:>6.2} µs late, {:>6.1} µs with a plan, boot {:>6.1} µs, {:>6} steps, {:>6} stops, stack {}",
                        job.name,
                        figures.time.ticks() as f64 / 16e3,
                        figures.latency.ticks() as f64 / 16.0,
                        figures.planning.ticks() as f64 / 16.0,
                        figures.boot.ticks() as f64 / 16.0,
                        figures.steps,
                        figures.stops,
                        figures.stack
                    );
                    let mut done = done.lock().expect("nobody panics while it adds one");
                    done.push(((job.kind.make)().spec().kind, figures));
                }
            });
        }
    });
    let done = done.into_inner().expect("all threads are over");
    assert_eq!(done.len(), jobs.len(), "every trace was played");
    keep(&done);
}

/// Writes down the worst figures of each kind.
fn keep(done: &[(&str, Figures)]) {
    let mut text = String::new();
    for kind in KINDS.iter().map(|kind| (kind.make)().spec().kind) {
        let of = || done.iter().filter(|(of, _)| *of == kind).map(|(_, figures)| figures);
        let worst = |figure: fn(&Figures) -> u64| of().map(figure).max().unwrap_or(0);
        let micros = |figure: u64| figure.div_ceil(16);
        text += &format!("{kind}.stack_bytes {}\n", worst(|figures| u64::from(figures.stack)));
        text += &format!("{kind}.boot_us {}\n", micros(worst(|figures| figures.boot.ticks())));
        text += &format!("{kind}.latency_us {}\n", micros(worst(|figures| figures.latency.ticks())));
        text += &format!("{kind}.planning_us {}\n", micros(worst(|figures| figures.planning.ticks())));
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("board-figures");
    fs::create_dir_all(&folder).expect("a folder");
    fs::write(folder.join("lm3s6965.txt"), text).expect("written");
}
