//! Motion of an MD3: commands, moves, jogs and home cycles (7.5 to 7.8, 7.15 to 7.19).

use fixed::types::{I24F8, U24F8};

use super::drive::{Drive, State};
use super::pins::{Mode, Pin2};
use super::reasons::Why;
use super::registers::io_port::{J2_2, J2_4, J2_5, J2_9};
use super::registers::{Reg, homing, motion_control};
use crate::device::{Context, Duration, Instant, REPORTS_REASONS};
use crate::motion::Limits;

/// Interval at which the flag is sampled (7.5; MD3-26).
const FLAG_SAMPLE: Duration = Duration::micros(4);

/// The present motion.
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
    /// True if pins 4 and 5 control the jog, false if the bus does.
    by_pins: bool,
    /// True if the direction is opposite to the sign of Speed.
    reversed: bool,
    /// Target speed of the ramp, kept after the ramp.
    speed: I24F8,
    /// True while the jog slows down to standstill, where it ends.
    is_ending: bool,
}

/// Phase of a home cycle (7.8, figure 4).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum HomePhase {
    PreOffset,
    /// The motor moves until the flag or the index is active.
    Search,
    /// The flag is active; the drive samples it at `sample`.
    FlagDetected {
        sample: Instant,
    },
    /// The flag was found; the motor stops.
    Slowing,
    Offset,
}

impl Motion {
    /// The bit of this motion in `MotionControl` (7.15).
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
    /// Applies a write of `MotionControl` (7.15). The drive first clears the fault, then applies Disable, a
    /// level that forbids the other commands, and then only the first set bit of those (MD3-3). While
    /// `INHIBIT_MODBUS_MOTION` is active, only Disable has an effect (7.8).
    ///
    /// # Errors
    /// The first reason why a bit has no effect, or has another effect.
    pub(super) fn command(&mut self, at: Instant, word: u16, out: &mut dyn Context) -> Result<(), Why> {
        let obeyed = if self.bus_inhibited { word & motion_control::DISABLE } else { word };
        let permitted = if obeyed == word { Ok(()) } else { Err(Why::BusInhibited) };
        let has = |bits| obeyed & bits != 0;
        self.restart_cutback(at);
        let cleared = if has(motion_control::FAULT) { self.clear_fault(at) } else { Ok(()) };
        let disabled = has(motion_control::DISABLE);
        // When the drive is enabled, levels of the pins and the endless modes may move the motor again.
        self.armed |= self.disabled && !disabled;
        self.disabled = disabled;
        let moved = if disabled || has(motion_control::STOP) {
            self.stop(at, out);
            if disabled && has(motion_control::MOTIONS) { Err(Why::Disabled) } else { Ok(()) }
        } else if has(motion_control::DECEL_STOP) {
            self.decelerate(at, out);
            Ok(())
        } else if has(motion_control::HOME) {
            self.home(at, out).and_then(|()| self.check_motion(Reg::Speed))
        } else if has(motion_control::JOG) {
            self.jog_by_bus(at, out).and_then(|()| self.check_motion(self.speed_register()))
        } else if has(motion_control::MOVE) {
            self.profile(false, at, out).and_then(|()| self.check_motion(self.speed_register()))
        } else {
            Ok(())
        };
        self.resume(at, out);
        let commands = obeyed & (motion_control::STOP | motion_control::DECEL_STOP | motion_control::MOTIONS);
        let single =
            if REPORTS_REASONS && commands.count_ones() > 1 { Err(Why::SeveralBits) } else { Ok(()) };
        permitted.and(cleared).and(moved).and(single)
    }

    /// Checks a motion that has just started with the speed of this register: the motor needs a current.
    fn check_motion(&self, speed: Reg) -> Result<(), Why> {
        match self.current {
            _ if !REPORTS_REASONS => Ok(()),
            0 if self.inhibited => Err(Why::Inhibited),
            0 => Err(Why::NoCurrent),
            _ if self.bank.clamped_value(speed) != self.bank.get(speed) => Err(Why::SpeedLimit),
            _ => Ok(()),
        }
    }

    /// Starts a profile move, from standstill only.
    ///
    /// # Errors
    /// The reason why the motor does not move.
    pub(super) fn profile(&mut self, reversed: bool, at: Instant, out: &mut dyn Context) -> Result<(), Why> {
        self.can_step()?;
        let steps = self.bank.get(Reg::MoveSteps) as i32;
        let steps = if reversed { steps.wrapping_neg() } else { steps };
        let rates = Limits::even(magnitude(self.speed()), self.acceleration());
        self.start_profile(Motion::Profile, steps, rates, at, out)
    }

