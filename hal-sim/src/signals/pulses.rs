//! Step pulses: the motion of an axis as edges of its STEP and DIR pins.
//!
//! The steps of a plan are computed one step ahead ([`StepIterator`]), because the width of a pulse depends
//! on the next step. STEP rises at each step and is high for 2 µs, or for half the interval to the next step
//! if that is shorter. DIR is high for forward. It changes 5 µs before the first step of a reversal, or half
//! the interval before it if that is shorter, but not while a pulse is high, and not before the step is
//! planned. Steps without a plan are made at once, at most one every 4 µs; closer steps are delayed. A step
//! that reverses DIR follows the change of DIR by 2 µs.
//!
//! STEP and DIR may also serve other purposes: if the drive outputs a level or wave at such a pin, the axis
//! lends the pin to it, and the next plan takes the pin back. The pin is then low until the first step of the
//! plan.
//!
//! This module has no clock: the caller passes the time.

use drivetwin_firmware::device::{Axis, Duration, Instant, Level, Pin, Plan};
use drivetwin_firmware::motion::{CYCLE, DIR_SETUP, HIGH, SETUP, Step, StepIterator};

use crate::record::trace::{Event, InputRecord, OutputRecord, Power, Trace};

/// An output of an axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum StepDir {
    /// Rises at each step.
    Step,
    /// High while the axis goes forward.
    Dir,
}

impl StepDir {
    /// The output at a pin, if the pin is `step` or `dir`.
    pub(crate) fn at((step, dir): (Pin, Pin), pin: Pin) -> Option<Self> {
        match pin {
            _ if pin == step => Some(Self::Step),
            _ if pin == dir => Some(Self::Dir),
            _ => None,
        }
    }
}

/// Outputs that the drive uses for another purpose now.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lent {
    pub(crate) step: bool,
    pub(crate) dir: bool,
}

impl Lent {
    /// Returns true if that output is lent.
    pub(crate) fn has(self, output: StepDir) -> bool {
        match output {
            StepDir::Step => self.step,
            StepDir::Dir => self.dir,
        }
    }

    pub(crate) fn add(&mut self, output: StepDir) {
        match output {
            StepDir::Step => self.step = true,
            StepDir::Dir => self.dir = true,
        }
    }
}

/// A change of STEP or DIR.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Edge {
    /// Time of the edge.
    pub(crate) at: Instant,
    /// Output of the edge.
    pub(crate) output: StepDir,
    /// Level after the edge: true for high.
    pub(crate) high: bool,
}

/// A pulse on a STEP output, returned by [`Bench::pulses`](crate::bench::Bench::pulses).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Pulse {
    /// Start of the pulse: the instant of the step.
    pub rise: Instant,
    /// End of the pulse: the falling edge.
    pub fall: Instant,
    /// True if DIR was high at the rising edge: a forward step.
    pub forward: bool,
}

/// Generates the pulses of one axis.
///
/// The caller passes changes of the axis in the order of time. Before each change it must [take](Self::take)
/// all edges up to the time of the change: an edge at the same instant comes before the change.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shaper {
    walker: Option<StepIterator>,
    /// The next step of the plan.
    planned: Option<Step>,
    /// Steps without a plan that are still to be made, signed.
    direct: i32,
    /// Last rising edge of STEP.
    rose: Option<Instant>,
    /// Time from which a step without a plan may follow the last change of DIR: `DIR_SETUP` after it.
    settled: Instant,
    /// Time of the last edge or change; no edge is earlier.
    since: Instant,
    powered: bool,
    step: bool,
    dir: bool,
}

impl Shaper {
    /// Pulses from `at` on, for an axis that follows `plan`. `dir` is true if its last step was forward.
    pub(crate) fn new(at: Instant, plan: &Plan, dir: bool) -> Self {
        let mut shaper = Self { dir, ..Self::default() };
        shaper.plan(at, plan, Lent::default());
        shaper
    }

    /// Follows `plan` from `at` on. A pulse that is high now still falls. Outputs in `lent` are low.
    pub(crate) fn plan(&mut self, at: Instant, plan: &Plan, lent: Lent) {
        (self.step, self.dir) = (self.step && !lent.step, self.dir && !lent.dir);
        let walker = self.walker.insert(StepIterator::new(plan, at));
        self.planned = walker.next();
        (self.since, self.powered) = (at, true);
    }

