//! Scenarios: scripted sequences of stimuli, each at a time or after a request of a master.

use drivetwin_firmware::device::{Duration, Fault, Instant, Pin};

use super::events::EventKind;
use super::{Bench, DriveId, PinStimulus, PowerAction};
use crate::decode::{Register, exchange};
use crate::line::faults::LineFaults;
use crate::record::journal::Outcome;
use crate::scheduler::Phase;
use crate::value::Value;

/// A sequence of steps, for [`Bench::play`](crate::bench::Bench::play).
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Scenario {
    /// The steps; each waits for the end of the step before it.
    pub steps: Vec<Step>,
}

/// A step of a scenario: an action, and the time at which it happens.
#[derive(Clone, PartialEq, Debug)]
pub struct Step {
    /// The event that the step waits for.
    pub trigger: Trigger,
    /// Time from the event to the action.
    pub after: Duration,
    /// The action.
    pub action: Action,
}

/// Event that a step of a scenario waits for.
#[derive(Clone, PartialEq, Debug)]
pub enum Trigger {
    /// The action of the step before; for the first step, the start of the scenario.
    Previous,
    /// A bench time. A time that has passed counts as now.
    At(Instant),
    /// The next request with which a master writes a register, when the drive accepts it.
    Written(Written),
}

/// A write of a register by a master.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Written {
    /// The drive.
    pub drive: DriveId,
    /// Row of the register in the drive's register map.
    pub row: usize,
    /// The value of the whole register, if only one value counts.
    pub value: Option<i64>,
}

/// Action of a step.
#[derive(Clone, PartialEq, Debug)]
pub enum Action {
    /// Sets the faults of a line or TCP port.
    LineFaults {
        /// Name of the line or port, as [`Bench::find_outlet`](crate::bench::Bench::find_outlet) finds it.
        bus: String,
        /// Faults of the line or port from now on.
        faults: Box<LineFaults>,
    },
    /// Sets or clears the cause of a fault of a drive.
    Fault {
        /// The drive.
        drive: DriveId,
        /// The fault.
        fault: Fault,
        /// True to set the cause of the fault, false to clear it.
        on: bool,
    },
    /// Drives a pin.
    Pin {
        /// The drive.
        drive: DriveId,
        /// The pin.
        pin: Pin,
        /// The stimulus.
        stimulus: PinStimulus,
    },
    /// Sends pulses to a pin. It has no effect while a pulse train or an encoder runs there.
    Pulses {
        /// The drive.
        drive: DriveId,
        /// The pin.
        pin: Pin,
        /// Number of pulses.
        count: u32,
        /// Pulses per second.
        hz: f64,
    },
    /// Switches the power of a drive.
    Power {
        /// The drive.
        drive: DriveId,
        /// The change.
        action: PowerAction,
    },
}

impl Written {
    /// Returns true if a request that a drive has accepted is this write. A part of the register in the request
    /// changes its `whole` value to this one.
    fn is_in(&self, name: &str, registers: &[Register], whole: impl Fn() -> i64) -> bool {
        registers.iter().any(|register| {
            let has_value = |wanted| {
                let is_part = register.name != name;
                register.value == Some(Value::Number(wanted)) && !is_part || is_part && whole() == wanted
            };
            register.written && register.row == self.row && self.value.is_none_or(has_value)
        })
    }
}

impl Scenario {
    /// Replaces the drive id in each step by `map` of this id. For instance, replaces the index of a drive in a file by
    /// the index of the same drive on a bench.
    pub(crate) fn map_drives(&mut self, map: impl Fn(DriveId) -> DriveId) {
        for step in &mut self.steps {
            if let Trigger::Written(Written { drive, .. }) = &mut step.trigger {
                *drive = map(*drive);
            }
            match &mut step.action {
                Action::LineFaults { faults, .. } => faults.map_drives(&map),
                Action::Fault { drive, .. }
                | Action::Pin { drive, .. }
                | Action::Pulses { drive, .. }
                | Action::Power { drive, .. } => *drive = map(*drive),
            }
        }
    }
}

/// Most scenarios that a bench plays at once.
pub(crate) const MOST_SCENARIOS: usize = 1_000;

/// A scenario that is being played.
#[derive(Debug)]
pub(super) struct Playing {
    steps: std::vec::IntoIter<Step>,
    /// The step that waits for a write.
    waits: Option<(Written, Duration)>,
    /// Number of the last entry of a journal that was looked at, or that came before the wait.
    seen: u64,
    action: Option<Action>,
}

impl Playing {
    fn new(scenario: Scenario) -> Self {
        Self { steps: scenario.steps.into_iter(), waits: None, seen: 0, action: None }
    }

    /// Begins the next step. Returns the time of its action if that is known. `seen` is the number of the last
    /// entry of a journal so far.
    fn begin_step(&mut self, now: Instant, seen: u64) -> Option<Instant> {
        let Step { trigger, after, action } = self.steps.next()?;
        self.action = Some(action);
        match trigger {
            Trigger::Previous => Some(now + after),
            Trigger::At(at) => Some(at.max(now) + after),
            Trigger::Written(written) => {
                (self.waits, self.seen) = (Some((written, after)), seen);
                None
            }
        }
    }

    /// Returns true if there is no step left.
    fn is_over(&self) -> bool {
        self.steps.len() == 0 && self.waits.is_none() && self.action.is_none()
    }

    /// The write that the present step waits for, and the number of the last entry that cannot be it.
    fn waits_for(&self) -> Option<(&Written, u64)> {
        self.waits.as_ref().map(|(written, _)| (written, self.seen))
    }

    /// Notes that the entries up to number `seen` are not the write.
    fn look_on(&mut self, seen: u64) {
        self.seen = seen;
    }

