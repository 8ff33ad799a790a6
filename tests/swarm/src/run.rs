//! Runs a plan and keeps its outcome.

use std::collections::BTreeMap;

use drivetwin_firmware::device::{Duration, Instant, Port};
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, Client, DriveId, PowerAction, Settings, Setup};
use drivetwin_sim::config::bench_file;
use drivetwin_sim::config::layout::Layout;
use drivetwin_sim::line::faults::LineFaults;
use drivetwin_sim::record::trace::{Event, InputRecord, Recording, Retention, Trace};
use fastrand::Rng;

use crate::dialect::Family;
use crate::oracle::{Failure, TOO_MUCH};
use crate::plan::{NAMES, Name, Plan, Step, Who};
use crate::replies::REPLY_DELAY;

/// A way to run a plan. The drives do the same in each.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Mode {
    /// Each wait runs in one piece. Clients read after each step.
    Whole,
    /// Waits run in pieces of random lengths. After each piece, a random choice decides whether clients on
    /// serial lines read.
    Pieces,
    /// Waits run in short pieces. After each, clients on serial lines read, as real programs do. The trace is
    /// a ring buffer.
    Lean,
}

/// The outcome of a run.
pub(crate) struct Happened {
    /// The lifetimes of the emulator: a plan without [`Step::Restart`] has one, and each restart begins
    /// another.
    pub(crate) lives: Vec<Life>,
    /// Digests of all bytes that clients received.
    pub(crate) heard: BTreeMap<Who, Heard>,
    /// Number of requests of well-behaved clients. Each was answered correctly.
    pub(crate) answered: u64,
    /// Number of saves after which a drive started again with the expected values.
    pub(crate) saved: u64,
    /// Number of power cuts after which a drive had the new values, the old ones, and the factory's.
    pub(crate) after_cuts: [u64; 3],
    /// True if the rest of the plan was left out, because the plan had [enough events](MOST_EVENTS).
    pub(crate) cut_short: bool,
    /// Addresses of the drives, as set in the bench file.
    pub(crate) addresses: BTreeMap<Name, u8>,
    /// Delays of the drives' replies in ms, as set in the bench file.
    pub(crate) delays: BTreeMap<Name, u64>,
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

/// A run of the emulator, from its start to its end.
pub(crate) struct Life {
    pub(crate) bench: Bench,
    /// The trace as it was written during the run.
    pub(crate) recording: String,
}

/// Bytes of the ring buffer that holds the trace in [`Mode::Lean`].
pub(crate) const RING: usize = 64 << 10;

/// Time between two reads of a client in [`Mode::Lean`].
const READS: Duration = Duration::millis(20);

/// Longer than any save takes.
const A_SAVE: Duration = Duration::millis(100);

/// After this many events the rest of a plan is left out. Pulses on wires may make millions of events.
pub(crate) const MOST_EVENTS: u64 = 30_000;

/// Most events of a drive in a time span: 4,096 however short the span, and 16 more for each tick. More mean
/// that the clock does not advance.
const MOST_AT_ONCE: u64 = 4_096;
const MOST_A_TICK: u64 = 16;

/// If one step of a plan with wires makes more events than this, the plan is given up or fails: see
/// [`too_many`].
const MOST_A_STEP: u64 = 300_000;

/// Every this many events, at least, a pin must change in a plan that is given up. A change of an input
/// seldom makes more than three events.
const EVENTS_OF_AN_EDGE: usize = 8;

/// With wires on the bench, time advances by at most this much before the events are counted.
const SLICE: Duration = Duration::millis(10);

/// A bench in the middle of a plan.
pub(crate) struct Runner<'a> {
    layout: Layout,
    mode: Mode,
    pub(crate) bench: Bench,
    /// Random numbers for the pieces into which a time span is divided: the length of each piece, and whether clients
    /// read after the piece.
    dice: Rng,
    clients: BTreeMap<Who, Client>,
    /// Current addresses of the drives on their buses.
    pub(crate) addresses: BTreeMap<Name, u8>,
    /// Values of first blocks that were saved, and that no other client can have changed since.
    pub(crate) kept: BTreeMap<Name, Vec<u32>>,
    recording: Option<Recording<Vec<u8>>>,
    pub(crate) happened: Happened,
    /// Number of events before the last restart.
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
    let delays = NAMES.iter().filter_map(|name| Some((*name, delay(&bench, name)?))).collect();
    // After a restart the drives find these values in their memories.
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
        happened: Happened {
            lives: Vec::new(),
            heard: BTreeMap::new(),
            answered: 0,
            saved: 0,
            after_cuts: [0; 3],
            cut_short: false,
            addresses,
            delays,
        },
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

/// The failure of a step with more than [`MOST_A_STEP`] events, after the first `mark`. If inputs cause them,
/// the plan is given up: an output that is wired to an input of the same drive may change at every tick. If
/// drives make them without inputs, a drive is at fault.
fn too_many(trace: &Trace, mark: u64) -> Failure {
    let events = trace.since(mark);
    let (count, is_edge) =
        (events.len(), |event: &Event| matches!(event, Event::Input(InputRecord::Edge { .. })));
    let edges = events.filter(|entry| is_edge(&entry.event)).count();
    let detail =
        format!("more than {MOST_A_STEP} events in a step; of the last {count}, {edges} are edges at inputs");
    Failure::new(if edges * EVENTS_OF_AN_EDGE >= count { TOO_MUCH } else { "too many events" }, detail)
}

/// The address that the bench file sets for a drive.
fn address(bench: &Bench, name: &str) -> Option<u8> {
    let seat = bench.find_drive(name)?;
    u8::try_from(bench.peek(seat, bench.spec(seat).address?)).ok()
}

/// The delay of replies in ms that the bench file sets for a drive; `None` if the drive has no such setting.
fn delay(bench: &Bench, name: &str) -> Option<u64> {
    let seat = bench.find_drive(name)?;
    u64::try_from(bench.peek(seat, bench.spec(seat).find(REPLY_DELAY)?.row)).ok()
}

impl Runner<'_> {
    fn play(&mut self) -> Result<(), Failure> {
        let plan = self.plan;
        for (done, step) in (1..).zip(&plan.steps) {
            self.take(step)?;
            self.read_all();
            if self.events + self.bench.trace().mark() > MOST_EVENTS {
                self.happened.cut_short = done < plan.steps.len();
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
                // A drive may refuse the value.
                self.with(name, |bench, seat| _ = bench.poke(seat, row, value));
            }
            Step::Power(name, action) => {
                self.finish_saves()?;
                self.with(name, |bench, seat| bench.power(seat, action));
            }
            Step::Attach(name, here) => self.with(name, |bench, seat| {
                if let Some(bus) = bench.bus(seat, Port(0)) {
                    bench.attach(bus, here);
                }
            }),
            Step::Disturb(name, port, ref given) => self.with(name, |bench, seat| {
                let mut faults = given.faults;
                for (_, rule) in faults.rules().into_iter().filter(|_| given.own) {
                    *rule = rule.drive(seat);
                }
                bench.set_faults(bench.outlet(seat, Port(port)), faults);
            }),
            Step::Ask(name, seed) => return self.ask_step(name, seed),
            Step::Save(name, seed, failing) => return self.save_step(name, seed, failing),
            Step::Restart => return self.restart(),
        }
        Ok(())
    }

