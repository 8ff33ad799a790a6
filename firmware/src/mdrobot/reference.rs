//! The reference: the source that commands, and its order to the motor; the last command decides (p. 7, 12, 15).

mod functions;
#[cfg(test)]
mod tests;

use drivetwin_protocol::registers::Bank;

use self::functions::Function;
use super::drive::{Drive, State};
use super::registers::{Pid, function};
use super::servo::{OUTPUTS, Order};
use crate::device::{Context, Instant};

/// A slower shaft counts as standing for limit switches: at 3,000 rpm in 15 s it stops within a count of 12 a turn, and
/// its last edge is no more than a sixth of a second old.
const TURNS_RPM: u32 = 30;

/// The command in effect, and its source.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reference {
    source: Source,
    /// The signal that starts what the connectors ask for, or a function, is ON.
    start: bool,
    /// RUN/BRAKE is OFF.
    brake: bool,
    command: Command,
    /// The ways that limit switches forbade last, CCW and CW.
    forbidden: [bool; 2],
    /// The motor is brought to a stand before it turns back from a limit switch.
    reverses: bool,
}

/// Source that may command.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Source {
    /// The bus, and not the CTRL connector.
    bus: bool,
    /// A function only, by its number in FUNC_CMD_TYPE.
    function: u16,
}

impl Source {
    /// START/STOP, RUN/BRAKE, DIR and the speed input.
    const CONNECTORS: Self = Self { bus: false, function: function::NONE };
    /// The commands of the bus.
    const BUS: Self = Self { bus: true, function: function::NONE };

    fn of(bank: &Bank<Pid, { Pid::WORDS }>) -> Self {
        Self { bus: bank.word(Pid::UI_COM) == 1, function: bank.word(Pid::FUNC_CMD_TYPE) }
    }

    /// Only a function drives (p. 15).
    fn is_function(self) -> bool {
        self.function != function::NONE
    }
}

/// Command to follow.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Command {
    /// No command.
    Nothing(Release),
    /// The connectors.
    Connectors {
        /// START/STOP, or the step number, has come ON.
        started: bool,
    },
    /// VEL_CMD, in rpm.
    Velocity(i16),
    /// START_STOP at COM_TAR_SPEED.
    StartStop,
    /// OPEN_VEL_CMD.
    Open(i16),
    /// TQ_CMD.
    Torque(i16),
    /// A position, which the servo knows: it moves along when the position is cleared.
    Position {
        /// Largest speed, not negative.
        rpm: i32,
    },
    /// A function that runs.
    Function(Function),
}

/// State of the motor without a command.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Release {
    /// Free.
    Free,
    /// Shorted windings.
    Brake,
    /// As SLOW_DOWN and STOP_STATUS select.
    Stop,
}

impl Reference {
    /// Power has come: the connectors command.
    pub(super) const NONE: Self = Self {
        source: Source::CONNECTORS,
        start: false,
        brake: false,
        command: Command::Connectors { started: false },
        forbidden: [false; 2],
        reverses: false,
    };
}

/// Verdict of the limit switches on an order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Verdict {
    /// Carried out.
    Permits,
    /// Back from the switch towards which the shaft turns: the shaft stops first.
    Reverses,
    /// Dropped.
    Forbids,
}

impl Drive {
    /// Carries out a written command of the bus, if it may be.
    pub(super) fn command_written(&mut self, at: Instant, pid: Pid, out: &mut dyn Context) {
        match pid {
            Pid::UI_COM | Pid::FUNC_CMD_TYPE | Pid::FUNC_CMD => return self.reference_changed(at, out),
            _ if self.state != State::Ready || self.alarms.any() => return,
            Pid::POSI_VEL_CMD | Pid::INC_POSI_VEL_CMD | Pid::POSI_CMD | Pid::INC_POSI_CMD => {
                return self.position_written(at, pid, out);
            }
            _ => {}
        }
        if let Some(command) = self.requested(pid) {
            self.reference.command = command;
            self.update_order(at, out);
        }
    }

