//! A simulated stepper motor.
//!
//! The drive moves a magnetic field, and the shaft follows it. The shaft also follows between two steps,
//! because a drive changes its current smoothly enough from one microstep to the next. So while a plan runs,
//! the shaft is at the plan's exact phase. If the field jumps, the shaft turns evenly to the new position
//! within a millisecond at most. The field jumps at a step without a plan, and at the end of a ramp that
//! stops between two steps.
//!
//! The torque of the motor is its holding torque times the share of the rated current. It falls linearly to
//! zero at the pull-out speed. If load, friction and the acceleration of the inertia need more torque, the
//! shaft loses step and stops. It also loses step when it is held, and when the current is switched off
//! (BENCH-7).
//!
//! A shaft out of step is turned by its load. Friction resists the load. So does the whole torque of a slow
//! field, because it pulls back at every full step. The mean torque of a fast field is zero. A field is slow
//! if its torque accelerates the inertia from rest to the field's speed within two full steps, where the
//! torque changes its sign. The load turns the shaft no faster than the pull-out speed. At this speed the
//! motor generates enough to feed its drive, and brakes through the diodes of the bridge.
//!
//! A shaft that is out of step and at rest falls into step with a slow field, if the torque suffices for load
//! and friction. It does so at the nearest position of the field's torque, which repeats every four full
//! steps. A field at rest takes the shaft in the direction of the load if it cannot take it against the load.
//!
//! Not modelled: resonance, damping, the angle by which a load turns a shaft that is in step, the momentum of
//! a shaft that loses step, detent torque other than as friction.
//!
//! All positions are phases of a plan, in which a step of the drive has `STEP` units. Only the displayed
//! angle is rounded, and the origin when the size of a step changes.

use super::{Command, Kinematics, Plant, Reports};
use crate::device::{Duration, Instant, Plan};
use crate::motion::STEP;
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// The longest time in which the shaft catches up with a field that has jumped.
const CATCH_UP: Duration = Duration::millis(1);
/// The longest interval. With this limit no number here exceeds 127 bits, and no position wraps unnoticed.
const LONGEST: Duration = Duration::from_ticks(1 << 31);
/// The smallest difference that counts as a jump, in units of phase. Smaller ones occur because the speed of
/// catching up is a whole number of units per tick.
const NOTHING: i128 = 1 << 16;
/// Number of full steps after which the field's torque repeats.
const PERIOD: i64 = 4;
/// The greatest speed of the shaft, as [`MotionInterval::half_speed`]. With this limit no number here exceeds
/// 127 bits.
const FASTEST: i128 = 1 << 56;
/// Torque in µN·m that accelerates 1 g·cm² by 1 turn/s²: 2π/10, in 2⁻²⁴. Other torques here are in 1/256
/// µN·m.
const TORQUE: i128 = 10_541_437;
/// More current than any drive gives, in mA.
const MOST_MA: u32 = 1_000_000;

/// Parameters of a stepper motor and its load. A value beyond a limit has the effect of the limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StepperParameters {
    /// Full steps per turn, 4 to 10,000.
    pub steps_per_rev: u16,
    /// Torque that holds the shaft at the rated current, in µN·m, up to 100,000,000. With 0 the shaft follows
    /// under any load while there is current.
    pub holding_unm: u32,
    /// Rated peak current, which gives the holding torque, in mA, 1 to 100,000.
    pub rated_ma: u32,
    /// Pull-out speed, at which no torque is left, in rpm, 1 to 200,000. The torque falls linearly with the
    /// speed.
    pub pull_out_rpm: u32,
    /// Inertia of rotor and load, in g·cm², 1 to 10,000,000.
    pub inertia_gcm2: u32,
    /// Friction torque against any motion, in µN·m, up to 100,000,000. Without current only friction holds
    /// the shaft.
    pub friction_unm: u32,
    /// Load torque in µN·m, up to 100,000,000, positive if against forward motion.
    pub load_unm: i32,
}

impl StepperParameters {
    /// A motor of 200 steps that follows its drive under any load.
    pub const NOMINAL: Self = Self {
        steps_per_rev: 200,
        holding_unm: 0,
        rated_ma: 3_000,
        pull_out_rpm: 3_000,
        inertia_gcm2: 400,
        friction_unm: 10_000,
        load_unm: 0,
    };

