//! Contents of the recording of a bench: pulses, motion over time, tracks of a picture.

use std::io::{self, Write};

use drivetwin_firmware::device::{Axis, Duration, Instant};
use drivetwin_sim::bench::{Bench, DriveId};
use drivetwin_sim::decode::Mark;
use drivetwin_sim::export;
use drivetwin_sim::export::plot::{self, Edge, Exchange, Options, Panel, Shape, Words, exchanges};
use drivetwin_sim::record::trace::Trace;
use drivetwin_sim::signals::history;
use drivetwin_sim::signals::motion::Motion;
use drivetwin_sim::signals::pulses::Pulse;
use drivetwin_sim::signals::waveforms::{Kind, Track, Variable};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::{Error, wrong};
use crate::shared::seconds;

/// Greatest number of samples of a history, and of pulses.
pub(crate) const MOST: usize = 10_000_000;

/// Greatest number of bytes of waveforms: a minute of fast step pulses.
const MOST_WAVEFORMS: usize = 256 << 20;

/// Number of instants of a picture between two looks for Ctrl-C.
const INSTANTS: u32 = 1 << 16;

/// A pulse: time in s, and +1 forward or -1 backward.
pub(crate) type PulseRow = (f64, i8);

/// A sample of a motion: time in s, position in steps or counts, speed per second.
pub(crate) type MotionRow = (f64, i32, f64);

/// The pulses of a drive since its last power-on, at most one more than [`MOST`]; `None` if the recording does not have
/// them all.
pub(crate) fn pulses(bench: &Bench, drive: DriveId) -> Option<Vec<PulseRow>> {
    let row = |pulse: Pulse| (seconds(pulse.rise), if pulse.forward { 1 } else { -1 });
    Some(bench.pulses_since_power_on(drive.step())?.map(row).take(MOST + 1).collect())
}

/// The motion of a drive's first axis over time, with a sample each `every` while it moves; `None` if there were too many.
pub(crate) fn motion(bench: &Bench, drive: DriveId, every: Duration) -> Option<Vec<MotionRow>> {
    let (now, trace) = (bench.now(), bench.trace());
    let index = trace.drives.iter().position(|of| of.name == bench.name(drive))?;
    let samples = history::history(trace, index, Axis(0), now, every, MOST)?;
    let row = |(at, is): &(Instant, Motion)| (seconds(*at), is.position, is.speed.to_num());
    let mut rows: Vec<MotionRow> = samples.iter().map(row).collect();
    rows.dedup();
    Some(rows)
}

/// Rows as a structured array where numpy is installed, else as a list of tuples. `bytes` appends the fields of a row, in the
/// order of the array's type.
pub(crate) fn rows<'py, Row>(
    py: Python<'py>,
    rows: Vec<Row>,
    fields: Vec<(&str, &str)>,
    bytes: impl Fn(&Row, &mut Vec<u8>) + Sync,
) -> PyResult<Bound<'py, PyAny>>
where
    Row: Sync,
    Vec<Row>: IntoPyObject<'py, Target = PyAny, Output = Bound<'py, PyAny>, Error = PyErr>,
{
    let Ok(numpy) = py.import("numpy") else { return rows.into_pyobject(py) };
    let all = py.detach(|| {
        let mut all = Vec::new();
        rows.iter().for_each(|row| bytes(row, &mut all));
        all
    });
    let array = numpy.call_method1("frombuffer", (PyBytes::new(py, &all), fields))?;
    array.call_method0("copy")
}

/// Begin and end of a message in s.
type Time = (f64, f64);

