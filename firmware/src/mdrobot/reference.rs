//! The reference: the source of commands, and the order to the motor.
//! The last command decides (p. 7, 12, 15).

mod functions;
#[cfg(test)]
mod tests;

use drivetwin_protocol::registers::Bank;

use self::functions::Function;
use super::drive::{Drive, State};
use super::reasons::Why;
use super::registers::{Pid, function};
use super::servo::{OUTPUTS, Order};
use crate::device::{Context, Instant, REPORTS_REASONS};

/// A slower shaft counts as standing still for the limit switches. From this speed, the ramp of 3,000 rpm in
/// 15 s stops the shaft within one of the 12 counts of a turn. The last edge is then at most a sixth of a
/// second old.
const TURNS_RPM: u32 = 30;

/// The present command, and the source of commands.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reference {
    source: Source,
    /// True if the start signal of the connectors, or of a function, is ON.
    start: bool,
    /// True if RUN/BRAKE is OFF.
    brake: bool,
    command: Command,
    /// True for the directions, CCW and CW, that limit switches forbade at the last check.
    forbidden: [bool; 2],
    /// True while the drive stops the motor before it turns back from a limit switch.
    reverses: bool,
}

/// Source of commands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Source {
    /// True for the bus, false for the CTRL connector.
    bus: bool,
    /// If not `NONE`, only this function of `FUNC_CMD_TYPE` drives the motor.
    function: u16,
}

impl Source {
    /// The source is START/STOP, RUN/BRAKE, DIR and the speed input.
    const CONNECTORS: Self = Self { bus: false, function: function::NONE };
    /// The source is the bus.
    const BUS: Self = Self { bus: true, function: function::NONE };

    fn of(bank: &Bank<Pid, { Pid::WORDS }>) -> Self {
        Self { bus: bank.word(Pid::UI_COM) == 1, function: bank.word(Pid::FUNC_CMD_TYPE) }
    }

    /// Returns true if only a function drives the motor (p. 15).
    fn is_function(self) -> bool {
        self.function != function::NONE
    }
}

/// The command that the motor follows.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Command {
    /// No command.
    Nothing(Release),
    /// The signals of the connectors.
    Connectors {
        /// START/STOP, or the step number, has changed to ON.
        started: bool,
    },
    /// VEL_CMD, in rpm.
    Velocity(i16),
    /// The direction of `START_STOP`, at the speed `COM_TAR_SPEED`.
    StartStop,
    /// `OPEN_VEL_CMD`, in 1/1023 of the supply.
    Open(i16),
    /// `TQ_CMD`, in 1/1023 of `MAX_LOAD`.
    Torque(i16),
    /// A position. The servo stores its count, because clearing the position also shifts the target.
    Position {
        /// Greatest speed in rpm, not negative.
        rpm: i32,
    },
    /// A running function.
    Function(Function),
}

/// State of the motor without a command: a released motor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Release {
    /// The terminals are open.
    Free,
    /// The windings are shorted.
    Brake,
    /// The motor stops as `SLOW_DOWN` and `STOP_STATUS` select.
    Stop,
}

impl Reference {
    /// State at power-on: the connectors are the source of commands.
    pub(super) const NONE: Self = Self {
        source: Source::CONNECTORS,
        start: false,
        brake: false,
        command: Command::Connectors { started: false },
        forbidden: [false; 2],
        reverses: false,
    };
}

/// Decision of the limit switches about an order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Verdict {
    /// The order is executed.
    Permits,
    /// The shaft turns towards an open switch, and the order turns it back: the shaft is stopped first.
    Reverses,
    /// The order is dropped.
    Forbids,
}

