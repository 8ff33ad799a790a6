//! Replay of a golden trace on the board.
//!
//! The harness controls time. It stops the board at the instant of each input, applies the input there, and
//! checks the board's outputs whenever the board is idle. An output must appear not before its instant and at
//! most [`Patience`] after it.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use drivetwin_firmware::device::{Duration, Instant, Level, Pin, Role};
use drivetwin_protocol::line::{Line, Parity};
use drivetwin_sim::record::trace::Trace;

use crate::expected::{Expected, Reply};
use crate::feed::{self, Act};
use crate::figures::Figures;
use crate::host::{Connection, Host, frames};
use crate::image::Image;
use crate::lag::Lag;
use crate::machine::{CYCLES_PER_US, Gpio, Jack, Machine, Overslept};
use crate::patience::{PLANNING, Patience, earlier};
use crate::pins::{DE, DIR, FAST, STEP, Wires};
use crate::place::Places;
use crate::stack::Stack;

/// A replay in progress.
struct Replay {
    machine: Machine,
    /// The host whose connections lead to a drive with TCP ports.
    host: Option<Host>,
    expected: Expected,
    places: Places,
    /// The pins that the drive can drive: index, name, and the pin of the board.
    wires: Vec<(Pin, &'static str, Gpio)>,
    /// For each of `wires`: true if the pin was released at the last stop.
    floats: Vec<bool>,
    /// True if STEP and DIR have pins of their own.
    has_axis_pins: bool,
    /// Driven level of each input, which a reset restores.
    inputs: Vec<(Gpio, bool)>,
    /// Allowed lateness.
    patience: Patience,
    /// Instant at which the board's clock was 0.
    origin: Instant,
    powered: bool,
    /// Instant of the last stop.
    now: Instant,
    /// Bytes sent on each connection or on the bus that have not been compared yet.
    said: BTreeMap<Option<Connection>, Vec<u8>>,
    /// Replies that the board has not sent yet.
    replies: VecDeque<Reply>,
    /// The level of DIR: true is forward.
    forward: bool,
    made: i32,
    lag: Lag,
    figures: Figures,
    saved: u32,
    /// Address of the image's count of steps that slipped.
    slipped: u32,
}

/// Plays a trace on a new board with these wires, and compares all of its outputs.
pub(crate) fn play(
    name: &str,
    trace: &Trace,
    expected: Expected,
    wires: &Wires,
    image: &Image,
    shift: u32,
) -> Result<Figures, Overslept> {
    let [drive] = trace.drives.as_slice() else { panic!("a board has one drive") };
    let spec = drive.spec;
    let gpio = |name: &str| wires.iter().find(|(wired, _)| *wired == name).map(|(_, gpio)| *gpio);
    let shows = |role| matches!(role, Role::Output | Role::Both | Role::Led);
    let shown = (0..).map(Pin).zip(spec.pins).filter(|(_, pin)| shows(pin.role));
    let shown: Vec<_> = shown.filter_map(|(pin, of)| Some((pin, of.name, gpio(of.name)?))).collect();
    let acts = feed::acts(trace, &expected, spec, &gpio);

    let is_on_network = spec.is_on_network();
    let jack = if is_on_network { Jack::Ethernet } else { Jack::Uart0 };
    let mut machine = Machine::new(image, jack, shift);
    let stack = Stack::paint(&mut machine, image);
    let saved = image.symbol("SAVED");
    machine.memory().write([(saved, 0x7374_616E), (saved + 4, 0x6469_6E21)]);
    machine.memory().put(saved + 8, &drive.memory);
    let mut inputs = vec![(FAST, !drive.boot_fast)];
    let hears = |role| matches!(role, Role::Input | Role::Both | Role::AnalogueOrDigital);
    let heard = spec.pins.iter().filter(|pin| hears(pin.role));
    inputs.extend(heard.filter_map(|pin| Some((gpio(pin.name)?, pin.idle != Level::Low))));
    inputs.extend(spec.faults.iter().chain(&["DTR"]).filter_map(|name| Some((gpio(name)?, true))));

    let has_axis_pins = expected.has_steps && expected.shared_step().is_none();
    let mut replay = Replay {
        machine,
        host: is_on_network.then(|| Host::new(spec)),
        replies: expected.replies.iter().cloned().collect(),
        expected,
        places: Places::of(name, trace),
        floats: vec![true; shown.len()],
        wires: shown,
        has_axis_pins,
        inputs,
        patience: Patience::of(trace, spec, is_on_network),
        origin: drive.from,
        powered: true,
        now: drive.from,
        said: BTreeMap::new(),
        forward: false,
        made: 0,
        lag: Lag::default(),
        figures: Figures::default(),
        saved,
        slipped: image.symbol("SLIPPED"),
    };
    replay.boot();
    replay.go(&acts, trace.end)?;
    replay.finish(trace.end);
    replay.figures.stops = replay.machine.stops();
    replay.figures.stack = stack.used(&mut replay.machine);
    Ok(replay.figures)
}

impl Replay {
    /// Runs the board from its first instruction until the start-up is done.
    fn boot(&mut self) {
        for (gpio, high) in self.inputs.clone() {
            self.machine.drive(gpio, high);
        }
        self.forward = false;
        self.run();
        let boot = self.now.since(self.origin);
        assert!(boot < self.patience.boot, "{}: the board starts in {boot:?}", self.here());
        self.figures.boot = self.figures.boot.max(boot);
        let axis = [("STEP", STEP), ("DIR", DIR)].into_iter().filter(|_| self.has_axis_pins);
        for (name, gpio) in axis.chain([("DE", DE)]) {
            let [level] = self.machine.levels(&[gpio])[..] else { unreachable!("one level of one pin") };
            assert_eq!(level, Level::Low, "{}: {name} begins driven low", self.here());
        }
    }