    /// The lowest value of each parameter.
    pub const LEAST: Self = Self {
        steps_per_rev: 4,
        holding_unm: 0,
        rated_ma: 1,
        pull_out_rpm: 1,
        inertia_gcm2: 1,
        friction_unm: 0,
        load_unm: -100_000_000,
    };

    /// The highest value of each parameter.
    pub const MOST: Self = Self {
        steps_per_rev: 10_000,
        holding_unm: 100_000_000,
        rated_ma: 100_000,
        pull_out_rpm: 200_000,
        inertia_gcm2: 10_000_000,
        friction_unm: 100_000_000,
        load_unm: 100_000_000,
    };

    fn bounded(self) -> Self {
        let (least, most) = (Self::LEAST, Self::MOST);
        Self {
            steps_per_rev: self.steps_per_rev.clamp(least.steps_per_rev, most.steps_per_rev),
            holding_unm: self.holding_unm.clamp(least.holding_unm, most.holding_unm),
            rated_ma: self.rated_ma.clamp(least.rated_ma, most.rated_ma),
            pull_out_rpm: self.pull_out_rpm.clamp(least.pull_out_rpm, most.pull_out_rpm),
            inertia_gcm2: self.inertia_gcm2.clamp(least.inertia_gcm2, most.inertia_gcm2),
            friction_unm: self.friction_unm.clamp(least.friction_unm, most.friction_unm),
            load_unm: self.load_unm.clamp(least.load_unm, most.load_unm),
        }
    }
}

/// Motion of the shaft from an instant on. The shaft does not reverse inside an interval.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct MotionInterval {
    since: Instant,
    end: Instant,
    /// Phase at the beginning.
    from: i128,
    /// Speed and acceleration in the units of a [`Segment`](crate::motion::Segment), but signed.
    half_speed: i64,
    half_acceleration: i64,
    /// Part of `half_speed` with which the shaft catches up with the field.
    catch_up_until: i64,
}

impl MotionInterval {
    fn at_rest(since: Instant, end: Instant, phase: i128) -> Self {
        Self { since, end, from: phase, half_speed: 0, half_acceleration: 0, catch_up_until: 0 }
    }

    fn phase_at(&self, at: Instant) -> i128 {
        let d = i128::from(at.min(self.end).since(self.since).ticks());
        if self.half_speed == 0 && self.half_acceleration == 0 {
            return self.from;
        }
        self.from + d * (2 * i128::from(self.half_speed) + i128::from(self.half_acceleration) * d)
    }

    /// Half of the speed at `at`, in the units of [`Self::half_speed`].
    fn speed_at(&self, at: Instant) -> i64 {
        let d = i128::from(at.min(self.end).since(self.since).ticks());
        (i128::from(self.half_speed) + i128::from(self.half_acceleration) * d).clamp(-FASTEST, FASTEST) as i64
    }

    /// Upper limit of the ticks until the shaft would reverse.
    fn turns_round(&self) -> u64 {
        let against = self.half_speed.signum() * self.half_acceleration.signum() < 0;
        let ticks = self.half_speed.unsigned_abs().checked_div(self.half_acceleration.unsigned_abs());
        ticks.filter(|_| against).map_or(u64::MAX, |ticks| ticks + 1)
    }
}

/// A stepper motor. It ignores [`Command::Duty`].
#[derive(Clone, Debug)]
pub struct StepperMotor {
    parameters: StepperParameters,
    /// Number of steps of the drive in a full step.
    microsteps: u16,
    /// Current in mA; `None` if the drive does not report it. Then the rated current is assumed.
    current_ma: Option<u32>,
    blocked: bool,
    plan: Plan,
    /// Angle of phase 0, in 2⁻³² turns.
    origin: i64,
    /// Position of the field, in whole steps of the drive from phase 0.
    field: i64,
    /// Position of the plan when the field was at `field`.
    planned: i32,
    /// Offset of the shaft from the field, in steps of the drive: a number of periods of its torque.
    field_offset: i64,
    /// True if the shaft does not follow the field: it is held, turned by its load, or at rest.
    is_loose: bool,
    /// True if the drive keeps its field near a shaft that does not follow, and so its whole torque.
    keeps_field: bool,
    /// Time of the last step that the drive made without a plan.
    stepped: Instant,
    /// Time until which the shaft catches up with the field.
    catch_up_until: Instant,
    interval: MotionInterval,
}