    /// Adds steps without a plan; negative steps go backward.
    pub(crate) fn steps(&mut self, at: Instant, steps: i32) {
        self.direct = self.direct.saturating_add(steps);
        (self.since, self.powered) = (at, true);
    }

    /// Switches power off: both outputs fall, and there are no more edges.
    pub(crate) fn power_off(&mut self, at: Instant) {
        *self = Self { since: at, step: self.step, dir: self.dir, ..Self::default() };
    }

    /// Returns true if an output is high.
    pub(crate) fn is_high(&self, output: StepDir) -> bool {
        match output {
            StepDir::Step => self.step,
            StepDir::Dir => self.dir,
        }
    }

    /// Time of the next edge if the axis does not change; [`Instant::NEVER`] if there is none.
    pub(crate) fn due(&self) -> Instant {
        self.next().map_or(Instant::NEVER, |edge| edge.at)
    }

    /// Takes the next edge, if it is due by `until`.
    pub(crate) fn take(&mut self, until: Instant) -> Option<Edge> {
        let edge = self.next().filter(|edge| edge.at <= until)?;
        self.since = edge.at;
        match edge.output {
            StepDir::Dir => (self.dir, self.settled) = (edge.high, edge.at + DIR_SETUP),
            StepDir::Step => self.step = edge.high,
        }
        if edge.output == StepDir::Step && edge.high {
            if self.plan_is_next() {
                self.planned = self.walker.as_mut().and_then(StepIterator::next);
            } else {
                self.direct -= self.direct.signum();
            }
            self.rose = Some(edge.at);
        }
        Some(edge)
    }

    fn next(&self) -> Option<Edge> {
        let edge = |at: Instant, output, high| Some(Edge { at: at.max(self.since), output, high });
        let step = self.next_step();
        let half = |step: Step| match self.rose {
            Some(rose) => Duration::from_ticks(step.at.since(rose).ticks() / 2),
            None => Duration::FOREVER,
        };
        match step {
            _ if self.step => {
                // A pulse is at least one tick long.
                let high = step.map_or(HIGH, |step| HIGH.min(half(step)).max(Duration::TICK));
                edge(self.rose.map_or(self.since, |rose| rose + high), StepDir::Step, false)
            }
            Some(step) if step.forward != self.dir => {
                edge(step.at - SETUP.min(half(step)), StepDir::Dir, step.forward)
            }
            Some(step) => edge(step.at, StepDir::Step, true),
            None if self.dir && !self.powered => edge(self.since, StepDir::Dir, false),
            None => None,
        }
    }

    fn next_step(&self) -> Option<Step> {
        if self.plan_is_next() { self.planned } else { self.next_direct() }
    }

    /// The next step without a plan.
    fn next_direct(&self) -> Option<Step> {
        let forward = self.direct > 0;
        let settled = if forward == self.dir { self.settled } else { self.since + DIR_SETUP };
        let at = self.rose.map_or(self.since, |rose| self.since.max(rose + CYCLE)).max(settled);
        (self.direct != 0).then_some(Step { at, forward })
    }

    /// Returns true if the next step is one of the plan.
    fn plan_is_next(&self) -> bool {
        match (self.planned, self.next_direct()) {
            (Some(planned), Some(direct)) => planned.at <= direct.at,
            (planned, _) => planned.is_some(),
        }
    }
}

/// The edges of an axis in a trace from `from`, when it stands, up to `until`, in the order of time.
fn edges(trace: &Trace, drive: usize, axis: Axis, from: Instant, until: Instant) -> Edges<'_> {
    let spec = trace.drives.get(drive).and_then(|drive| drive.spec.axes.get(usize::from(axis.0)));
    let pins = spec.and_then(|axis| axis.step_dir);
    let is_within = move |at| from <= at && at <= until;
    let news = trace.events().filter(move |entry| entry.drive == drive && is_within(entry.at));
    let news = news.filter_map(move |entry| Some((entry.at, News::of(&entry.event, axis, pins)?)));
    Edges { news: Box::new(news), next: None, shaper: Shaper::default(), lent: Lent::default(), until }
}