    /// Performs each act at its instant, up to `end`.
    fn go(&mut self, acts: &[(Instant, Act)], end: Instant) -> Result<(), Overslept> {
        // An output is checked at the latest instant at which it may appear.
        let due = self.expected.instants().filter(|at| *at <= end);
        let mut stands: BTreeSet<Instant> = due.map(|at| at + self.patience(at)).collect();
        stands.extend(acts.iter().map(|(at, _)| *at));
        stands.insert(end + PLANNING);

        let mut acts = acts.iter().peekable();
        self.look(self.now);
        while let Some(next) = stands.first().copied() {
            if !self.powered {
                self.now = self.now.max(next);
            } else if self.now < next {
                let until = (next.since(self.origin).ticks() * CYCLES_PER_US).div_ceil(TICKS_PER_US);
                let slept = self.machine.sleep(until)?;
                self.set_now(slept);
            }
            let from = self.now;
            while let Some((at, act)) = acts.next_if(|(at, _)| *at <= from) {
                self.late(*at, &act.to_string());
                self.act(*at, act);
            }
            while stands.first().is_some_and(|at| *at <= from) {
                stands.pop_first();
            }
            if self.powered {
                self.run();
                if self.drive_again() {
                    self.run();
                }
                self.look(from);
            }
        }
        Ok(())
    }

    fn act(&mut self, at: Instant, act: &Act) {
        match *act {
            Act::Open(connection) => self.on_network(|host| host.open(connection)),
            Act::Say(connection, ref bytes) => self.on_network(|host| host.say(connection, bytes)),
            Act::Close(connection) => self.on_network(|host| host.close(connection)),
            Act::Character(byte) => {
                let sends = self.machine.levels(&[DE]) == [Level::High];
                assert!(!sends, "{}: the transceiver does not listen", self.here());
                self.check_line(at);
                self.machine.hear(byte);
            }
            Act::Drive(_, gpio, high) => {
                for (input, level) in &mut self.inputs {
                    if *input == gpio {
                        *level = high;
                    }
                }
                self.machine.drive(gpio, high);
            }
            Act::Power(false) => self.powered = false,
            Act::Power(true) => {
                self.powered = true;
                self.origin = at;
                self.machine.reset();
                if let Some(host) = &mut self.host {
                    host.forget();
                }
                self.boot();
            }
        }
    }