    /// Calls a function with a drive, if the drive is on the bench.
    fn with(&mut self, name: Name, act: impl FnOnce(&mut Bench, DriveId)) {
        if let Some(seat) = self.bench.find_drive(name) {
            act(&mut self.bench, seat);
        }
    }

    /// The family of a drive, if the drive is on the bench.
    pub(crate) fn family(&self, name: Name) -> Option<Family> {
        Some(Family::of(self.bench.spec(self.bench.find_drive(name)?).kind))
    }

    /// Returns true if something may change an input of a drive: a wire, a switch, an encoder, a scenario, or a step
    /// of the plan.
    pub(crate) fn has_inputs(&self, name: &str) -> bool {
        let layout = &self.layout;
        let wires = layout.wires.iter().map(|wire| wire.to);
        let switches = layout.switches.iter().map(|switch| switch.to);
        let encoders =
            layout.encoders.iter().flat_map(|encoder| [encoder.a, encoder.b, encoder.index]).flatten();
        let is_stimulated = self.plan.steps.iter().any(|step| match step {
            Step::Hand(drive, ..) | Step::Pulse(drive, ..) | Step::Turn(drive, ..) => *drive == name,
            _ => false,
        });
        let mut wired = wires.chain(switches).chain(encoders);
        is_stimulated
            || !layout.scenarios.is_empty()
            || wired.any(|(drive, _)| layout.drives[drive].name == name)
    }

