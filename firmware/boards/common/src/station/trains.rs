//! Trains of pulses and turning encoders: edges at exact times, as many as the loop can make.

use drivetwin_control::{Refused, Stimulus};
use drivetwin_firmware::device::{Duration, EncoderSpec, Instant, Pin};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use heapless::Vec;

use super::pins::{Pins, Signal};
use super::{Events, MOST_EDGES};

/// Number of trains that can run at the same time.
const MOST: usize = 4;

/// Edges at an input, or at both channels of an encoder.
#[derive(Clone, Copy, Debug)]
struct Train {
    /// Time of the next edge.
    due: Instant,
    /// Number of edges that are to be made.
    left: u64,
    /// Edges in a second, on average.
    rate: u64,
    course: Course,
}

/// Edges of a train.
#[derive(Clone, Copy, Debug)]
enum Course {
    /// Pulses away from the level `rest` and back.
    Pulses {
        pin: Pin,
        rest: bool,
        /// Length of a pulse, and of the pause behind it.
        spans: [Duration; 2],
        /// Stimulus of the pin before the train, to which the pin returns.
        before: Stimulus,
    },
    /// An encoder turns; backwards if B leads.
    Turn { a: Pin, b: Pin, back: bool, span: Duration },
}

impl Course {
    fn uses(self, pin: Pin) -> bool {
        match self {
            Self::Pulses { pin: own, .. } => own == pin,
            Self::Turn { a, b, .. } => a == pin || b == pin,
        }
    }
}

/// The trains that run.
#[derive(Debug, Default)]
pub(crate) struct Trains(Vec<Train, MOST>);

impl Trains {
    /// Returns true if a train runs at a pin.
    pub(crate) fn runs(&self, pin: Pin) -> bool {
        self.0.iter().any(|train| train.course.uses(pin))
    }

    /// Ends the trains at a pin.
    pub(crate) fn end(&mut self, pin: Pin) {
        self.0.retain(|train| !train.course.uses(pin));
    }

    /// Begins a train of pulses at `at`. `count` is at least 1, and `high` is between 0 and `period`.
    ///
    /// # Errors
    /// A train drives the pin already, or the board cannot make so many edges.
    pub(crate) fn pulse(
        &mut self,
        at: Instant,
        pins: &Pins,
        pin: Pin,
        count: u32,
        (period, high): (Duration, Duration),
    ) -> Result<(), Refused> {
        let (rest, before) = (pins.is_high(pin), pins.stimulus(pin));
        let course = Course::Pulses { pin, rest, spans: [high, period - high], before };
        self.begin(at, course, 2 * u64::from(count), 2 * TICKS_PER_SECOND / period.ticks().max(1))
    }

    /// Begins to turn an encoder at `at`. `counts` is not 0.
    ///
    /// # Errors
    /// A train drives A or B already, or the board cannot make so many edges.
    pub(crate) fn turn(
        &mut self,
        at: Instant,
        spec: &EncoderSpec,
        counts: i32,
        span: Duration,
    ) -> Result<(), Refused> {
        let course = Course::Turn { a: spec.a, b: spec.b, back: counts < 0, span };
        self.begin(at, course, counts.unsigned_abs().into(), TICKS_PER_SECOND / span.ticks().max(1))
    }

    fn begin(&mut self, due: Instant, course: Course, left: u64, rate: u64) -> Result<(), Refused> {
        let is_driven = match course {
            Course::Pulses { pin, .. } => self.runs(pin),
            Course::Turn { a, b, .. } => self.runs(a) || self.runs(b),
        };
        if is_driven {
            return Err(Refused::Driven);
        }
        let all = self.0.iter().fold(rate, |all, train| all + train.rate);
        if all > MOST_EDGES {
            return Err(Refused::TooFast);
        }
        self.0.push(Train { due, left, rate, course }).map_err(|_| Refused::TooFast)
    }

    /// Time of the next edge.
    pub(crate) fn due(&self) -> Instant {
        self.0.iter().map(|train| train.due).min().unwrap_or(Instant::NEVER)
    }

    /// Makes the next edge, which is due, and queues its events for the drive.
    pub(crate) fn make(&mut self, pins: &mut Pins, events: &mut Events) {
        let due = self.due();
        let Some(place) = self.0.iter().position(|train| train.due == due) else { return };
        let Some(train) = self.0.get_mut(place) else { return };
        train.left = train.left.saturating_sub(1);
        let is_over = train.left == 0;
        match train.course {
            Course::Pulses { pin, rest, spans: [pulse, pause], before } => {
                // An even number of edges is left at the end of each pulse.
                let ends = train.left.is_multiple_of(2);
                train.due += if ends { pause } else { pulse };
                events.push(due, pins.drive(pin, level(rest == ends)));
                if is_over {
                    events.push(due, pins.drive(pin, before));
                }
            }
            Course::Turn { a, b, back, span } => {
                train.due += span;
                // A drive that distinguishes an open contact would miss the first edges.
                for pin in [a, b] {
                    if pins.seen(pin) == Signal::Open {
                        events.push(due, pins.drive(pin, Stimulus::High));
                    }
                }
                // If A leads, A changes while A and B have the same level.
                let pin = if (pins.is_high(a) == pins.is_high(b)) == back { b } else { a };
                events.push(due, pins.drive(pin, level(!pins.is_high(pin))));
            }
        }
        self.0.retain(|train| train.left > 0);
    }
}

fn level(high: bool) -> Stimulus {
    if high { Stimulus::High } else { Stimulus::Low }
}
