//! EE = 1: what the motor does is compared with what its encoder says (MC 7.3.7, 5-18, 5-56, 5-68 to 5-70, 9.6).

use super::Motion;
use super::orders::{Activity, Move};
use super::scale::Scale;
use crate::device::{Context, Duration, Instant, Plan};
use crate::mdrive::error::Error;
use crate::motion::Limits;

/// "After failing 3 attempts Error 92 will be generated" (MC 9.6).
const ATTEMPTS: u8 = 3;

/// Period at which a shaft that its load turns is looked at.
const LOOK: Duration = Duration::millis(1);

/// End of a move.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Verdict {
    InPosition,
    /// Being corrected.
    Corrected,
    /// Off the target, and stays so.
    Off,
}

/// Comparison of plan and encoder.
#[derive(Clone, Debug)]
pub(super) struct Closed {
    /// Plan and encoder when a motion began, or since, and their difference there: steps times [`Scale::counts`] less
    /// counts times [`Scale::steps`].
    steps: i32,
    counts: i32,
    apart: i64,
    /// Time at which it is SF counts behind, if the encoder counts no more until then.
    pub(super) due: Instant,
    /// True once it stalled in this motion.
    stalled: bool,
    /// ST.
    pub(super) has_stalled: bool,
    /// Count at which the encoder is to be kept.
    aim: Option<i32>,
}

impl Closed {
    pub(super) const NEW: Self = Self {
        steps: 0,
        counts: 0,
        apart: 0,
        due: Instant::NEVER,
        stalled: false,
        has_stalled: false,
        aim: None,
    };

    /// Following error: encoder behind the plan.
    fn apart(&self, scale: Scale, steps: i32, counts: i32) -> i64 {
        let (steps, counts) = (steps.wrapping_sub(self.steps), counts.wrapping_sub(self.counts));
        self.apart + i64::from(steps) * scale.counts - i64::from(counts) * scale.steps
    }

    /// The same, reckoned from here.
    pub(super) fn rebase(&mut self, scale: Scale, steps: i32, counts: i32) {
        self.apart = self.apart(scale, steps, counts);
        (self.steps, self.counts) = (steps, counts);
    }
}

impl Motion {
    /// A motion begins: from here plan and encoder are compared.
    pub(super) fn watch_from(&mut self, at: Instant) {
        self.closed.steps = self.motor.position(at);
        self.closed.counts = self.encoder.count(at, &self.motor);
        (self.closed.apart, self.closed.stalled) = (0, false);
    }

    fn apart(&self, at: Instant) -> i64 {
        let count = self.encoder.count(at, &self.motor);
        self.closed.apart(self.settings.scale(), self.motor.position(at), count)
    }

    /// Following error that is a stall.
    fn stalls_at(&self) -> i64 {
        i64::from(self.settings.stall_factor.max(1)) * self.settings.scale().steps
    }

    /// Returns whether stalls are detected.
    fn watches(&self) -> bool {
        self.settings.closed && !self.stands() && !self.closed.stalled
    }

    /// PM, while the bridge is on.
    fn maintains(&self) -> bool {
        self.settings.closed && self.settings.maintains && self.settings.enabled
    }

    /// Instant at which the load turns a shaft that PM keeps in DB out of it.
    fn leaves_deadband(&self, at: Instant) -> Instant {
        let Some(aim) = self.closed.aim.filter(|_| self.maintains() && self.activity == Activity::Rest)
        else {
            return Instant::NEVER;
        };
        let off = i32::from(self.settings.deadband) + 1;
        let reaches = |count| self.encoder.reaches(at, &self.motor, count);
        reaches(aim.wrapping_add(off)).min(reaches(aim.wrapping_sub(off)))
    }

    /// Looks when the encoder will be too far behind. A shaft that follows is not; a remote encoder that counts is
    /// looked at again only then.
    pub(super) fn watch(&mut self, at: Instant) {
        self.closed.due = self.leaves_deadband(at);
        let follows = self.motor.follows() && !self.motor.is_too_fast();
        if !self.watches() || !self.encoder.is_remote() && follows {
            return;
        }
        let (apart, most) = (self.apart(at), self.stalls_at());
        if apart.abs() >= most {
            self.closed.due = at;
            return;
        }
        if self.motor.slides() {
            self.closed.due = at + LOOK;
        }
        let (here, counts) = (self.motor.position(at), self.settings.scale().counts);
        let up = |way: i64| way.checked_add(counts - 1)?.checked_div(counts);
        for way in [up(most - apart), up(most + apart).map(|way| -way)] {
            if let Some(way) = way.and_then(|way| i32::try_from(way).ok()) {
                let due = self.motor.plan().when(at, here.wrapping_add(way));
                self.closed.due = self.closed.due.min(due);
            }
        }
    }