    /// Lets the connected host act.
    fn on_network(&mut self, act: impl FnOnce(&mut Host)) {
        act(self.host.as_mut().expect("the drive is on a network"));
        self.pass();
    }

    /// Drives pins again that have become inputs. In QEMU such a pin keeps the level that it had as an
    /// output, and ignores an earlier input level. Returns true if there was such a pin.
    fn drive_again(&mut self) -> bool {
        let gpios: Vec<Gpio> = self.wires.iter().map(|(_, _, gpio)| *gpio).collect();
        let floats = self.machine.levels(&gpios).into_iter().map(|level| level == Level::Float);
        let floats: Vec<bool> = floats.collect();
        let floated = std::mem::replace(&mut self.floats, floats);
        let began = |gpio: &Gpio| {
            let place = gpios.iter().position(|shown| shown == gpio);
            place.is_some_and(|place| self.floats[place] && !floated[place])
        };
        let again: Vec<_> = self.inputs.iter().copied().filter(|(gpio, _)| began(gpio)).collect();
        for (gpio, high) in &again {
            self.machine.drive(*gpio, *high);
        }
        !again.is_empty()
    }

    /// Runs the board and the connected host until both are idle.
    fn run(&mut self) {
        loop {
            let before = self.now;
            let cycles = self.machine.run();
            self.set_now(cycles);
            assert!(before <= self.now, "{}: {before:?} was before", self.here());
            let passed = self.pass();
            self.hear();
            if !passed {
                break;
            }
        }
    }

    /// Passes on the bytes that the board has sent. Returns true if the host answers with frames.
    fn pass(&mut self) -> bool {
        let said = self.machine.said();
        let Some(host) = &mut self.host else {
            self.said.entry(None).or_default().extend(said);
            return false;
        };
        let back = host.poll(self.now, frames(&said));
        for (connection, bytes) in host.heard() {
            self.said.entry(Some(connection)).or_default().extend(bytes);
        }
        if !back.is_empty() {
            self.machine.take(&back);
        }
        !back.is_empty()
    }

    /// Sets the instant of a stop, from the cycles of the board's clock.
    fn set_now(&mut self, cycles: u64) {
        self.now = self.origin + Duration::from_ticks(cycles * TICKS_PER_US / CYCLES_PER_US);
    }

    /// The present position in the trace, for messages.
    fn here(&self) -> String {
        self.places.at(self.now)
    }

    /// Allowed lateness of the board at `at`.
    fn patience(&self, at: Instant) -> Duration {
        // The outputs of power-on may be late by the time that the board needs to start.
        if at == self.origin { self.patience.boot } else { self.patience.at(&self.expected, at) }
    }

    /// Checks and records the lateness of an output that was due at `at` and appears now.
    fn late(&mut self, at: Instant, what: &str) {
        let late = self.now.since(at);
        let patience = self.patience(at);
        assert!(late <= patience, "{}: {what} comes {late:?} late", self.places.at(at));
        let worst = if patience == PLANNING { &mut self.figures.planning } else { &mut self.figures.latency };
        *worst = late.max(*worst);
    }

    /// Compares everything that the board shows with the expectations. The board has run since `from`.
    fn look(&mut self, from: Instant) {
        self.check_levels();
        if self.expected.has_steps {
            self.count(from);
        }
    }

    /// Compares the levels of pins.
    fn check_levels(&mut self) {
        let after = earlier(self.now, self.patience(self.now));
        let gpios: Vec<Gpio> = self.wires.iter().map(|(_, _, gpio)| *gpio).collect();
        let levels = self.machine.levels(&gpios);
        for ((pin, name, gpio), level) in self.wires.iter().zip(levels) {
            let right = self.expected.is_axis(*pin, self.now)
                || self.expected.has_level(*pin, level != Level::Low, after, self.now);
            assert!(right, "{}: {name} ({gpio}) is {level:?}", self.here());
        }
    }

