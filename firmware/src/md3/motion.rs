//! Motion of an MD3: commands, moves, jogs and home cycles (7.5 to 7.8, 7.15 to 7.19).

use fixed::types::{I24F8, U24F8};

use super::drive::{Drive, State};
use super::pins::{Mode, Pin2};
use super::registers::io_port::{J2_2, J2_4, J2_5, J2_9};
use super::registers::{Reg, homing, motion_control};
use crate::device::{Context, Duration, Instant};
use crate::motion::Limits;

/// Interval at which the flag is sampled (7.5; MD3-26).
const FLAG_SAMPLE: Duration = Duration::micros(4);

/// Present motion.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Motion {
    None,
    Profile,
    Jog(Jog),
    DecelStop,
    Home(HomePhase),
}

/// A jog.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Jog {
    /// Pins 4 and 5 ask for it, not the bus.
    by_pins: bool,
    /// Against the sign of Speed.
    reversed: bool,
    /// Speed that it ramps to and keeps.
    speed: I24F8,
    /// True while it slows down to standstill, where it ends.
    is_ending: bool,
}

/// A part of a home cycle (7.8, figure 4).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum HomePhase {
    PreOffset,
    /// On the way to the flag or the index.
    Search,
    /// The flag is active, and will be sampled.
    FlagDetected {
        sample: Instant,
    },
    /// Flag found: to a standstill.
    Slowing,
    Offset,
}

impl Motion {
    /// Bit in MotionControl (7.15).
    pub(super) fn bit(self) -> u16 {
        match self {
            Self::None => 0,
            Self::Profile => motion_control::MOVE,
            Self::Jog(_) => motion_control::JOG,
            Self::DecelStop => motion_control::DECEL_STOP,
            Self::Home(_) => motion_control::HOME,
        }
    }
}

impl Drive {
    /// A write of MotionControl (7.15): the fault first, then Disable, which is a level and forbids the
    /// rest, then the first bit that is set (MD3-3). INHIBIT_MODBUS_MOTION leaves only Disable (7.8).
    pub(super) fn command(&mut self, at: Instant, word: u16, out: &mut dyn Context) {
        let has = |bit| word & bit != 0 && !self.bus_inhibited;
        let (clear, stop, decelerate) =
            (has(motion_control::FAULT), has(motion_control::STOP), has(motion_control::DECEL_STOP));
        let (home, jog, profile) =
            (has(motion_control::HOME), has(motion_control::JOG), has(motion_control::MOVE));
        self.restart_cutback(at);
        if clear {
            self.clear_fault(at);
        }
        let disabled = word & motion_control::DISABLE != 0;
        // What pins ask for acts again when the drive is enabled.
        self.armed |= self.disabled && !disabled;
        self.disabled = disabled;
        if disabled || stop {
            self.stop(at, out);
        } else if decelerate {
            self.decelerate(at, out);
        } else if home {
            self.home(at, out);
        } else if jog {
            self.jog_by_bus(at, out);
        } else if profile {
            self.profile(false, at, out);
        }
        self.resume(at, out);
    }

    /// A profile move, from standstill only; whether it moves.
    pub(super) fn profile(&mut self, reversed: bool, at: Instant, out: &mut dyn Context) -> bool {
        let steps = self.bank.get(Reg::MoveSteps) as i32;
        let steps = if reversed { steps.wrapping_neg() } else { steps };
        let rates = Limits::even(magnitude(self.speed()), self.acceleration());
        self.can_step() && self.start_profile(Motion::Profile, steps, rates, at, out)
    }

    /// A move from standstill, as `motion`; whether that takes any time (MD3-7).
    fn start_profile(
        &mut self,
        motion: Motion,
        steps: i32,
        rates: Limits,
        at: Instant,
        out: &mut dyn Context,
    ) -> bool {
        let moves = steps != 0 && rates.max_speed > 0 && rates.acceleration > 0;
        if moves {
            self.start(motion, at, out);
            self.motor.profile(at, steps, rates, out);
        }
        moves
    }

    /// A jog from standstill; one that runs ramps to the present speed (MD3-4).
    fn jog_by_bus(&mut self, at: Instant, out: &mut dyn Context) {
        match self.motion {
            Motion::Jog(jog) if !jog.is_ending => self.jog(jog.by_pins, jog.reversed, at, out),
            _ => self.jog(false, false, at, out),
        }
    }