    /// Command of a PID other than of a position; `None` if it may not command now (MDROBOT-13).
    fn requested(&self, pid: Pid) -> Option<Command> {
        let drives = self.reference.source == Source::BUS;
        let armed = drives && self.bank.word(Pid::START_STOP) != 0;
        let value = self.bank.get(pid) as i16;
        // A dropped command stays dropped: there is no speed to be ramped to zero.
        let dropped = matches!(self.reference.command, Command::Nothing(_));
        match pid {
            Pid::TQ_OFF => Some(Command::Nothing(Release::Free)),
            Pid::BRAKE => Some(Command::Nothing(Release::Brake)),
            Pid::START_STOP if drives && !armed => (!dropped).then_some(Command::Nothing(Release::Stop)),
            // A speed drives; none ends only what START_STOP itself drives.
            Pid::START_STOP | Pid::COM_TAR_SPEED if armed => {
                let turns = self.bank.word(Pid::COM_TAR_SPEED) != 0;
                (turns || self.reference.command == Command::StartStop).then_some(Command::StartStop)
            }
            Pid::VEL_CMD if dropped && value == 0 => None,
            Pid::VEL_CMD if armed => Some(Command::Velocity(value)),
            Pid::OPEN_VEL_CMD if armed => Some(Command::Open(value)),
            Pid::TQ_CMD if armed => Some(Command::Torque(value)),
            _ => None,
        }
    }

    /// A command of a position was written: low word, high word, and maybe a speed.
    fn position_written(&mut self, at: Instant, pid: Pid, out: &mut dyn Context) {
        let words = self.bank.get(pid);
        let count = self.turned(words as i32);
        let here = matches!(pid, Pid::INC_POSI_CMD | Pid::INC_POSI_VEL_CMD);
        let count = if here { self.relative(count) } else { count };
        let rpm = match pid {
            Pid::POSI_VEL_CMD | Pid::INC_POSI_VEL_CMD => i32::from((words >> 32) as i16).abs(),
            _ => self.bank.word(Pid::TAR_POSI_VEL).into(),
        };
        if self.reference.source == Source::BUS {
            self.reference.command = Command::Position { rpm };
            self.apply(at, self.position(count, rpm), out);
        }
    }

    /// A register was written that selects the source of commands, or the meaning of a command or an input.
    pub(super) fn reference_changed(&mut self, at: Instant, out: &mut dyn Context) {
        if self.update_source() {
            // A signal that is already ON does not start the new command.
            self.reference.start = self.state == State::Ready && self.start_signal();
        } else {
            self.signals_changed(at, out);
        }
        self.update_order(at, out);
    }

