//! The masters: a thread for each port, which sends requests one after the other and compares each reply.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crate::dialect::{Dialect, Exchange};
use crate::layout::{PLANS, POWER_FAILS, Plan, fault_share};
use crate::now;
use crate::process::Ready;
use crate::stimulus;
use crate::tally::{Gate, Line, Tally};
use crate::wire::{Failed, Wire};

/// Longest wait for a reply on a port without faults. The machine may be busy.
const PATIENCE: Duration = Duration::from_secs(10);
/// The same on a port with faults, where replies are lost.
const FAULTY_PATIENCE: Duration = Duration::from_millis(250);
/// Silence before a request on a line of 115,200 baud, a little longer than t3.5 of 1.75 ms (serial 2.5.1.1).
const SILENCE: Duration = Duration::from_millis(2);
/// Wait before another attempt to connect.
const AGAIN: Duration = Duration::from_millis(50);
/// Each request with a number that this divides is a write.
const CYCLE: u32 = 4;
/// Exchanges in a row without a right reply after which a drive on a port with faults is dead. A fault strikes one in a
/// hundred.
const TRIES: u32 = 20;
/// Longest time that a late master makes up.
const LATE: Duration = Duration::from_secs(1);

/// State of the power of each drive whose power fails: odd while the drive has no power or is starting.
pub(crate) type Power = BTreeMap<&'static str, AtomicU64>;

/// Longest time between two requests at one port that fills up the rate, in nanoseconds: each drive must get its
/// messages in the warm-up, whatever the rate.
const SLOWEST: u64 = 50_000_000;

/// All masters of the run.
pub(crate) struct Masters {
    /// Number of masters, which wait at their gate.
    pub(crate) count: usize,
    /// Number of threads that act from outside, which wait at theirs.
    pub(crate) actions: usize,
    /// Nanoseconds between two requests at one port that fills up the rate.
    pace: Arc<AtomicU64>,
    fillers: Vec<&'static Line>,
}

impl Masters {
    /// Starts the masters, and the actions from outside.
    pub(crate) fn start(ready: &Ready, tally: &Arc<Tally>, gate: &Arc<Gate>, actions: &Arc<Gate>) -> Self {
        let power: Arc<Power> =
            Arc::new(POWER_FAILS.iter().map(|&(drive, _)| (drive, AtomicU64::new(1))).collect());
        let pace = Arc::new(AtomicU64::new(1_000_000));
        let is_filler = |plan: &&Plan| plan.is_modbus_tcp();
        let fillers = PLANS.iter().filter(is_filler).map(|plan| tally.line(plan.port)).collect();
        for plan in PLANS {
            let place = ready.places(plan.place.0).swap_remove(plan.place.1);
            let pace = is_filler(&plan).then(|| Arc::clone(&pace));
            let mut master = Master::new(plan, place, pace, (tally, gate, &power));
            thread::spawn(move || master.run());
        }
        let actions = stimulus::start(ready, tally, actions, &power);
        Self { count: PLANS.len(), actions, pace, fillers }
    }

    /// Lets the masters at Modbus/TCP send so many requests per second together.
    pub(crate) fn fill(&self, rate: u64) {
        let each = 1_000_000_000 * self.fillers.len() as u64 / rate.max(1);
        self.pace.store(each.min(SLOWEST), Ordering::Relaxed);
    }

    /// Number of right replies to the masters that fill up the rate.
    pub(crate) fn filled(&self) -> u64 {
        self.fillers.iter().map(|line| line.right.load(Ordering::Relaxed)).sum()
    }
}

/// A register of a drive with the value that it must have.
struct Talk {
    drive: &'static str,
    dialect: Dialect,
    messages: &'static AtomicU64,
    /// The value; `None` if a write may not have arrived.
    value: Option<u32>,
    number: u32,
    /// Number of exchanges since the last right reply; those without power count as one.
    lost: u32,
}

/// A connection with the requests in turn.
struct Seat {
    wire: Option<Wire>,
    talks: Vec<Talk>,
    turn: usize,
    /// What is under way: the right reply, the value after it, the state of the power before, and the time of sending.
    exchange: Exchange,
    next_value: u32,
    power: u64,
    sent: Instant,
    received: Vec<u8>,
}