    /// Starts a jog; without effect while another motion runs, and without an acceleration, which would take for ever.
    fn jog(&mut self, by_pins: bool, reversed: bool, at: Instant, out: &mut dyn Context) {
        let speed = self.jog_speed(reversed);
        let starts = self.motion == Motion::None && self.can_move() && speed != 0;
        let acceleration = self.acceleration();
        if (starts || matches!(self.motion, Motion::Jog(_))) && acceleration > 0 {
            self.start(Motion::Jog(Jog { by_pins, reversed, speed, is_ending: false }), at, out);
            self.motor.ramp_to(at, speed, acceleration, out);
        }
    }

    fn jog_speed(&self, reversed: bool) -> I24F8 {
        if reversed { -self.speed() } else { self.speed() }
    }

    /// Direction that pins 4 and 5 ask for in the modes that jog, if any.
    fn jog_wanted(&self) -> Option<bool> {
        let (pin_4, pin_5) = (self.active & J2_4 != 0, self.active & J2_5 != 0);
        match (self.pins.mode, pin_4, pin_5) {
            (Mode::JogDirection, true, reversed) => Some(reversed),
            // The direction that runs stays; from rest pin 4's.
            (Mode::JogEitherWay, true, true) => {
                Some(matches!(self.motion, Motion::Jog(Jog { reversed: true, .. })))
            }
            (Mode::JogEitherWay, true, false) => Some(false),
            (Mode::JogEitherWay, false, true) => Some(true),
            _ => None,
        }
    }

    /// Jogs as pins 4 and 5 ask for it, or no longer (MD3-22).
    pub(super) fn jog_by_pins(&mut self, at: Instant, out: &mut dyn Context) {
        match (self.jog_wanted(), self.motion) {
            (Some(wanted), Motion::Jog(Jog { by_pins: true, reversed, is_ending: false, .. }))
                if wanted == reversed => {}
            (Some(reversed), Motion::None | Motion::Jog(_)) if self.armed => {
                self.jog(true, reversed, at, out);
            }
            (None, Motion::Jog(jog)) if jog.by_pins && !jog.is_ending => {
                self.slow_down(Motion::Jog(Jog { is_ending: true, ..jog }), at, out);
            }
            _ => {}
        }
    }

    /// A home cycle, from standstill only (MD3-37); whether it moves.
    pub(super) fn home(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        let known = homing::mode(self.homing()).is_some();
        known
            && self.can_step()
            && (self.home_by(HomePhase::PreOffset, Reg::PreHomeOffset, at, out) || self.search_on(at, out))
    }

    /// The move of an offset, as `phase` of a home cycle; whether that takes any time.
    fn home_by(&mut self, phase: HomePhase, offset: Reg, at: Instant, out: &mut dyn Context) -> bool {
        // SPEEDSEL does not matter here.
        let rates = Limits::even(magnitude(self.normal_speed()), self.acceleration());
        self.start_profile(Motion::Home(phase), self.bank.get(offset) as i32, rates, at, out)
    }

    /// The search, or what follows it if there is nothing to search for; whether that takes any time.
    fn search_on(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        let (speed, acceleration) = (magnitude(self.normal_speed()), self.acceleration());
        if speed == 0 || acceleration == 0 {
            return false;
        }
        if self.flag() {
            return self.home_by(HomePhase::Offset, Reg::HomeOffset, at, out);
        }
        // "The acceleration is not divided down" (7.5).
        let search = I24F8::from_bits(speed.to_bits().cast_signed() >> homing::divisor(self.homing()));
        let backward = self.homing() & homing::BACKWARD != 0;
        self.start(Motion::Home(HomePhase::Search), at, out);
        self.motor.ramp_to(at, if backward { -search } else { search }, acceleration, out);
        true
    }

    /// Returns whether the flag that a home cycle searches for is present.
    fn flag(&self) -> bool {
        match homing::mode(self.homing()) {
            // "Active high encoder index pulse on J2 pin 9" (MD3-27)
            Some(homing::Mode { by_index: true, .. }) => self.levels & J2_9 != 0 && !self.gpio_outputs(),
            Some(_) => self.active & J2_2 != 0,
            None => false,
        }
    }