/// Iterator that [`edges`] returns.
struct Edges<'a> {
    news: Box<dyn Iterator<Item = (Instant, News<'a>)> + 'a>,
    /// Next change of the axis; the edges up to its time are returned first.
    next: Option<(Instant, News<'a>)>,
    shaper: Shaper,
    /// Outputs that the drive uses for other purposes now.
    lent: Lent,
    until: Instant,
}

/// Change of an axis.
#[derive(Clone, Copy)]
enum News<'a> {
    Plan(&'a Plan),
    Steps(i32),
    /// The drive uses an output for another purpose; true if its level is high at first.
    Lent(StepDir, bool),
    PowerOff,
}

impl<'a> News<'a> {
    fn of(event: &'a Event, axis: Axis, pins: Option<(Pin, Pin)>) -> Option<Self> {
        let output = |pin| pins.and_then(|pins| StepDir::at(pins, pin));
        match event {
            Event::Output(OutputRecord::Plan { axis: of, plan }) if *of == axis => Some(Self::Plan(plan)),
            Event::Output(OutputRecord::Step { axis: of, steps }) if *of == axis => Some(Self::Steps(*steps)),
            Event::Output(OutputRecord::Level { pin, level }) => {
                Some(Self::Lent(output(*pin)?, *level == Level::High))
            }
            Event::Output(OutputRecord::Wave { pin, .. }) => Some(Self::Lent(output(*pin)?, true)),
            Event::Output(OutputRecord::PowerOff) | Event::Input(InputRecord::Power(Power::Off)) => {
                Some(Self::PowerOff)
            }
            _ => None,
        }
    }
}

impl Edges<'_> {
    /// Time of the falling edge of a pulse that is still high at the end.
    fn due(&self) -> Instant {
        self.shaper.due()
    }
}

impl Iterator for Edges<'_> {
    type Item = Edge;

    fn next(&mut self) -> Option<Edge> {
        loop {
            self.next = self.next.take().or_else(|| self.news.next());
            let until = self.next.map_or(self.until, |(at, _)| at);
            while let Some(edge) = self.shaper.take(until) {
                if !self.lent.has(edge.output) {
                    return Some(edge);
                }
            }
            let (at, news) = self.next.take()?;
            match news {
                News::Plan(plan) => {
                    let lent = std::mem::take(&mut self.lent);
                    self.shaper.plan(at, plan, lent);
                    if lent.dir {
                        return Some(Edge { at, output: StepDir::Dir, high: false });
                    }
                }
                News::Steps(steps) => self.shaper.steps(at, steps),
                News::Lent(output, high) => {
                    let cut = self.shaper.is_high(output) && !self.lent.has(output);
                    self.lent.add(output);
                    match output {
                        StepDir::Dir => return Some(Edge { at, output, high }),
                        StepDir::Step if cut => return Some(Edge { at, output, high: false }),
                        StepDir::Step => {}
                    }
                }
                News::PowerOff => self.shaper.power_off(at),
            }
        }
    }
}

/// The pulses of an axis in a trace that rise from `from` up to `until`, in the order of time. `drive` is an index in
/// [`Trace::drives`]. `from` is the beginning of the trace, or a power-on: the axis then has no plan.
///
/// The pulses are complete only if the trace is: all events are retained, and none is [lost](Trace::lost). A
/// trace that was read from text has only the courses of plans, not the plans themselves; replay it first.
pub fn pulses(
    trace: &Trace,
    drive: usize,
    axis: Axis,
    from: Instant,
    until: Instant,
) -> impl Iterator<Item = Pulse> {
    let mut edges = edges(trace, drive, axis, from, until);
    let (mut forward, mut rise) = (false, None);
    std::iter::from_fn(move || {
        loop {
            match edges.next() {
                Some(Edge { output: StepDir::Dir, high, .. }) => forward = high,
                Some(Edge { output: StepDir::Step, high: true, at }) => rise = Some(at),
                Some(Edge { output: StepDir::Step, high: false, at: fall }) => {
                    return rise.take().map(|rise| Pulse { rise, fall, forward });
                }
                None => return rise.take().map(|rise| Pulse { rise, fall: edges.due(), forward }),
            }
        }
    })
}

#[cfg(test)]
mod tests;
