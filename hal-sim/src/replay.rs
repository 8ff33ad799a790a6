//! A trace once more, and the first difference.

use std::fmt;

use drivetwin_firmware::device::{Device, Instant};

use crate::bench::{Bench, DriveId, Settings, Setup};
use crate::line::LineMode;
use crate::record::trace::{
    Entry, Event, InputRecord, Make, OutputRecord, ParseError, Retention, Trace, TraceDrive, without_comment,
};

/// First difference of a replay from its trace.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Difference {
    /// The line of the trace that differs; `None` if something more came than it says.
    pub line: Option<usize>,
    /// Line of the trace.
    pub expected: Option<String>,
    /// Line that came instead; `None` if none did.
    pub got: Option<String>,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let nothing = "nothing more";
        let expected = self.expected.as_deref().unwrap_or(nothing);
        let got = self.got.as_deref().unwrap_or(nothing);
        match self.line {
            Some(line) => write!(f, "line {line}: expected {expected}; got {got}"),
            None => write!(f, "expected {expected}; got {got}"),
        }
    }
}

/// Reason why a text cannot be replayed.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Unplayable {
    /// The text is no trace.
    Text(ParseError),
    /// The beginning is missing: so many events were dropped when it was recorded.
    Lost(u64),
    /// A drive in it cannot be seated; in one sentence.
    DriveId(String),
}

impl fmt::Display for Unplayable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(error) => error.fmt(f),
            Self::Lost(events) => {
                write!(
                    f,
                    "the first {events} events of this trace were dropped while it was recorded, so it cannot be replayed"
                )
            }
            Self::DriveId(sentence) => f.write_str(sentence),
        }
    }
}

impl std::error::Error for Unplayable {}

impl From<ParseError> for Unplayable {
    fn from(error: ParseError) -> Self {
        Self::Text(error)
    }
}

/// Runs a trace on fresh benches, whose drives `make` makes by their kind, and returns the first
/// difference.
///
/// # Errors
/// Why it cannot be run.
pub fn run(trace: &Trace, make: &Make<'_>) -> Result<Option<Difference>, Unplayable> {
    Ok(difference(trace, &play(trace, make)?))
}

/// Feeds the drives what the trace says, up to its end. What they did to each other is in what each was fed, so each
/// has a bench of its own, and whatever happens to another at the same instant moves none of its deadlines.
fn play(trace: &Trace, make: &Make<'_>) -> Result<Vec<Bench>, Unplayable> {
    if trace.lost > 0 {
        return Err(Unplayable::Lost(trace.lost));
    }
    let mut fed: Vec<Vec<(Instant, &InputRecord)>> = vec![Vec::new(); trace.drives.len()];
    for entry in trace.events() {
        if let Event::Input(event) = &entry.event {
            fed[entry.drive].push((entry.at, event));
        }
    }
    trace.drives.iter().zip(fed).map(|(drive, fed)| play_drive(trace, drive, &fed, make)).collect()
}

/// Feeds one drive.
fn play_drive(
    trace: &Trace,
    drive: &TraceDrive,
    fed: &[(Instant, &InputRecord)],
    make: &Make<'_>,
) -> Result<Bench, Unplayable> {
    let line = if drive.fast_line { LineMode::Fast } else { LineMode::Timed };
    let settings = Settings { seed: trace.seed, line, trace: Retention::All, ..Settings::default() };
    let mut bench = Bench::with(settings);
    if drive.from <= trace.end {
        bench.run_until(drive.from);
        let seat = seat(&mut bench, drive, make)?;
        for &(at, fed) in fed {
            bench.feed(seat, at, fed);
        }
    }
    bench.run_until(trace.end);
    Ok(bench)
}

fn seat(bench: &mut Bench, drive: &TraceDrive, make: &Make<'_>) -> Result<DriveId, Unplayable> {
    let kind = drive.spec.kind;
    let device: Box<dyn Device> =
        make(kind).ok_or_else(|| Unplayable::DriveId(format!("there is no kind \"{kind}\"")))?;
    let memory = Some(drive.memory.clone());
    let setup = Setup { boot_fast: drive.boot_fast, apart: drive.apart, memory, ..Setup::default() };
    bench.add_with(&drive.name, device, setup).map_err(|error| Unplayable::DriveId(error.to_string()))
}