    /// Starts a move from standstill as `motion`.
    ///
    /// # Errors
    /// The reason why the move takes no time (MD3-7).
    fn start_profile(
        &mut self,
        motion: Motion,
        steps: i32,
        rates: Limits,
        at: Instant,
        out: &mut dyn Context,
    ) -> Result<(), Why> {
        if steps == 0 {
            return Err(Why::NoSteps);
        }
        if rates.max_speed == 0 {
            return Err(self.no_speed());
        }
        if rates.acceleration == 0 {
            return Err(Why::NoAcceleration);
        }
        self.start(motion, at, out);
        self.motor.profile(at, steps, rates, out);
        Ok(())
    }

    /// Starts a jog from standstill. A running jog ramps to the present speed (MD3-4).
    fn jog_by_bus(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Why> {
        match self.motion {
            Motion::Jog(jog) if !jog.is_ending => self.jog(jog.by_pins, jog.reversed, at, out),
            _ => self.jog(false, false, at, out),
        }
    }

    /// Starts a jog, or changes the running jog.
    ///
    /// # Errors
    /// Another motion runs, the drive may not move, the speed is 0; or the acceleration is 0, because the
    /// ramp would never end.
    fn jog(&mut self, by_pins: bool, reversed: bool, at: Instant, out: &mut dyn Context) -> Result<(), Why> {
        let speed = self.jog_speed(reversed);
        match self.motion {
            Motion::Jog(_) => {}
            Motion::None => {
                self.can_move()?;
                if speed == 0 {
                    return Err(self.no_speed());
                }
            }
            _ => return Err(Why::Moves),
        }
        let acceleration = self.acceleration();
        if acceleration == 0 {
            return Err(Why::NoAcceleration);
        }
        self.start(Motion::Jog(Jog { by_pins, reversed, speed, is_ending: false }), at, out);
        self.motor.ramp_to(at, speed, acceleration, out);
        Ok(())
    }

    fn jog_speed(&self, reversed: bool) -> I24F8 {
        if reversed { -self.speed() } else { self.speed() }
    }

    /// Direction in which pins 4 and 5 request a jog: true for reversed, `None` if they request none.
    fn jog_wanted(&self) -> Option<bool> {
        let (pin_4, pin_5) = (self.active & J2_4 != 0, self.active & J2_5 != 0);
        match (self.pins.mode, pin_4, pin_5) {
            (Mode::JogDirection, true, reversed) => Some(reversed),
            // If both pins are active, a running jog keeps its direction; from standstill pin 4 decides.
            (Mode::JogEitherWay, true, true) => {
                Some(matches!(self.motion, Motion::Jog(Jog { reversed: true, .. })))
            }
            (Mode::JogEitherWay, true, false) => Some(false),
            (Mode::JogEitherWay, false, true) => Some(true),
            _ => None,
        }
    }

    /// Starts, changes or ends the jog that pins 4 and 5 control (MD3-22).
    pub(super) fn jog_by_pins(&mut self, at: Instant, out: &mut dyn Context) {
        match (self.jog_wanted(), self.motion) {
            (Some(wanted), Motion::Jog(Jog { by_pins: true, reversed, is_ending: false, .. }))
                if wanted == reversed => {}
            (Some(reversed), Motion::None | Motion::Jog(_)) if self.armed => {
                let _ = self.jog(true, reversed, at, out);
            }
            (None, Motion::Jog(jog)) if jog.by_pins && !jog.is_ending => {
                self.slow_down(Motion::Jog(Jog { is_ending: true, ..jog }), at, out);
            }
            _ => {}
        }
    }

    /// Starts a home cycle, from standstill only (MD3-37).
    ///
    /// # Errors
    /// The reason why the motor does not move.
    pub(super) fn home(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Why> {
        self.can_step()?;
        if homing::mode(self.homing()).is_none() {
            return Err(Why::NoHomingMode);
        }
        match self.home_by(HomePhase::PreOffset, Reg::PreHomeOffset, at, out) {
            Ok(()) => Ok(()),
            Err(_) => self.search_on(at, out),
        }
    }

    /// Starts the move by an offset, as `phase` of a home cycle.
    ///
    /// # Errors
    /// The reason why the move takes no time.
    fn home_by(
        &mut self,
        phase: HomePhase,
        offset: Reg,
        at: Instant,
        out: &mut dyn Context,
    ) -> Result<(), Why> {
        // SPEEDSEL does not affect this speed.
        let rates = Limits::even(magnitude(self.normal_speed()), self.acceleration());
        self.start_profile(Motion::Home(phase), self.bank.get(offset) as i32, rates, at, out)
    }

    /// Starts the search, or the home offset if the flag is already present.
    ///
    /// # Errors
    /// The reason why the motion takes no time.
    fn search_on(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Why> {
        let (speed, acceleration) = (magnitude(self.normal_speed()), self.acceleration());
        if speed == 0 {
            return Err(Why::NoSpeed);
        }
        if acceleration == 0 {
            return Err(Why::NoAcceleration);
        }
        if self.flag() {
            let offset = self.home_by(HomePhase::Offset, Reg::HomeOffset, at, out);
            return offset.map_err(|_| Why::AtHome);
        }
        // "The acceleration is not divided down" (7.5).
        let search = I24F8::from_bits(speed.to_bits().cast_signed() >> homing::divisor(self.homing()));
        let backward = self.homing() & homing::BACKWARD != 0;
        self.start(Motion::Home(HomePhase::Search), at, out);
        self.motor.ramp_to(at, if backward { -search } else { search }, acceleration, out);
        Ok(())
    }

    /// Returns true if the flag or index that a home cycle searches for is present.
    fn flag(&self) -> bool {
        match homing::mode(self.homing()) {
            // "Active high encoder index pulse on J2 pin 9" (MD3-27)
            Some(homing::Mode { by_index: true, .. }) => self.levels & J2_9 != 0 && !self.gpio_outputs(),
            Some(_) => self.active & J2_2 != 0,
            None => false,
        }
    }

    /// Handles a change of pin 2 or 9 during a search. The drive sees an index at once, and the flag at the
    /// next sample.
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

    /// The value of `HomingConfiguration` (7.5).
    fn homing(&self) -> u16 {
        self.bank.word(Reg::HomingConfiguration)
    }

    /// Time at which the present motion needs [`Drive::motion_over`].
    pub(super) fn motion_due(&self) -> Instant {
        match self.motion {
            // A jog continues after its ramp has reached standstill, because the speed may rise again
            // (MD3-5).
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
            Motion::Home(HomePhase::PreOffset) => self.search_on(at, out).is_ok(),
            Motion::Home(HomePhase::Slowing) => {
                self.home_by(HomePhase::Offset, Reg::HomeOffset, at, out).is_ok()
            }
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
                let _ = self.home(at, out);
            }
            _ => {}
        }
        self.resume(at, out);
    }

    /// Starts the motion that the levels of pins 4 and 5 or an endless mode request, if no motion is running
    /// (MD3-21).
    pub(super) fn resume(&mut self, at: Instant, out: &mut dyn Context) {
        if !self.armed || self.motion != Motion::None {
            return;
        }
        match self.pins.mode {
            Mode::JogDirection | Mode::JogEitherWay => self.jog_by_pins(at, out),
            // A move or home cycle that takes no time is skipped; else the two could alternate without end
            // (MD3-23).
            Mode::EndlessMoves => {
                let _ = self.profile(false, at, out);
            }
            Mode::EndlessHomes => {
                let _ = self.profile(false, at, out).or_else(|_| self.home(at, out));
            }
            _ => {}
        }
    }

    /// Pins 4 and 5 have a new function; `before` is the old one (7.8).
    pub(super) fn mode_changed(&mut self, before: Mode, at: Instant, out: &mut dyn Context) {
        match before {
            same if same == self.pins.mode => {}
            Mode::EndlessMoves | Mode::EndlessHomes => self.halt(at, out),
            _ => self.jog_by_pins(at, out),
        }
    }

    /// Speed, `AlternateSpeed` or the selection between them has changed. A jog changes its speed at once, a
    /// running profile move does not (7.17).
    pub(super) fn speed_changed(&mut self, at: Instant, out: &mut dyn Context) {
        match self.motion {
            Motion::Jog(jog) if !jog.is_ending => {
                if jog.speed != self.jog_speed(jog.reversed) {
                    let _ = self.jog(jog.by_pins, jog.reversed, at, out);
                }
            }
            _ => self.resume(at, out),
        }
    }

    /// SPEEDSEL has changed in a profile move: section 7.8 says that the move ignores it, section 7.18 that
    /// the move becomes a jog (MD3-30). This function makes the jog.
    pub(super) fn jog_on(&mut self, at: Instant, out: &mut dyn Context) {
        let speed = I24F8::ZERO;
        self.motion = Motion::Jog(Jog { by_pins: false, reversed: false, speed, is_ending: false });
        let _ = self.jog(false, false, at, out);
    }

    /// "Changing the acceleration while the motor is moving will cause the motor to stop" (7.17): this
    /// applies to a profile move. A jog uses the new acceleration for its next ramp. A ramp that could not
    /// start because the acceleration was 0 starts now (MD3-6).
    pub(super) fn acceleration_changed(&mut self, at: Instant, out: &mut dyn Context) {
        if self.motion == Motion::Profile {
            self.stop(at, out);
        }
        self.jog_by_pins(at, out);
        self.speed_changed(at, out);
    }

    /// Ends any motion with a ramp; bit 4 reads 1 until the motor stands still (MD3-8).
    fn decelerate(&mut self, at: Instant, out: &mut dyn Context) {
        self.armed = false;
        if self.motion != Motion::None {
            self.slow_down(Motion::DecelStop, at, out);
        }
    }

    /// Ramps to standstill as `motion`; stops at once if no ramp is possible.
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

    /// Stops any motion at once, at the present position of the motor.
    pub(super) fn halt(&mut self, at: Instant, out: &mut dyn Context) {
        if self.motion != Motion::None {
            self.motor.halt(at, out);
            self.enter(Motion::None, at);
        }
    }

    /// Starts a motion. The cutback ends before the first step, because a load that needs the full current
    /// would otherwise hold the motor back (7.3).
    fn start(&mut self, motion: Motion, at: Instant, out: &mut dyn Context) {
        self.enter(motion, at);
        self.update_current(at, out);
    }

    /// Changes the present motion. The cutback timeout restarts when a motion begins and when it ends (7.3).
    fn enter(&mut self, motion: Motion, at: Instant) {
        self.motion = motion;
        self.restart_cutback(at);
    }

    /// Checks that a command may start a motion.
    pub(super) fn can_move(&self) -> Result<(), Why> {
        if self.fault {
            Err(Why::Fault)
        } else if self.disabled || self.state != State::Ready {
            Err(Why::Disabled)
        } else {
            Ok(())
        }
    }

    /// Checks that a motion in steps may begin. A DC motor can only jog (7.2).
    pub(super) fn can_step(&self) -> Result<(), Why> {
        self.can_move()?;
        if self.motor.is_dc() {
            return Err(Why::DcMotor);
        }
        if self.motion == Motion::None { Ok(()) } else { Err(Why::Moves) }
    }

    /// The register of the speed that SPEEDSEL selects.
    fn speed_register(&self) -> Reg {
        if self.alternate { Reg::AlternateSpeed } else { Reg::Speed }
    }

    /// The reason why a speed of 0 moves nothing: the register that is 0.
    fn no_speed(&self) -> Why {
        if self.alternate { Why::NoAlternateSpeed } else { Why::NoSpeed }
    }

    /// Acceleration, in steps/s².
    fn acceleration(&self) -> u32 {
        self.bank.clamped_value(Reg::AccelDecel) as u32
    }

    /// The value of Speed (7.17) in steps/s, or in counts of a DC motor, with its sign. The limits apply on
    /// use, not on write (MD3-38).
    fn normal_speed(&self) -> I24F8 {
        self.in_range(self.bank.clamped_value(Reg::Speed) as i32)
    }

    /// The speed that SPEEDSEL selects. `AlternateSpeed` has no sign of its own and gets the sign of Speed
    /// (7.18).
    fn speed(&self) -> I24F8 {
        if !self.alternate {
            return self.normal_speed();
        }
        let speed = self.bank.clamped_value(Reg::AlternateSpeed) as i32;
        self.in_range(if self.bank.get(Reg::Speed) < 0 { -speed } else { speed })
    }

    /// Limits the speed of a DC motor to the counts of a PWM period.
    fn in_range(&self, speed: i32) -> I24F8 {
        let speed = match self.motor.pwm() {
            Some(pwm) => speed.min(pwm.range.get().cast_signed()).max(-pwm.range.get().cast_signed()),
            None => speed,
        };
        // The value is at most 40,000, so the shift does not overflow.
        I24F8::from_bits(speed << 8)
    }
}

fn magnitude(speed: I24F8) -> U24F8 {
    U24F8::from_bits(speed.to_bits().unsigned_abs())
}
