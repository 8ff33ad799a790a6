//! The motor: its steps, moves, limits, homing, jog, currents, and the encoder on its shaft.
//!
//! Positions and velocities are in steps here. With EE = 1, orders in counts are converted to steps, and
//! values are converted back when a variable is read.
//!
//! | file | content |
//! |---|---|
//! | `motor` | the plan that turns the motor, its shaft, its current |
//! | `response` | SS: the maximum speed of a Hybrid's rotor |
//! | `encoder` | the encoder on the shaft, or a remote one |
//! | `scale` | steps and counts |
//! | `orders` | moves and slews, and how one follows another |
//! | `pause` | PS and RS |
//! | `jog` | motion by jog contacts |
//! | `limits` | contacts, and stops at limits |
//! | `home` | homing to a switch or to the index |
//! | `closed` | EE = 1: stalls, corrections, position maintenance |
//! | `follow` | clock inputs |
//! | `readback` | values of variables |
//! | `circuit` | motion by a Hybrid's circuitry |

mod circuit;
mod closed;
mod encoder;
mod follow;
mod home;
mod jog;
mod limits;
mod motor;
mod orders;
mod pause;
mod readback;
mod response;
mod scale;
#[cfg(test)]
mod tests;

use heapless::Deque;

use self::closed::Closed;
pub(super) use self::encoder::Channel;
use self::encoder::Encoder;
use self::follow::Follow;
use self::motor::Motor;
use self::orders::{Activity, Task};
use super::error::Error;
use super::reasons::Why;
use crate::device::{Context, Duration, Instant};
use crate::motor::stepper::StepperParameters;

/// Settings of the motion: present values of variables.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Settings {
    /// Initial speed VI and maximum speed VM, in steps/s or counts/s.
    pub(super) start: u32,
    pub(super) speed: u32,
    /// Acceleration A and deceleration D.
    pub(super) up: u32,
    pub(super) down: u32,
    /// MS: microsteps in a full step.
    pub(super) microsteps: u16,
    /// Settling time MT and delay HT to the holding current, in ms.
    pub(super) settle_ms: u16,
    pub(super) hold_delay_ms: u16,
    /// Run current RC and holding current HC, in %.
    pub(super) run_percent: u8,
    pub(super) hold_percent: u8,
    /// DE: true if the output bridge is on.
    pub(super) enabled: bool,
    /// Maximum speed of the rotor, in steps/s: SS of a Hybrid with AS 1 and 2.
    pub(super) response: u32,
    /// True if the circuitry keeps the field next to a rotor that does not follow: AS of a Hybrid is not 0.
    pub(super) keeps_field: bool,
    /// LM: reaction to a limit, 1 to 6.
    pub(super) limit_mode: u8,
    /// Debounce time of the home switch, one of D1 to D4, in ms.
    pub(super) home_debounce_ms: u8,
    /// JE: true if jog contacts turn the motor.
    pub(super) jogs: bool,
    /// CM with clock inputs: limits and jog have no effect.
    pub(super) follows_clock: bool,
    /// Clock ratio CR, in thousandths.
    pub(super) ratio: u16,
    /// EE: true if the user's units are counts. EL: lines of the encoder.
    pub(super) closed: bool,
    pub(super) lines: u16,
    /// Deadband DB and stall factor SF, in counts; SM: continue after a stall; PM: position maintenance.
    pub(super) deadband: u16,
    pub(super) stall_factor: u16,
    pub(super) goes_on_stalled: bool,
    pub(super) maintains: bool,
    /// The motor and its load.
    pub(super) machine: StepperParameters,
}

/// Motion command. Positions and speeds are in the user's units: steps, or counts with EE = 1.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Order {
    /// MA: move to a position.
    To { position: i32, notify_on_end: bool, continuous: bool },
    /// MR: move by a distance.
    By { distance: i32, notify_on_end: bool, continuous: bool },
    /// SL: turn at this speed.
    Slew(i32),
    /// HM: homing to the switch, with type 1 to 4.
    Home(u8),
    /// HI: homing to the index, with type 1 to 4.
    HomeToIndex(u8),
}

/// Contacts that the motion uses, each of them active or not.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Contact {
    Home,
    PlusLimit,
    MinusLimit,
    JogPlus,
    JogMinus,
}

/// Events of the motion for the rest of the drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Event {
    /// An error.
    Failed(Error),
    /// A limit also stops the program (LM 3, 6).
    StopsProgram,
    /// A move with parameter 2 has ended: the drive sends its name.
    Announce,
}

