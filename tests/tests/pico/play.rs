//! A run in the virtual time of an emulated Pico: a script of the board's inputs, and its outputs.
//!
//! `tests/pico/play.mjs` defines the formats of both. Instants are nanoseconds since the board first got
//! power.

use std::fmt::{Display, Write as _};
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::Mutex;

/// Instants and durations, in nanoseconds.
pub(crate) type Nanos = u64;

/// A millisecond.
pub(crate) const MS: Nanos = 1_000_000;
/// A microsecond.
pub(crate) const US: Nanos = 1_000;

/// The jumper that is low at the start to skip the start-up delay
/// (firmware/boards/rp2040/README.md).
const FAST: u8 = 22;

/// Stimuli of a board.
#[derive(Clone, Default)]
pub(crate) struct Script(String);

/// Event of a board.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum OutputRecord {
    /// Starts to send a character.
    Sent(u8),
    /// Drives a pin low or high, or releases it.
    Pin(u8, Drive),
    /// Starts to erase the sector at this offset.
    Erased(u32),
    /// Starts to program so many bytes at this offset.
    Programmed(u32, u32),
    /// The value of a word of memory that was read.
    Peeked(u32),
    /// Power was switched off.
    PowerOff,
    /// The watchdog reset the board.
    Watchdog,
    /// The boot loader of the ROM started; it lights these pins, one bit each.
    BootLoader(u32),
}

/// Level of a pin that is driven or released.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Drive {
    Low,
    High,
    Float,
}

/// Results of a run.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Run {
    /// Events of the board, ordered by time.
    pub(crate) did: Vec<(Nanos, OutputRecord)>,
    /// Events at the computer's end of the USB cable, ordered by time.
    pub(crate) usb: Vec<(Nanos, String)>,
    /// The lines of the output that begin with `stat`, without that word.
    pub(crate) figures: Vec<String>,
}

impl Script {
    /// A script for a board whose jumper disables the start-up delay.
    pub(crate) fn fast() -> Self {
        let mut script = Self::default();
        script.at(0, format_args!("pin {FAST} low"));
        script
    }

    /// Adds a stimulus at `at`, which must not be before earlier stimuli.
    pub(crate) fn at(&mut self, at: Nanos, what: impl Display) {
        writeln!(self.0, "{}.{:03} {what}", at / US, at % US).expect("a string takes all");
    }

    /// Sends characters to the board without pauses; the stop bit of the first one ends at `at`.
    pub(crate) fn hear(&mut self, at: Nanos, bytes: &[u8]) {
        let bytes: String = bytes.iter().map(|byte| format!(" {byte:02x}")).collect();
        self.at(at, format_args!("rx{bytes}"));
    }

    /// Lets the computer send bytes to a port of the USB cable.
    pub(crate) fn send(&mut self, at: Nanos, port: &str, bytes: &[u8]) {
        let bytes: String = bytes.iter().map(|byte| format!(" {byte:02x}")).collect();
        self.at(at, format_args!("usb {port}{bytes}"));
    }

    /// Plays the script to an image until `end`, on a flash that was never used.
    pub(crate) fn play(&self, image: &Path, end: Nanos) -> Run {
        self.play_with(image, end, "")
    }

    /// Plays the script with a flash that is stored in a file. If the file is missing, the flash is unused.
    pub(crate) fn play_on(&self, flash: &Path, image: &Path, end: Nanos) -> Run {
        self.play_with(image, end, &format!("\t--flash\t{}", flash.display()))
    }

    fn play_with(&self, image: &Path, end: Nanos, options: &str) -> Run {
        let mut script = self.clone();
        script.at(end, "end");
        let idle = IDLE.lock().expect("no thread panics while it takes a player").pop();
        let mut player = idle.unwrap_or_else(Player::start);
        let run = Run::parse(&player.play(&format!("{}{options}\n{}", image.display(), script.0)));
        IDLE.lock().expect("no thread panics while it returns a player").push(player);
        run
    }
}

/// Players that wait for a job. They end when their input ends, with this process.
static IDLE: Mutex<Vec<Player>> = Mutex::new(Vec::new());

/// A process that plays one script after the other.
struct Player {
    node: Child,
    output: BufReader<ChildStdout>,
}

impl Player {
    fn start() -> Self {
        let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("pico/play.mjs");
        let mut command = Command::new("node");
        command.arg(program).arg("--many").stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut node = command.spawn().expect("node starts");
        let output = BufReader::new(node.stdout.take().expect("it is piped"));
        Self { node, output }
    }

