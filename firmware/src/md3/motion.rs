//! Motion of an MD3: commands, moves, jogs and home cycles (7.5 to 7.8, 7.15 to 7.19).

use fixed::types::{I24F8, U24F8};

use super::Words;
use super::current::Current;
use super::homing::{Homing, Target};
use super::io::{Changes, Io, Mode, Pin3, Request};
use super::motor::{Motor, Setting};
use super::reasons::Why;
use super::registers::{Reg, motion_control};
use crate::device::{Context, Duration, Instant, REPORTS_REASONS};
use crate::motion::Limits;

/// Interval at which the flag is sampled (7.5; MD3-26).
const FLAG_SAMPLE: Duration = Duration::micros(4);
/// Minimum time between two step pulses: 250 kHz. Faster pulses are lost (7.8; MD3-25).
const STEP_INTERVAL: Duration = Duration::micros(4);
/// The bits of `MotionControl` that start a motion.
const MOTIONS: u16 = motion_control::HOME | motion_control::JOG | motion_control::MOVE;

/// The present motion.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Activity {
    None,
    Profile,
    Jog(Jog),
    DecelStop,
    Home(HomePhase),
}

/// A jog.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Jog {
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
enum HomePhase {
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

/// The instant of a call, and the parts of the drive that a motion reads or changes.
pub(super) struct Now<'a> {
    pub(super) at: Instant,
    pub(super) bank: &'a mut Words,
    pub(super) io: &'a Io,
    pub(super) current: &'a mut Current,
    pub(super) out: &'a mut dyn Context,
}

impl Now<'_> {
    /// The register of the speed that SPEEDSEL selects.
    fn speed_register(&self) -> Reg {
        if self.io.selects_alternate() { Reg::AlternateSpeed } else { Reg::Speed }
    }

    /// The value of a register of speed in steps/s, or in counts of a DC motor. The limits apply on use, not on
    /// write (MD3-38).
    fn speed_of(&self, register: Reg) -> i32 {
        self.bank.clamped_value(register) as i32
    }

    /// The speed that SPEEDSEL selects. `AlternateSpeed` has no sign of its own and gets the sign of Speed
    /// (7.18).
    fn speed(&self) -> i32 {
        let speed = self.speed_of(self.speed_register());
        if self.io.selects_alternate() && self.bank.get(Reg::Speed) < 0 { -speed } else { speed }
    }

    /// The reason why a speed of 0 moves nothing: the register that is 0.
    fn no_speed(&self) -> Why {
        if self.io.selects_alternate() { Why::NoAlternateSpeed } else { Why::NoSpeed }
    }

    /// Acceleration, in steps/s².
    fn acceleration(&self) -> u32 {
        self.bank.clamped_value(Reg::AccelDecel) as u32
    }
}

/// The motion controller, with the motor that it moves.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    activity: Activity,
    motor: Motor,
    /// True while the levels of pins 4 and 5 and the endless modes may move the motor. A stop clears it. The
    /// next edge at pins 4 or 5 in a jog mode, a write of the pins' functions, the end of Disable, or a
    /// cleared fault sets it again.
    armed: bool,
    /// Step pulses before this instant are too fast and are lost.
    next_step_allowed: Instant,
}

impl Motion {
    /// A motor at rest, with the levels of the pins not armed.
    pub(super) fn new(at: Instant) -> Self {
        Self {
            activity: Activity::None,
            motor: Motor::new(at),
            armed: false,
            next_step_allowed: Instant::ZERO,
        }
    }

    /// Power-on: puts the first plan and current.
    pub(super) fn begin(&self, at: Instant, out: &mut dyn Context) {
        self.motor.begin(at, out);
    }

    /// The bit of the present motion in `MotionControl` (7.15).
    pub(super) fn control(&self) -> u16 {
        match self.activity {
            Activity::None => 0,
            Activity::Profile => motion_control::MOVE,
            Activity::Jog(_) => motion_control::JOG,
            Activity::DecelStop => motion_control::DECEL_STOP,
            Activity::Home(_) => motion_control::HOME,
        }
    }