impl Drive {
    /// Applies a command written by the bus, if the drive allows it now. Returns the reason why it does not do
    /// what it says.
    pub(super) fn command_written(&mut self, at: Instant, pid: Pid, out: &mut dyn Context) -> Option<Why> {
        match pid {
            Pid::UI_COM | Pid::FUNC_CMD_TYPE => {
                self.reference_changed(at, out);
                return None;
            }
            Pid::FUNC_CMD => return self.function_written(at, out),
            _ if self.state != State::Ready => return None,
            Pid::POSI_VEL_CMD | Pid::INC_POSI_VEL_CMD | Pid::POSI_CMD | Pid::INC_POSI_CMD => {
                return self.position_written(at, pid, out);
            }
            _ => {}
        }
        match self.requested(pid) {
            Err(why) => why,
            // An alarm has freed the motor already.
            Ok(Command::Nothing(Release::Free)) if self.alarms.any() => None,
            Ok(_) if self.alarms.any() => Some(Why::Alarm),
            Ok(command) => {
                self.reference.command = command;
                let order = self.ordered();
                self.apply(at, order, out).or_else(|| self.limited(order))
            }
        }
    }

    /// The command of a PID that is not a position.
    ///
    /// # Errors
    /// The PID may not command now (MDROBOT-13), with the reason. There is no reason if the PID asks for a
    /// standstill and nothing drives, or if the value counts with a later command.
    fn requested(&self, pid: Pid) -> Result<Command, Option<Why>> {
        let drives = self.reference.source == Source::BUS;
        let armed = drives && self.bank.word(Pid::START_STOP) != 0;
        let value = self.bank.get(pid) as i16;
        let idle =
            matches!(self.reference.command, Command::Nothing(_) | Command::Connectors { started: false });
        match pid {
            Pid::TQ_OFF => Ok(Command::Nothing(Release::Free)),
            Pid::BRAKE => Ok(Command::Nothing(Release::Brake)),
            Pid::OPEN_VEL_CMD if armed => Ok(Command::Open(value)),
            Pid::TQ_CMD if armed => Ok(Command::Torque(value)),
            // After a dropped command, speed 0 has no effect, because there is no speed to ramp down.
            _ if idle && value == 0 => Err(None),
            Pid::VEL_CMD if armed => Ok(Command::Velocity(value)),
            // A speed other than 0 drives. Speed 0 only ends a motion that `START_STOP` has started.
            Pid::START_STOP | Pid::COM_TAR_SPEED if armed => {
                if self.bank.word(Pid::COM_TAR_SPEED) != 0 || self.reference.command == Command::StartStop {
                    return Ok(Command::StartStop);
                }
                Err(Some(if pid == Pid::START_STOP { Why::ArmsOnly } else { Why::OtherCommand }))
            }
            Pid::COM_TAR_SPEED => Err((value < 0).then_some(Why::Unsigned)),
            Pid::START_STOP if drives => Ok(Command::Nothing(Release::Stop)),
            Pid::START_STOP if value == 0 => Err(Some(Why::StopsNothing)),
            Pid::START_STOP if !self.reference.source.is_function() => Err(Some(Why::ArmsLater)),
            _ => Err(Some(self.other_source().unwrap_or(Why::NotArmed))),
        }
    }

    /// The reason why the bus does not command; `None` if it does.
    fn other_source(&self) -> Option<Why> {
        match self.reference.source {
            Source::BUS => None,
            source if source.is_function() => Some(Why::OnlyFunction),
            _ => Some(Why::Inputs),
        }
    }

    /// The reason why `order` is slower than the present command.
    fn limited(&self, order: Order) -> Option<Why> {
        let (rpm, unsigned) = match self.reference.command {
            Command::Velocity(rpm) => (rpm.unsigned_abs(), false),
            Command::StartStop => (self.bank.word(Pid::COM_TAR_SPEED), true),
            _ => return None,
        };
        match order {
            _ if !REPORTS_REASONS => None,
            Order::Velocity(acts) if acts.unsigned_abs() == u32::from(rpm) => None,
            Order::Velocity(0) => Some(Why::NoMaxRpm),
            _ if unsigned && rpm > i16::MAX.unsigned_abs() => Some(Why::Unsigned),
            _ => Some(Why::MaxRpm),
        }
    }

    /// Applies a written `FUNC_CMD`.
    fn function_written(&mut self, at: Instant, out: &mut dyn Context) -> Option<Why> {
        let why = self.reference_changed(at, out);
        match self.bank.word(Pid::FUNC_CMD) {
            0 => None,
            _ if !self.reference.source.is_function() => Some(Why::NoFunction),
            _ => why,
        }
    }

