//! Tracks of a picture: changes of variables, as far as the width of the picture shows them.

use std::io;

use drivetwin_firmware::device::{Instant, Spec};

use super::Span;
use crate::decode::Mark;
use crate::signals::motion::SAMPLE;
use crate::signals::waveforms::{Kind, Sink, Track, Value, Variable};

/// Number of columns of the time axis. A track keeps a few values for each.
pub(super) const COLUMNS: f64 = 2_000.0;

/// Maximum number of points that a curve keeps in one column of the picture. If there are more points, it keeps only
/// the first point, the last point and the extremes.
const CROWD: usize = 16;

/// The tracks of a drive.
pub struct Panel {
    /// Name of the drive.
    pub name: String,
    /// Description of the drive's kind.
    pub spec: &'static Spec,
    /// True if the axis turns a motor with Hall sensors, whose counts are its position.
    pub turns_motor: bool,
    /// Pins, motion and messages.
    pub tracks: Vec<(Variable, Shape)>,
}

/// What a track shows.
pub enum Shape {
    /// Points of a curve; `None` where the number is unknown from then on.
    Curve(Vec<(Instant, Option<f64>)>),
    /// Levels of a digital pin.
    Levels(Vec<Edge>),
    /// Messages.
    Messages(Vec<Words>),
}

/// A change of a digital pin.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Edge {
    /// Time of the first edge of the column.
    pub at: Instant,
    /// True if there is more than one edge in this column.
    pub many: bool,
    /// Level after the column's last edge: `0`, `1`, `z` or `x`.
    pub level: char,
}

/// A message.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Words {
    /// Begin of the message.
    pub begin: Instant,
    /// End of the message.
    pub end: Instant,
    /// The message in the names of the manual.
    pub text: String,
    /// The outcome of a message to the drive, if it is known.
    pub outcome: Option<(String, Mark)>,
}

impl Shape {
    fn of(kind: Kind) -> Self {
        match kind {
            Kind::Level => Self::Levels(Vec::new()),
            Kind::Volts | Kind::Track(_) => Self::Curve(Vec::new()),
            Kind::Received | Kind::Sent => Self::Messages(Vec::new()),
        }
    }

    /// Returns true if there is something to see: two different values, or a message.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        match self {
            Self::Curve(points) => {
                let mut known = points.iter().filter_map(|(_, value)| *value);
                known.next().is_some_and(|first| known.any(|value| value != first))
            }
            Self::Levels(edges) => {
                let known = edges.iter().filter(|edge| edge.level != 'x');
                let levels = known.clone().zip(known.clone().skip(1));
                known.clone().any(|edge| edge.many) || levels.into_iter().any(|(a, b)| a.level != b.level)
            }
            Self::Messages(messages) => !messages.is_empty(),
        }
    }
}

/// Collects the tracks of a drive.
pub(super) struct Collector<Pause> {
    span: Span,
    tracks: Vec<(Variable, Shape)>,
    /// State of each variable.
    states: Vec<State>,
    /// Function that is called between two instants.
    pause: Pause,
}

/// State of a variable.
#[derive(Clone, Default)]
struct State {
    /// The last value and the time of its change.
    last: Option<(Instant, Value)>,
    /// The present column, and the number of points before it.
    column: usize,
    before: usize,
}

impl<Pause> Collector<Pause> {
    pub(super) fn new(variables: &[Variable], span: Span, pause: Pause) -> Self {
        let tracks = variables.iter().map(|variable| (variable.clone(), Shape::of(variable.kind)));
        Self { span, tracks: tracks.collect(), states: vec![State::default(); variables.len()], pause }
    }

    /// The tracks, each up to the end of the span.
    pub(super) fn finish(mut self) -> Vec<(Variable, Shape)> {
        for index in 0..self.tracks.len() {
            if let Some((_, value)) = self.states[index].last.clone() {
                self.enter(index);
                self.show(index, self.span.to, &value);
            }
        }
        self.tracks
    }

