//! A golden trace on the board.
//!
//! The harness owns time. It makes the board stand at the instant of every line of the trace: what is fed
//! is done to it right there, and what the drive does is looked for, not before its instant and at most
//! [`LATENCY`] after it.

use std::collections::BTreeSet;

use standin_firmware::device::{Duration, Fault, Instant, Level, Pin, Role, Spec};
use standin_protocol::line::{Line, Parity};
use standin_sim::trace::{Event, Fed, Power, Trace};

use crate::expected::Expected;
use crate::image::Image;
use crate::machine::{CYCLES_PER_US, Gpio, Machine, Overslept};
use crate::pins::{self, DE, DIR, FAST, STEP};

/// How long after its instant the board may do a thing, or hear one: interrupts and the loop.
const LATENCY: Duration = Duration::micros(250);
/// How long if the motor is given a new plan then, which the loop computes before it does anything else.
const PLANNING: Duration = Duration::millis(1);
/// How long it may take from its first instruction until it has done all that it does at power-on.
const BOOT: Duration = Duration::millis(1);

/// What a replay found out.
#[derive(Clone, Copy, Default)]
pub(crate) struct Figures {
    /// How far virtual time went.
    pub(crate) time: Duration,
    /// The longest that anything took.
    pub(crate) latency: Duration,
    /// The longest that anything took for which a plan was computed first.
    pub(crate) planning: Duration,
    /// From the start of the clock until the loop slept for the first time.
    pub(crate) boot: Duration,
    /// Step pulses.
    pub(crate) steps: u32,
    /// Times that the board stood.
    pub(crate) stops: u32,
    /// Bytes of the stack that were ever used.
    pub(crate) stack: u32,
}

/// What is done to the board.
#[derive(Clone, Copy, Debug)]
enum Act {
    Character(u8),
    Drive(Gpio, bool),
    Power(bool),
}

/// A replay under way.
struct Replay<'a> {
    machine: Machine,
    expected: Expected,
    wires: Vec<(Pin, Gpio)>,
    /// What each input is driven to, for the next reset.
    inputs: Vec<(Gpio, bool)>,
    /// When the board's clock was 0.
    origin: Instant,
    powered: bool,
    /// What has left the bus of the reply that comes next.
    sent: Vec<u8>,
    replies: usize,
    forward: bool,
    made: i32,
    lag: Lag,
    /// When it was looked at last.
    looked: Instant,
    figures: Figures,
    saved: u32,
    /// Where the image counts steps that slipped.
    slipped: u32,
    /// Where a trace stands in messages.
    name: &'a str,
}

/// Plays a trace on a new board and compares all that can be seen of it.
pub(crate) fn play(
    name: &str,
    trace: &Trace,
    expected: Expected,
    image: &Image,
    shift: u32,
) -> Result<Figures, Overslept> {
    let [drive] = trace.drives.as_slice() else { panic!("a board has one drive") };
    let spec = drive.spec;
    let wiring = pins::wiring(spec.kind).unwrap_or_else(|| panic!("who wires a {}?", spec.kind));
    let gpio = |name: &str| wiring.iter().find(|(wired, _)| *wired == name).map(|(_, gpio)| *gpio);
    let shown = (0..).map(Pin).zip(spec.pins).filter(|(_, pin)| pin.role != Role::Input);
    let wires: Vec<(Pin, Gpio)> = shown.filter_map(|(pin, of)| Some((pin, gpio(of.name)?))).collect();
    let acts = acts(trace, &expected, spec, &gpio);

    let mut machine = Machine::new(image, shift);
    let stack = Stack::paint(&mut machine, image);
    let saved = image.symbol("SAVED");
    machine.memory().write([(saved, 0x7374_616E), (saved + 4, 0x6469_6E21)]);
    machine.memory().put(saved + 8, &drive.memory);
    let mut inputs = vec![(FAST, !drive.boot_fast)];
    let hears = spec.pins.iter().filter(|pin| matches!(pin.role, Role::Input | Role::Both));
    inputs.extend(hears.filter_map(|pin| Some((gpio(pin.name)?, pin.rest != Level::Low))));
    inputs.extend(spec.faults.iter().filter_map(|fault| Some((gpio(fault)?, true))));

    let mut replay = Replay {
        machine,
        expected,
        wires,
        inputs,
        origin: drive.from,
        powered: true,
        sent: Vec::new(),
        replies: 0,
        forward: false,
        made: 0,
        lag: Lag::default(),
        looked: drive.from,
        figures: Figures::default(),
        saved,
        slipped: image.symbol("SLIPPED"),
        name,
    };
    replay.boot()?;
    replay.go(&acts, trace.end)?;
    replay.finish(trace.end);
    replay.figures.stack = stack.used(&mut replay.machine);
    Ok(replay.figures)
}

