//! The reference: the source of commands, and the order to the motor.
//! The last command decides (p. 7, 12, 15).

mod functions;
mod limits;

use self::functions::Function;
use self::limits::{Limits, Verdict};
use super::inputs::Inputs;
use super::reasons::Why;
use super::registers::{Pid, Words, flag, function, max_rpm};
use super::servo::{OUTPUTS, Order, Servo};
use crate::device::{Context, Instant, REPORTS_REASONS};

/// An event that concerns the reference.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Event {
    /// The start-up ends.
    Ready,
    /// The bus has written a command.
    Command(Pid),
    /// A register has changed that selects the source of commands, or the meaning of a command or an input.
    Setting,
    /// A contact has changed.
    Contact,
    /// The order to the motor may change: there is a new measurement of the speed input, a function has ended, or a shaft
    /// that is to turn back from a limit switch may stand still by now.
    Update,
    /// An alarm has begun.
    Alarm,
    /// The last alarm has been cleared.
    NoAlarm,
}

/// The instant of an event, and the parts of the drive that the reference reads or changes.
pub(super) struct Environment<'a> {
    pub(super) at: Instant,
    pub(super) bank: &'a Words,
    pub(super) inputs: &'a Inputs,
    pub(super) servo: &'a mut Servo,
    /// False during the start-up.
    pub(super) is_ready: bool,
    pub(super) has_alarm: bool,
    pub(super) out: &'a mut dyn Context,
}

impl Environment<'_> {
    /// Returns true if RUN/BRAKE requests the electric brake.
    fn is_braked(&self) -> bool {
        self.inputs.is_braked(self.bank)
    }

    /// The order for a speed in rpm, after `INV_SIGN_CMD` and limited by `MAX_RPM`.
    fn velocity(&self, rpm: i32) -> Order {
        let most = self.max_rpm();
        Order::Velocity(self.turned(rpm).min(most).max(-most))
    }

    /// The order for a position; its greatest speed `rpm` is limited by `MAX_RPM`.
    fn position(&self, count: i32, rpm: i32) -> Order {
        Order::Position { count, rpm: rpm.min(self.max_rpm()) }
    }

    /// The position `counts` away from the motor's present position, limited to the range of positions.
    fn relative(&self, counts: i32) -> i32 {
        self.servo.position().saturating_add(counts)
    }

    /// The reference, with the opposite sign if `INV_SIGN_CMD` is 1 (MDROBOT-15).
    fn turned(&self, reference: i32) -> i32 {
        if flag(self.bank, Pid::INV_SIGN_CMD) { reference.saturating_neg() } else { reference }
    }

    fn max_rpm(&self) -> i32 {
        max_rpm(self.bank).into()
    }
}