    /// Shows the value that a variable has at the begin of the span.
    fn enter(&mut self, index: usize) {
        let is_empty = match &self.tracks[index].1 {
            Shape::Curve(points) => points.is_empty(),
            Shape::Levels(edges) => edges.is_empty(),
            Shape::Messages(_) => false,
        };
        if is_empty && let Some((_, value)) = self.states[index].last.clone() {
            self.show(index, self.span.from, &value);
        }
    }

    /// Shows a value from `at` on, which is in the span.
    fn show(&mut self, index: usize, at: Instant, value: &Value) {
        let column = (self.span.part(at) * COLUMNS) as usize;
        let State { last, column: present, before } = &mut self.states[index];
        let is_new = *present != column;
        *present = column;
        let (variable, shape) = &mut self.tracks[index];
        match (shape, value) {
            (Shape::Curve(points), Value::Number(value)) => {
                if is_new {
                    *before = points.len();
                }
                if let Some((since, Value::Number(held))) = last
                    && !points.is_empty()
                {
                    // A number that stays the same is not repeated. Position and speed change gradually, from
                    // one sample to the next.
                    let slopes = matches!(variable.kind, Kind::Track(Track::Position | Track::Speed));
                    let until = if slopes && at > *since + SAMPLE { at - SAMPLE } else { at };
                    if !slopes || until < at {
                        points.push((until.max(self.span.from), held.map(number)));
                    }
                }
                points.push((at, value.map(number)));
                if points.len() - *before > CROWD {
                    thin(points, *before);
                }
            }
            (Shape::Levels(edges), Value::Level(level)) => match edges.last_mut() {
                Some(edge) if !is_new => (edge.many, edge.level) = (true, *level),
                Some(edge) if edge.level == *level => {}
                _ => edges.push(Edge { at, many: false, level: *level }),
            },
            (Shape::Messages(messages), Value::Words(words)) => {
                if let Some(last) = messages.last_mut() {
                    last.end = last.end.min(at);
                }
                let outcome = words.outcome.as_ref();
                let result = outcome.map(|known| (known.text.clone(), known.mark));
                // An outcome belongs to the message that began then, which is one of the last.
                let mut last = messages.iter_mut().rev().take(8);
                if let Some(known) = outcome
                    && let Some(message) = last.find(|message| message.begin == known.begin)
                {
                    (message.text, message.outcome) = (known.request.clone(), result);
                } else if !words.text.is_empty() && at < self.span.to {
                    let text = outcome.map_or(&words.text, |known| &known.request).clone();
                    messages.push(Words { begin: at, end: self.span.to, text, outcome: result });
                }
            }
            _ => {}
        }
    }
}

/// A number of millionths.
fn number(millionths: i64) -> f64 {
    millionths as f64 / 1e6
}

/// Removes points from `from` on, except the first, the last and the extremes.
fn thin(points: &mut Vec<(Instant, Option<f64>)>, from: usize) {
    let crowd = points.split_off(from);
    let known = || crowd.iter().enumerate().filter_map(|(index, (_, value))| Some((index, (*value)?)));
    let least = known().min_by(|a, b| a.1.total_cmp(&b.1));
    let most = known().max_by(|a, b| a.1.total_cmp(&b.1));
    let mut kept = vec![0, crowd.len() - 1];
    kept.extend(least.into_iter().chain(most).map(|(index, _)| index));
    kept.sort_unstable();
    kept.dedup();
    points.extend(kept.into_iter().map(|index| crowd[index]));
}

impl<Pause: FnMut() -> io::Result<()>> Sink for Collector<Pause> {
    fn change(&mut self, at: Instant, index: usize, value: &Value) {
        if at >= self.span.from && at <= self.span.to {
            self.enter(index);
            self.show(index, at, value);
        }
        if at <= self.span.to {
            self.states[index].last = Some((at, value.clone()));
        }
    }

    fn pause(&mut self) -> io::Result<()> {
        (self.pause)()
    }
}
