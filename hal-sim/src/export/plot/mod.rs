//! A trace as a picture (SVG): motion, pins that change and messages of each drive over time.
//!
//! The drives run again with the inputs of the trace, so also a trace of inputs alone gives a picture. The size
//! of the picture does not grow with the number of events: each track shows what fits into its width.

mod axis;
mod draw;
mod exchanges;
mod tracks;

use std::io;

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_protocol::time::TICKS_PER_SECOND;

use crate::bench::Bench;
use crate::record::trace::{Make, Trace};
use crate::replay;
use crate::signals::waveforms::Waveforms;
use crate::suggest;
pub use exchanges::{Exchange, exchanges};
use tracks::Collector;
pub use tracks::{Edge, Panel, Shape, Words};

/// Options of a picture; the default is the whole trace with all drives.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Options {
    /// Heading.
    pub title: String,
    /// Begin of the time axis in seconds, from 0 to [`Options::MOST`]; the beginning of the trace if not given.
    pub from: Option<f64>,
    /// End of the time axis in seconds, from 0 to [`Options::MOST`]; the end of the trace if not given.
    pub to: Option<f64>,
    /// Names of the drives to show, in the order of the trace; all if empty.
    pub drives: Vec<String>,
}

impl Options {
    /// Greatest time in seconds.
    pub const MOST: f64 = 1e9;

    /// Refuses the name of a drive that the trace has not.
    fn check(&self, trace: &Trace) -> Result<(), String> {
        let names = || trace.drives.iter().map(|drive| drive.name.as_str());
        match self.drives.iter().find(|name| !names().any(|other| other == *name)) {
            Some(unknown) => Err(suggest::unknown("drive", unknown, names())),
            None => Ok(()),
        }
    }

    /// The time axis.
    fn span(&self, end: Instant) -> Result<Span, String> {
        let instant = |seconds: f64| {
            Instant::from_ticks((seconds.clamp(0.0, Self::MOST) * TICKS_PER_SECOND as f64).round() as u64)
        };
        let from = self.from.map_or(Instant::ZERO, instant);
        let to = self.to.map_or(end.max(from + Duration::TICK), instant);
        let (begin, last, end_of_trace) = (axis::seconds(from), axis::seconds(to), axis::seconds(end));
        if self.from.is_some() && from >= end {
            return Err(format!("the trace ends at {end_of_trace} s, so there is nothing from {begin} s on"));
        }
        if from >= to {
            return Err(format!("the time axis begins at {begin} s, so it cannot end at {last} s"));
        }
        Ok(Span { from, to })
    }
}

/// Part of the time that a picture shows.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Span {
    from: Instant,
    to: Instant,
}

impl Span {
    /// Place of `at` in the span: 0 at its begin, 1 at its end.
    fn part(self, at: Instant) -> f64 {
        at.since(self.from).ticks() as f64 / self.to.since(self.from).ticks() as f64
    }
}

/// Draws a trace. `make` makes a drive of a kind.
///
/// ```
/// use drivetwin_sim::catalog;
/// use drivetwin_sim::export::plot::{self, Options};
/// use drivetwin_sim::record::trace::Trace;
///
/// let make = |kind: &str| catalog::make(kind).ok();
/// let text = "drivetwin trace 1\ndrive x md3 fast\n\
///     100 > rx 01 06 00 11 00 01 18 0F\n3000 end\n";
/// let trace = Trace::parse(text, &make).unwrap();
/// let picture = plot::svg(&trace, &make, &Options::default()).unwrap();
/// assert!(picture.contains("write MotionControl = 1"));
/// ```
///
/// # Errors
/// One sentence: the trace cannot be replayed, there is no such drive, or the time axis has no length.
pub fn svg(trace: &Trace, make: &Make<'_>, options: &Options) -> Result<String, String> {
    options.check(trace)?;
    let span = options.span(trace.end)?;
    let benches = replay::benches(trace, make).map_err(|error| error.to_string())?;
    // All drives together, because what one of them sends on a line is no message to the others.
    let traces: Vec<&Trace> = benches.iter().map(Bench::trace).collect();
    let trace = Trace::joined(trace, &traces);
    Ok(draw::picture(&options.title, span, &chosen(&trace, span, options, || Ok(()))?))
}

/// The tracks of a trace that was recorded on a bench, as far as a picture shows them. The motion of motors is in it if the
/// bench recorded [`shafts`](crate::bench::Settings::shafts). `pause` is called often; an error of it ends the work.
///
/// # Errors
/// One sentence: there is no such drive, the time axis has no length, or that of `pause`.
pub fn panels(
    trace: &Trace,
    options: &Options,
    pause: impl FnMut() -> io::Result<()>,
) -> Result<Vec<Panel>, String> {
    options.check(trace)?;
    chosen(trace, options.span(trace.end)?, options, pause)
}

/// The tracks of the chosen drives.
fn chosen(
    trace: &Trace,
    span: Span,
    options: &Options,
    pause: impl FnMut() -> io::Result<()>,
) -> Result<Vec<Panel>, String> {
    let mut waveforms = Waveforms::new(trace);
    let mut collector = Collector::new(waveforms.variables(), span, pause);
    let reading = waveforms.follow(trace, &mut collector);
    reading.map_err(|error| error.to_string())?;
    waveforms.finish(&mut collector);
    let mut tracks = collector.finish().into_iter().peekable();
    let mut panels = Vec::new();
    for (index, drive) in trace.drives.iter().enumerate() {
        let own = std::iter::from_fn(|| tracks.next_if(|(variable, _)| variable.drive == index)).collect();
        if options.drives.is_empty() || options.drives.contains(&drive.name) {
            panels.push(Panel {
                name: drive.name.clone(),
                spec: drive.spec,
                turns_motor: drive.turns_motor,
                tracks: own,
            });
        }
    }
    Ok(panels)
}

#[cfg(test)]
mod tests;