impl StepperMotor {
    /// A motor at standstill at angle 0, with a drive that makes full steps.
    #[must_use]
    pub fn new(parameters: StepperParameters) -> Self {
        Self {
            parameters: parameters.bounded(),
            microsteps: 1,
            current_ma: None,
            blocked: false,
            plan: Plan::at_rest(Instant::ZERO, 0),
            origin: 0,
            field: 0,
            planned: 0,
            field_offset: 0,
            is_loose: false,
            keeps_field: false,
            stepped: Instant::ZERO,
            catch_up_until: Instant::ZERO,
            interval: MotionInterval::at_rest(Instant::ZERO, Instant::NEVER, 0),
        }
    }

    // Not inlined: here the compiler knows that the plans do not overlap, and a board needs no `memmove` of 1.6 KB.
    #[inline(never)]
    fn set_plan(&mut self, at: Instant, plan: &Plan) {
        self.move_field(at);
        (self.plan, self.planned) = (*plan, plan.position_at(at));
    }

    /// Sets the number of steps of the drive in a full step, from `at` on.
    pub fn set_microsteps(&mut self, at: Instant, microsteps: u16) {
        let (new, old) = (microsteps.max(1), self.microsteps);
        if new == old {
            return;
        }
        self.move_field(at);
        let (shaft, speed) = (self.interval.phase_at(at), self.interval.speed_at(at));
        let field = i128::from(self.field) * i128::from(STEP);
        let (to, from) = (i128::from(new), i128::from(old));
        let resized = |size: i128| (size * to).checked_div(from).unwrap_or(0);
        self.origin = self.angle_of(field);
        self.field_offset = resized(self.field_offset.into()) as i64;
        self.interval = MotionInterval::at_rest(at, at, resized(shaft - field));
        self.interval.half_speed = resized(speed.into()).clamp(-FASTEST, FASTEST) as i64;
        (self.field, self.microsteps) = (0, new);
        self.next_interval(at, CATCH_UP);
    }

    /// Sets new parameters of the motor and its load, from `at` on. If the number of full steps changes, the
    /// new motor is in step where the shaft is now.
    pub fn load(&mut self, at: Instant, parameters: StepperParameters) {
        let parameters = parameters.bounded();
        if parameters == self.parameters {
            return;
        }
        if parameters.steps_per_rev != self.parameters.steps_per_rev {
            self.move_field(at);
            self.origin = self.angle_of(self.interval.phase_at(at));
            (self.field, self.field_offset, self.is_loose) = (0, 0, false);
            self.interval = MotionInterval::at_rest(at, at, 0);
        }
        self.parameters = parameters;
        self.next_interval(at, CATCH_UP);
    }

    /// Sets whether the drive keeps the field near a shaft that does not follow, from `at` on.
    pub fn keep_field(&mut self, at: Instant, keeps: bool) {
        if self.keeps_field != keeps {
            self.keeps_field = keeps;
            self.next_interval(at, CATCH_UP);
        }
    }

    /// Moves the field to the shaft, as a drive does that knows the shaft's position. A shaft that rests
    /// without being held then follows again, from the nearest position of the field's torque.
    pub fn resynchronise(&mut self, at: Instant) {
        if self.is_free() && self.interval.speed_at(at) == 0 {
            self.move_field(at);
            let shaft = self.interval.phase_at(at);
            self.field_offset = self.nearest_period(shaft);
            self.fall_into_step(at, shaft);
            self.next_interval(at, CATCH_UP);
        }
    }

    /// Lets a shaft at rest follow the field again. The deceleration with which it stopped has ended; otherwise it would
    /// count as one of the plan, and hide how far the field is away.
    fn fall_into_step(&mut self, at: Instant, shaft: i128) {
        self.is_loose = false;
        self.interval = MotionInterval::at_rest(at, at, shaft);
    }

    /// Returns true if the shaft does not follow though it has current and is not held.
    fn is_free(&self) -> bool {
        self.is_loose && self.can_follow()
    }

    fn can_follow(&self) -> bool {
        !self.blocked && self.current_ma != Some(0)
    }

    /// Returns true if the motor's torque is enough to turn the shaft from rest.
    #[must_use]
    pub fn can_turn(&self, forward: bool) -> bool {
        self.overcomes(0, if forward { 1 } else { -1 })
    }