    /// Pin 2 or 9 has changed: an index is seen at once, the flag at the next sample.
    pub(super) fn check_flag(&mut self, at: Instant, out: &mut dyn Context) {
        if self.motion != Motion::Home(HomePhase::Search) || !self.flag() {
            return;
        }
        if self.pins.pin_2 == Pin2::Flag {
            let samples = (at.since(Instant::ZERO) + FLAG_SAMPLE - Duration::TICK) / FLAG_SAMPLE;
            self.motion =
                Motion::Home(HomePhase::FlagDetected { sample: Instant::ZERO + FLAG_SAMPLE * samples });
        } else {
            self.flag_found(at, out);
        }
    }

    /// Stops the search: at once, or with a ramp.
    fn flag_found(&mut self, at: Instant, out: &mut dyn Context) {
        if homing::mode(self.homing()).is_some_and(|mode| mode.with_ramp) {
            self.motor.ramp_to(at, I24F8::ZERO, self.acceleration(), out);
        } else {
            self.motor.halt(at, out);
        }
        self.motion = Motion::Home(HomePhase::Slowing);
    }

    /// HomingConfiguration (7.5).
    fn homing(&self) -> u16 {
        self.bank.word(Reg::HomingConfiguration)
    }

    /// Time of the next work for the present motion.
    pub(super) fn motion_due(&self) -> Instant {
        match self.motion {
            // A jog goes on when its ramp has reached standstill: the speed may rise again (MD3-5).
            Motion::None | Motion::Jog(Jog { is_ending: false, .. }) | Motion::Home(HomePhase::Search) => {
                Instant::NEVER
            }
            Motion::Home(HomePhase::FlagDetected { sample }) => sample,
            Motion::Profile | Motion::Jog(_) | Motion::DecelStop | Motion::Home(_) => self.motor.end(),
        }
    }

    /// Handles the end of a motion, or a sample of the flag.
    pub(super) fn motion_over(&mut self, at: Instant, out: &mut dyn Context) {
        let over = self.motion;
        let continues = match over {
            Motion::Home(HomePhase::FlagDetected { .. }) => {
                if self.flag() {
                    self.flag_found(at, out);
                } else {
                    self.motion = Motion::Home(HomePhase::Search);
                }
                true
            }
            Motion::Home(HomePhase::PreOffset) => self.search_on(at, out),
            Motion::Home(HomePhase::Slowing) => self.home_by(HomePhase::Offset, Reg::HomeOffset, at, out),
            _ => false,
        };
        if continues {
            return;
        }
        self.motor.finish(at, out);
        self.enter(Motion::None, at);
        match (self.pins.mode, over) {
            // "The sign of MoveSteps will be negative if the motor is moving backward" (7.8).
            (Mode::EndlessMoves, Motion::Profile) if self.armed => {
                let steps = self.bank.get(Reg::MoveSteps) as i32;
                self.bank.set(Reg::MoveSteps, i64::from(steps.wrapping_neg()));
            }
            (Mode::EndlessHomes, Motion::Profile) if self.armed => {
                self.home(at, out);
            }
            _ => {}
        }
        self.resume(at, out);
    }

    /// Moves as the levels of pins 4 and 5 or an endless mode ask for it, if nothing else moves (MD3-21).
    pub(super) fn resume(&mut self, at: Instant, out: &mut dyn Context) {
        if !self.armed || self.motion != Motion::None {
            return;
        }
        match self.pins.mode {
            Mode::JogDirection | Mode::JogEitherWay => self.jog_by_pins(at, out),
            // A part that takes no time is left out, lest the two follow each other for ever (MD3-23).
            Mode::EndlessMoves => {
                self.profile(false, at, out);
            }
            Mode::EndlessHomes => {
                let _ = self.profile(false, at, out) || self.home(at, out);
            }
            _ => {}
        }
    }

    /// Pins 4 and 5 have another function than `before` (7.8).
    pub(super) fn mode_changed(&mut self, before: Mode, at: Instant, out: &mut dyn Context) {
        match before {
            same if same == self.pins.mode => {}
            Mode::EndlessMoves | Mode::EndlessHomes => self.halt(at, out),
            _ => self.jog_by_pins(at, out),
        }
    }

    /// Speed, AlternateSpeed or what selects them has changed: it counts at once in a jog, and not in a
    /// profile move (7.17).
    pub(super) fn speed_changed(&mut self, at: Instant, out: &mut dyn Context) {
        match self.motion {
            Motion::Jog(jog) if !jog.is_ending => {
                if jog.speed != self.jog_speed(jog.reversed) {
                    self.jog(jog.by_pins, jog.reversed, at, out);
                }
            }
            _ => self.resume(at, out),
        }
    }