/// The motor, and the state of its motion.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    settings: Settings,
    motor: Motor,
    encoder: Encoder,
    /// Offset of C1 to the position of the plan, and of C2 to the count of the encoder.
    c1: i32,
    c2: i32,
    /// Lag of the rotor, in steps, at which a Hybrid reports a lag of 0.
    lag_origin: i32,
    activity: Activity,
    /// Deadline of the activity.
    due: Instant,
    /// Task that begins when the present motion has ended.
    waiting: Option<Task>,
    /// PS: no motion begins before RS. `left` is the interrupted task.
    paused: bool,
    left: Option<Task>,
    /// Active contacts, one bit each.
    contacts: u8,
    closed: Closed,
    follow: Follow,
    /// Time at which the index changes during a homing to the index.
    index_due: Instant,
    on_index: bool,
    /// Time since which the motor has been at rest.
    rested: Instant,
    /// True if the current is that of HC.
    holds: bool,
    events: Deque<Event, 8>,
    changed: bool,
}

impl Motion {
    /// Creates a motor at rest at position 0. The settings give the number of lines of the built-in
    /// encoder.
    pub(super) fn new(settings: Settings) -> Self {
        Self {
            settings,
            motor: Motor::new(settings.microsteps),
            encoder: Encoder::new(settings.lines),
            c1: 0,
            c2: 0,
            lag_origin: 0,
            activity: Activity::Rest,
            due: Instant::NEVER,
            waiting: None,
            paused: false,
            left: None,
            contacts: 0,
            closed: Closed::NEW,
            follow: Follow::NEW,
            index_due: Instant::NEVER,
            on_index: false,
            rested: Instant::ZERO,
            holds: true,
            events: Deque::new(),
            changed: false,
        }
    }

    /// Handles power-on or a restart: clears everything except the shaft's position, the levels of the remote
    /// encoder, and the blocking of the shaft. Contacts that are active follow as events.
    pub(super) fn power_on(&mut self, at: Instant, settings: Settings, out: &mut dyn Context) {
        self.settings = settings;
        self.motor.set_microsteps(at, settings.microsteps);
        self.motor.load(at, settings.machine);
        self.motor.keep_field(at, settings.keeps_field);
        self.motor.limit(at, settings.response, out);
        self.motor.power_on(at, out);
        (self.c1, self.c2) = (0, self.encoder.count(at, &self.motor).wrapping_neg());
        self.enter_rest(at);
        self.waiting = None;
        (self.paused, self.left) = (false, None);
        self.contacts = 0;
        (self.closed, self.follow) = (Closed::NEW, Follow::NEW);
        self.keep(at);
        self.holds = true;
        self.events.clear();
        self.clear_lag(at);
        self.refresh(at, out);
    }

    /// Disconnects the remote encoder.
    pub(super) fn unplug(&mut self, at: Instant) {
        for channel in [Channel::A, Channel::B, Channel::Index] {
            self.encoder.channel(at, &self.motor, channel, None);
        }
    }

    /// Applies new values of variables. A move in progress keeps the speed and the ramps with which it began
    /// (MDRIVE-17).
    pub(super) fn set(&mut self, at: Instant, settings: Settings, out: &mut dyn Context) {
        let before = core::mem::replace(&mut self.settings, settings);
        if settings == before {
            return;
        }
        self.motor.set_microsteps(at, settings.microsteps);
        self.motor.load(at, settings.machine);
        self.motor.keep_field(at, settings.keeps_field);
        self.motor.limit(at, settings.response, out);
        let is_another = settings.machine.steps_per_rev != before.machine.steps_per_rev;
        if is_another {
            self.clear_lag(at);
        }
        if is_another || (settings.closed, settings.lines) != (before.closed, before.lines) {
            self.watch_from(at);
        }
        if (settings.closed && settings.maintains) != (before.closed && before.maintains) {
            self.keep(at);
        }
        if (settings.follows_clock, settings.follows_at_once())
            != (before.follows_clock, before.follows_at_once())
        {
            self.end_following(at, out);
        }
        self.permit_jog(at, before.jogs, out);
        if settings.enabled && !before.enabled {
            self.maintain(at, out);
        }
        self.refresh(at, out);
    }

    /// Returns true if the bridge is off although the circuitry is on (MC 5-50).
    pub(super) fn lacks_bridge(&self) -> bool {
        self.settings.keeps_field && !self.settings.enabled
    }

    /// Executes a motion command.
    ///
    /// # Errors
    /// Error 81, 85, 93: the state forbids it; 21: the distance has more than 32 bits of steps. Nothing has changed
    /// then. (The I/O reports 80, the Hybrid 88.) The inner error is the reason why the command does not begin now.
    pub(super) fn order(
        &mut self,
        at: Instant,
        order: Order,
        out: &mut dyn Context,
    ) -> Result<Result<(), Why>, Error> {
        let begins = self.begin_order(at, order, out)?;
        self.refresh(at, out);
        Ok(begins)
    }