    /// Returns true if the shaft is at the position of the field and does not have to catch up.
    #[must_use]
    pub fn is_in_step(&self, at: Instant) -> bool {
        !self.is_loose && self.catch_up_until <= at
    }

    /// Steps of the drive per turn.
    fn steps_per_rev(&self) -> i64 {
        i64::from(self.parameters.steps_per_rev) * i64::from(self.microsteps)
    }

    /// Units of phase per turn.
    fn turn(&self) -> i128 {
        i128::from(self.steps_per_rev()) * i128::from(STEP)
    }

    /// The angle of a phase, rounded up. So if a step is exactly at an edge of an encoder, the shaft has
    /// passed the edge.
    fn angle_of(&self, phase: i128) -> i64 {
        let (parts, turn) = (phase << 32, self.turn());
        let down = parts.checked_div_euclid(turn).unwrap_or(0);
        let rest = parts - down * turn;
        self.origin.wrapping_add(down as i64).wrapping_add(i64::from(rest > 0))
    }

    /// Moves the field to the plan's position at `at`. Adds whole turns to the origin.
    fn move_field(&mut self, at: Instant) {
        let position = self.plan.position_at(at);
        self.field += i64::from(position.wrapping_sub(self.planned));
        self.planned = position;
        let turns = self.field.checked_div_euclid(self.steps_per_rev()).unwrap_or(0);
        if turns != 0 {
            self.field -= turns * self.steps_per_rev();
            self.origin = self.origin.wrapping_add(turns << 32);
            let phase = i128::from(turns) * self.turn();
            self.interval.from -= phase;
        }
    }

    /// Starts the next interval at `at`, with the state of the present one. If the field has jumped, the
    /// shaft catches up in the time `within`.
    fn next_interval(&mut self, at: Instant, within: Duration) {
        let speed = self.loose_speed(at);
        self.move_field(at);
        let shaft = self.interval.phase_at(at);
        let field = Field::of(&self.plan, at);
        let resynchronises =
            self.is_free() && speed == 0 && self.catch_up_until <= at && self.resynchronises(shaft, &field);
        if resynchronises {
            self.fall_into_step(at, shaft);
        }
        self.is_loose |= !self.can_follow();
        if !self.is_loose {
            let next = self.following(at, within, shaft, &field);
            let fails = if resynchronises { None } else { self.fails_after(&next) };
            if fails != Some(0) {
                let stands = next.half_speed == 0 && next.half_acceleration == 0;
                let longest = if stands { u64::MAX } else { LONGEST.ticks() };
                let ticks = fails.unwrap_or(u64::MAX).min(next.turns_round()).min(longest);
                self.interval =
                    MotionInterval { end: next.end.min(at + Duration::from_ticks(ticks)), ..next };
                return;
            }
            // The shaft tries once more.
            (self.is_loose, self.catch_up_until) = (true, at + CATCH_UP);
        }
        self.interval = self.loose(at, shaft, speed, &field);
        self.follow_shaft(shaft);
    }

    /// Speed of a shaft that does not follow, in the units of [`MotionInterval::half_speed`]; 0 if the shaft
    /// followed until now.
    fn loose_speed(&self, at: Instant) -> i64 {
        let speed = self.interval.speed_at(at);
        let turned_round = self.interval.half_speed.signum() * speed.signum() < 0;
        let is_bound = self.can_follow() && self.parameters.holding_unm == 0;
        if !self.is_loose || self.blocked || is_bound || turned_round { 0 } else { speed }
    }

    /// Returns true if a shaft at rest falls into step with the field. Then sets its offset to the nearest
    /// possible position of the field's torque.
    fn resynchronises(&mut self, shaft: i128, field: &Field) -> bool {
        let goes_on = MotionInterval {
            half_speed: field.half_speed,
            half_acceleration: field.half_acceleration,
            ..MotionInterval::at_rest(Instant::ZERO, Instant::ZERO, 0)
        };
        if [self.starting(field), goes_on].iter().any(|way| self.fails_after(way) == Some(0)) {
            return false;
        }
        let nearest = self.nearest_period(shaft);
        let period = PERIOD * i64::from(self.microsteps);
        let place = |field_offset: i64| i128::from(self.field + field_offset) * i128::from(STEP);
        let beyond = if place(nearest) < shaft { nearest + period } else { nearest - period };
        let reaches =
            |field_offset: &i64| field.half_speed != 0 || self.overcomes(shaft, place(*field_offset));
        match [nearest, beyond].into_iter().find(reaches) {
            Some(field_offset) => self.field_offset = field_offset,
            None => return false,
        }
        true
    }

