//! A plan becomes what happened.

use std::collections::BTreeMap;

use drivetwin_firmware::device::{Duration, Instant, Port};
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, Client, DriveId, PowerAction, Settings, Setup};
use drivetwin_sim::config::bench_file;
use drivetwin_sim::config::layout::Layout;
use drivetwin_sim::record::trace::{Recording, Retention};
use fastrand::Rng;

use crate::dialect::Family;
use crate::oracle::{Failure, TOO_MUCH};
use crate::plan::{NAMES, Name, Plan, Step, Who};

/// A way to run a plan; the same happens in each.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Mode {
    /// Each wait in one piece, clients read behind each step.
    Whole,
    /// Waits in pieces of any lengths, in which clients of lines read, or do not.
    Pieces,
    /// Waits in short pieces, behind each of which clients of lines read, as programs do; only a ring of the trace is kept.
    Lean,
}

/// The outcome of a run.
pub(crate) struct Happened {
    /// Lives, one from each beginning.
    pub(crate) lives: Vec<Life>,
    /// All that clients received.
    pub(crate) heard: BTreeMap<Who, Heard>,
    /// Requests of clients that behave, each of which was answered rightly.
    pub(crate) answered: u64,
    /// Saves after which a drive came back with what it should.
    pub(crate) saved: u64,
    /// Addresses that the bench file gives.
    pub(crate) addresses: BTreeMap<Name, u8>,
}

/// Digest of all bytes that a client received: their number and their FNV-1a hash.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Heard {
    count: usize,
    sum: u64,
}

impl Heard {
    const NOTHING: Self = Self { count: 0, sum: 0xCBF2_9CE4_8422_2325 };

    fn hear(&mut self, bytes: &[u8]) {
        self.count += bytes.len();
        let sum = |sum: u64, &byte: &u8| (sum ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3);
        self.sum = bytes.iter().fold(self.sum, sum);
    }
}

/// From a beginning to an end of the program.
pub(crate) struct Life {
    pub(crate) bench: Bench,
    /// Written while it went on.
    pub(crate) recording: String,
}

/// The ring of [`Mode::Lean`].
pub(crate) const RING: usize = 64 << 10;

/// Between two looks of a program at its port.
const READS: Duration = Duration::millis(20);

/// Longer than any drive saves: power fails during a save only where a well-behaved client expects it.
const A_SAVE: Duration = Duration::millis(100);

/// Events after which the rest of a plan is left out. Pulses in wires may make millions.
const MOST_EVENTS: u64 = 30_000;

/// Events of a drive in a tick, and in a span however short: more would mean that the clock does not advance.
const MOST_AT_ONCE: u64 = 4_096;
const MOST_A_TICK: u64 = 16;

/// Events in a step of a plan after which the plan is given up: an output that is wired to an input of its own drive may
/// change at every tick.
const MOST_A_STEP: u64 = 300_000;

/// Longest time that such a bench runs before its events are counted.
const SLICE: Duration = Duration::millis(10);

/// A bench in the middle of a plan.
pub(crate) struct Runner<'a> {
    layout: Layout,
    mode: Mode,
    pub(crate) bench: Bench,
    /// Random lengths of pieces, and the clients that read between them.
    dice: Rng,
    clients: BTreeMap<Who, Client>,
    /// Addresses on the bus.
    pub(crate) addresses: BTreeMap<Name, u8>,
    /// Saved first blocks that cannot have changed since.
    pub(crate) kept: BTreeMap<Name, Vec<u32>>,
    recording: Option<Recording<Vec<u8>>>,
    pub(crate) happened: Happened,
    /// Events of former lives.
    events: u64,
    plan: &'a Plan,
}

/// Runs a plan.
pub(crate) fn run(plan: &Plan, mode: Mode) -> Result<Happened, Failure> {
    let mut layout =
        bench_file::parse(&plan.bench_file()).map_err(|error| Failure::new("no bench file", error))?;
    let (bench, recording) = build(&layout, mode, Vec::new())?;
    let addresses: BTreeMap<Name, u8> =
        NAMES.iter().filter_map(|name| Some((*name, address(&bench, name)?))).collect();
    // Later lives find them in their memories.
    layout.drives.iter_mut().for_each(|drive| drive.presets.clear());
    let mut runner = Runner {
        layout,
        mode,
        bench,
        dice: Rng::with_seed(plan.seed),
        clients: BTreeMap::new(),
        addresses: addresses.clone(),
        kept: BTreeMap::new(),
        recording: Some(recording),
        happened: Happened { lives: Vec::new(), heard: BTreeMap::new(), answered: 0, saved: 0, addresses },
        events: 0,
        plan,
    };
    runner.play()?;
    runner.end_life()?;
    Ok(runner.happened)
}

fn build(layout: &Layout, mode: Mode, given: Vec<Setup>) -> Result<(Bench, Recording<Vec<u8>>), Failure> {
    let (trace, capture) = match mode {
        Mode::Lean => (Retention::Ring(RING), Retention::Off),
        Mode::Whole | Mode::Pieces => (Retention::All, Retention::Ring(RING)),
    };
    let settings = Settings { trace, capture, ..layout.settings() };
    let bench = layout.build(settings, given).map_err(|error| Failure::new("no bench", error))?.bench;
    let recording =
        Recording::new(bench.trace(), Vec::new()).map_err(|error| Failure::new("no recording", error))?;
    Ok((bench, recording))
}

