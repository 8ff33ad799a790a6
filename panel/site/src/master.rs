//! A small master: it writes and reads registers of one drive, one request after the other.
//!
//! The master repeats a request that has no answer, as masters do, so that a fault of the line can be watched.

use std::collections::VecDeque;

use drivetwin_firmware::device::{Duration, Framing, Instant, Port, Spec};
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::registers::{Row, Space};
use drivetwin_sim::bench::{Bench, Client, DriveId};

/// Wait for the answer of a request.
const PATIENCE: Duration = Duration::millis(250);

/// Number of times that a request without an answer is repeated before the master goes on with the next step.
const REPEATS: u32 = 4;

/// Time from the first characters of an answer to the next request: longer than the rest of the answer.
const PAUSE: Duration = Duration::millis(50);

/// Time between two polls while the master has nothing else to do.
const POLL: Duration = Duration::millis(200);

/// A step of a master. A row is an index of [`Spec::rows`].
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Step {
    /// Writes a register.
    Write {
        /// Row of the register.
        row: usize,
        /// Value.
        value: i64,
    },
    /// Reads a register.
    Read {
        /// Row of the register.
        row: usize,
    },
    /// Sends a command to a drive that takes text; without effect on others.
    Say(String),
    /// Waits.
    Wait(Duration),
}

/// A master of one drive.
#[derive(Debug)]
pub struct Master {
    drive: DriveId,
    port: Port,
    client: Client,
    actions: VecDeque<Action>,
    /// Request that is sent again and again while there are no actions, from a time on.
    poll: Option<Vec<u8>>,
    polls_at: Instant,
    state: State,
    /// Number of the next request on a TCP port.
    transaction: u16,
}

/// Action of a master. A request is a PDU, or a command of a QSB.
#[derive(Clone, PartialEq, Eq, Debug)]
enum Action {
    Ask(Vec<u8>),
    Wait(Duration),
}

#[derive(Debug)]
enum State {
    /// The next request is sent at this time.
    Idle(Instant),
    /// A step waits until this time.
    Waiting(Instant),
    /// A request waits for its answer.
    Asked { request: Vec<u8>, repeats: u32, until: Instant },
}

impl Master {
    /// A master at the first port of a drive; `None` if the port takes no client.
    pub fn new(bench: &mut Bench, drive: DriveId) -> Option<Self> {
        let port = Port(0);
        let client = bench.join(bench.outlet(drive, port)).ok()?;
        let now = bench.now();
        let (actions, state) = (VecDeque::new(), State::Idle(now));
        Some(Self { drive, port, client, actions, poll: None, polls_at: now, state, transaction: 0 })
    }

    /// The drive.
    #[must_use]
    pub fn drive(&self) -> DriveId {
        self.drive
    }

    /// Begins with these steps, and ends others that are still to be done. Returns whether there were some.
    ///
    /// # Errors
    /// The rest of the waits, if the steps that are still to be done have one: the end of their story would be lost.
    pub fn play(&mut self, bench: &Bench, steps: &[Step]) -> Result<bool, Duration> {
        let rest = self.waits(bench.now());
        if rest > Duration::ZERO {
            return Err(rest);
        }
        let spec = bench.spec(self.drive);
        let ended = !self.actions.is_empty();
        self.actions = steps.iter().flat_map(|step| actions(spec, step)).collect();
        if let State::Asked { repeats, .. } = &mut self.state {
            // The drive may be about to answer, so the request keeps its time, but is not repeated.
            *repeats = 0;
        }
        Ok(ended)
    }

    /// The rest of the waits of the steps that are still to be done.
    fn waits(&self, now: Instant) -> Duration {
        let begun = match self.state {
            State::Waiting(until) => until.since(now),
            State::Idle(_) | State::Asked { .. } => Duration::ZERO,
        };
        self.actions.iter().fold(begun, |sum, action| match action {
            Action::Wait(time) => sum + *time,
            Action::Ask(_) => sum,
        })
    }

    /// Chooses the register that is read while there are no steps.
    pub fn poll(&mut self, bench: &Bench, row: usize) {
        let read = actions(bench.spec(self.drive), &Step::Read { row });
        self.poll = read.into_iter().find_map(|action| match action {
            Action::Ask(request) => Some(request),
            Action::Wait(_) => None,
        });
    }

    /// Does what is due now. Call it after each short run of the bench.
    pub fn run(&mut self, bench: &mut Bench) {
        let now = bench.now();
        match &self.state {
            State::Asked { request, repeats, until } => {
                if bench.receive(self.client, &mut Vec::new()) > 0 || (now >= *until && *repeats == 0) {
                    self.state = State::Idle(now + PAUSE);
                } else if now >= *until {
                    let (request, repeats) = (request.clone(), repeats - 1);
                    self.ask(bench, request, repeats);
                }
            }
            State::Idle(at) | State::Waiting(at) if now >= *at => {
                match (self.actions.pop_front(), &self.poll) {
                    (Some(Action::Wait(time)), _) => self.state = State::Waiting(now + time),
                    (Some(Action::Ask(request)), _) => self.ask(bench, request, REPEATS),
                    (None, Some(request)) if now >= self.polls_at => {
                        let request = request.clone();
                        self.polls_at = now + POLL;
                        self.ask(bench, request, 0);
                    }
                    (None, _) => {}
                }
            }
            State::Idle(_) | State::Waiting(_) => {}
        }
    }