    /// Checks that the present motion uses new values of A, D and VI, or of VM (`is_speed`).
    ///
    /// # Errors
    /// The motion keeps the values with which it began (MDRIVE-17).
    pub(super) fn needs_rates(&self, is_speed: bool) -> Result<(), Why> {
        match self.activity {
            Activity::Moves(_) => Err(Why::KeepsRates),
            Activity::Slews(_) if is_speed => Err(Why::SlewHasSpeed),
            Activity::Slews(_) => Err(Why::NextSpeed),
            _ => Ok(()),
        }
    }

    /// Stops any motion with the deceleration D.
    pub(super) fn stop(&mut self, at: Instant, out: &mut dyn Context) {
        self.clear_waiting();
        self.ramp_down(at, false, out);
        self.refresh(at, out);
    }

    /// Stops any motion without a ramp (Esc).
    pub(super) fn halt(&mut self, at: Instant, out: &mut dyn Context) {
        self.clear_waiting();
        self.stop_at_once(at, out);
        self.refresh(at, out);
    }

    /// Sets the level of a remote encoder's pin; `None` if nothing drives the pin any more.
    pub(super) fn channel(
        &mut self,
        at: Instant,
        channel: Channel,
        level: Option<bool>,
        out: &mut dyn Context,
    ) {
        self.encoder.channel(at, &self.motor, channel, level);
        self.counted(at, out);
        self.refresh(at, out);
    }

    /// Adds edges that a remote encoder has made. Its channels A and B have these levels now.
    pub(super) fn count(&mut self, at: Instant, edges: i32, channels: [bool; 2], out: &mut dyn Context) {
        self.encoder.take_edges(at, &self.motor, edges, channels);
        self.counted(at, out);
        self.refresh(at, out);
    }

    /// Blocks the shaft, or releases it.
    pub(super) fn block_shaft(&mut self, at: Instant, blocked: bool, out: &mut dyn Context) {
        self.motor.set_blocked(at, blocked);
        self.counted(at, out);
        self.refresh(at, out);
    }

    /// Takes the oldest event, if any.
    pub(super) fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    fn push_event(&mut self, event: Event) {
        let told = self.events.push_back(event);
        debug_assert!(
            told.is_ok(),
            "the drive takes events after each thing that happens, each line of a message, too"
        );
    }

    fn fail(&mut self, error: Error) {
        self.push_event(Event::Failed(error));
    }

    pub(super) fn deadline(&self) -> Instant {
        let shaft = self.motor.deadline().min(self.index_due).min(self.closed.due);
        shaft.min(self.due).min(self.hold_due())
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.motor.deadline() <= at {
            self.motor.timeout(at, out);
            // Keeps the compared positions within 32 bits of each other.
            self.closed.rebase(
                self.settings.scale(),
                self.motor.position(at),
                self.encoder.count(at, &self.motor),
            );
            self.counted(at, out);
        }
        if self.closed.due <= at {
            self.counted(at, out);
        }
        if self.due <= at {
            self.activity_due(at, out);
        }
        self.refresh(at, out);
    }

    /// Updates the motor current and the deadlines.
    fn refresh(&mut self, at: Instant, out: &mut dyn Context) {
        self.look_at_index(at, out);
        if self.hold_due() <= at {
            self.holds = true;
        }
        self.motor.energize(at, self.percent(), self.spins(), out);
        self.watch(at);
    }

    /// Current that the motor is to have, in %; `None` if the bridge is off.
    fn percent(&self) -> Option<u8> {
        let Settings { enabled, run_percent, hold_percent, .. } = self.settings;
        let percent = match self.activity {
            Activity::CircuitDriven { percent, .. } => percent,
            _ if self.holds => hold_percent,
            _ => run_percent,
        };
        enabled.then_some(percent)
    }

    /// Returns true if the current does not fall to that of HC, because HT is 0 (MDRIVE-19).
    pub(super) fn never_holds(&self) -> bool {
        !self.holds && self.settings.hold_delay_ms == 0
    }

    /// Time at which the current falls to that of HC: HT after the end of all motion, or never (MC 5-32;
    /// MDRIVE-19).
    fn hold_due(&self) -> Instant {
        match self.activity {
            Activity::Rest if !self.holds && !self.never_holds() => {
                self.rested + Duration::millis(self.settings.hold_delay_ms.into())
            }
            _ => Instant::NEVER,
        }
    }
}