    /// Returns true if the motor moves, as BUSY shows it.
    pub(super) fn is_moving(&self) -> bool {
        if self.motor.is_dc() { self.motor.is_driven() } else { self.activity != Activity::None }
    }

    /// Returns true if the motor is a DC motor.
    pub(super) fn is_dc(&self) -> bool {
        self.motor.is_dc()
    }

    /// Applies `MotorCurrentAndMicrostepping`, except the current.
    pub(super) fn configure(&mut self, setting: Setting, now: &mut Now<'_>) {
        if self.motor.is_changed_by(setting) {
            self.halt(now);
        }
        self.motor.configure(now.at, setting, now.out);
    }

    /// A board has made `steps` more steps than the plan has.
    pub(super) fn correct_steps(&mut self, steps: i32) {
        self.motor.correct_steps(steps);
    }

    /// Permits that levels of the pins and the endless modes move the motor.
    pub(super) fn arm(&mut self) {
        self.armed = true;
    }

    /// Time of the next [`timeout`](Self::timeout).
    pub(super) fn deadline(&self) -> Instant {
        self.activity_due().min(self.motor.deadline())
    }

    /// Handles the start of a PWM period, the end of a motion, or a sample of the flag, if it is due.
    pub(super) fn timeout(&mut self, now: &mut Now<'_>) {
        self.motor.timeout(now.at, now.out);
        if self.activity_due() <= now.at {
            self.on_activity_due(now);
        }
    }

    /// Handles new levels, polarities or functions of J2 pins 2 to 5.
    // Inlined, so that `Changes` are never stored.
    #[inline(always)]
    pub(super) fn react(&mut self, changes: &Changes, now: &mut Now<'_>) {
        if changes.has_edges {
            now.current.restart_cutback(now.at);
        }
        match changes.mode_before {
            same if same == now.io.mode() => {}
            Mode::EndlessMoves | Mode::EndlessHomes => self.halt(now),
            _ => self.jog_by_pins(now),
        }
        self.check_target(now);
        if changes.selects_speed {
            self.on_speedsel(now);
        }
        if changes.begins != Pin3::None {
            let _ = self.clear_fault(now);
        }
        match changes.begins {
            // "Currently running motion is stopped" (MD3-29).
            Pin3::InhibitModbus => self.stop(now),
            Pin3::Home => {
                let _ = self.home(now);
            }
            Pin3::Inhibit | Pin3::None => {}
        }
        if let Some(request) = changes.request {
            // The current changes before a step is made.
            self.update_current(now);
            self.obey(request, now);
        }
    }

    /// Handles an edge at pin 4 or 5, with its request.
    pub(super) fn on_edge(&mut self, request: Option<Request>, now: &mut Now<'_>) {
        let was_lowered = now.current.is_lowered();
        now.current.restart_cutback(now.at);
        if let Some(request) = request {
            if was_lowered {
                // The current rises before a step is made.
                self.update_current(now);
            }
            self.obey(request, now);
        }
    }

    /// Executes a request of pins 4 and 5. Moves, steps and home cycles start only if no motion is running
    /// (MD3-24).
    fn obey(&mut self, request: Request, now: &mut Now<'_>) {
        match request {
            Request::Step { backward } => {
                if now.at >= self.next_step_allowed && self.can_step(now).is_ok() {
                    self.next_step_allowed = now.at + STEP_INTERVAL;
                    self.motor.step(now.at, if backward { -1 } else { 1 }, now.out);
                }
            }
            Request::Profile { reversed } => {
                let _ = self.profile(reversed, now);
            }
            Request::Home => {
                let _ = self.home(now);
            }
            Request::Jog => {
                self.armed = true;
                self.jog_by_pins(now);
            }
        }
    }