    /// Motion with the field's speed and with the acceleration that reaches this speed from rest within two
    /// full steps.
    fn starting(&self, field: &Field) -> MotionInterval {
        const TICKS: i128 = TICKS_PER_SECOND.cast_signed() as i128;
        // v² = 2·a·s, where s is two full steps.
        let square = (i128::from(field.half_speed) * i128::from(field.half_speed))
            .checked_div(TICKS * TICKS)
            .unwrap_or(0);
        let half_acceleration = square.checked_div(4 * i128::from(self.microsteps)).unwrap_or(0);
        let half_acceleration =
            i64::try_from(half_acceleration).unwrap_or(i64::MAX) * field.half_speed.signum();
        MotionInterval {
            half_speed: field.half_speed,
            half_acceleration,
            ..MotionInterval::at_rest(Instant::ZERO, Instant::ZERO, 0)
        }
    }

    /// Motion of a shaft that does not follow the field: its load turns it, against all resisting torques.
    fn loose(&self, at: Instant, shaft: i128, speed: i64, field: &Field) -> MotionInterval {
        let mut end = field.end;
        if self.catch_up_until > at {
            end = end.min(self.catch_up_until);
        } else if self.can_follow() && field.half_acceleration != 0 {
            // The field may become slow enough.
            end = end.min(at + CATCH_UP);
        }
        let StepperParameters { pull_out_rpm, load_unm, .. } = self.parameters;
        let fastest = self.in_phase(pull_out_rpm.into(), 60).clamp(1, FASTEST) as i64;
        let speed = speed.clamp(-fastest, fastest);
        let pushes = -i128::from(load_unm) << 8;
        let way = if speed == 0 { pushes.signum() as i64 } else { speed.signum() };
        let Some(resists) = self.resists(field).filter(|_| !self.blocked) else {
            return MotionInterval::at_rest(at, end, shaft);
        };
        let drives = i128::from(way) * pushes - resists;
        if speed == 0 && drives <= 0 {
            return MotionInterval::at_rest(at, end, shaft);
        }
        let half_acceleration =
            if drives > 0 && speed.abs() == fastest { 0 } else { self.accelerated_by(drives) };
        let next = MotionInterval {
            since: at,
            end,
            from: shaft,
            half_speed: speed,
            half_acceleration: way * half_acceleration,
            catch_up_until: 0,
        };
        let comes_to_fastest =
            (fastest - speed.abs()).unsigned_abs().div_ceil(half_acceleration.unsigned_abs().max(1));
        let lasts = match half_acceleration.signum() {
            1 => comes_to_fastest.max(1),
            _ => next.turns_round(),
        };
        MotionInterval { end: end.min(at + Duration::from_ticks(lasts.min(LONGEST.ticks()))), ..next }
    }

    /// Torque that resists the motion of a shaft that does not follow; `None` if the shaft cannot be turned
    /// at all.
    fn resists(&self, field: &Field) -> Option<i128> {
        let friction = i128::from(self.parameters.friction_unm) << 8;
        if !self.can_follow() {
            return Some(friction);
        }
        if self.parameters.holding_unm == 0 {
            return None;
        }
        let holds = self.holds();
        let is_slow = self.accelerates(self.starting(field).half_acceleration).abs() <= holds;
        Some(if is_slow || self.keeps_field { friction + holds } else { friction })
    }

    /// Moves the field by whole turns towards a shaft that does not follow, so that they never are far apart.
    /// The field's torque stays the same.
    fn follow_shaft(&mut self, shaft: i128) {
        let steps = PERIOD * self.steps_per_rev();
        let away = shaft - i128::from(self.field) * i128::from(STEP);
        let periods = away.checked_div(i128::from(steps) * i128::from(STEP)).unwrap_or(0);
        self.field += periods as i64 * steps;
    }