/// The masters of a port.
struct Master {
    plan: &'static Plan,
    place: String,
    seats: Vec<Seat>,
    is_faulty: bool,
    line: &'static Line,
    tally: Arc<Tally>,
    gate: Arc<Gate>,
    power: Arc<Power>,
    pace: Option<Arc<AtomicU64>>,
    next: Instant,
}

impl Master {
    fn new(
        plan: &'static Plan,
        place: String,
        pace: Option<Arc<AtomicU64>>,
        (tally, gate, power): (&Arc<Tally>, &Arc<Gate>, &Arc<Power>),
    ) -> Self {
        let seat = |index: usize| {
            let talk = |&(drive, dialect): &(&'static str, Dialect)| Talk {
                drive,
                // A register belongs to one connection.
                dialect: if index > 0 { Dialect::TcpConstant } else { dialect },
                messages: tally.drive(drive),
                value: None,
                number: 0,
                lost: 0,
            };
            let talks = plan.talks.iter().map(talk).collect();
            let exchange = Exchange { request: Vec::new(), reply: Vec::new() };
            let (next_value, power, sent, received) = (0, 0, now(), Vec::new());
            Seat { wire: None, talks, turn: 0, exchange, next_value, power, sent, received }
        };
        Self {
            plan,
            place,
            seats: (0..plan.connections).map(seat).collect(),
            is_faulty: fault_share(plan.port) > 0.0,
            line: tally.line(plan.port),
            tally: Arc::clone(tally),
            gate: Arc::clone(gate),
            power: Arc::clone(power),
            pace,
            next: now(),
        }
    }

    fn run(&mut self) {
        loop {
            if self.gate.is_closed() {
                self.ask_lost();
                self.probe();
                self.open_all();
                self.gate.pass();
                self.next = now();
            }
            self.round();
        }
    }

    /// Makes the next exchange of each connection.
    fn round(&mut self) {
        self.keep_pace();
        for index in 0..self.seats.len() {
            self.send(index);
        }
        for index in 0..self.seats.len() {
            self.receive(index);
        }
    }

    /// Goes on until the last reply of each drive is right, or the drive is dead. All drives have power.
    fn ask_lost(&mut self) {
        let is_lost = |talk: &Talk| (1..TRIES).contains(&talk.lost);
        while self.seats.iter().flat_map(|seat| &seat.talks).any(is_lost) {
            self.round();
        }
    }

    /// Forgets the connections that the drive has closed.
    fn probe(&mut self) {
        for seat in &mut self.seats {
            if seat.wire.as_mut().is_some_and(|wire| wire.drain().is_err()) {
                seat.wire = None;
            }
        }
    }

    /// Opens the connections that are not open.
    fn open_all(&mut self) {
        while self.seats.iter().any(|seat| seat.wire.is_none()) {
            for index in 0..self.seats.len() {
                self.open(index);
            }
        }
    }

    /// Waits until the next round is due.
    fn keep_pace(&mut self) {
        let Some(pace) = &self.pace else {
            if matches!(self.plan.talks[0].1, Dialect::Rtu { .. }) {
                thread::park_timeout(SILENCE);
            }
            return;
        };
        let interval = Duration::from_nanos(pace.load(Ordering::Relaxed)) * self.seats.len() as u32;
        let present = now();
        self.next = (self.next + interval).max(present.checked_sub(LATE).unwrap_or(present));
        if self.next > present {
            thread::park_timeout(self.next - present);
        }
    }

    /// Opens a connection if it is closed.
    fn open(&mut self, index: usize) {
        let seat = &mut self.seats[index];
        if seat.wire.is_some() {
            return;
        }
        seat.wire = Wire::open(&self.place).ok();
        // A greeting of the drive, or what is left of the reply to another connection.
        if !self.plan.is_modbus_tcp() && seat.wire.as_mut().is_some_and(|wire| wire.drain().is_err()) {
            seat.wire = None;
        }
        if seat.wire.is_none() {
            thread::park_timeout(AGAIN);
        }
    }

    fn power_of(&self, drive: &str) -> u64 {
        self.power.get(drive).map_or(0, |state| state.load(Ordering::SeqCst))
    }

