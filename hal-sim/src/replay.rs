//! A trace once more, and the first difference.

use std::fmt;

use standin_firmware::device::{Device, Instant};

use crate::bench::{Bench, Seat, Settings, Setup};
use crate::trace::{Did, Drive, Entry, Event, Make, ParseError, Trace, TraceKeep, without_comment};

/// Where a replay differs from its trace.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Difference {
    /// The line of the trace that differs; `None` if something more came than it says.
    pub line: Option<usize>,
    /// What the trace says.
    pub expected: Option<String>,
    /// What came instead; `None` if nothing did.
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

/// Why a text cannot be replayed.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Unplayable {
    /// It is no trace.
    Text(ParseError),
    /// Its beginning is missing: so many events were dropped when it was recorded.
    Lost(u64),
    /// A drive in it cannot be seated; in one sentence.
    Seat(String),
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
            Self::Seat(sentence) => f.write_str(sentence),
        }
    }
}

impl std::error::Error for Unplayable {}

impl From<ParseError> for Unplayable {
    fn from(error: ParseError) -> Self {
        Self::Text(error)
    }
}

/// Runs a trace on a fresh bench, whose drives `make` makes by their kind, and returns the first
/// difference.
///
/// # Errors
/// Why it cannot be run.
pub fn run(trace: &Trace, make: &Make<'_>) -> Result<Option<Difference>, Unplayable> {
    Ok(difference(trace, play(trace, make)?.trace()))
}

/// Feeds a fresh bench what the trace says, up to its end.
fn play(trace: &Trace, make: &Make<'_>) -> Result<Bench, Unplayable> {
    if trace.lost > 0 {
        return Err(Unplayable::Lost(trace.lost));
    }
    let settings = Settings { seed: trace.seed, trace: TraceKeep::All, ..Settings::default() };
    let mut bench = Bench::with(settings);
    let mut seats: Vec<Option<Seat>> = vec![None; trace.drives.len()];
    // Drives take their seats when their time has come.
    let mut waiting: Vec<(usize, &Drive)> = trace.drives.iter().enumerate().collect();
    waiting.sort_by_key(|(_, drive)| drive.from);
    let mut waiting = waiting.into_iter().peekable();
    let mut fed = trace.events().filter_map(|entry| match &entry.event {
        Event::Fed(fed) => Some((entry, fed)),
        Event::Did(_) => None,
    });
    loop {
        let next = fed.next();
        let until = next.map_or(trace.end, |(entry, _)| entry.at);
        while let Some((place, drive)) = waiting.next_if(|(_, drive)| drive.from <= until) {
            // Who is seated at one instant is seated before anything happens at it.
            if drive.from > bench.now() {
                bench.run_until(drive.from);
            }
            seats[place] = Some(seat(&mut bench, drive, make)?);
        }
        let Some((entry, fed)) = next else { break };
        if let Some(seat) = seats[entry.drive] {
            bench.feed(seat, entry.at, fed);
        }
    }
    bench.run_until(trace.end);
    Ok(bench)
}

fn seat(bench: &mut Bench, drive: &Drive, make: &Make<'_>) -> Result<Seat, Unplayable> {
    let kind = drive.spec.kind;
    let device: Box<dyn Device> =
        make(kind).ok_or_else(|| Unplayable::Seat(format!("there is no kind \"{kind}\"")))?;
    let memory = Some(drive.memory.clone());
    let setup = Setup { boot_fast: drive.boot_fast, apart: drive.apart, memory, ..Setup::default() };
    bench.seat(&drive.name, device, setup).map_err(|error| Unplayable::Seat(error.to_string()))
}

/// The first difference between what a trace expects and what a replay of it recorded. Drives are
/// compared one by one: at one instant their order among each other means nothing.
fn difference(expected: &Trace, got: &Trace) -> Option<Difference> {
    let differences = expected.drives.iter().enumerate().filter_map(|(place, drive)| {
        let other = got.drives.iter().position(|other| other.name == drive.name);
        let wanted = outputs(expected, Some(place), expected);
        let made = outputs(got, other, expected);
        let mut pairs = (0..wanted.len().max(made.len())).map(|n| (wanted.get(n), made.get(n)));
        pairs
            .find(|pair| match pair {
                (Some((a, a_did)), Some((b, b_did))) => (a.at, a_did.told(a.at)) != (b.at, b_did.told(b.at)),
                _ => true,
            })
            .map(|(wanted, made)| {
                let at = wanted.iter().chain(&made).map(|(entry, _)| entry.at).min();
                let difference = Difference {
                    line: wanted.map(|(entry, _)| entry.line),
                    expected: wanted.map(|(entry, _)| expected.entry_text(entry)),
                    got: made.map(|(entry, _)| got.entry_text(entry)),
                };
                (at, difference)
            })
    });
    differences.min_by_key(|(at, _)| *at).map(|(_, difference)| difference)
}

/// What a drive did and `rules` compare, by stamp.
fn outputs<'a>(trace: &'a Trace, drive: Option<usize>, rules: &Trace) -> Vec<(&'a Entry, &'a Did)> {
    let mut outputs: Vec<_> = trace
        .events()
        .filter(|entry| Some(entry.drive) == drive && entry.at <= rules.end)
        .filter_map(|entry| match &entry.event {
            Event::Did(did) if rules.compare.contains(&did.group()) => Some((entry, did)),
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
    let bench = play(&trace, make)?;
    let got = bench.trace();
    let mut outputs: Vec<(Instant, String)> = Vec::new();
    for drive in 0..got.drives.len() {
        outputs.extend(
            self::outputs(got, Some(drive), &trace)
                .iter()
                .map(|(entry, _)| (entry.at, got.entry_text(entry))),
        );
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
        if !entry.is_some_and(|entry| matches!(entry.event, Event::Did(_))) {
            put(line);
        }
    }
    outputs.for_each(|(_, output)| put(&output));
    comments.into_iter().for_each(put);
    Ok(new)
}