    fn ask(&mut self, bench: &mut Bench, request: Vec<u8>, repeats: u32) {
        let spec = bench.spec(self.drive);
        let address = spec.address.and_then(|row| u8::try_from(bench.peek(self.drive, row)).ok());
        self.transaction = self.transaction.wrapping_add(1);
        let framing = spec.ports.get(usize::from(self.port.0)).map(|port| port.framing);
        let frame = match framing {
            Some(Framing::Silence) => rtu::frame(address.unwrap_or(1), &request).to_vec(),
            Some(Framing::Mbap) => {
                let length = request.len() as u16 + 1;
                let header = [self.transaction.to_be_bytes(), [0, 0], length.to_be_bytes()].concat();
                [header.as_slice(), &[address.unwrap_or(1)], &request].concat()
            }
            _ => request.clone(),
        };
        bench.send(self.client, &frame);
        self.state = State::Asked { request, repeats, until: bench.now() + PATIENCE };
    }
}

/// Actions of a step; empty if the bus cannot do it.
fn actions(spec: &Spec, step: &Step) -> Vec<Action> {
    let is_text = spec.ports.first().is_some_and(|port| port.framing == Framing::Character);
    let (row, value) = match step {
        Step::Write { row, value } => (*row, Some(*value)),
        Step::Read { row } => (*row, None),
        Step::Say(command) if is_text => return vec![Action::Ask(format!("{command}\r").into_bytes())],
        Step::Say(_) => return Vec::new(),
        Step::Wait(time) => return vec![Action::Wait(*time)],
    };
    let Some(register) = spec.registers.rows.get(row) else { return Vec::new() };
    let requests = match value {
        // The commands of a QSB.
        Some(value) if is_text => {
            vec![format!("W{:02X}{:08X}\r", register.address, value as u32).into_bytes()]
        }
        None if is_text => vec![format!("R{:02X}\r", register.address).into_bytes()],
        Some(value) => writes(spec, register, value),
        None => read(register).into_iter().collect(),
    };
    requests.into_iter().map(Action::Ask).collect()
}

/// The PDUs that write a register.
fn writes(spec: &Spec, register: &Row, value: i64) -> Vec<Vec<u8>> {
    let [high, low] = register.address.to_be_bytes();
    match register.space {
        Space::Coil => vec![vec![5, high, low, if value == 0 { 0 } else { 0xFF }, 0]],
        Space::Holding => {
            let words = (0..usize::from(register.shape.words()))
                .map(|n| spec.registers.word(register.shape, value, n).to_be_bytes());
            // The MD3 has no function 16 (6), so its words are written one after the other; an MDrive has no function 6 (4.4).
            if (register.shape.words() == 1 && !spec.kind.starts_with("mdrive"))
                || spec.kind.starts_with("md3")
            {
                let address = |n: u16| register.address.wrapping_add(n).to_be_bytes();
                (0..).zip(words).map(|(n, word)| [&[6], &address(n)[..], &word].concat()).collect()
            } else {
                let bytes: Vec<u8> = words.flatten().collect();
                let (count, length) = (register.shape.words() as u8, bytes.len() as u8);
                vec![[&[16, high, low, 0, count, length], bytes.as_slice()].concat()]
            }
        }
        _ => Vec::new(),
    }
}

/// The PDU that reads a register; `None` if the bus cannot.
fn read(register: &Row) -> Option<Vec<u8>> {
    let [high, low] = register.address.to_be_bytes();
    let function = match register.space {
        Space::Coil => 1,
        Space::Discrete => 2,
        Space::Holding => 3,
        Space::Input => 4,
        Space::Variable | Space::Setting => return None,
    };
    Some(vec![function, high, low, 0, register.shape.words() as u8])
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_firmware::device::Axis;
    use drivetwin_firmware::md3::Md3;
    use drivetwin_protocol::time::Span as _;
    use drivetwin_sim::line::faults::{FaultRule, LineFaults};

    fn row(spec: &Spec, name: &str) -> usize {
        spec.rows().find(|(_, row)| row.name == name).map(|(index, _)| index).expect("a register")
    }

    fn run(bench: &mut Bench, master: &mut Master, seconds: u64) {
        for _ in 0..seconds * 200 {
            let next = bench.now() + Duration::millis(5);
            bench.run_until(next);
            master.run(bench);
        }
    }

    #[test]
    fn a_master_moves_a_drive_and_repeats_lost_requests() {
        let mut bench = Bench::new();
        let md3 = bench.add::<Md3>("md3");
        bench.run_until(2_500.millis());
        let bus = bench.bus(md3, Port(0)).unwrap();
        let mut master = Master::new(&mut bench, md3).unwrap();
        let spec = bench.spec(md3);
        let steps = || {
            [
                Step::Write { row: row(spec, "MoveSteps"), value: 2_500 },
                Step::Wait(Duration::millis(100)),
                Step::Write { row: row(spec, "MotionControl"), value: 1 },
            ]
        };
        assert_eq!(master.play(&bench, &steps()), Ok(false));
        run(&mut bench, &mut master, 3);
        assert_eq!(bench.motion(md3, Axis(0)).position, 2_500);

        // The master repeats what is lost.
        bench.set_line_faults(bus, LineFaults { drop: FaultRule::next(2), ..LineFaults::NONE });
        assert_eq!(master.play(&bench, &steps()), Ok(false));
        run(&mut bench, &mut master, 4);
        assert_eq!(bench.motion(md3, Axis(0)).position, 5_000);
    }
}