/// The first difference between what a trace expects and what its drives did, each on its bench.
fn difference(expected: &Trace, got: &[Bench]) -> Option<Difference> {
    let until = told_until(expected);
    let differences = got.iter().enumerate().filter_map(|(place, got)| {
        let got = got.trace();
        let wanted = outputs(expected, place, expected, until);
        let made = outputs(got, 0, expected, until);
        let mut pairs = (0..wanted.len().max(made.len())).map(|n| (wanted.get(n), made.get(n)));
        pairs
            .find(|pair| match pair {
                (Some((a, a_did)), Some((b, b_did))) => (a.at, a_did.told(a.at)) != (b.at, b_did.told(b.at)),
                (None, Some((more, _))) => expected.ended || more.at < until,
                _ => true,
            })
            .map(|(wanted, made)| {
                let at = wanted.iter().chain(&made).map(|(entry, _)| entry.at).min();
                let difference = Difference {
                    line: wanted.map(|(entry, _)| entry.line),
                    expected: wanted.map(|(entry, _)| expected.entry_text(entry)),
                    got: made.map(|(entry, _)| expected.entry_text(&of_drive(entry, place))),
                };
                (at, difference)
            })
    });
    differences.min_by_key(|(at, _)| *at).map(|(_, difference)| difference)
}

/// An entry of a bench with one drive, as that of the drive in `place`.
fn of_drive(entry: &Entry, place: usize) -> Entry {
    Entry { drive: place, ..entry.clone() }
}

/// Up to which stamp a trace tells what its drives did: beyond its end, if they had put something for later.
fn told_until(trace: &Trace) -> Instant {
    trace.events().map(|entry| entry.at).fold(trace.end, Instant::max)
}

/// Events of a drive with a stamp up to `until` and `rules` compare, by stamp.
fn outputs<'a>(
    trace: &'a Trace,
    drive: usize,
    rules: &Trace,
    until: Instant,
) -> Vec<(&'a Entry, &'a OutputRecord)> {
    let mut outputs: Vec<_> = trace
        .events()
        .filter(|entry| entry.drive == drive && entry.at <= until)
        .filter_map(|entry| match &entry.event {
            Event::Output(did) if rules.compare.contains(&did.group()) => Some((entry, did)),
            _ => None,
        })
        .collect();
    outputs.sort_by_key(|(entry, _)| entry.at);
    outputs
}

/// The text of a trace with what it compares brought up to date: header, comments and what is fed
/// stay as they are. It runs as far as the old text went; say so with `end`.
///
/// # Errors
/// Why it cannot be run.
pub fn rewrite(text: &str, make: &Make<'_>) -> Result<String, Unplayable> {
    let trace = Trace::parse(text, make)?;
    let until = told_until(&trace);
    let mut outputs: Vec<(Instant, String)> = Vec::new();
    for (place, bench) in play(&trace, make)?.iter().enumerate() {
        let text = |entry| trace.entry_text(&of_drive(entry, place));
        let made = self::outputs(bench.trace(), 0, &trace, until);
        outputs.extend(made.iter().map(|(entry, _)| (entry.at, text(entry))));
    }
    outputs.sort_by_key(|(at, _)| *at);
    let mut outputs = outputs.into_iter().peekable();

    let mut new = String::new();
    let mut put = |line: &str| {
        new.push_str(line);
        new.push('\n');
    };
    // Comments go with the event below them.
    let mut comments: Vec<&str> = Vec::new();
    let mut events = trace.events().peekable();
    for (index, line) in text.lines().enumerate() {
        let words = without_comment(line).trim();
        if !words.starts_with(|c: char| c.is_ascii_digit()) {
            // A word of the header, or no word at all.
            if words.is_empty() {
                comments.push(line);
            } else {
                comments.drain(..).chain([line]).for_each(&mut put);
            }
            continue;
        }
        let entry = events.next_if(|entry| entry.line == index + 1);
        let at = entry.map_or(trace.end, |entry| entry.at);
        let ends = entry.is_none();
        while let Some((_, output)) = outputs.next_if(|(due, _)| *due < at || (ends && *due == at)) {
            put(&output);
        }
        comments.drain(..).for_each(&mut put);
        if !entry.is_some_and(|entry| matches!(entry.event, Event::Output(_))) {
            put(line);
        }
    }
    outputs.for_each(|(_, output)| put(&output));
    comments.into_iter().for_each(put);
    Ok(new)
}