/// The address that a bench file has given a drive.
fn address(bench: &Bench, name: &str) -> Option<u8> {
    let seat = bench.find_drive(name)?;
    u8::try_from(bench.peek(seat, bench.spec(seat).address?)).ok()
}

impl Runner<'_> {
    fn play(&mut self) -> Result<(), Failure> {
        let plan = self.plan;
        for step in &plan.steps {
            self.take(step)?;
            self.read_all();
            if self.events + self.bench.trace().mark() > MOST_EVENTS {
                break;
            }
        }
        Ok(())
    }

    fn take(&mut self, step: &Step) -> Result<(), Failure> {
        match *step {
            Step::Wait(time) => return self.pass(time),
            Step::Say(who, ref bytes) => self.say(who, bytes),
            Step::Leave(who) => {
                if let Some(client) = self.clients.remove(&who) {
                    self.bench.disconnect(client);
                }
            }
            Step::Hand(name, pin, driving) => {
                self.with(name, |bench, seat| bench.set_pin(seat, pin, driving));
            }
            Step::Pulse(name, pin, count, hz) => {
                self.with(name, |bench, seat| _ = bench.pulse(seat, pin, count, hz.into()));
            }
            Step::Turn(name, encoder, counts, hz) => {
                self.with(name, |bench, seat| _ = bench.encoder(seat, encoder, counts, hz.into()));
            }
            Step::Cause(name, fault, on) => self.with(name, |bench, seat| bench.fault(seat, fault, on)),
            Step::Preset(name, row, value) => {
                self.kept.remove(name);
                // Refused is as good.
                self.with(name, |bench, seat| _ = bench.poke(seat, row, value));
            }
            Step::Power(name, action) => {
                self.pass(A_SAVE)?;
                self.with(name, |bench, seat| bench.power(seat, action));
            }
            Step::Attach(name, here) => self.with(name, |bench, seat| {
                if let Some(bus) = bench.bus(seat, Port(0)) {
                    bench.attach(bus, here);
                }
            }),
            Step::Disturb(name, ref faults) => self.with(name, |bench, seat| {
                if let Some(bus) = bench.bus(seat, Port(0)) {
                    bench.set_line_faults(bus, **faults);
                }
            }),
            Step::Ask(name, seed) => return self.ask_step(name, seed),
            Step::Save(name, seed, failing) => return self.save_step(name, seed, failing),
            Step::Restart => return self.restart(),
        }
        Ok(())
    }

    /// Does something with a drive, if it is there.
    fn with(&mut self, name: Name, act: impl FnOnce(&mut Bench, DriveId)) {
        if let Some(seat) = self.bench.find_drive(name) {
            act(&mut self.bench, seat);
        }
    }

    /// The family of a drive, if that is on the bench.
    pub(crate) fn family(&self, name: Name) -> Option<Family> {
        Some(Family::of(self.bench.spec(self.bench.find_drive(name)?).kind))
    }

    fn say(&mut self, who: Who, bytes: &[u8]) {
        let Some(seat) = self.bench.find_drive(who.drive) else { return };
        // All that it sends may be received, and saved.
        for name in NAMES {
            if self.shares(who.drive, name) {
                self.kept.remove(name);
            }
        }
        let ended = self.clients.get(&who).is_some_and(|&client| self.bench.ended(client).is_some());
        if ended && let Some(client) = self.clients.remove(&who) {
            self.bench.disconnect(client);
        }
        if !self.clients.contains_key(&who) {
            let Ok(client) = self.bench.connect_to(seat, Port(who.port)) else { return };
            self.clients.insert(who, client);
        }
        self.bench.send(self.clients[&who], bytes);
    }

    /// Returns whether two drives are the same, or on one line.
    pub(crate) fn shares(&self, a: Name, b: Name) -> bool {
        let line = |name| self.bench.find_drive(name).and_then(|seat| self.bench.bus(seat, Port(0)));
        a == b || (line(a).is_some() && line(a) == line(b))
    }

    /// Time passes.
    pub(crate) fn pass(&mut self, time: Duration) -> Result<(), Failure> {
        let until = self.bench.now() + time;
        while self.mode == Mode::Lean && self.bench.now() < until {
            self.go_on(until.min(self.bench.now() + READS))?;
            self.read_lines();
        }
        while self.mode == Mode::Pieces && self.dice.u8(..4) > 0 {
            let left = until.since(self.bench.now()).ticks();
            if left == 0 {
                break;
            }
            let piece = self.dice.u64(0..=left);
            self.go_on(self.bench.now() + Duration::from_ticks(piece))?;
            if self.dice.bool() {
                self.read_lines();
            }
            if self.dice.bool() {
                self.record()?;
            }
        }
        self.go_on(until)
    }

    /// Brings the bench to an instant, and looks that it does not count for ever what happens at one.
    fn go_on(&mut self, until: Instant) -> Result<(), Failure> {
        let (from, before) = (self.bench.now(), self.bench.trace().mark());
        if self.layout.wires.is_empty() {
            self.bench.run_until(until);
        }
        while self.bench.now() < until {
            self.bench.run_until(until.min(self.bench.now() + SLICE));
            if self.bench.trace().mark() - before > MOST_A_STEP {
                return Err(Failure::new(TOO_MUCH, format!("{MOST_A_STEP} events in a step")));
            }
        }
        // What is due at this instant.
        self.bench.run_until(until);
        let made = self.bench.trace().mark() - before;
        let drives = self.bench.drives().len() as u64;
        let ticks = until.since(from).ticks();
        if made > drives * (MOST_AT_ONCE + MOST_A_TICK * ticks) {
            return Err(Failure::new("stuck clock", format!("{made} events in {ticks} ticks")));
        }
        if self.bench.now() != until {
            return Err(Failure::new("stuck clock", format!("{:?} instead of {until:?}", self.bench.now())));
        }
        Ok(())
    }

    fn record(&mut self) -> Result<(), Failure> {
        let Some(recording) = self.recording.as_mut().filter(|_| self.mode != Mode::Lean) else {
            return Ok(());
        };
        recording.follow(self.bench.trace()).map_err(|error| Failure::new("no recording", error))
    }

    /// All clients read.
    fn read_all(&mut self) {
        self.read(|_| true);
    }

    /// Reads at clients on lines: on a TCP connection a drive gets no more requests until its answers are read.
    fn read_lines(&mut self) {
        let tcp = NAMES.map(|name| (name, self.family(name) == Some(Family::Mdrive)));
        self.read(|who| !tcp.contains(&(who.drive, true)));
    }

    fn read(&mut self, who_reads: impl Fn(&Who) -> bool) {
        let mut bytes = Vec::new();
        for (who, client) in self.clients.iter().filter(|(who, _)| who_reads(who)) {
            bytes.clear();
            self.bench.receive(*client, &mut bytes);
            self.happened.heard.entry(*who).or_insert(Heard::NOTHING).hear(&bytes);
        }
    }

    /// Power, and time to start.
    pub(crate) fn power_on(&mut self, name: Name) -> Result<(), Failure> {
        self.with(name, |bench, seat| bench.power(seat, PowerAction::On));
        let boot = self.family(name).map_or(Duration::ZERO, Family::boot);
        self.pass(if self.boots_fast(name) { boot.min(300.millis()) } else { boot })
    }

    fn boots_fast(&self, name: Name) -> bool {
        self.layout.drives.iter().any(|drive| drive.name == name && drive.fast_boot)
    }

    /// Waits in silence until all messages are over and all drives have started.
    pub(crate) fn quiet(&mut self, name: Name) -> Result<(), Failure> {
        self.with(name, |bench, seat| {
            if let Some(bus) = bench.bus(seat, Port(0)) {
                bench.set_line_faults(bus, drivetwin_sim::line::faults::LineFaults::NONE);
            }
        });
        // At 1,200 baud, and doubled, garbage takes some seconds.
        for _ in 0..10 {
            self.pass(1.secs())?;
            let bus = self.bench.find_drive(name).and_then(|seat| self.bench.bus(seat, Port(0)));
            if bus.is_none_or(|bus| self.bench.is_answered(bus)) {
                break;
            }
        }
        let starts = self.bench.find_drive(name).is_some_and(|seat| !self.bench.powered(seat));
        if starts || !self.boots_fast(name) { self.power_on(name) } else { Ok(()) }
    }

    /// The program ends and begins again with what the memories hold.
    fn restart(&mut self) -> Result<(), Failure> {
        self.pass(A_SAVE)?;
        let names = self.layout.drives.iter().map(|drive| drive.name.clone());
        let seats: Vec<Option<DriveId>> = names.map(|name| self.bench.find_drive(&name)).collect();
        let memory = |seat: &Option<DriveId>| seat.map(|seat| self.bench.memory(seat).to_vec());
        let given = seats.iter().map(|seat| Setup { memory: memory(seat), ..Setup::default() }).collect();
        self.read_all();
        self.end_life()?;
        self.clients.clear();
        let (bench, recording) = build(&self.layout, self.mode, given)?;
        (self.bench, self.recording) = (bench, Some(recording));
        for (name, values) in self.kept.clone() {
            self.quiet(name)?;
            self.expect_kept(name, &values)?;
        }
        Ok(())
    }

    fn end_life(&mut self) -> Result<(), Failure> {
        // All of its last instant.
        self.pass(Duration::ZERO)?;
        self.events += self.bench.trace().mark();
        let Some(recording) = self.recording.take().filter(|_| self.mode != Mode::Lean) else {
            return Ok(());
        };
        let bytes =
            recording.finish(self.bench.trace()).map_err(|error| Failure::new("no recording", error))?;
        let recording = String::from_utf8(bytes).map_err(|error| Failure::new("no recording", error))?;
        let bench = std::mem::take(&mut self.bench);
        self.happened.lives.push(Life { bench, recording });
        Ok(())
    }
}