/// What a trace feeds, in the order of time, each character at its own instant.
fn acts(
    trace: &Trace,
    expected: &Expected,
    spec: &Spec,
    gpio: &dyn Fn(&str) -> Option<Gpio>,
) -> Vec<(Instant, Act)> {
    let wired = |name: &str| gpio(name).unwrap_or_else(|| panic!("{name} is not wired"));
    let mut acts = Vec::new();
    for entry in trace.events() {
        let Event::Fed(fed) = &entry.event else { continue };
        match fed {
            Fed::Bytes { bytes, .. } => {
                let character = expected.line(entry.at).character();
                acts.extend(
                    (0..).zip(bytes).map(|(n, byte)| (entry.at + character * n, Act::Character(*byte))),
                );
            }
            Fed::Edge { pin, high } => {
                let name = spec.pins[usize::from(pin.0)].name;
                acts.push((entry.at, Act::Drive(wired(name), *high)));
            }
            Fed::Fault { fault: Fault(fault), on } => {
                acts.push((entry.at, Act::Drive(wired(spec.faults[usize::from(*fault)]), !on)));
            }
            Fed::Power(power @ (Power::On | Power::Off)) => {
                acts.push((entry.at, Act::Power(*power == Power::On)));
            }
            other => panic!("nobody can do this to the board: {other:?}"),
        }
    }
    acts.sort_by_key(|(at, _)| *at);
    acts
}