    fn say(&mut self, who: Who, bytes: &[u8]) {
        let Some(seat) = self.bench.find_drive(who.drive) else { return };
        // Every drive on the same line may receive these bytes and save values.
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

    /// Returns true if two drives are the same drive or are on the same line.
    pub(crate) fn shares(&self, a: Name, b: Name) -> bool {
        let line = |name| self.bench.find_drive(name).and_then(|seat| self.bench.bus(seat, Port(0)));
        a == b || (line(a).is_some() && line(a) == line(b))
    }

    /// Advances the time, in pieces that depend on the mode.
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

    /// Advances the bench to an instant. Fails if the bench makes so many events that its clock seems stuck.
    fn go_on(&mut self, until: Instant) -> Result<(), Failure> {
        let (from, before) = (self.bench.now(), self.bench.trace().mark());
        if self.layout.wires.is_empty() {
            self.bench.run_until(until);
        }
        while self.bench.now() < until {
            self.bench.run_until(until.min(self.bench.now() + SLICE));
            if self.bench.trace().mark() - before > MOST_A_STEP {
                return Err(too_many(self.bench.trace(), before));
            }
        }
        // Handles what is due at the instant `until` itself.
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

    /// Reads at all clients.
    fn read_all(&mut self) {
        self.read(|_| true);
    }

    /// Reads at clients on serial lines. On a TCP connection a drive gets no more requests until its answers
    /// are read, so reading there would change what happens.
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

    /// Switches a drive on and waits until it has started.
    pub(crate) fn power_on(&mut self, name: Name) -> Result<(), Failure> {
        self.with(name, |bench, seat| bench.power(seat, PowerAction::On));
        let boot = self.family(name).map_or(Duration::ZERO, Family::boot);
        self.pass(if self.boots_fast(name) { boot.min(300.millis()) } else { boot })
    }

    fn boots_fast(&self, name: Name) -> bool {
        self.layout.drives.iter().any(|drive| drive.name == name && drive.fast_boot)
    }

    /// Clears the faults of lines and TCP ports, and waits until all messages are answered. Then waits for the start-up, unless the
    /// drive is on and starts fast. Switches the drive on if it is off.
    pub(crate) fn quiet(&mut self, name: Name) -> Result<(), Failure> {
        self.with(name, |bench, seat| {
            for port in (0..bench.spec(seat).ports.len() as u8).map(Port) {
                bench.set_faults(bench.outlet(seat, port), LineFaults::NONE);
            }
        });
        // At 1,200 baud, noise that a line fault duplicates takes some seconds.
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

    /// Waits until all requests on lines are answered, and until a save that the last one began has ended. So power
    /// fails during a save only where a well-behaved client expects it. A delayed reply is not waited for.
    fn finish_saves(&mut self) -> Result<(), Failure> {
        self.pass(A_SAVE)?;
        for _ in 0..100 {
            let mut drives = self.layout.drives.iter().filter_map(|drive| self.bench.find_drive(&drive.name));
            if drives.all(|seat| self.bench.bus(seat, Port(0)).is_none_or(|bus| self.bench.is_answered(bus)))
            {
                break;
            }
            self.pass(A_SAVE)?;
        }
        self.pass(A_SAVE)
    }

    /// Ends the emulator and starts it again with the contents of the drives' memories.
    fn restart(&mut self) -> Result<(), Failure> {
        self.finish_saves()?;
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
        // Handles everything that is due at the last instant.
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

#[cfg(test)]
mod tests {
    use drivetwin_sim::catalog;

    use super::*;
    use crate::oracle;

    /// An MD3 whose cutback light, D5, is wired to its LOWCURRENT input. LOWCURRENT switches the light on
    /// (MD3-39), and the light ends LOWCURRENT.
    #[test]
    fn a_plan_whose_wires_oscillate_is_given_up() {
        let parts = [
            "[[drive]]\nname = \"a\"\nkind = \"md3\"\nfast_boot = true\nset = { HomingConfiguration = 8 }\n",
            "[[wire]]\nfrom = \"a.D5\"\nto = \"a.J2.2\"\n",
        ];
        let parts = parts.map(str::to_owned).to_vec();
        let plan = Plan { seed: 1, fast: true, parts, steps: vec![Step::Wait(1.secs())] };
        assert_eq!(oracle::judge(&plan).map(|tally| tally.given_up), Ok(1));
        let renamed = run(&plan, Mode::Whole).map(drop).map_err(|failure| failure.of("HomingConfiguration"));
        assert_eq!(renamed.map_err(|failure| failure.what), Err(TOO_MUCH.to_owned()));
    }

    #[test]
    fn many_outputs_without_inputs_are_a_failure() {
        let make = |kind: &str| catalog::make(kind).ok();
        let judged = |edges: usize| {
            let head = "drivetwin trace 1\nseed 1\ndrive a md3\n";
            let text = format!(
                "{head}{}{}",
                "0.000000 < pin D5 low\n".repeat(700),
                "0.000000 > pin J2.2 low\n".repeat(edges)
            );
            too_many(&Trace::parse(&text, &make).expect("a trace"), 0).what
        };
        assert_eq!([judged(0), judged(99), judged(100)], ["too many events", "too many events", TOO_MUCH]);
    }
}