    /// The interval from `at` on of a shaft at the phase `shaft` that follows the field.
    fn following(&mut self, at: Instant, within: Duration, shaft: i128, field: &Field) -> MotionInterval {
        let target = i128::from(self.field + self.field_offset) * i128::from(STEP) + field.fraction;
        let gap = target - shaft;
        let still = i128::from(self.catch_up_until.since(at).ticks());
        let expected = 2 * i128::from(self.interval.catch_up_until) * still;
        // A plan may change its acceleration between two ticks; the motor gets this change at the next tick.
        let nothing = NOTHING + i128::from(self.interval.half_acceleration.unsigned_abs());
        if (gap - expected).abs() > nothing {
            self.catch_up_until = at + within;
        } else if gap.abs() <= nothing {
            self.catch_up_until = self.catch_up_until.min(at);
        }
        let ticks = i128::from(self.catch_up_until.since(at).ticks());
        let Some(speed) = gap.checked_div(2 * ticks) else {
            return MotionInterval {
                since: at,
                end: field.end,
                from: target,
                half_speed: field.half_speed,
                half_acceleration: field.half_acceleration,
                catch_up_until: 0,
            };
        };
        let speed = speed.clamp(-FASTEST, FASTEST) as i64;
        MotionInterval {
            since: at,
            end: field.end.min(self.catch_up_until),
            from: shaft,
            half_speed: field.half_speed + speed,
            half_acceleration: field.half_acceleration,
            catch_up_until: speed,
        }
    }

    /// Offset of the shaft from the field if the shaft falls into step at the nearest position.
    fn nearest_period(&self, shaft: i128) -> i64 {
        let steps = PERIOD * i64::from(self.microsteps);
        let period = i128::from(steps) * i128::from(STEP);
        let away = shaft - i128::from(self.field) * i128::from(STEP);
        let periods = (away + period / 2).checked_div_euclid(period).unwrap_or(0);
        (periods as i64).wrapping_mul(steps)
    }

    /// Returns true if the torque at standstill is enough to turn the shaft from one phase to the other.
    fn overcomes(&self, from: i128, to: i128) -> bool {
        let way = (to - from).signum() as i64;
        self.fails_after(&MotionInterval {
            half_speed: way,
            ..MotionInterval::at_rest(Instant::ZERO, Instant::ZERO, from)
        }) != Some(0)
    }

    /// The speed of `turns` turns in `seconds` seconds, in the units of [`MotionInterval::half_speed`].
    fn in_phase(&self, turns: i128, seconds: i128) -> i128 {
        let way = turns * i128::from(self.steps_per_rev()) * i128::from(TICKS_PER_SECOND);
        way.checked_div(seconds).unwrap_or(0)
    }

    /// The torque of the field at standstill.
    fn holds(&self) -> i128 {
        let StepperParameters { holding_unm, rated_ma, .. } = self.parameters;
        let ma = self.current_ma.unwrap_or(rated_ma).min(MOST_MA);
        ((i128::from(holding_unm) * i128::from(ma)) << 8).checked_div(rated_ma.into()).unwrap_or(0)
    }

    /// The torque that gives the inertia this acceleration.
    fn accelerates(&self, half_acceleration: i64) -> i128 {
        let torque = i128::from(self.parameters.inertia_gcm2) * i128::from(half_acceleration) * TORQUE;
        torque.checked_div(i128::from(self.steps_per_rev()) << 16).unwrap_or(0)
    }

    /// The acceleration of the inertia by a torque, rounded away from 0.
    fn accelerated_by(&self, torque: i128) -> i64 {
        let inertia = i128::from(self.parameters.inertia_gcm2) * TORQUE;
        let size =
            (torque.abs() * (i128::from(self.steps_per_rev()) << 16) + inertia - 1).checked_div(inertia);
        size.unwrap_or(0).min(FASTEST) as i64 * torque.signum() as i64
    }

    /// Ticks after which the torque is not enough in `interval`; `None` if it is enough throughout.
    fn fails_after(&self, interval: &MotionInterval) -> Option<u64> {
        let StepperParameters { holding_unm, pull_out_rpm, friction_unm, load_unm, .. } = self.parameters;
        let MotionInterval { half_speed, half_acceleration, .. } = *interval;
        if holding_unm == 0 {
            return None;
        }
        let way = if half_speed == 0 { half_acceleration.signum() } else { half_speed.signum() };
        let (holds, load, friction) =
            (self.holds(), i128::from(load_unm) << 8, i128::from(friction_unm) << 8);
        if way == 0 {
            // Friction also holds the shaft.
            return (load.abs() > holds + friction).then_some(0);
        }
        let left = holds - (self.accelerates(half_acceleration) + load + i128::from(way) * friction).abs();
        if left < 0 {
            return Some(0);
        }
        // The speed at which the torque is just enough.
        let fastest = (self.in_phase(pull_out_rpm.into(), 60) * left).checked_div(holds).unwrap_or(0);
        let headroom = fastest - i128::from(half_speed).abs();
        if headroom < 0 {
            Some(0)
        } else if half_acceleration.signum() == way {
            let ticks = headroom.checked_div(i128::from(half_acceleration).abs())? + 1;
            Some(u64::try_from(ticks).unwrap_or(u64::MAX))
        } else {
            None
        }
    }
}