/// The present command, and the source of commands.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reference {
    source: Source,
    /// True if the start signal of the connectors, or of a function, is ON.
    start: bool,
    /// True if RUN/BRAKE is OFF.
    brake: bool,
    command: Command,
    limits: Limits,
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

    fn of(bank: &Words) -> Self {
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
        limits: Limits::NONE,
        reverses: false,
    };

    /// Handles an event. Returns the reason why a command of the bus does not do what it says.
    pub(super) fn handle(&mut self, event: Event, env: &mut Environment<'_>) -> Option<Why> {
        match event {
            Event::Command(pid) => return self.command_written(pid, env),
            Event::Setting => return self.changed(env),
            // A command of the connectors starts. A function waits until its signal changes to ON (p. 17).
            Event::Ready => {
                self.update_source(env);
                if self.source.is_function() {
                    self.start = self.start_signal(env);
                }
                self.signals_changed(env);
            }
            Event::Contact => {
                self.signals_changed(env);
            }
            Event::Update => {}
            Event::Alarm => {
                self.command = Command::Nothing(Release::Free);
                env.servo.order(env.at, Order::Free, env.out);
                return None;
            }
            Event::NoAlarm => self.brake_dropped(env),
        }
        self.update_order(env);
        None
    }

    /// Applies a command written by the bus, if the drive allows it now. Returns the reason why it does not do
    /// what it says.
    fn command_written(&mut self, pid: Pid, env: &mut Environment<'_>) -> Option<Why> {
        match pid {
            Pid::FUNC_CMD => return self.function_written(env),
            _ if !env.is_ready => return None,
            Pid::POSI_VEL_CMD | Pid::INC_POSI_VEL_CMD | Pid::POSI_CMD | Pid::INC_POSI_CMD => {
                return self.position_written(pid, env);
            }
            _ => {}
        }
        match self.requested(pid, env) {
            Err(why) => why,
            // An alarm has freed the motor already.
            Ok(Command::Nothing(Release::Free)) if env.has_alarm => None,
            Ok(_) if env.has_alarm => Some(Why::Alarm),
            Ok(command) => {
                self.command = command;
                let order = self.ordered(env);
                self.apply(order, env).or_else(|| self.limited(order, env))
            }
        }
    }

    /// The command of a PID that is not a position.
    ///
    /// # Errors
    /// The PID may not command now (MDROBOT-13), with the reason. There is no reason if the PID asks for a
    /// standstill and nothing drives, or if the value counts with a later command.
    fn requested(&self, pid: Pid, env: &Environment<'_>) -> Result<Command, Option<Why>> {
        let drives = self.source == Source::BUS;
        let armed = drives && env.bank.word(Pid::START_STOP) != 0;
        let value = env.bank.get(pid) as i16;
        let idle = matches!(self.command, Command::Nothing(_) | Command::Connectors { started: false });
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
                if env.bank.word(Pid::COM_TAR_SPEED) != 0 || self.command == Command::StartStop {
                    return Ok(Command::StartStop);
                }
                Err(Some(if pid == Pid::START_STOP { Why::ArmsOnly } else { Why::OtherCommand }))
            }
            Pid::COM_TAR_SPEED => Err((value < 0).then_some(Why::Unsigned)),
            Pid::START_STOP if drives => Ok(Command::Nothing(Release::Stop)),
            Pid::START_STOP if value == 0 => Err(Some(Why::StopsNothing)),
            Pid::START_STOP if !self.source.is_function() => Err(Some(Why::ArmsLater)),
            _ => Err(Some(self.other_source().unwrap_or(Why::NotArmed))),
        }
    }

    /// The reason why the bus does not command; `None` if it does.
    fn other_source(&self) -> Option<Why> {
        match self.source {
            Source::BUS => None,
            source if source.is_function() => Some(Why::OnlyFunction),
            _ => Some(Why::Inputs),
        }
    }

    /// The reason why `order` is slower than the present command.
    fn limited(&self, order: Order, env: &Environment<'_>) -> Option<Why> {
        let (rpm, unsigned) = match self.command {
            Command::Velocity(rpm) => (rpm.unsigned_abs(), false),
            Command::StartStop => (env.bank.word(Pid::COM_TAR_SPEED), true),
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
    fn function_written(&mut self, env: &mut Environment<'_>) -> Option<Why> {
        let why = self.changed(env);
        match env.bank.word(Pid::FUNC_CMD) {
            0 => None,
            _ if !self.source.is_function() => Some(Why::NoFunction),
            _ => why,
        }
    }

    /// Applies a written position command: low word, high word, and possibly a speed.
    fn position_written(&mut self, pid: Pid, env: &mut Environment<'_>) -> Option<Why> {
        let words = env.bank.get(pid);
        let count = env.turned(words as i32);
        let here = matches!(pid, Pid::INC_POSI_CMD | Pid::INC_POSI_VEL_CMD);
        let count = if here { env.relative(count) } else { count };
        let (rpm, limit) = match pid {
            Pid::POSI_VEL_CMD | Pid::INC_POSI_VEL_CMD => {
                (i32::from((words >> 32) as i16).abs(), env.max_rpm())
            }
            // The factory value is beyond the factory value of `MAX_RPM`.
            _ => (env.bank.word(Pid::TAR_POSI_VEL).into(), i32::MAX),
        };
        let barred = self.other_source().or(env.has_alarm.then_some(Why::Alarm));
        if barred.is_some() {
            return barred;
        }
        self.command = Command::Position { rpm };
        self.apply(env.position(count, rpm), env).or((rpm > limit).then_some(Why::MaxRpm))
    }

    /// Applies a write of a register that selects the source of commands, or the meaning of a command or an
    /// input. Returns the reason why `FUNC_CMD` does not start a function.
    fn changed(&mut self, env: &mut Environment<'_>) -> Option<Why> {
        let why = if self.update_source(env) {
            // A signal that is already ON does not start the new command.
            self.start = env.is_ready && self.start_signal(env);
            None
        } else {
            self.signals_changed(env)
        };
        why.or(self.update_order(env))
    }

    /// End of the running function.
    pub(super) fn deadline(&self) -> Instant {
        match self.command {
            Command::Function(function) => function.end(),
            _ => Instant::NEVER,
        }
    }

    /// Ends a function that is due, or keeps it while its signal is ON. Returns true if the order to the motor changes.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        let is_due = self.deadline() <= at;
        if is_due {
            self.command = match self.command {
                Command::Function(Function::Add { rpm, .. }) if self.start => {
                    Command::Function(Function::Add { rpm, until: Instant::NEVER })
                }
                _ => Command::Nothing(Release::Stop),
            };
        }
        is_due
    }

    /// Updates the source of commands. Returns true if the source has changed. Then the motor stops and waits
    /// for a command of the new source; a dropped command stays dropped (MDROBOT-12).
    fn update_source(&mut self, env: &Environment<'_>) -> bool {
        let source = Source::of(env.bank);
        let another = source != core::mem::replace(&mut self.source, source);
        if another {
            self.command = match (self.command, source) {
                (dropped @ Command::Nothing(Release::Free | Release::Brake), _) => dropped,
                (_, Source::CONNECTORS) => Command::Connectors { started: false },
                _ => Command::Nothing(Release::Stop),
            };
            self.brake_dropped(env);
        }
        another
    }

    /// While the connectors are the source, RUN/BRAKE at OFF also brakes a released motor.
    fn brake_dropped(&mut self, env: &Environment<'_>) {
        if env.is_braked() {
            self.set_release(Release::Brake);
        }
    }

    /// Sets the state of a released motor, if the connectors are the source.
    fn set_release(&mut self, release: Release) {
        let Reference { source: Source::CONNECTORS, command: Command::Nothing(left), .. } = self else {
            return;
        };
        *left = release;
    }

    /// Handles a possible change of START/STOP, RUN/BRAKE, the step number or `FUNC_CMD`. Returns the reason
    /// why a signal that is ON does not start a function.
    fn signals_changed(&mut self, env: &mut Environment<'_>) -> Option<Why> {
        if !env.is_ready {
            return None;
        }
        let (on, brake) = (self.start_signal(env), env.is_braked());
        let was_on = core::mem::replace(&mut self.start, on);
        let was_braked = core::mem::replace(&mut self.brake, brake);
        if env.has_alarm {
            return on.then_some(Why::AlarmFunction);
        }
        if brake != was_braked {
            self.set_release(if brake { Release::Brake } else { Release::Free });
        }
        if on == was_on {
            return on.then_some(Why::SignalOn);
        }
        let connectors = matches!(self.command, Command::Connectors { .. });
        match self.source {
            source if source.is_function() && on => return self.start_function(env),
            source if source.is_function() => {
                if matches!(self.command, Command::Function(running) if running.needs_signal()) {
                    self.command = Command::Nothing(Release::Stop);
                }
            }
            // A command that `TQ_OFF`, BRAKE or an alarm has dropped starts again when the signal changes to
            // ON (MDROBOT-14).
            Source::CONNECTORS if on || connectors => {
                self.command = Command::Connectors { started: on };
            }
            Source { .. } => {}
        }
        None
    }

    /// The signal of a function has changed to ON: starts the function that `FUNC_CMD_TYPE` selects. Returns the reason
    /// why the motor does not move.
    fn start_function(&mut self, env: &mut Environment<'_>) -> Option<Why> {
        // A running speed function ignores the signal; a position function starts again from the motor's
        // position.
        if matches!(self.command, Command::Function(running) if !running.is_position()) {
            return Some(Why::FunctionRuns);
        }
        let Some((function, order)) = Function::selected(env) else { return Some(Why::NoRunTime) };
        self.command = Command::Function(function);
        order.and_then(|order| self.apply(order, env))
    }

    /// Returns true if the start signal of the connectors, or of a function, is ON.
    fn start_signal(&self, env: &Environment<'_>) -> bool {
        let source = self.source;
        let contact = match env.inputs.step(env.bank).filter(|_| !source.is_function()) {
            Some(step) => step != 0,
            None => env.inputs.start_contact(env.bank),
        };
        let by_bus = source.is_function() && env.bank.word(Pid::FUNC_CMD) != 0;
        !source.bus && contact || by_bus
    }

    /// Gives the motor the order of the present command. Returns the reason why the motor does not turn.
    fn update_order(&mut self, env: &mut Environment<'_>) -> Option<Why> {
        self.apply(self.ordered(env), env)
    }

    /// Gives `order` to the servo, unless the drive is not ready, an alarm is active, or a limit switch
    /// forbids the order. Returns the reason why the motor does not turn.
    fn apply(&mut self, order: Order, env: &mut Environment<'_>) -> Option<Why> {
        if !env.is_ready || env.has_alarm {
            return None;
        }
        let verdict = self.limits.check(order, self.source.bus, env);
        self.reverses = verdict == Verdict::Reverses;
        let order = match verdict {
            Verdict::Permits => order,
            // The ramp from the present speed would continue towards the switch, so the speed is controlled
            // at 0.
            Verdict::Reverses => Order::Position { count: env.servo.target(), rpm: 0 },
            Verdict::Forbids => {
                let release =
                    if flag(env.bank, Pid::LIMIT_STOP_COND) { Release::Brake } else { Release::Free };
                self.command = Command::Nothing(release);
                self.ordered(env)
            }
        };
        env.servo.order(env.at, order, env.out);
        match verdict {
            Verdict::Permits => env.servo.stands(),
            Verdict::Reverses => None,
            Verdict::Forbids => Some(Why::LimitSwitch),
        }
    }

    /// Returns true while the drive stops a motor that is to turn back from a limit switch.
    pub(super) fn reverses(&self) -> bool {
        self.reverses
    }

    /// The order to the motor that follows from the present command.
    fn ordered(&self, env: &Environment<'_>) -> Order {
        match self.command {
            Command::Nothing(Release::Free) => Order::Free,
            Command::Nothing(Release::Brake) => Order::Brake,
            Command::Nothing(Release::Stop) => Order::Velocity(0),
            Command::Connectors { started } => self.connected(started, env),
            Command::Velocity(rpm) => env.velocity(rpm.into()),
            Command::StartStop => {
                let rpm = i32::from(env.bank.word(Pid::COM_TAR_SPEED));
                env.velocity(if env.bank.word(Pid::START_STOP) == 2 { -rpm } else { rpm })
            }
            Command::Open(part) => Order::Open(env.turned(part.into()) as i16),
            Command::Torque(part) => Order::Torque(env.turned(part.into()) as i16),
            Command::Position { rpm } | Command::Function(Function::Position { rpm }) => {
                env.position(env.servo.target(), rpm)
            }
            Command::Function(
                Function::Speed { rpm, .. } | Function::Momentary { rpm } | Function::Add { rpm, .. },
            ) => env.velocity(rpm),
        }
    }

    /// The order of the connectors to the motor; a torque if `TQ_CTRL` is 1 (MDROBOT-25).
    fn connected(&self, started: bool, env: &Environment<'_>) -> Order {
        if env.is_braked() {
            return Order::Brake;
        }
        if !started {
            return Order::Velocity(0);
        }
        let input = env.inputs.speed_input(env.bank);
        if flag(env.bank, Pid::TQ_CTRL) {
            // The value is at most full scale, which fits in a word.
            Order::Torque(env.turned(input.of(OUTPUTS)) as i16)
        } else {
            env.velocity(input.of(max_rpm(env.bank)))
        }
    }
}