    /// SPEEDSEL has changed. In a profile move, section 7.8 says that the move ignores it, section 7.18 that the
    /// move becomes a jog (MD3-30).
    fn on_speedsel(&mut self, now: &mut Now<'_>) {
        if self.activity == Activity::Profile && now.bank.get(Reg::SpeedselJogsProfile) != 0 {
            let speed = I24F8::ZERO;
            self.activity = Activity::Jog(Jog { by_pins: false, reversed: false, speed, is_ending: false });
            let _ = self.jog(false, false, now);
        } else {
            let _ = self.speed_changed(now);
        }
    }

    /// Applies a write of `MotionControl` (7.15). The drive first clears the fault, then applies Disable, a
    /// level that forbids the other commands, and then only the first set bit of those (MD3-3). While
    /// `INHIBIT_MODBUS_MOTION` is active, only Disable has an effect (7.8).
    ///
    /// # Errors
    /// The first reason why a bit has no effect, or has another effect.
    pub(super) fn command(&mut self, word: u16, now: &mut Now<'_>) -> Result<(), Why> {
        let obeyed = if now.io.is_bus_inhibited() { word & motion_control::DISABLE } else { word };
        let permitted = if obeyed == word { Ok(()) } else { Err(Why::BusInhibited) };
        let has = |bits| obeyed & bits != 0;
        now.current.restart_cutback(now.at);
        let cleared = if has(motion_control::FAULT) { self.clear_fault(now) } else { Ok(()) };
        let disabled = has(motion_control::DISABLE);
        // When the drive is enabled, levels of the pins and the endless modes may move the motor again.
        self.armed |= now.current.disable(disabled);
        let moved = if disabled || has(motion_control::STOP) {
            self.stop(now);
            if disabled && has(MOTIONS) { Err(Why::Disabled) } else { Ok(()) }
        } else if has(motion_control::DECEL_STOP) {
            self.decelerate(now);
            Ok(())
        } else if has(motion_control::HOME) {
            self.home(now).and_then(|()| self.check(Reg::Speed, now))
        } else if has(motion_control::JOG) {
            self.jog_by_bus(now).and_then(|()| self.check(now.speed_register(), now))
        } else if has(motion_control::MOVE) {
            self.profile(false, now).and_then(|()| self.check(now.speed_register(), now))
        } else {
            Ok(())
        };
        let commands = obeyed & (motion_control::STOP | motion_control::DECEL_STOP | MOTIONS);
        let single =
            if REPORTS_REASONS && commands.count_ones() > 1 { Err(Why::SeveralBits) } else { Ok(()) };
        permitted.and(cleared).and(moved).and(single)
    }

    /// Checks a motion that has just started with the speed of this register: the motor needs a current.
    fn check(&self, speed: Reg, now: &Now<'_>) -> Result<(), Why> {
        match self.motor.current() {
            _ if !REPORTS_REASONS => Ok(()),
            0 if now.io.is_inhibited() => Err(Why::Inhibited),
            0 => Err(Why::NoCurrent),
            _ if now.bank.clamped_value(speed) != now.bank.get(speed) => Err(Why::SpeedLimit),
            _ => Ok(()),
        }
    }

    /// Clears a fault. Afterwards the levels of the pins and the endless modes may move the motor again.
    ///
    /// # Errors
    /// The reason why the fault stays.
    fn clear_fault(&mut self, now: &mut Now<'_>) -> Result<(), Why> {
        self.armed |= now.current.clear_fault(now.at)?;
        Ok(())
    }

    /// Starts the motion that the levels of pins 4 and 5 or an endless mode request, if no motion is running
    /// (MD3-21).
    pub(super) fn resume(&mut self, now: &mut Now<'_>) {
        if !self.armed || self.activity != Activity::None {
            return;
        }
        match now.io.mode() {
            Mode::JogDirection | Mode::JogEitherWay => self.jog_by_pins(now),
            // A move or home cycle that takes no time is skipped; else the two could alternate without end
            // (MD3-23).
            Mode::EndlessMoves => {
                let _ = self.profile(false, now);
            }
            Mode::EndlessHomes => {
                let _ = self.profile(false, now).or_else(|_| self.home(now));
            }
            _ => {}
        }
    }

    /// Carries out what follows from an event.
    pub(super) fn settle(&mut self, now: &mut Now<'_>) {
        if now.io.mode().moves_by_itself() {
            self.resume(now);
        }
        self.update_current(now);
    }