    /// The encoder may have counted.
    pub(super) fn counted(&mut self, at: Instant, out: &mut dyn Context) {
        self.look_for_stall(at, out);
        self.maintain(at, out);
    }

    /// With SM 1 the field turns on after a stall. Once the shaft is in step again it can stall again.
    fn recover(&mut self, at: Instant) {
        let goes_on = self.closed.stalled && self.settings.goes_on_stalled && !self.stands();
        if goes_on && !self.encoder.is_remote() && self.motor.is_in_step(at) {
            self.watch_from(at);
        }
    }

    /// Tells of a stall, and stops it unless SM says no.
    pub(super) fn look_for_stall(&mut self, at: Instant, out: &mut dyn Context) {
        self.recover(at);
        if !self.watches() || self.apart(at).abs() < self.stalls_at() {
            return;
        }
        self.tell_stall();
        if !self.settings.goes_on_stalled {
            self.forget_what_waits();
            self.stand(at, out);
        }
    }

    fn tell_stall(&mut self) {
        self.closed.stalled = true;
        self.closed.has_stalled = true;
        self.fail(Error::Stall);
    }

    /// Counts from where it is to be, `None` if that is within DB.
    fn off(&self, at: Instant, aim: i32) -> Option<i32> {
        let off = aim.wrapping_sub(self.encoder.count(at, &self.motor));
        (off.unsigned_abs() > u32::from(self.settings.deadband)).then_some(off)
    }

    /// Judges the end of a move. With EE = 1 its aim is kept from then on.
    pub(super) fn judge(&mut self, at: Instant, way: Move, out: &mut dyn Context) -> Verdict {
        let Some(aim) = way.aim.filter(|_| self.settings.closed) else { return Verdict::InPosition };
        self.closed.aim = Some(aim);
        match self.off(at, aim) {
            Some(_) if way.tries >= ATTEMPTS => {
                self.fail(Error::PositionError);
                self.closed.aim = None;
                Verdict::Off
            }
            Some(off) if self.correct(at, way, off, out) => Verdict::Corrected,
            Some(_) => Verdict::Off,
            None => Verdict::InPosition,
        }
    }

    /// Goes back at VI (MC 5-56); whether it does.
    fn correct(&mut self, at: Instant, way: Move, off: i32, out: &mut dyn Context) -> bool {
        let Some(steps) = self.steps_of(self.counts(at), off) else { return false };
        if self.is_barred(off < 0) {
            self.fail_at_limit(off < 0);
            self.closed.aim = None;
            return false;
        }
        let rates = self.settings.rates();
        let from = self.motor.position(at);
        let rates = Limits { speed: rates.start, ..rates };
        self.go(at, Plan::profile(at, from, steps, rates), out);
        let way = Move { target: from.wrapping_add(steps), tries: way.tries + 1, ..way };
        self.enter(Activity::Moves(way), self.motor.plan().end());
        true
    }

    /// Lets PM keep the present position from now on.
    pub(super) fn keep(&mut self, at: Instant) {
        self.closed.aim = self.settings.closed.then(|| self.encoder.count(at, &self.motor));
    }

    /// PM: brings back what stands and was forced out of DB, if that is no stall or SM lets it go on (MC 5-56). Without
    /// the bridge it waits.
    pub(super) fn maintain(&mut self, at: Instant, out: &mut dyn Context) {
        let (Activity::Rest, true, Some(aim)) = (self.activity, self.maintains(), self.closed.aim) else {
            return;
        };
        let Some(off) = self.off(at, aim) else { return };
        let stalls_at = u32::from(self.settings.stall_factor.max(1));
        if !self.settings.goes_on_stalled && off.unsigned_abs() >= stalls_at {
            self.tell_stall();
            self.closed.aim = None;
            return;
        }
        self.correct(at, Move::back_to(aim), off, out);
    }
}