    /// The drive is ready: what the connectors ask for begins. A function waits until its signal comes (p. 17).
    pub(super) fn sources_ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.update_source();
        if self.reference.source.is_function() {
            self.reference.start = self.start_signal();
        }
        self.signals_changed(at, out);
        self.update_order(at, out);
    }

    /// An alarm: nothing is followed any more, and the motor is free.
    pub(super) fn drop_reference(&mut self, at: Instant, out: &mut dyn Context) {
        self.reference.command = Command::Nothing(Release::Free);
        self.servo.order(at, Order::Free, out);
    }

    /// The last alarm is cleared.
    pub(super) fn alarms_cleared(&mut self, at: Instant, out: &mut dyn Context) {
        self.brake_dropped();
        self.update_order(at, out);
    }

    /// Time of the next work for inputs or functions.
    pub(super) fn sources_due(&self) -> Instant {
        self.inputs.due().min(self.function_due())
    }

    /// Handles that time.
    pub(super) fn sources_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        let measured = self.inputs.timeout(at);
        if self.function_timeout(at) || measured {
            self.update_order(at, out);
        }
    }

    /// Updates the source that commands; returns whether it is another one. The motor stops, and waits for a command of
    /// that source; a dropped command stays dropped (MDROBOT-12).
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

    /// While the connectors command, RUN/BRAKE at OFF also brakes a released motor.
    fn brake_dropped(&mut self) {
        if self.is_braked() {
            self.set_release(Release::Brake);
        }
    }

    /// Sets the state of a released motor, while the connectors command.
    fn set_release(&mut self, release: Release) {
        let Reference { source: Source::CONNECTORS, command: Command::Nothing(left), .. } =
            &mut self.reference
        else {
            return;
        };
        *left = release;
    }

    /// START/STOP, RUN/BRAKE, the step number or FUNC_CMD may have come or gone: what that starts and ends.
    pub(super) fn signals_changed(&mut self, at: Instant, out: &mut dyn Context) {
        if self.state != State::Ready {
            return;
        }
        let (on, brake) = (self.start_signal(), self.is_braked());
        let was_on = core::mem::replace(&mut self.reference.start, on);
        let was_braked = core::mem::replace(&mut self.reference.brake, brake);
        if self.alarms.any() {
            return;
        }
        if brake != was_braked {
            self.set_release(if brake { Release::Brake } else { Release::Free });
        }
        if on == was_on {
            return;
        }
        let connectors = matches!(self.reference.command, Command::Connectors { .. });
        match self.reference.source {
            source if source.is_function() && on => self.start_function(at, out),
            source if source.is_function() => self.release_function(),
            // What TQ_OFF, BRAKE or an alarm has dropped begins again when the signal comes (MDROBOT-14).
            Source::CONNECTORS if on || connectors => {
                self.reference.command = Command::Connectors { started: on };
            }
            Source { .. } => {}
        }
    }

    /// Returns whether the start signal of the connectors, or of a function, is ON.
    fn start_signal(&self) -> bool {
        let source = self.reference.source;
        let contact = match self.step().filter(|_| !source.is_function()) {
            Some(step) => step != 0,
            None => self.start_contact(),
        };
        let by_bus = source.is_function() && self.bank.word(Pid::FUNC_CMD) != 0;
        !source.bus && contact || by_bus
    }

    /// The motor does from now on what there is to follow.
    pub(super) fn update_order(&mut self, at: Instant, out: &mut dyn Context) {
        self.apply(at, self.ordered(), out);
    }

    /// Orders that of the servo, unless nothing moves now or a limit switch forbids it.
    pub(super) fn apply(&mut self, at: Instant, order: Order, out: &mut dyn Context) {
        if self.state != State::Ready || self.alarms.any() {
            return;
        }
        let verdict = self.check_limits(at, order);
        self.reference.reverses = verdict == Verdict::Reverses;
        let order = match verdict {
            Verdict::Permits => order,
            // A ramp from the present speed would lead on towards the switch, so the speed is controlled at 0.
            Verdict::Reverses => Order::Position { count: self.servo.target(), rpm: 0 },
            Verdict::Forbids => {
                let release = if self.flag(Pid::LIMIT_STOP_COND) { Release::Brake } else { Release::Free };
                self.reference.command = Command::Nothing(release);
                self.ordered()
            }
        };
        self.servo.order(at, order, out);
    }

    /// The shaft that is to turn back from a limit switch may stand by now.
    pub(super) fn reverse_when_slow(&mut self, at: Instant, out: &mut dyn Context) {
        if self.reference.reverses {
            self.update_order(at, out);
        }
    }

    /// The motor is brought to a stand before it turns back from a limit switch.
    pub(super) fn reverses(&self) -> bool {
        self.reference.reverses
    }

    /// An open limit switch forbids an order that turns the motor towards it. When it opens it also stops a shaft that
    /// an order of speed or position would still have to slow down; a later order of the way back is carried out (MDROBOT-23).
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
        // Positive CCW.
        let [way, shaft] = match order {
            Order::Free | Order::Brake => [0, 0],
            Order::Velocity(rpm) => [rpm, shaft],
            // What pushes the other way brakes at once.
            Order::Open(part) | Order::Torque(part) => [part.into(), 0],
            // One that holds its position has no way to go.
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
            // A position has no ramp.
            _ => Verdict::Permits,
        }
    }

    /// Order to the motor.
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

    /// Order of the connectors to the motor, a torque with TQ_CTRL 1 (MDROBOT-25).
    fn connected(&self, started: bool) -> Order {
        if self.is_braked() {
            return Order::Brake;
        }
        if !started {
            return Order::Velocity(0);
        }
        let input = self.speed_input();
        if self.flag(Pid::TQ_CTRL) {
            // No more than full scale, which a word holds.
            Order::Torque(self.turned(input.of(OUTPUTS)) as i16)
        } else {
            self.velocity(input.of(self.full_speed()))
        }
    }

    /// A velocity before INV_SIGN_CMD and MAX_RPM, in rpm.
    fn velocity(&self, rpm: i32) -> Order {
        let most = self.max_rpm();
        Order::Velocity(self.turned(rpm).min(most).max(-most))
    }

    /// A position, and how fast it may be gone to before MAX_RPM.
    pub(super) fn position(&self, count: i32, rpm: i32) -> Order {
        Order::Position { count, rpm: rpm.min(self.max_rpm()) }
    }

    /// `counts` from where the motor is, or as far as positions go.
    pub(super) fn relative(&self, counts: i32) -> i32 {
        self.servo.position().saturating_add(counts)
    }

    /// Reference with the sign that INV_SIGN_CMD gives it (MDROBOT-15).
    pub(super) fn turned(&self, reference: i32) -> i32 {
        if self.flag(Pid::INV_SIGN_CMD) { reference.saturating_neg() } else { reference }
    }

    /// MAX_RPM as it acts.
    pub(super) fn full_speed(&self) -> u16 {
        self.bank.clamped_value(Pid::MAX_RPM) as u16
    }

    fn max_rpm(&self) -> i32 {
        self.full_speed().into()
    }
}