    /// Updates the motor's current and the lights.
    fn update_current(&mut self, now: &mut Now<'_>) {
        let stands = self.activity == Activity::None;
        let ma = now.current.update(now.at, now.bank, now.io, stands, now.out);
        self.motor.set_current(now.at, ma, now.out);
    }

    /// Starts a profile move, from standstill only.
    ///
    /// # Errors
    /// The reason why the motor does not move.
    fn profile(&mut self, reversed: bool, now: &mut Now<'_>) -> Result<(), Why> {
        self.can_step(now)?;
        let steps = now.bank.get(Reg::MoveSteps) as i32;
        let steps = if reversed { steps.wrapping_neg() } else { steps };
        self.start_profile(Activity::Profile, steps, now.speed(), now)
    }

    /// Starts a move from standstill as `activity`.
    ///
    /// # Errors
    /// The reason why the move takes no time (MD3-7).
    fn start_profile(
        &mut self,
        activity: Activity,
        steps: i32,
        speed: i32,
        now: &mut Now<'_>,
    ) -> Result<(), Why> {
        let rates = Limits::even(magnitude(speed), now.acceleration());
        if steps == 0 {
            return Err(Why::NoSteps);
        }
        if rates.max_speed == 0 {
            return Err(now.no_speed());
        }
        if rates.acceleration == 0 {
            return Err(Why::NoAcceleration);
        }
        self.start(activity, now);
        self.motor.profile(now.at, steps, rates, now.out);
        Ok(())
    }

    /// Starts a jog from standstill. A running jog ramps to the present speed (MD3-4).
    fn jog_by_bus(&mut self, now: &mut Now<'_>) -> Result<(), Why> {
        match self.activity {
            Activity::Jog(jog) if !jog.is_ending => self.jog(jog.by_pins, jog.reversed, now),
            _ => self.jog(false, false, now),
        }
    }

    /// Starts a jog, or changes the running jog.
    ///
    /// # Errors
    /// Another motion runs, the drive may not move, the speed is 0; or the acceleration is 0, because the
    /// ramp would never end.
    fn jog(&mut self, by_pins: bool, reversed: bool, now: &mut Now<'_>) -> Result<(), Why> {
        let speed = self.jog_speed(reversed, now);
        match self.activity {
            Activity::Jog(_) => {}
            Activity::None => {
                now.current.can_move()?;
                if speed == 0 {
                    return Err(now.no_speed());
                }
            }
            _ => return Err(Why::Moves),
        }
        let acceleration = now.acceleration();
        if acceleration == 0 {
            return Err(Why::NoAcceleration);
        }
        self.start(Activity::Jog(Jog { by_pins, reversed, speed, is_ending: false }), now);
        self.motor.ramp_to(now.at, speed, acceleration, now.out);
        Ok(())
    }

    fn jog_speed(&self, reversed: bool, now: &Now<'_>) -> I24F8 {
        let speed = self.motor.speed(now.speed());
        if reversed { -speed } else { speed }
    }

    /// Starts, changes or ends the jog that pins 4 and 5 control (MD3-22).
    fn jog_by_pins(&mut self, now: &mut Now<'_>) {
        let is_reversed = matches!(self.activity, Activity::Jog(Jog { reversed: true, .. }));
        match (now.io.jog(is_reversed), self.activity) {
            (Some(wanted), Activity::Jog(Jog { by_pins: true, reversed, is_ending: false, .. }))
                if wanted == reversed => {}
            (Some(reversed), Activity::None | Activity::Jog(_)) if self.armed => {
                let _ = self.jog(true, reversed, now);
            }
            (None, Activity::Jog(jog)) if jog.by_pins && !jog.is_ending => {
                self.slow_down(Activity::Jog(Jog { is_ending: true, ..jog }), now);
            }
            _ => {}
        }
    }

