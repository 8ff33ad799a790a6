//! Replay of a trace, and comparison of its outputs.

use std::fmt;

use drivetwin_firmware::device::{Device, Instant};

use crate::bench::{Bench, DriveId, Settings, Setup};
use crate::line::LineMode;
use crate::record::trace::{
    Entry, Event, InputRecord, Make, OutputRecord, ParseError, Retention, Trace, TraceDrive, without_comment,
};

/// First difference between a trace and its replay.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Difference {
    /// Line number in the trace; `None` if the replay has an additional output.
    pub line: Option<usize>,
    /// Expected line of the trace; `None` if the trace has no further output.
    pub expected: Option<String>,
    /// Line of the replay; `None` if the replay has no further output.
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

/// Reason why a trace cannot be replayed, or its text cannot be read.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Unplayable {
    /// The text is not a valid trace.
    Text(ParseError),
    /// The beginning is missing: that many events were dropped during recording.
    Lost(u64),
    /// A drive of the trace cannot be added; the reason in one sentence.
    Drive(String),
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
            Self::Drive(sentence) => f.write_str(sentence),
        }
    }
}

impl std::error::Error for Unplayable {}

impl From<ParseError> for Unplayable {
    fn from(error: ParseError) -> Self {
        Self::Text(error)
    }
}

/// Replays a trace and returns the first difference; `None` if all outputs are the same. `make` makes a drive
/// of a kind. Each drive runs on its own bench, with its recorded inputs. Drives on boards are left out. [`Trace`] has an
/// example.
///
/// # Errors
/// The trace cannot be replayed: it is not valid, its beginning is missing, all its drives are on boards, or a drive cannot
/// be added.
pub fn run(trace: &Trace, make: &Make<'_>) -> Result<Option<Difference>, Unplayable> {
    if !trace.drives.is_empty() && trace.drives.iter().all(|drive| drive.elsewhere) {
        let what = "the drives of this trace are on boards, which a replay cannot repeat";
        return Err(Unplayable::Drive(what.to_owned()));
    }
    Ok(difference(trace, &play(trace, make, false)?))
}

/// The drives after a replay, each on a bench of its own, in the order of [`Trace::drives`]. The traces of the
/// benches have the plans of all motions, the motion of motors, and the outcomes of messages.
///
/// # Errors
/// As [`run`].
pub fn benches(trace: &Trace, make: &Make<'_>) -> Result<Vec<Bench>, Unplayable> {
    play(trace, make, true)
}

/// Delivers the recorded inputs to the drives, up to the end of the trace. The inputs of a drive include the
/// effects of other drives. Therefore each drive has its own bench, and events of other drives do not affect
/// its deadlines.
fn play(trace: &Trace, make: &Make<'_>, is_shown: bool) -> Result<Vec<Bench>, Unplayable> {
    if trace.lost > 0 {
        return Err(Unplayable::Lost(trace.lost));
    }
    let mut input: Vec<Vec<(Instant, &InputRecord)>> = vec![Vec::new(); trace.drives.len()];
    for entry in trace.events() {
        if let Event::Input(event) = &entry.event {
            input[entry.drive].push((entry.at, event));
        }
    }
    trace
        .drives
        .iter()
        .zip(input)
        .map(|(drive, input)| play_drive(trace, drive, &input, make, is_shown))
        .collect()
}

/// Delivers the inputs of one drive.
fn play_drive(
    trace: &Trace,
    drive: &TraceDrive,
    input: &[(Instant, &InputRecord)],
    make: &Make<'_>,
    is_shown: bool,
) -> Result<Bench, Unplayable> {
    let line = if drive.fast_line { LineMode::Fast } else { LineMode::Timed };
    let (shafts, outcomes) = (is_shown, is_shown);
    let retention = Retention::All;
    let settings =
        Settings { seed: trace.seed, line, trace: retention, shafts, outcomes, ..Settings::default() };
    let mut bench = Bench::with(settings);
    if drive.from <= trace.end {
        bench.run_until(drive.from);
        let id = add_drive(&mut bench, drive, make)?;
        for &(at, input) in input {
            bench.feed(id, at, input);
        }
    }
    bench.run_until(trace.end);
    Ok(bench)
}