    /// Notes that the write has happened. Returns the time of the action.
    fn happened(&mut self, now: Instant) -> Option<Instant> {
        // A scenario acts from outside, so at least one tick later.
        self.waits.take().map(|(_, after)| now + after.max(Duration::TICK))
    }

    /// The action that is due now.
    fn act(&mut self) -> Option<Action> {
        self.action.take()
    }
}

/// Scenarios.
impl Bench {
    /// Plays a scenario from now on, beside those that are played already. Its actions are stimuli from
    /// outside: a trace has them as inputs of drives, and is replayed without the scenario.
    ///
    /// ```
    /// use drivetwin_firmware::md3::Md3;
    /// use drivetwin_protocol::modbus::rtu;
    /// use drivetwin_protocol::time::Span;
    /// use drivetwin_sim::bench::{Bench, PowerAction};
    /// use drivetwin_sim::bench::scenario::{Action, Scenario, Step, Trigger, Written};
    ///
    /// let mut bench = Bench::new();
    /// let x = bench.add::<Md3>("x");
    /// let row = bench.spec(x).find("MotionControl").unwrap().row;
    /// // Power fails 100 ms after a move has begun.
    /// bench.play(Scenario {
    ///     steps: vec![Step {
    ///         trigger: Trigger::Written(Written { drive: x, row, value: Some(1) }),
    ///         after: 100.millis(),
    ///         action: Action::Power { drive: x, action: PowerAction::Off },
    ///     }],
    /// })?;
    /// bench.run_until(3.secs());
    /// bench.ask(x, &rtu::write(1, 0x11, 1));
    /// assert!(bench.powered(x));
    /// bench.run_until(bench.now() + 100.millis());
    /// assert!(!bench.powered(x));
    /// # Ok::<(), String>(())
    /// ```
    ///
    /// # Errors
    /// There is no line or TCP port of a name in the scenario, or 1,000 scenarios have not ended yet; nothing is
    /// played then.
    pub fn play(&mut self, scenario: Scenario) -> Result<(), String> {
        self.play_all(vec![scenario])
    }

    /// Plays scenarios beside each other, like [`play`](Self::play).
    ///
    /// # Errors
    /// As [`play`](Self::play); none of them is played then.
    pub fn play_all(&mut self, scenarios: Vec<Scenario>) -> Result<(), String> {
        let unknown =
            scenarios.iter().flat_map(|scenario| &scenario.steps).find_map(|step| match &step.action {
                Action::LineFaults { bus, .. } if self.find_outlet(bus).is_none() => Some(bus),
                _ => None,
            });
        if let Some(bus) = unknown {
            return Err(format!("there is no bus '{bus}'"));
        }
        let playing = self.scenarios.iter().filter(|scenario| !scenario.is_over()).count();
        if playing + scenarios.len() > MOST_SCENARIOS {
            return Err(format!(
                "a bench plays {MOST_SCENARIOS} scenarios at once; wait until one has ended"
            ));
        }
        for scenario in scenarios {
            let ended = self.scenarios.iter().position(Playing::is_over);
            let number = ended.unwrap_or(self.scenarios.len());
            let playing = Playing::new(scenario);
            match self.scenarios.get_mut(number) {
                Some(ended) => *ended = playing,
                None => self.scenarios.push(playing),
            }
            self.begin_step(number);
        }
        Ok(())
    }

    /// Begins the next step of a scenario.
    fn begin_step(&mut self, number: usize) {
        let (now, seen) = (self.now, self.received_count());
        if let Some(at) = self.scenarios[number].begin_step(now, seen) {
            self.schedule(at, Phase::Scenario, 0, EventKind::Scenario { number });
        }
    }

    /// Carries out the action of a scenario that is due now, and begins its next step.
    pub(super) fn scenario_is_due(&mut self, number: usize) {
        match self.scenarios[number].act() {
            Some(Action::LineFaults { bus, faults }) => {
                if let Some(outlet) = self.find_outlet(&bus) {
                    self.set_faults(outlet, *faults);
                }
            }
            Some(Action::Fault { drive, fault, on }) => self.fault(drive, fault, on),
            Some(Action::Pin { drive, pin, stimulus }) => self.set_pin(drive, pin, stimulus),
            // A train that runs on the pin goes on.
            Some(Action::Pulses { drive, pin, count, hz }) => _ = self.pulse(drive, pin, count, hz),
            Some(Action::Power { drive, action }) => self.power(drive, action),
            None => {}
        }
        self.begin_step(number);
    }

    /// Looks if a drive has accepted a request that a scenario waits for.
    pub(super) fn look_for_writes(&mut self, index: u32) {
        for number in 0..self.scenarios.len() {
            let Some((written, seen)) = self.scenarios[number].waits_for() else { continue };
            if written.drive != DriveId(index) {
                continue;
            }
            let has_happened = {
                let slot = &self.slots[index as usize];
                let new = slot.state.journal.entries().rev().take_while(|entry| entry.number > seen);
                let mut accepted = new.filter(|entry| entry.outcome == Outcome::Accepted);
                let name = slot.spec.registers.rows.get(written.row).map_or("", |row| row.name);
                accepted.any(|entry| {
                    let registers = exchange(slot.spec, entry).request.registers;
                    written.is_in(name, &registers, || slot.peek(self.now, written.row))
                })
            };
            let (now, last) = (self.now, self.received_count());
            let scenario = &mut self.scenarios[number];
            scenario.look_on(last);
            if has_happened && let Some(at) = scenario.happened(now) {
                self.schedule(at, Phase::Scenario, 0, EventKind::Scenario { number });
            }
        }
    }
}