    /// Speed, `AlternateSpeed` or the selection between them may have changed. A jog changes its speed at once.
    ///
    /// # Errors
    /// A profile move does not change its speed (7.17).
    pub(super) fn speed_changed(&mut self, now: &mut Now<'_>) -> Result<(), Why> {
        match self.activity {
            Activity::Profile => return Err(Why::NextMove),
            Activity::Jog(jog) if !jog.is_ending && jog.speed != self.jog_speed(jog.reversed, now) => {
                let _ = self.jog(jog.by_pins, jog.reversed, now);
            }
            _ => {}
        }
        Ok(())
    }

    /// "Changing the acceleration while the motor is moving will cause the motor to stop" (7.17): this
    /// applies to a profile move. A jog uses the new acceleration for its next ramp. A ramp that could not
    /// start because the acceleration was 0 starts now (MD3-6).
    pub(super) fn acceleration_changed(&mut self, now: &mut Now<'_>) {
        if self.activity == Activity::Profile {
            self.stop(now);
        }
        self.jog_by_pins(now);
        let _ = self.speed_changed(now);
    }

    /// Starts a home cycle, from standstill only (MD3-37).
    ///
    /// # Errors
    /// The reason why the motor does not move.
    pub(super) fn home(&mut self, now: &mut Now<'_>) -> Result<(), Why> {
        self.can_step(now)?;
        if Homing::of(now.bank).target().is_none() {
            return Err(Why::NoHomingMode);
        }
        match self.home_by(HomePhase::PreOffset, Reg::PreHomeOffset, now) {
            Ok(()) => Ok(()),
            Err(_) => self.search(now),
        }
    }

    /// Starts the move by an offset, as `phase` of a home cycle.
    ///
    /// # Errors
    /// The reason why the move takes no time.
    fn home_by(&mut self, phase: HomePhase, offset: Reg, now: &mut Now<'_>) -> Result<(), Why> {
        // SPEEDSEL does not affect this speed.
        let speed = now.speed_of(Reg::Speed);
        self.start_profile(Activity::Home(phase), now.bank.get(offset) as i32, speed, now)
    }

    /// Starts the search, or the home offset if the target is already present.
    ///
    /// # Errors
    /// The reason why the motion takes no time.
    fn search(&mut self, now: &mut Now<'_>) -> Result<(), Why> {
        let (speed, acceleration) = (magnitude(now.speed_of(Reg::Speed)), now.acceleration());
        if speed == 0 {
            return Err(Why::NoSpeed);
        }
        if acceleration == 0 {
            return Err(Why::NoAcceleration);
        }
        if now.io.is_at_target() {
            let offset = self.home_by(HomePhase::Offset, Reg::HomeOffset, now);
            return offset.map_err(|_| Why::AtHome);
        }
        self.start(Activity::Home(HomePhase::Search), now);
        // "The acceleration is not divided down" (7.5).
        self.motor.ramp_to(now.at, Homing::of(now.bank).search_speed(speed), acceleration, now.out);
        Ok(())
    }

    /// Handles a change of pin 2 or 9 during a search. The drive sees an index at once, and the flag at the
    /// next sample.
    pub(super) fn check_target(&mut self, now: &mut Now<'_>) {
        if self.activity != Activity::Home(HomePhase::Search) || !now.io.is_at_target() {
            return;
        }
        if Homing::of(now.bank).target() == Some(Target::Flag) {
            let samples = (now.at.since(Instant::ZERO) + FLAG_SAMPLE - Duration::TICK) / FLAG_SAMPLE;
            let sample = Instant::ZERO + FLAG_SAMPLE * samples;
            self.activity = Activity::Home(HomePhase::FlagDetected { sample });
        } else {
            self.end_search(now);
        }
    }

    /// Stops the search: at once, or with a ramp.
    fn end_search(&mut self, now: &mut Now<'_>) {
        if Homing::of(now.bank).has_ramp() {
            self.motor.ramp_to(now.at, I24F8::ZERO, now.acceleration(), now.out);
        } else {
            self.motor.halt(now.at, now.out);
        }
        self.activity = Activity::Home(HomePhase::Slowing);
    }