    /// SPEEDSEL has changed in a profile move: by 7.8 this is ignored, by 7.18 the move becomes a jog (MD3-30).
    pub(super) fn jog_on(&mut self, at: Instant, out: &mut dyn Context) {
        let speed = I24F8::ZERO;
        self.motion = Motion::Jog(Jog { by_pins: false, reversed: false, speed, is_ending: false });
        self.jog(false, false, at, out);
    }

    /// "Changing the acceleration while the motor is moving will cause the motor to stop" (7.17): in a
    /// profile move. A jog takes it for its next ramp, be it one that waited for an acceleration (MD3-6).
    pub(super) fn acceleration_changed(&mut self, at: Instant, out: &mut dyn Context) {
        if self.motion == Motion::Profile {
            self.stop(at, out);
        }
        self.jog_by_pins(at, out);
        self.speed_changed(at, out);
    }

    /// Ends any motion with a ramp; bit 4 reads 1 until standstill (MD3-8).
    fn decelerate(&mut self, at: Instant, out: &mut dyn Context) {
        self.armed = false;
        if self.motion != Motion::None {
            self.slow_down(Motion::DecelStop, at, out);
        }
    }

    /// A ramp to standstill, as `motion`.
    fn slow_down(&mut self, motion: Motion, at: Instant, out: &mut dyn Context) {
        let acceleration = self.acceleration();
        if acceleration > 0 && self.motor.ramp_to(at, I24F8::ZERO, acceleration, out) {
            self.enter(motion, at);
        } else {
            self.halt(at, out);
        }
    }

    /// Stops any motion at once and disarms the pins.
    pub(super) fn stop(&mut self, at: Instant, out: &mut dyn Context) {
        self.armed = false;
        self.halt(at, out);
    }

    /// Stops at once, with the motor where it is.
    pub(super) fn halt(&mut self, at: Instant, out: &mut dyn Context) {
        if self.motion != Motion::None {
            self.motor.halt(at, out);
            self.enter(Motion::None, at);
        }
    }

    /// A motion begins. The cutback ends before its first step: a load that needs the full current would else
    /// hold the motor back (7.3).
    fn start(&mut self, motion: Motion, at: Instant, out: &mut dyn Context) {
        self.enter(motion, at);
        self.update_current(at, out);
    }

    /// A motion begins or ends: either way the cutback waits anew (7.3).
    fn enter(&mut self, motion: Motion, at: Instant) {
        self.motion = motion;
        self.restart_cutback(at);
    }

    /// Returns whether a command may start motion.
    pub(super) fn can_move(&self) -> bool {
        self.state == State::Ready && !self.fault && !self.disabled
    }

    /// Returns whether steps may begin: a DC motor only jogs (7.2).
    pub(super) fn can_step(&self) -> bool {
        self.can_move() && self.motion == Motion::None && !self.motor.is_dc()
    }

    /// Acceleration, in steps/s².
    fn acceleration(&self) -> u32 {
        self.bank.clamped_value(Reg::AccelDecel) as u32
    }

    /// Speed (7.17) in steps/s, or in counts of a DC motor, with its sign; limited when it is used (MD3-38).
    fn normal_speed(&self) -> I24F8 {
        self.in_range(self.bank.clamped_value(Reg::Speed) as i32)
    }

    /// The speed that SPEEDSEL selects; the alternate one has the other one's sign (7.18).
    fn speed(&self) -> I24F8 {
        if !self.alternate {
            return self.normal_speed();
        }
        let speed = self.bank.clamped_value(Reg::AlternateSpeed) as i32;
        self.in_range(if self.bank.get(Reg::Speed) < 0 { -speed } else { speed })
    }

    /// A DC motor's duty has at most as many counts as its period.
    fn in_range(&self, speed: i32) -> I24F8 {
        let speed = match self.motor.pwm() {
            Some(pwm) => speed.min(pwm.range.get().cast_signed()).max(-pwm.range.get().cast_signed()),
            None => speed,
        };
        // At most 40,000: it fits.
        I24F8::from_bits(speed << 8)
    }
}

fn magnitude(speed: I24F8) -> U24F8 {
    U24F8::from_bits(speed.to_bits().unsigned_abs())
}