    /// Compares the bytes that the board has sent.
    fn hear(&mut self) {
        for (to, mut said) in std::mem::take(&mut self.said) {
            while !said.is_empty() {
                let Some(next) = self.replies.iter().position(|reply| reply.to == to) else {
                    panic!("{}: unexpected output {}", self.here(), said.escape_ascii());
                };
                let Reply { at, earliest, bytes, .. } = self.replies[next].clone();
                assert!(earliest < self.now, "{}: it is early: {}", self.here(), said.escape_ascii());
                self.late(at, "a reply");
                // The UART of QEMU does not pace bytes: it sends all of them at once.
                let reply: Vec<u8> = said.drain(..bytes.len().min(said.len())).collect();
                let [reply, bytes] = [reply, bytes].map(|bytes| bytes.escape_ascii().to_string());
                assert_eq!(reply, bytes, "{}: the reply", self.places.at(at));
                self.replies.remove(next);
            }
        }
    }

    /// Counts the pulses since `from`, and compares their directions and the position.
    fn count(&mut self, from: Instant) {
        // When a pin is driven or released, it also shows changes that are not steps.
        let given = |pin| self.expected.is_given(pin, earlier(from, PLANNING), self.now);
        let is_given = self.expected.shared_step().is_some_and(given);
        for (output, high) in self.machine.changes() {
            if output == DIR.1 {
                self.forward = high;
            } else if output == STEP.1 && high && !is_given {
                self.figures.steps += 1;
                self.made += if self.forward { 1 } else { -1 };
                let right = self.expected.goes(self.forward, earlier(from, PLANNING), self.now);
                assert!(right, "{}: a step with DIR high: {}", self.here(), self.forward);
            }
        }
        let slipped = self.machine.memory().word(self.slipped) as i32;
        if slipped != 0 {
            let most = self.expected.slips(self.now, PLANNING);
            assert!(slipped.abs() <= most, "{}: {slipped} steps slip, {most} may", self.here());
        }
        let right = self.lag.explains(&self.expected, self.made - slipped, from, self.now);
        assert!(right, "{}: {} steps, of which {slipped} slipped", self.here(), self.made);
    }

    /// Compares the settings of UART0 with the line settings at `at` (12.6 of the datasheet).
    fn check_line(&mut self, at: Instant) {
        const UART0: u32 = 0x4000_C000;
        let memory = self.machine.memory();
        let [whole, parts, shape] = [0x24, 0x28, 0x2C].map(|register| memory.word(UART0 + register));
        let divisor = f64::from(whole) + f64::from(parts) / 64.0;
        let Line { baud, data, parity, stop } = self.expected.line(at);
        let rate = 1e6 * CYCLES_PER_US as f64 / (16.0 * divisor);
        let right = (rate / f64::from(baud) - 1.0).abs() < 0.005;
        assert!(right, "{}: {rate} baud, not {baud}", self.here());
        let parity = match parity {
            Parity::None => 0,
            Parity::Odd => 0b10,
            Parity::Even => 0b110,
        };
        let expected = parity | u32::from(stop == 2) << 3 | u32::from(data - 5) << 5;
        // The board may use the FIFOs or not, so their bit is ignored.
        assert_eq!(shape & !(1 << 4), expected, "{}: the shape of a character", self.here());
    }

    /// Compares the state at the end of the trace.
    fn finish(&mut self, end: Instant) {
        assert!(self.replies.is_empty(), "{}: {} replies are missing", self.here(), self.replies.len());
        let memory = self.machine.memory().bytes(self.saved + 8, self.expected.memory.len());
        assert_eq!(memory, self.expected.memory, "{}: the saved registers", self.here());
        self.figures.time = end.since(Instant::ZERO);
    }
}

/// Ticks of drivetwin's time in a microsecond.
const TICKS_PER_US: u64 = Duration::micros(1).ticks();