    /// Applies a written position command: low word, high word, and possibly a speed.
    fn position_written(&mut self, at: Instant, pid: Pid, out: &mut dyn Context) -> Option<Why> {
        let words = self.bank.get(pid);
        let count = self.turned(words as i32);
        let here = matches!(pid, Pid::INC_POSI_CMD | Pid::INC_POSI_VEL_CMD);
        let count = if here { self.relative(count) } else { count };
        let (rpm, limit) = match pid {
            Pid::POSI_VEL_CMD | Pid::INC_POSI_VEL_CMD => {
                (i32::from((words >> 32) as i16).abs(), self.max_rpm())
            }
            // The factory value is beyond the factory value of `MAX_RPM`.
            _ => (self.bank.word(Pid::TAR_POSI_VEL).into(), i32::MAX),
        };
        let barred = self.other_source().or(self.alarms.any().then_some(Why::Alarm));
        if barred.is_some() {
            return barred;
        }
        self.reference.command = Command::Position { rpm };
        self.apply(at, self.position(count, rpm), out).or((rpm > limit).then_some(Why::MaxRpm))
    }

    /// Applies a write of a register that selects the source of commands, or the meaning of a command or an
    /// input. Returns the reason why `FUNC_CMD` does not start a function.
    pub(super) fn reference_changed(&mut self, at: Instant, out: &mut dyn Context) -> Option<Why> {
        let why = if self.update_source() {
            // A signal that is already ON does not start the new command.
            self.reference.start = self.state == State::Ready && self.start_signal();
            None
        } else {
            self.signals_changed(at, out)
        };
        why.or(self.update_order(at, out))
    }