    /// End of the present motion or phase, or the next sample of the flag.
    fn activity_due(&self) -> Instant {
        match self.activity {
            // A jog continues after its ramp has reached standstill, because the speed may rise again
            // (MD3-5).
            Activity::None
            | Activity::Jog(Jog { is_ending: false, .. })
            | Activity::Home(HomePhase::Search) => Instant::NEVER,
            Activity::Home(HomePhase::FlagDetected { sample }) => sample,
            Activity::Profile | Activity::Jog(_) | Activity::DecelStop | Activity::Home(_) => {
                self.motor.end()
            }
        }
    }

    fn on_activity_due(&mut self, now: &mut Now<'_>) {
        let over = self.activity;
        let continues = match over {
            Activity::Home(HomePhase::FlagDetected { .. }) => {
                if now.io.is_at_target() {
                    self.end_search(now);
                } else {
                    self.activity = Activity::Home(HomePhase::Search);
                }
                true
            }
            Activity::Home(HomePhase::PreOffset) => self.search(now).is_ok(),
            Activity::Home(HomePhase::Slowing) => {
                self.home_by(HomePhase::Offset, Reg::HomeOffset, now).is_ok()
            }
            _ => false,
        };
        if continues {
            return;
        }
        self.motor.finish(now.at, now.out);
        self.enter(Activity::None, now);
        if over != Activity::Profile || !self.armed {
            return;
        }
        match now.io.mode() {
            // "The sign of MoveSteps will be negative if the motor is moving backward" (7.8).
            Mode::EndlessMoves => {
                let steps = now.bank.get(Reg::MoveSteps) as i32;
                now.bank.set(Reg::MoveSteps, i64::from(steps.wrapping_neg()));
            }
            Mode::EndlessHomes => {
                let _ = self.home(now);
            }
            _ => {}
        }
    }

    /// Ends any motion with a ramp; bit 4 reads 1 until the motor stands still (MD3-8).
    fn decelerate(&mut self, now: &mut Now<'_>) {
        self.armed = false;
        if self.activity != Activity::None {
            self.slow_down(Activity::DecelStop, now);
        }
    }

    /// Ramps to standstill as `activity`; stops at once if no ramp is possible.
    fn slow_down(&mut self, activity: Activity, now: &mut Now<'_>) {
        let acceleration = now.acceleration();
        if acceleration > 0 && self.motor.ramp_to(now.at, I24F8::ZERO, acceleration, now.out) {
            self.enter(activity, now);
        } else {
            self.halt(now);
        }
    }

    /// Stops any motion at once and disarms the pins.
    fn stop(&mut self, now: &mut Now<'_>) {
        self.armed = false;
        self.halt(now);
    }

    /// Stops any motion at once, at the present position of the motor.
    pub(super) fn halt(&mut self, now: &mut Now<'_>) {
        if self.activity != Activity::None {
            self.motor.halt(now.at, now.out);
            self.enter(Activity::None, now);
        }
    }

    /// Starts a motion. The cutback ends before the first step, because a load that needs the full current
    /// would otherwise hold the motor back (7.3).
    fn start(&mut self, activity: Activity, now: &mut Now<'_>) {
        self.enter(activity, now);
        self.update_current(now);
    }

    /// Changes the present motion. The cutback timeout restarts when a motion begins and when it ends (7.3).
    fn enter(&mut self, activity: Activity, now: &mut Now<'_>) {
        self.activity = activity;
        now.current.restart_cutback(now.at);
    }

    /// Checks that a motion in steps may begin. A DC motor can only jog (7.2).
    fn can_step(&self, now: &Now<'_>) -> Result<(), Why> {
        now.current.can_move()?;
        if self.motor.is_dc() {
            return Err(Why::DcMotor);
        }
        if self.activity == Activity::None { Ok(()) } else { Err(Why::Moves) }
    }
}

/// The amount of a speed of a stepper.
fn magnitude(speed: i32) -> U24F8 {
    // The value is at most 40,000, so the shift does not overflow.
    U24F8::from_bits(speed.unsigned_abs() << 8)
}