impl Replay<'_> {
    /// Lets the board run from its first instruction until it has done what it does at power-on.
    fn boot(&mut self) -> Result<(), Overslept> {
        for (gpio, high) in self.inputs.clone() {
            self.machine.drive(gpio, high);
        }
        // Its clock does not run yet, so that nobody knows when this is.
        self.machine.stand_in(1);
        self.run();
        let boot = self.now()?.since(self.origin);
        assert!(boot < BOOT, "{}: the board starts in {boot:?}", self.name);
        self.figures.boot = self.figures.boot.max(boot);
        self.forward = false;
        Ok(())
    }

    /// Does all of it at its instant, up to `end`.
    fn go(&mut self, acts: &[(Instant, Act)], end: Instant) -> Result<(), Overslept> {
        let mut stands: BTreeSet<Instant> = self.expected.instants().filter(|at| *at <= end).collect();
        // Once at the instant, and once when it must have happened.
        let late: Vec<Instant> =
            stands.iter().map(|at| *at + self.patience(*at) + self.figures.boot).collect();
        stands.extend(late);
        stands.extend(acts.iter().map(|(at, _)| *at));
        stands.insert(end + PLANNING);

        let mut acts = acts.iter().peekable();
        let mut now = self.now()?;
        self.look(now);
        let mut waits = false;
        while let Some(next) = stands.first().copied() {
            if self.powered {
                if !waits {
                    self.machine.stand_in(cycles(next.since(now)));
                }
                self.run();
                let then = std::mem::replace(&mut now, self.now()?);
                assert!(then < now, "{}: time goes from {then:?} to {now:?}", self.name);
                // Behind an instant the board stands every microsecond, until it has done what it has to.
                waits = self.look(now) || next <= now;
            } else {
                now = next;
            }
            while let Some((at, act)) = acts.next_if(|(at, _)| *at <= now) {
                self.late(*at, now, &format!("{act:?}"));
                self.act(*at, *act)?;
                if let Act::Power(true) = act {
                    now = self.now()?;
                }
            }
            while stands.first().is_some_and(|at| *at <= now) {
                stands.pop_first();
            }
        }
        Ok(())
    }

    fn act(&mut self, at: Instant, act: Act) -> Result<(), Overslept> {
        match act {
            Act::Character(byte) => {
                assert!(!self.machine.levels(&[DE])[0], "{}: the transceiver listens at {at:?}", self.name);
                self.check_line(at);
                self.machine.hear(byte);
            }
            Act::Drive(gpio, high) => {
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
                self.boot()?;
            }
        }
        Ok(())
    }

    fn run(&mut self) {
        self.machine.run();
        self.figures.stops += 1;
    }

    /// The instant of the trace at which the board stands.
    fn now(&mut self) -> Result<Instant, Overslept> {
        Ok(self.origin + Duration::from_ticks(self.machine.now()? * 16 / CYCLES_PER_US))
    }

    /// How late the board may be at `at`.
    fn patience(&self, at: Instant) -> Duration {
        if self.expected.plans(earlier(at, PLANNING), at) { PLANNING } else { LATENCY }
    }

    /// What was due at `at` happens now.
    fn late(&mut self, at: Instant, now: Instant, what: &str) {
        let late = now.since(at);
        assert!(late <= self.patience(at), "{}: {what} comes {late:?} late", self.name);
        let worst = if self.patience(at) == PLANNING {
            &mut self.figures.planning
        } else {
            &mut self.figures.latency
        };
        *worst = late.max(*worst);
    }

    /// Looks at everything that the board shows and compares it with what it should show. Returns whether
    /// something that was due by `now` has not been seen.
    fn look(&mut self, now: Instant) -> bool {
        let after = earlier(now, self.patience(now));
        self.hear(now);
        // The drive has power a little after the board's clock starts, and counts its waves from there.
        let before = earlier(after, self.figures.boot);
        let mut behind = self.expected.replies.get(self.replies).is_some_and(|(at, _)| *at <= now);
        let levels = self.machine.levels(&self.wires.iter().map(|(_, gpio)| *gpio).collect::<Vec<_>>());
        for ((pin, gpio), high) in self.wires.iter().copied().zip(levels) {
            behind |= self.expected.level(pin, now) != high;
            let right = self.expected.has_level(pin, high, before, now);
            assert!(right, "{}: {gpio:?}, which is {pin:?}, is high: {high} at {now:?}", self.name);
        }
        self.count(now);
        behind
    }

    /// Takes what has left the bus.
    fn hear(&mut self, now: Instant) {
        let said = self.machine.said();
        if said.is_empty() {
            return;
        }
        self.sent.extend(said);
        let Some((at, reply)) = self.expected.replies.get(self.replies).cloned() else {
            panic!("{}: nobody asked for {:02x?} at {now:?}", self.name, self.sent);
        };
        assert!(at < now, "{}: {:02x?} leaves before {at:?}", self.name, self.sent);
        self.late(at, now, "a reply");
        // The UART of QEMU paces nothing: all of it leaves at once.
        assert_eq!(self.sent, reply, "{}: the reply that is due at {at:?}", self.name);
        self.sent.clear();
        self.replies += 1;
    }

    /// Counts pulses, and compares the position.
    fn count(&mut self, now: Instant) {
        for (output, high) in self.machine.changes() {
            if output == DIR.1 {
                self.forward = high;
            } else if output == STEP.1 && high {
                self.figures.steps += 1;
                self.made += if self.forward { 1 } else { -1 };
            }
        }
        let slipped = self.machine.memory().word(self.slipped) as i32;
        if slipped != 0 {
            let most = self.expected.slips(now, PLANNING);
            assert!(slipped.abs() <= most, "{}: {slipped} steps slip by {now:?}, {most} may", self.name);
        }
        let right = self.lag.explains(&self.expected, self.made - slipped, self.looked, now);
        assert!(right, "{}: {} steps at {now:?}, of which {slipped} slipped", self.name, self.made);
        self.looked = now;
    }

    /// Compares the settings of UART0 with the line at `at` (12.6 of the datasheet).
    fn check_line(&mut self, at: Instant) {
        const UART0: u32 = 0x4000_C000;
        let memory = self.machine.memory();
        let [whole, parts, shape] = [0x24, 0x28, 0x2C].map(|register| memory.word(UART0 + register));
        let divisor = f64::from(whole) + f64::from(parts) / 64.0;
        let Line { baud, data, parity, stop } = self.expected.line(at);
        let rate = 1e6 * CYCLES_PER_US as f64 / (16.0 * divisor);
        assert!((rate / f64::from(baud) - 1.0).abs() < 0.005, "{}: {rate} at {at:?}, not {baud}", self.name);
        let parity = match parity {
            Parity::None => 0,
            Parity::Odd => 0b10,
            Parity::Even => 0b110,
        };
        let expected = parity | u32::from(stop == 2) << 3 | u32::from(data - 5) << 5;
        // Whether its FIFOs are on is the board's affair.
        assert_eq!(shape & !(1 << 4), expected, "{}: the line at {at:?}", self.name);
    }

    /// What must be true in the end.
    fn finish(&mut self, end: Instant) {
        assert_eq!(self.replies, self.expected.replies.len(), "{}: all replies have come", self.name);
        let memory = self.machine.memory().bytes(self.saved + 8, self.expected.memory.len());
        assert_eq!(memory, self.expected.memory, "{}: the saved registers", self.name);
        self.figures.time = end.since(Instant::ZERO);
    }
}