fn add_drive(bench: &mut Bench, drive: &TraceDrive, make: &Make<'_>) -> Result<DriveId, Unplayable> {
    let kind = drive.spec.kind;
    let device: Box<dyn Device> =
        make(kind).ok_or_else(|| Unplayable::Drive(format!("there is no kind \"{kind}\"")))?;
    let memory = Some(drive.memory.to_vec());
    let setup = Setup {
        boot_fast: drive.boot_fast,
        external_motor: drive.external_motor,
        memory,
        ..Setup::default()
    };
    bench.add_with(&drive.name, device, setup).map_err(|error| Unplayable::Drive(error.to_string()))
}

/// The first difference between the outputs of a trace and those of its replayed drives, each on its own bench.
fn difference(expected: &Trace, got: &[Bench]) -> Option<Difference> {
    let until = last_stamp(expected);
    let here = got.iter().enumerate().filter(|(place, _)| !is_elsewhere(expected, *place));
    let differences = here.filter_map(|(place, got)| {
        let got = got.trace();
        let wanted = outputs(expected, place, expected, until);
        let made = outputs(got, 0, expected, until);
        let mut pairs = (0..wanted.len().max(made.len())).map(|n| (wanted.get(n), made.get(n)));
        pairs
            .find(|pair| match pair {
                (Some((a, a_output)), Some((b, b_output))) => {
                    (a.at, a_output.as_text(a.at)) != (b.at, b_output.as_text(b.at))
                }
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

/// Returns true if the drive with that index is on a board.
fn is_elsewhere(trace: &Trace, drive: usize) -> bool {
    trace.drives.get(drive).is_some_and(|drive| drive.elsewhere)
}

/// An entry of a bench with one drive, as an entry of the drive with that index.
fn of_drive(entry: &Entry, place: usize) -> Entry {
    Entry { drive: place, ..entry.clone() }
}

/// The last timestamp of a trace. It is later than the end if drives had scheduled outputs for later.
fn last_stamp(trace: &Trace) -> Instant {
    trace.events().map(|entry| entry.at).fold(trace.end, Instant::max)
}

/// Outputs of a drive with timestamps up to `until`, sorted by timestamp. Only groups that `rules` compares
/// are included.
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
            Event::Output(output) if rules.compare.contains(&output.group()) => Some((entry, output)),
            _ => None,
        })
        .collect();
    outputs.sort_by_key(|(entry, _)| entry.at);
    outputs
}

/// Replays a trace and returns its text with the new outputs. Header, comments and inputs stay unchanged, and so do the
/// outputs of drives on boards. The replay
/// runs until the last time in the old text. The `end` line of the trace should give this time.
///
/// # Errors
/// The trace cannot be replayed: it is not valid, its beginning is missing, or a drive cannot be added.
pub fn rewrite(text: &str, make: &Make<'_>) -> Result<String, Unplayable> {
    let trace = Trace::parse(text, make)?;
    let until = last_stamp(&trace);
    let mut outputs: Vec<(Instant, String)> = Vec::new();
    let benches = play(&trace, make, false)?;
    for (place, bench) in benches.iter().enumerate().filter(|(place, _)| !is_elsewhere(&trace, *place)) {
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
    // Comments stay above the event that follows them.
    let mut comments: Vec<&str> = Vec::new();
    let mut events = trace.events().peekable();
    for (index, line) in text.lines().enumerate() {
        let words = without_comment(line).trim();
        if !words.starts_with(|c: char| c.is_ascii_digit()) {
            // A line of the header, or a line without words.
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
        let is_new =
            |entry: &Entry| matches!(entry.event, Event::Output(_)) && !is_elsewhere(&trace, entry.drive);
        if !entry.is_some_and(is_new) {
            put(line);
        }
    }
    outputs.for_each(|(_, output)| put(&output));
    comments.into_iter().for_each(put);
    Ok(new)
}
