//! Axes of a drive: their commands and their step pulses.

use drivetwin_firmware::device::{AxisSpec, Duration, Instant, Level, Pin, PinSpec, Plan, Role};
use drivetwin_firmware::motion::HIGH;

use crate::signals::motion::{Commanded, Sampler};
use crate::signals::pin_waveform::level_of;
use crate::signals::pulses::{Lent, Shaper, StepDir};
use crate::slot::MotorCommand;

/// State of an axis.
pub(crate) struct AxisState {
    step_dir: Option<(Pin, Pin)>,
    pub(super) commanded: Commanded,
    /// Chooses the states of a motor that are recorded.
    pub(crate) sampler: Sampler,
    /// True if the last step before the plan was forward.
    forward: bool,
    /// Direction of the last step that the drive has made without a plan, true if forward; `None` if it has made no
    /// such step since the last plan.
    stepped: Option<bool>,
    /// True once the drive has set a current.
    pub(super) reports_current: bool,
    /// True if a motor of the bench is attached.
    pub(super) turns_motor: bool,
    /// Generates the pulses for wires; `None` if no wire needs them.
    pub(super) shaper: Option<Box<Shaper>>,
    /// Pulses from the start of the plan on, if a pulse of the previous plan was unfinished then. Used only
    /// without a wire.
    unfinished: Option<Box<Shaper>>,
    /// Number of predictions of the next edge so far.
    changes: u32,
    /// Outputs STEP and DIR that the drive also uses for other purposes.
    shared: Lent,
    /// The outputs of `shared` that the drive uses for other purposes now.
    lent: Lent,
}

/// Advances the pulses over all edges up to `at`.
fn taken(mut shaper: Shaper, at: Instant) -> Shaper {
    while shaper.take(at).is_some() {}
    shaper
}

impl AxisState {
    pub(super) fn new(spec: &AxisSpec, pins: &[PinSpec]) -> Self {
        let is_shared = |pin: Pin| pins.get(usize::from(pin.0)).is_some_and(|pin| pin.role == Role::Both);
        let shared = spec.step_dir.map(|(step, dir)| Lent { step: is_shared(step), dir: is_shared(dir) });
        let shared = shared.unwrap_or_default();
        Self {
            step_dir: spec.step_dir,
            commanded: Commanded::at_rest(Instant::ZERO),
            sampler: Sampler::default(),
            forward: false,
            stepped: None,
            reports_current: false,
            turns_motor: false,
            shaper: None,
            unfinished: None,
            changes: 0,
            shared,
            lent: shared,
        }
    }

    pub(super) fn power_on(&mut self, at: Instant) {
        (self.commanded, self.sampler) = (Commanded::at_rest(at), Sampler::default());
        (self.forward, self.stepped) = (false, None);
    }

    pub(super) fn power_off(&mut self, at: Instant) {
        if let Some(shaper) = &mut self.shaper {
            shaper.power_off(at);
        }
        self.commanded.power_off(at);
        self.unfinished = None;
        // Without power DIR is low, so the last direction counts as backward.
        self.stepped = Some(false);
    }

    /// Follows `plan` from `at` on. The axis takes all lent outputs back.
    pub(super) fn follow(&mut self, at: Instant, plan: &Plan) {
        let lent = std::mem::take(&mut self.lent);
        if let Some(shaper) = &mut self.shaper {
            shaper.plan(at, plan, lent);
        } else {
            let mut shaper = self.recent_pulses(at, true);
            self.unfinished = (!lent.step && shaper.is_high(StepDir::Step)).then(|| {
                shaper.plan(at, plan, lent);
                Box::new(shaper)
            });
        }
        self.forward = self.forward_at(at) && !lent.dir;
        self.commanded.follow(plan);
        self.stepped = None;
    }

    /// Lends an output to the drive until the next plan. Returns false if the output is not shared, so that
    /// the axis keeps it.
    pub(super) fn lend(&mut self, output: StepDir) -> bool {
        let is_shared = self.shared.has(output);
        if is_shared {
            self.lent.add(output);
        }
        is_shared
    }

    /// The pins that are lent to the drive.
    pub(super) fn lent(&self) -> impl Iterator<Item = Pin> + use<> {
        let lent = self.lent;
        let pins = self.step_dir.map(|(step, dir)| [(step, StepDir::Step), (dir, StepDir::Dir)]);
        pins.into_iter().flatten().filter(move |(_, output)| lent.has(*output)).map(|(pin, _)| pin)
    }