    /// Sends the next request of a connection.
    fn send(&mut self, index: usize) {
        self.open(index);
        let seat = &mut self.seats[index];
        seat.turn = (seat.turn + 1) % seat.talks.len();
        let talk = &mut seat.talks[seat.turn];
        talk.number = talk.number.wrapping_add(1);
        let number = talk.number as u16;
        let is_write =
            talk.dialect.can_write() && (talk.value.is_none() || talk.number.is_multiple_of(CYCLE));
        (seat.exchange, seat.next_value) = match talk.value {
            Some(value) if !is_write => (talk.dialect.read(number, value), value),
            _ => {
                let value = talk.dialect.value(talk.number);
                (talk.dialect.write(number, value), value)
            }
        };
        let drive = talk.drive;
        let power = self.power_of(drive);
        let seat = &mut self.seats[index];
        seat.power = power;
        seat.sent = now();
        if let Some(wire) = &mut seat.wire
            && wire.send(&seat.exchange.request).is_err()
        {
            seat.wire = None;
        }
    }

    /// Receives the reply to the request that a connection has sent, and compares it.
    fn receive(&mut self, index: usize) {
        let seat = &mut self.seats[index];
        let patience = if self.is_faulty { FAULTY_PATIENCE } else { PATIENCE };
        let reply = &seat.exchange.reply;
        seat.received.clear();
        let result = match &mut seat.wire {
            Some(wire) => wire.receive(reply.len(), patience, &mut seat.received),
            None => Err(Failed::Closed),
        };
        let talk = &mut seat.talks[seat.turn];
        talk.messages.fetch_add(1, Ordering::Relaxed);
        if result.is_ok() && seat.received == *reply {
            talk.value = Some(seat.next_value);
            talk.lost = 0;
            self.line.answered(seat.sent);
            return;
        }
        talk.value = None;
        let (drive, dialect, power) = (talk.drive, talk.dialect, seat.power);
        let after = self.power_of(drive);
        let seat = &mut self.seats[index];
        let lost = &mut seat.talks[seat.turn].lost;
        if power % 2 == 1 || power != after {
            self.line.powerless.fetch_add(1, Ordering::Relaxed);
            *lost = 1;
        } else if self.is_faulty {
            self.line.faulty.fetch_add(1, Ordering::Relaxed);
            *lost += 1;
            if *lost == TRIES {
                let port = self.plan.port;
                self.tally.wrong(&format!(
                    "{port}: {drive} has power, but no right reply to {TRIES} requests in a row"
                ));
            }
        } else {
            let how = match result {
                Ok(()) => "a wrong reply",
                Err(Failed::Silent) => "no whole reply",
                Err(Failed::Closed) => "a closed connection",
            };
            let (asked, reply) = (seat.exchange.request.escape_ascii(), seat.exchange.reply.escape_ascii());
            let received = seat.received.escape_ascii();
            self.tally.wrong(&format!(
                "{}: {how} of {drive} to {asked}: {received} instead of {reply}",
                self.plan.port
            ));
        }
        if result == Err(Failed::Closed) {
            // A drive without power accepts connections and closes them at once.
            thread::park_timeout(AGAIN);
        }
        recover(seat, dialect, result == Err(Failed::Closed));
    }
}

/// Brings a connection into a known state after an exchange without a right reply.
fn recover(seat: &mut Seat, dialect: Dialect, is_closed: bool) {
    let is_line = matches!(dialect, Dialect::Rtu { .. } | Dialect::Qsb);
    if is_closed || !is_line {
        seat.wire = None;
    } else if let Some(wire) = &mut seat.wire {
        let ended = if dialect.has_no_frames() { wire.send(b"\r") } else { Ok(()) };
        if ended.and_then(|()| wire.drain()).is_err() {
            seat.wire = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;

    #[test]
    fn a_drive_with_faults_that_never_replies_is_wrong() {
        let plan = PLANS.iter().find(|plan| plan.port == "f3.rs485").unwrap();
        let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let master = |state| {
            let (tally, gate) = (Arc::new(Tally::default()), Arc::new(Gate::default()));
            let power = Arc::new(Power::from([("f3", AtomicU64::new(state))]));
            Master::new(plan, format!("tcp:{nobody}"), None, (&tally, &gate, &power))
        };
        let mut on = master(2);
        on.round();
        assert_eq!(on.tally.counts().wrong, 0);
        on.ask_lost();
        let counts = on.tally.counts();
        assert_eq!((counts.faulty, counts.wrong), (u64::from(TRIES), 1));
        let mut off = master(1);
        (0..=TRIES).for_each(|_| off.round());
        assert_eq!((off.tally.counts().powerless, off.tally.counts().wrong), (u64::from(TRIES) + 1, 0));
    }
}