    /// Handles the end of the start-up: a command of the connectors starts. A function waits until its signal
    /// changes to ON (p. 17).
    pub(super) fn sources_ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.update_source();
        if self.reference.source.is_function() {
            self.reference.start = self.start_signal();
        }
        self.signals_changed(at, out);
        self.update_order(at, out);
    }

    /// Handles an alarm: drops the command and releases the motor.
    pub(super) fn drop_reference(&mut self, at: Instant, out: &mut dyn Context) {
        self.reference.command = Command::Nothing(Release::Free);
        self.servo.order(at, Order::Free, out);
    }

    /// Handles the clearing of the last alarm.
    pub(super) fn alarms_cleared(&mut self, at: Instant, out: &mut dyn Context) {
        self.brake_dropped();
        self.update_order(at, out);
    }

    /// Time of the next deadline of the inputs or of a function.
    pub(super) fn sources_due(&self) -> Instant {
        self.inputs.due().min(self.function_due())
    }

    /// Handles the deadline of [`Drive::sources_due`].
    pub(super) fn sources_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        let measured = self.inputs.timeout(at);
        if self.function_timeout(at) || measured {
            self.update_order(at, out);
        }
    }

    /// Updates the source of commands. Returns true if the source has changed. Then the motor stops and waits
    /// for a command of the new source; a dropped command stays dropped (MDROBOT-12).
    fn update_source(&mut self) -> bool {
        let source = Source::of(&self.bank);
        let another = source != core::mem::replace(&mut self.reference.source, source);
        if another {
            self.reference.command = match (self.reference.command, source) {
                (dropped @ Command::Nothing(Release::Free | Release::Brake), _) => dropped,
                (_, Source::CONNECTORS) => Command::Connectors { started: false },
                _ => Command::Nothing(Release::Stop),
            };
            self.brake_dropped();
        }
        another
    }

    /// While the connectors are the source, RUN/BRAKE at OFF also brakes a released motor.
    fn brake_dropped(&mut self) {
        if self.is_braked() {
            self.set_release(Release::Brake);
        }
    }

    /// Sets the state of a released motor, if the connectors are the source.
    fn set_release(&mut self, release: Release) {
        let Reference { source: Source::CONNECTORS, command: Command::Nothing(left), .. } =
            &mut self.reference
        else {
            return;
        };
        *left = release;
    }

    /// Handles a possible change of START/STOP, RUN/BRAKE, the step number or `FUNC_CMD`. Returns the reason
    /// why a signal that is ON does not start a function.
    pub(super) fn signals_changed(&mut self, at: Instant, out: &mut dyn Context) -> Option<Why> {
        if self.state != State::Ready {
            return None;
        }
        let (on, brake) = (self.start_signal(), self.is_braked());
        let was_on = core::mem::replace(&mut self.reference.start, on);
        let was_braked = core::mem::replace(&mut self.reference.brake, brake);
        if self.alarms.any() {
            return on.then_some(Why::AlarmFunction);
        }
        if brake != was_braked {
            self.set_release(if brake { Release::Brake } else { Release::Free });
        }
        if on == was_on {
            return on.then_some(Why::SignalOn);
        }
        let connectors = matches!(self.reference.command, Command::Connectors { .. });
        match self.reference.source {
            source if source.is_function() && on => return self.start_function(at, out),
            source if source.is_function() => self.release_function(),
            // A command that `TQ_OFF`, BRAKE or an alarm has dropped starts again when the signal changes to
            // ON (MDROBOT-14).
            Source::CONNECTORS if on || connectors => {
                self.reference.command = Command::Connectors { started: on };
            }
            Source { .. } => {}
        }
        None
    }

    /// Returns true if the start signal of the connectors, or of a function, is ON.
    fn start_signal(&self) -> bool {
        let source = self.reference.source;
        let contact = match self.step().filter(|_| !source.is_function()) {
            Some(step) => step != 0,
            None => self.start_contact(),
        };
        let by_bus = source.is_function() && self.bank.word(Pid::FUNC_CMD) != 0;
        !source.bus && contact || by_bus
    }

    /// Gives the motor the order of the present command. Returns the reason why the motor does not turn.
    pub(super) fn update_order(&mut self, at: Instant, out: &mut dyn Context) -> Option<Why> {
        self.apply(at, self.ordered(), out)
    }

    /// Gives `order` to the servo, unless the drive is not ready, an alarm is active, or a limit switch
    /// forbids the order. Returns the reason why the motor does not turn.
    pub(super) fn apply(&mut self, at: Instant, order: Order, out: &mut dyn Context) -> Option<Why> {
        if self.state != State::Ready || self.alarms.any() {
            return None;
        }
        let verdict = self.check_limits(at, order);
        self.reference.reverses = verdict == Verdict::Reverses;
        let order = match verdict {
            Verdict::Permits => order,
            // The ramp from the present speed would continue towards the switch, so the speed is controlled
            // at 0.
            Verdict::Reverses => Order::Position { count: self.servo.target(), rpm: 0 },
            Verdict::Forbids => {
                let release = if self.flag(Pid::LIMIT_STOP_COND) { Release::Brake } else { Release::Free };
                self.reference.command = Command::Nothing(release);
                self.ordered()
            }
        };
        self.servo.order(at, order, out);
        match verdict {
            Verdict::Permits => self.servo.stands(),
            Verdict::Reverses => None,
            Verdict::Forbids => Some(Why::LimitSwitch),
        }
    }

    /// Checks if a shaft that is to turn back from a limit switch stands still by now.
    pub(super) fn reverse_when_slow(&mut self, at: Instant, out: &mut dyn Context) {
        if self.reference.reverses {
            self.update_order(at, out);
        }
    }

    /// Returns true while the drive stops a motor that is to turn back from a limit switch.
    pub(super) fn reverses(&self) -> bool {
        self.reference.reverses
    }

    /// Checks an order against the limit switches (MDROBOT-23). An open switch forbids an order that turns the motor
    /// towards this switch. When a switch opens, the drive also stops a shaft that still turns towards this switch
    /// while a speed or position order slows the shaft down. A later order away from the switch is executed.
    fn check_limits(&mut self, at: Instant, order: Order) -> Verdict {
        let now = [self.limit_forbids(1), self.limit_forbids(-1)];
        let before = core::mem::replace(&mut self.reference.forbidden, now);
        if !self.reference.source.bus {
            return Verdict::Permits;
        }
        let shaft = match self.servo.rpm(at) {
            rpm if rpm.unsigned_abs() < TURNS_RPM => 0,
            rpm => rpm,
        };
        // Directions of the order and of the shaft, positive CCW.
        let [way, shaft] = match order {
            Order::Free | Order::Brake => [0, 0],
            Order::Velocity(rpm) => [rpm, shaft],
            // Open loop and torque in the other direction brake the shaft at once.
            Order::Open(part) | Order::Torque(part) => [part.into(), 0],
            // A position order within the window has no distance to go.
            Order::Position { count, .. } => match self.servo.distance_to(count) {
                error if error.unsigned_abs() <= u64::from(self.bank.word(Pid::IN_POSITION).max(1)) => {
                    [0, shaft]
                }
                error => [error.signum() as i32, shaft],
            },
        };
        let has_opened = now.iter().zip(before).any(|(now, before)| *now && !before);
        match order {
            _ if self.limit_forbids(way) => Verdict::Forbids,
            _ if !self.limit_forbids(shaft) => Verdict::Permits,
            _ if way == 0 || has_opened => Verdict::Forbids,
            Order::Velocity(_) => Verdict::Reverses,
            // A position order has no ramp.
            _ => Verdict::Permits,
        }
    }

    /// The order to the motor that follows from the present command.
    fn ordered(&self) -> Order {
        match self.reference.command {
            Command::Nothing(Release::Free) => Order::Free,
            Command::Nothing(Release::Brake) => Order::Brake,
            Command::Nothing(Release::Stop) => Order::Velocity(0),
            Command::Connectors { started } => self.connected(started),
            Command::Velocity(rpm) => self.velocity(rpm.into()),
            Command::StartStop => {
                let rpm = i32::from(self.bank.word(Pid::COM_TAR_SPEED));
                self.velocity(if self.bank.word(Pid::START_STOP) == 2 { -rpm } else { rpm })
            }
            Command::Open(part) => Order::Open(self.turned(part.into()) as i16),
            Command::Torque(part) => Order::Torque(self.turned(part.into()) as i16),
            Command::Position { rpm } | Command::Function(Function::Position { rpm }) => {
                self.position(self.servo.target(), rpm)
            }
            Command::Function(
                Function::Speed { rpm, .. } | Function::Momentary { rpm } | Function::Add { rpm, .. },
            ) => self.velocity(rpm),
        }
    }

    /// The order of the connectors to the motor; a torque if `TQ_CTRL` is 1 (MDROBOT-25).
    fn connected(&self, started: bool) -> Order {
        if self.is_braked() {
            return Order::Brake;
        }
        if !started {
            return Order::Velocity(0);
        }
        let input = self.speed_input();
        if self.flag(Pid::TQ_CTRL) {
            // The value is at most full scale, which fits in a word.
            Order::Torque(self.turned(input.of(OUTPUTS)) as i16)
        } else {
            self.velocity(input.of(self.full_speed()))
        }
    }

    /// The order for a speed in rpm, after `INV_SIGN_CMD` and limited by `MAX_RPM`.
    fn velocity(&self, rpm: i32) -> Order {
        let most = self.max_rpm();
        Order::Velocity(self.turned(rpm).min(most).max(-most))
    }

    /// The order for a position; its greatest speed `rpm` is limited by `MAX_RPM`.
    pub(super) fn position(&self, count: i32, rpm: i32) -> Order {
        Order::Position { count, rpm: rpm.min(self.max_rpm()) }
    }

    /// The position `counts` away from the motor's present position, limited to the range of positions.
    pub(super) fn relative(&self, counts: i32) -> i32 {
        self.servo.position().saturating_add(counts)
    }

    /// The reference, with the opposite sign if `INV_SIGN_CMD` is 1 (MDROBOT-15).
    pub(super) fn turned(&self, reference: i32) -> i32 {
        if self.flag(Pid::INV_SIGN_CMD) { reference.saturating_neg() } else { reference }
    }

    /// The value of `MAX_RPM`, limited to its range.
    pub(super) fn full_speed(&self) -> u16 {
        self.bank.clamped_value(Pid::MAX_RPM) as u16
    }

    fn max_rpm(&self) -> i32 {
        self.full_speed().into()
    }
}