    /// Makes steps without a plan; negative steps go backward.
    pub(super) fn step(&mut self, at: Instant, steps: i32) {
        if let Some(shaper) = &mut self.shaper {
            shaper.steps(at, steps);
        }
        self.commanded.step(steps);
        self.stepped = Some(steps > 0);
    }

    /// Commands that give a motor the present state of the axis, in the order that a drive uses: motion, then
    /// current. A current that the drive has never set is omitted: the motor of such a drive has its rated
    /// current, also without power.
    pub(super) fn motor_commands(&self) -> impl Iterator<Item = MotorCommand> + use<> {
        let Commanded { plan, current_ma, duty, .. } = self.commanded;
        let current = self.reports_current.then_some(MotorCommand::Current(current_ma));
        [MotorCommand::Plan(plan), MotorCommand::Duty(duty)].into_iter().chain(current)
    }

    /// The output at a pin: STEP or DIR; `None` for any other pin.
    pub(super) fn output(&self, pin: Pin) -> Option<StepDir> {
        StepDir::at(self.step_dir?, pin)
    }

    /// The level of STEP or DIR; `None` for any other pin, and while the output is lent.
    pub(super) fn level(&self, at: Instant, pin: Pin, powered: bool) -> Option<Level> {
        let output = self.output(pin).filter(|output| !self.lent.has(*output))?;
        let shaper = match &self.shaper {
            Some(shaper) => taken(Shaper::clone(shaper), at),
            None => self.recent_pulses(at, powered),
        };
        Some(level_of(shaper.is_high(output)))
    }

    /// The pulses after all edges up to `at`, if no wire needs earlier edges.
    fn recent_pulses(&self, at: Instant, powered: bool) -> Shaper {
        let start = self.commanded.plan.start();
        // Earlier edges have no effect, because `HIGH` is the length of the longest pulse.
        match &self.unfinished {
            Some(shaper) if at <= start + HIGH => taken(Shaper::clone(shaper), at),
            _ => taken(self.pulses(start.max(at - HIGH), powered), at),
        }
    }

    /// Generates pulses from `at` on, for a wire.
    pub(super) fn listen(&mut self, at: Instant, powered: bool) {
        if self.shaper.is_none() {
            self.shaper = Some(Box::new(self.pulses(at, powered)));
        }
    }

    /// The pulses of the plan from `at` on.
    fn pulses(&self, at: Instant, powered: bool) -> Shaper {
        if powered { Shaper::new(at, &self.commanded.plan, self.forward_at(at)) } else { Shaper::default() }
    }

    /// Time of the next edge, and a number that identifies this prediction.
    pub(super) fn next_edge(&mut self) -> Option<(Instant, u32)> {
        self.changes = self.changes.wrapping_add(1);
        Some((self.shaper.as_ref()?.due(), self.changes))
    }

    /// Takes the edge that was predicted under that number, if it is due by `until`. The level is `None`
    /// while the pin is lent.
    pub(super) fn take_edge(&mut self, number: u32, until: Instant) -> Option<(Pin, Option<Level>)> {
        if self.changes != number {
            return None;
        }
        self.take(until).map(|(pin, _, level)| (pin, level))
    }

    /// Takes the next edge, if it is due by `until`: pin, time and level. The level is `None` while the pin
    /// is lent.
    pub(super) fn take(&mut self, until: Instant) -> Option<(Pin, Instant, Option<Level>)> {
        let (step, dir) = self.step_dir?;
        let edge = self.shaper.as_mut()?.take(until)?;
        let pin = if edge.output == StepDir::Step { step } else { dir };
        Some((pin, edge.at, (!self.lent.has(edge.output)).then(|| level_of(edge.high))))
    }

    /// Returns true if the last step up to `at` was forward.
    fn forward_at(&self, at: Instant) -> bool {
        if let Some(forward) = self.stepped
            && self.commanded.plan.end() <= at
        {
            return forward;
        }
        let mut forward = self.forward;
        let (mut begin, mut from) =
            (self.commanded.plan.start(), self.commanded.plan.position_at(self.commanded.plan.start()));
        for segment in self.commanded.plan.segments() {
            let end = at.min(begin + Duration::from_ticks(segment.ticks));
            let to = self.commanded.plan.position_at(end);
            if from != to {
                forward = !segment.reverse;
            }
            (begin, from) = (end, to);
        }
        forward
    }
}