/// How far behind its instants the board makes a plan that it began late: one from standstill as a whole,
/// so that each step is late by the same span. One that replaces another joins in where it is; there an
/// input that was heard a little late also moves the way that follows by a part of a step, and close to
/// standstill that is long: there one step more or less is right.
#[derive(Default)]
struct Lag {
    /// When the motor was told last, and whether it stood then.
    told: Option<(Instant, bool)>,
    /// The spans, in microseconds, that explain all that was seen since.
    possible: Vec<u64>,
}

impl Lag {
    /// Whether one lag explains that, and all that was seen of the plan before: so many steps were made
    /// by an instant after `since` and before `now`.
    fn explains(&mut self, expected: &Expected, made: i32, since: Instant, now: Instant) -> bool {
        let told = expected.told(now);
        if told != self.told {
            self.told = told;
            self.possible = (0..=PLANNING.ticks() / Duration::micros(1).ticks()).collect();
        }
        let far = earlier(since, PLANNING);
        let (told, stood) = told.unwrap_or((Instant::ZERO, true));
        if earlier(now, PLANNING) <= told || !stood {
            let turns = expected.turns(far, now);
            let positions = [far, now].into_iter().chain(turns).map(|at| expected.steps(at));
            let (low, high) =
                positions.fold((i32::MAX, i32::MIN), |(low, high), at| (low.min(at), high.max(at)));
            let aside = i32::from(!stood);
            return (low - aside..=high + aside).contains(&made);
        }
        if expected.steps(far) == made && expected.steps(now) == made {
            return true;
        }
        self.possible.retain(|lag| {
            let lag = Duration::micros(*lag);
            let [from, to] = [since, now].map(|at| expected.steps(earlier(at, lag)));
            (from.min(to)..=from.max(to)).contains(&made)
        });
        !self.possible.is_empty()
    }
}

/// So long before `at`.
fn earlier(at: Instant, by: Duration) -> Instant {
    Instant::from_ticks(at.ticks().saturating_sub(by.ticks()))
}

/// The cycles of a span, rounded up.
fn cycles(span: Duration) -> u64 {
    (span.ticks() * CYCLES_PER_US).div_ceil(16)
}

/// The memory below the stack, painted before the start.
struct Stack {
    begin: u32,
    end: u32,
}

impl Stack {
    const PAINT: u8 = 0xA5;

    fn paint(machine: &mut Machine, image: &Image) -> Self {
        let (begin, end) = (image.symbol("_stack_end"), image.symbol("_stack_start"));
        machine.memory().put(begin, &vec![Self::PAINT; (end - begin) as usize]);
        Self { begin, end }
    }

    /// How deep it went.
    fn used(&self, machine: &mut Machine) -> u32 {
        let painted = machine.memory().bytes(self.begin, (self.end - self.begin) as usize);
        let untouched = painted.iter().take_while(|byte| **byte == Self::PAINT).count();
        self.end - self.begin - untouched as u32
    }
}