    /// Plays a job; returns the output.
    fn play(&mut self, job: &str) -> String {
        let input = self.node.stdin.as_mut().expect("it is piped");
        input.write_all(job.as_bytes()).expect("node reads");
        let mut output = String::new();
        while !output.ends_with("\n.\n") {
            assert_ne!(self.output.read_line(&mut output).expect("text"), 0, "the emulator failed");
        }
        output.truncate(output.len() - ".\n".len());
        output
    }
}

impl Run {
    fn parse(text: &str) -> Self {
        let mut run = Self { did: Vec::new(), usb: Vec::new(), figures: Vec::new() };
        for line in text.lines() {
            let (at, what) = line.split_once(' ').expect("two words");
            if at == "stat" {
                run.figures.push(what.to_owned());
            } else {
                let at = at.parse().expect("an instant");
                if let Some(what) = what.strip_prefix("usb ") {
                    run.usb.push((at, what.to_owned()));
                    continue;
                }
                run.did.push((at, parse(what).unwrap_or_else(|| panic!("at {at} ns: {what}"))));
            }
        }
        run
    }

    /// Characters that were sent between `from` and `to`, after the start of the first one.
    pub(crate) fn sent(&self, from: Nanos, to: Nanos) -> (Nanos, Vec<u8>) {
        let sent = self.did.iter().filter_map(|(at, did)| match did {
            OutputRecord::Sent(byte) if (from..to).contains(at) => Some((*at, *byte)),
            _ => None,
        });
        let (times, bytes): (Vec<_>, Vec<_>) = sent.unzip();
        (times.first().copied().unwrap_or(0), bytes)
    }

    /// Start of each character that was sent between `from` and `to`.
    pub(crate) fn times_sent(&self, from: Nanos, to: Nanos) -> Vec<Nanos> {
        let sent = self
            .did
            .iter()
            .filter(|(at, did)| matches!(did, OutputRecord::Sent(_)) && (from..to).contains(at));
        sent.map(|(at, _)| *at).collect()
    }

    /// Events at the computer's end of the USB cable between `from` and `to`.
    pub(crate) fn seen(&self, from: Nanos, to: Nanos) -> Vec<&str> {
        let seen = self.usb.iter().filter(|(at, _)| (from..to).contains(at));
        seen.map(|(_, what)| what.as_str()).collect()
    }

    /// Bytes that the computer got from a port of the USB cable between `from` and `to`.
    pub(crate) fn got(&self, port: &str, from: Nanos, to: Nanos) -> Vec<u8> {
        let packets = self.seen(from, to).into_iter().filter_map(|what| what.strip_prefix(port));
        packets
            .flat_map(str::split_whitespace)
            .map(|byte| u8::from_str_radix(byte, 16).expect("a byte"))
            .collect()
    }

    /// Instants at which a pin changed to `drive`.
    pub(crate) fn edges(&self, pin: u8, drive: Drive) -> Vec<Nanos> {
        let edges = self.did.iter().filter(|(_, did)| *did == OutputRecord::Pin(pin, drive));
        edges.map(|(at, _)| *at).collect()
    }
}

/// Parses the event of a line; `None` if the line is not an event.
fn parse(what: &str) -> Option<OutputRecord> {
    let words: Vec<&str> = what.split(' ').collect();
    Some(match words.as_slice() {
        ["tx", byte] => OutputRecord::Sent(u8::from_str_radix(byte, 16).ok()?),
        ["pin", pin, level] => {
            let drive = match *level {
                "low" => Drive::Low,
                "high" => Drive::High,
                "float" => Drive::Float,
                _ => return None,
            };
            OutputRecord::Pin(pin.parse().ok()?, drive)
        }
        ["flash", "erase", offset, ..] => OutputRecord::Erased(hex(offset)?),
        ["flash", "program", offset, bytes] => OutputRecord::Programmed(hex(offset)?, bytes.parse().ok()?),
        ["peek", _, word] => OutputRecord::Peeked(u32::from_str_radix(word, 16).ok()?),
        ["power", "off"] => OutputRecord::PowerOff,
        ["reset", "watchdog"] => OutputRecord::Watchdog,
        ["boot", "loader", pins] => OutputRecord::BootLoader(u32::from_str_radix(pins, 16).ok()?),
        _ => return None,
    })
}

fn hex(number: &str) -> Option<u32> {
    u32::from_str_radix(number.strip_prefix("0x")?, 16).ok()
}