/// A message to a drive with its answer: their times, their words, and the mark of the outcome.
type ExchangeRow = (Option<Time>, Option<Time>, String, &'static str);

/// A track of a picture: name, type, and what it shows.
#[derive(IntoPyObject)]
pub(crate) struct TrackView {
    name: String,
    kind: &'static str,
    /// Points of a curve; None where it is unknown from then on.
    curve: Vec<(f64, Option<f64>)>,
    /// Changes of a level: time in s, true if there are many at once, level.
    edges: Vec<(f64, bool, char)>,
    exchanges: Vec<ExchangeRow>,
}

/// The tracks of a drive in a picture.
#[derive(IntoPyObject)]
pub(crate) struct PanelView {
    name: String,
    product: &'static str,
    /// Unit of positions.
    unit: &'static str,
    tracks: Vec<TrackView>,
}

/// A copy of the recording of a bench, with the outcomes of messages. Calls that take long work on a copy, so that the bench
/// is free and Ctrl-C interrupts.
pub(crate) fn copy(bench: &Bench) -> Trace {
    let mut trace = bench.trace().clone();
    trace.add_outcomes(bench.outcomes());
    trace
}

/// The waveforms in a trace as a VCD file.
pub(crate) fn vcd(py: Python<'_>, trace: &Trace) -> PyResult<Vec<u8>> {
    let mut file = Waveforms(Vec::new());
    py.detach(|| export::vcd::write(trace, &mut file))?;
    Ok(file.0)
}

/// A VCD file in memory.
struct Waveforms(Vec<u8>);

impl Write for Waveforms {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Python::attach(|py| py.check_signals())?;
        if self.0.len() + bytes.len() > MOST_WAVEFORMS {
            let most = MOST_WAVEFORMS >> 20;
            return Err(Error::new_err(format!(
                "the waveforms have more than {most} MiB; bench.plot(start=, end=) shows a part of the time"
            ))
            .into());
        }
        self.0.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The tracks of drives in a trace, from and to a time in s.
pub(crate) fn panels(py: Python<'_>, trace: &Trace, options: &Options) -> PyResult<Vec<PanelView>> {
    let (mut instants, mut interrupted) = (0_u32, None);
    let panels = py.detach(|| {
        plot::panels(trace, options, || {
            instants = instants.wrapping_add(1);
            if instants.is_multiple_of(INSTANTS)
                && let Err(raised) = Python::attach(|py| py.check_signals())
            {
                interrupted = Some(raised);
                return Err(io::ErrorKind::Interrupted.into());
            }
            Ok(())
        })
    });
    if let Some(raised) = interrupted {
        return Err(raised);
    }
    let view = |panel: Panel| PanelView {
        name: panel.name,
        product: panel.spec.product,
        unit: if panel.turns_motor { "counts" } else { "steps" },
        tracks: tracks(panel.tracks),
    };
    let panels = panels.map_err(|sentence| wrong(&sentence))?;
    Ok(panels.into_iter().map(view).collect())
}

/// The tracks that have something to show. The messages of a port and its answers are one track.
fn tracks(all: Vec<(Variable, Shape)>) -> Vec<TrackView> {
    let mut views = Vec::new();
    let mut all = all.into_iter().peekable();
    while let Some((variable, shape)) = all.next() {
        if let Shape::Messages(received) = &shape {
            let Some((_, Shape::Messages(sent))) = all.next_if(|(next, _)| next.kind == Kind::Sent) else {
                continue;
            };
            let exchanges: Vec<ExchangeRow> = exchanges(received, &sent).iter().map(exchange).collect();
            if !exchanges.is_empty() {
                let name = variable.name.trim_end_matches("_rx").to_owned();
                views.push(TrackView { exchanges, ..TrackView::new(name, "frames") });
            }
        } else if shape.is_alive() {
            views.push(track(variable, shape));
        }
    }
    views
}

impl TrackView {
    fn new(name: String, kind: &'static str) -> Self {
        Self { name, kind, curve: Vec::new(), edges: Vec::new(), exchanges: Vec::new() }
    }
}

fn track(variable: Variable, shape: Shape) -> TrackView {
    let kind = match variable.kind {
        Kind::Level => "level",
        Kind::Volts => "volts",
        Kind::Track(Track::Position) => "position",
        Kind::Track(Track::Speed) => "speed",
        Kind::Track(Track::Current) => "current",
        Kind::Track(Track::Duty) => "duty",
        Kind::Received | Kind::Sent => "frames",
    };
    let mut view = TrackView::new(variable.name, kind);
    match shape {
        Shape::Curve(points) => {
            view.curve = points.into_iter().map(|(at, value)| (seconds(at), value)).collect();
        }
        Shape::Levels(edges) => {
            let edge = |Edge { at, many, level }| (seconds(at), many, level);
            view.edges = edges.into_iter().map(edge).collect();
        }
        Shape::Messages(_) => {}
    }
    view
}

fn exchange(exchange: &Exchange<'_>) -> ExchangeRow {
    let mark = match exchange.mark() {
        Mark::Done => "done",
        Mark::Refused => "refused",
        Mark::WithoutEffect => "without effect",
        Mark::NotReceived => "not received",
        Mark::ByFault => "by fault",
    };
    let time = |words: &Words| (seconds(words.begin), seconds(words.end));
    (exchange.received.map(time), exchange.sent.map(time), exchange.text(), mark)
}