/// Motion of the motor's magnetic field according to a plan, from a given instant until `end`.
struct Field {
    /// Phase beyond the plan's position at this instant.
    fraction: i128,
    /// In the units of a [`MotionInterval`].
    half_speed: i64,
    half_acceleration: i64,
    /// End of this motion.
    end: Instant,
}

impl Field {
    fn of(plan: &Plan, at: Instant) -> Self {
        if at < plan.start() {
            return Self { fraction: 0, half_speed: 0, half_acceleration: 0, end: plan.start() };
        }
        let (segment, d) = plan.segment_at(at);
        let way = if segment.reverse { -1 } else { 1 };
        let fraction = segment.phase(d) - i128::from(segment.steps_made(d)) * i128::from(STEP);
        // After its last segment a plan stands still.
        let ends = if segment.ticks == 0 { u64::MAX } else { segment.ticks };
        Self {
            fraction: i128::from(way) * fraction,
            half_speed: way * segment.speed(d),
            half_acceleration: way * i64::from(segment.acceleration),
            end: at + Duration::from_ticks(if ends == u64::MAX { ends } else { ends.saturating_sub(d) }),
        }
    }
}

impl Plant for StepperMotor {
    /// Does nothing. The shaft stays where it is.
    fn power_on(&mut self, _at: Instant, _out: &mut dyn Reports) {}

    fn command(&mut self, at: Instant, command: Command<'_>, _out: &mut dyn Reports) {
        let mut within = CATCH_UP;
        match command {
            Command::Plan(plan) => self.set_plan(at, plan),
            Command::Step(steps) => {
                self.move_field(at);
                self.field += i64::from(steps);
                within = within.min(at.since(self.stepped)).max(Duration::TICK);
                self.stepped = at;
                if self.is_loose {
                    self.catch_up_until = at + within;
                }
            }
            Command::CurrentLimit(ma) => self.current_ma = Some(ma),
            Command::Microsteps(microsteps) => return self.set_microsteps(at, microsteps),
            Command::Duty(_) => return,
        }
        self.next_interval(at, within);
    }

    fn set_blocked(&mut self, at: Instant, blocked: bool, _out: &mut dyn Reports) {
        self.blocked = blocked;
        self.next_interval(at, CATCH_UP);
    }

    fn deadline(&self) -> Instant {
        self.interval.end
    }

    fn timeout(&mut self, at: Instant, _out: &mut dyn Reports) {
        if at >= self.interval.end {
            self.next_interval(at, CATCH_UP);
        }
    }

    fn until(&self) -> Instant {
        self.interval.end
    }

    fn angle_at(&self, at: Instant) -> i64 {
        self.angle_of(self.interval.phase_at(at))
    }

    // Compares angles without a division, and divided by 2²¹, a factor of `STEP`, so that the product fits.
    fn is_at_least(&self, at: Instant, angle: i64) -> bool {
        const { assert!(STEP.trailing_zeros() == 21 && STEP >> 21 < 1 << 31) };
        let turn = i128::from(self.steps_per_rev() * (STEP >> 21));
        let angle = i128::from(angle.wrapping_sub(self.origin)) * turn;
        self.interval.phase_at(at) << (32 - 21) > angle - turn
    }

    fn kinematics(&self) -> Kinematics {
        let MotionInterval { since, half_speed, half_acceleration, .. } = self.interval;
        Kinematics { since, angle: self.angle_at(since), half_speed, half_acceleration, turn: self.turn() }
    }

    fn stalled(&self) -> bool {
        self.blocked || self.is_free()
    }

    fn draws_ma(&self) -> i32 {
        self.current_ma.map_or(0, |ma| i32::try_from(ma).unwrap_or(i32::MAX))
    }
}

#[cfg(test)]
mod tests;
