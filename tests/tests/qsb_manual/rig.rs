//! A QSB on a bench, a terminal at its port, and methods that set its pins.

use drivetwin_firmware::device::{Axis, Device, Encoder, Level, Pin, Port};
use drivetwin_firmware::qsb::Qsb;
use drivetwin_protocol::time::{Duration, Instant, Span};
use drivetwin_sim::bench::{Bench, Bus, Client, DriveId, PinStimulus, PowerAction, Settings, Setup};
use drivetwin_sim::line::{LineMode, Sender};

/// Period of the 512 Hz clock that TIME STAMP and INTERVAL RATE use (QSB-10): 1.953125 ms.
pub(crate) const TICK: Duration = Duration::from_ticks(31_250);

/// Time from power-on to the banner.
pub(crate) const START_UP: Duration = Duration::millis(50);

/// Time longer than any reply takes, also while a stream fills the line at 9,600 baud.
const PATIENCE: Duration = Duration::millis(200);

/// All variants, with the names that users type.
pub(crate) const KINDS: [&str; 3] = ["qsb-d", "qsb-m", "qsb-s"];

/// A drive of a variant, without power.
fn make(kind: &str) -> Box<dyn Device> {
    Box::new(match kind {
        "qsb-d" => Qsb::d(),
        "qsb-m" => Qsb::m(),
        "qsb-s" => Qsb::s(),
        _ => panic!("there is no {kind}"),
    })
}

/// A text line from the drive, up to the exclamation mark and without CR and LF, and the instant at which its
/// first character was received.
pub(crate) type Line = (Instant, String);

/// A QSB with a terminal. By default characters take no time on the line, so a command takes effect at the
/// instant of the call.
pub(crate) struct Rig {
    pub(crate) bench: Bench,
    pub(crate) seat: DriveId,
    pub(crate) bus: Bus,
    client: Client,
    /// Instant of the last power-on.
    pub(crate) power: Instant,
    /// Text lines that were received and not yet returned, and the incomplete one after them.
    heard: Vec<Line>,
    partial: Option<Line>,
}

impl Rig {
    /// A QSB whose power has just been switched on.
    pub(crate) fn new(kind: &str, line: LineMode, setup: Setup) -> Self {
        let mut bench = Bench::with(Settings { line, ..Settings::default() });
        let seat = bench.add_with("x", make(kind), setup).expect("a drive that can be seated");
        let bus = bench.bus(seat, Port(0)).expect("a serial port");
        let client = bench.connect(bus);
        let power = bench.now();
        Self { bench, seat, bus, client, power, heard: Vec::new(), partial: None }
    }

    /// A new QSB of that kind that has sent its banner.
    pub(crate) fn ready(kind: &str) -> Self {
        Self::ready_on(kind, LineMode::Fast)
    }

    /// A new QSB of that kind that has sent its banner, with a given mode of the line.
    pub(crate) fn ready_on(kind: &str, line: LineMode) -> Self {
        let mut rig = Self::new(kind, line, Setup::default());
        rig.until_banner(kind);
        rig
    }

    /// Runs until the drive has sent its banner.
    #[track_caller]
    pub(crate) fn until_banner(&mut self, kind: &str) {
        let heard = self.hear(START_UP + 5.millis());
        let banner = format!("{}  0E!", kind.to_uppercase());
        assert!(heard.iter().any(|(_, text)| *text == banner), "{kind} says {heard:?}");
    }

    pub(crate) fn now(&self) -> Instant {
        self.bench.now()
    }

    /// Advances the time.
    pub(crate) fn after(&mut self, span: Duration) {
        self.bench.run_until(self.now() + span);
    }

    /// Advances the time to `span` after power-on.
    pub(crate) fn at(&mut self, span: Duration) {
        assert!(self.now() <= self.power + span, "that is over");
        self.bench.run_until(self.power + span);
    }

    /// Advances the time to `part` (in 1/16 µs) after the next 512 Hz tick.
    pub(crate) fn past_tick(&mut self, part: u64) {
        let next = self.number() + 1;
        self.at(TICK * next + Duration::from_ticks(part));
    }

    /// Presets a register, not through the bus.
    pub(crate) fn poke(&mut self, name: &str, value: i64) {
        let named = self.bench.spec(self.seat).find(name).expect("a register of the variant");
        self.bench.poke(self.seat, named.row, value).expect("a value that it takes");
    }

    /// 512 Hz ticks since power-on.
    pub(crate) fn number(&self) -> u64 {
        number(self.now(), self.power)
    }

    /// Types characters.
    pub(crate) fn send(&mut self, text: &str) {
        self.send_bytes(text.as_bytes());
    }

    pub(crate) fn send_bytes(&mut self, bytes: &[u8]) {
        self.bench.send(self.client, bytes);
    }

    /// Types characters at a baud rate.
    pub(crate) fn send_at(&mut self, baud: u32, text: &str) {
        let sender = Sender { baud: Some(baud), ..Sender::default() };
        self.bench.send_from(self.client, text.as_bytes(), sender);
    }

    /// Characters that were received and not yet returned, including those of the next `span`.
    pub(crate) fn raw(&mut self, span: Duration) -> String {
        self.after(span);
        let mut bytes = Vec::new();
        self.bench.receive(self.client, &mut bytes);
        String::from_utf8(bytes).expect("the drive sends ASCII")
    }

    /// Text lines that were received and not yet returned, including those of the next `span`.
    pub(crate) fn hear(&mut self, span: Duration) -> Vec<Line> {
        self.hear_until(self.now() + span);
        std::mem::take(&mut self.heard)
    }

    /// The text lines of [`hear`](Self::hear), without their times.
    pub(crate) fn texts(&mut self, span: Duration) -> Vec<String> {
        self.hear(span).into_iter().map(|(_, text)| text).collect()
    }

    fn hear_until(&mut self, end: Instant) {
        self.bench.run_until(self.now());
        self.take();
        loop {
            let next = self.bench.next();
            if next > end {
                break;
            }
            self.bench.run_until(next);
            self.take();
        }
        self.bench.run_until(end);
    }

    /// Reads the characters that have arrived and splits them into text lines.
    fn take(&mut self) {
        let mut bytes = Vec::new();
        self.bench.receive(self.client, &mut bytes);
        for byte in bytes {
            if matches!(byte, b'\r' | b'\n') {
                continue;
            }
            let now = self.bench.now();
            let (_, text) = self.partial.get_or_insert_with(|| (now, String::new()));
            text.push(char::from(byte));
            if byte == b'!' {
                self.heard.extend(self.partial.take());
            }
        }
    }

    /// Sends a command with a CR and returns the drive's answer. Records of streams before the answer stay
    /// for [`hear`](Self::hear).
    #[track_caller]
    pub(crate) fn ask(&mut self, command: &str) -> String {
        let before = self.heard.len();
        self.send(command);
        self.send("\r");
        let streams = command.starts_with('S');
        let end = self.now() + PATIENCE;
        loop {
            self.bench.run_until(self.now());
            self.take();
            let answer = (before..self.heard.len()).find(|&n| {
                let text = &self.heard[n].1;
                !text.starts_with('s') || (streams && digits(text).starts_with(&digits(command)))
            });
            if let Some(answer) = answer {
                return self.heard.remove(answer).1;
            }
            let next = self.bench.next();
            assert!(next <= end, "no answer to {command}");
            self.bench.run_until(next);
        }
    }

    /// Sends commands and asserts the answer to each.
    #[track_caller]
    pub(crate) fn says(&mut self, script: &[(&str, &str)]) {
        for (command, reply) in script {
            assert_eq!(self.ask(command), *reply, "to {command}");
        }
    }

    /// Sends a write that the drive must accept.
    #[track_caller]
    pub(crate) fn write(&mut self, command: &str) {
        let reply = self.ask(command);
        assert!(reply.starts_with('w'), "{command} is answered {reply}");
    }

    /// Reads a register. Replies must have spaces and no time stamp.
    #[track_caller]
    pub(crate) fn read(&mut self, register: &str) -> u32 {
        let reply = self.ask(&format!("R{register}"));
        let data = reply.strip_prefix(&format!("r {register} ")).and_then(|rest| rest.strip_suffix(" !"));
        let data = data.unwrap_or_else(|| panic!("R{register} is answered {reply}"));
        u32::from_str_radix(data, 16).unwrap_or_else(|_| panic!("R{register} is answered {reply}"))
    }

    /// Saves the parameters and waits until the save is complete (10 ms).
    #[track_caller]
    pub(crate) fn save(&mut self) {
        self.write("W163");
        self.after(11.millis());
    }

    /// Switches power off and on. Returns before the banner.
    pub(crate) fn power_cycle(&mut self) {
        self.bench.power(self.seat, PowerAction::Cycle);
        // Power goes off now or a tick later, and on a tick after that.
        self.after(Duration::TICK * 3);
        self.raw(Duration::ZERO);
        self.heard.clear();
        self.partial = None;
    }

    /// Switches power off and on. Returns after the banner and sets `power` from its time.
    #[track_caller]
    pub(crate) fn restart(&mut self, kind: &str) {
        self.power_cycle();
        let heard = self.hear(START_UP + TICK);
        self.take_banner(heard, kind);
    }

    /// Computes the instant of the reset from the banner. Keeps the lines after the banner.
    #[track_caller]
    pub(crate) fn take_banner(&mut self, mut heard: Vec<Line>, kind: &str) {
        assert!(!heard.is_empty(), "no banner");
        let (at, text) = heard.remove(0);
        assert_eq!(text, format!("{}  0E!", kind.to_uppercase()));
        self.power = at - START_UP;
        self.heard = heard;
    }

    pub(crate) fn pin(&self, name: &str) -> Pin {
        self.bench.spec(self.seat).pin(name).unwrap_or_else(|| panic!("there is no pin {name}"))
    }

    /// Sets a pin from outside. The drive receives the change a tick later.
    pub(crate) fn set(&mut self, name: &str, drive: PinStimulus) {
        self.bench.set_pin(self.seat, self.pin(name), drive);
    }

    /// Sets a pin from outside, and returns a microsecond later.
    pub(crate) fn drive(&mut self, name: &str, drive: PinStimulus) {
        self.set(name, drive);
        self.after(1.micros());
    }

    pub(crate) fn low(&mut self, name: &str) {
        self.drive(name, PinStimulus::Low);
    }

    pub(crate) fn high(&mut self, name: &str) {
        self.drive(name, PinStimulus::High);
    }

    /// Drives a pin high or low.
    pub(crate) fn hold(&mut self, name: &str, high: bool) {
        self.drive(name, if high { PinStimulus::High } else { PinStimulus::Low });
    }

    pub(crate) fn open(&mut self, name: &str) {
        self.drive(name, PinStimulus::Open);
    }

    pub(crate) fn level(&self, name: &str) -> Level {
        self.bench.level(self.seat, self.pin(name))
    }

    /// Returns true if a pin is high, with an external pull-up.
    pub(crate) fn is_high(&self, name: &str) -> bool {
        self.level(name) != Level::Low
    }

    /// Turns the encoder at 1,000,000 edges/s and waits until it has stopped.
    pub(crate) fn turn(&mut self, edges: i32) {
        self.turn_at(edges, 1_000_000);
    }

    /// Turns the encoder at `hz` edges/s, waits until it has stopped, and 2 µs more.
    pub(crate) fn turn_at(&mut self, edges: i32, hz: u32) {
        self.bench.encoder(self.seat, Encoder(0), edges, f64::from(hz)).expect("nothing turns");
        let lasts = u64::from(edges.unsigned_abs()) * 16_000_000 / u64::from(hz);
        self.after(Duration::from_ticks(lasts) + 2.micros());
    }

    /// Position of the motor, in steps since power-on.
    pub(crate) fn position(&self) -> i32 {
        self.bench.motion(self.seat, Axis(0)).position
    }

    /// Speed of the motor in steps/s, signed.
    pub(crate) fn speed(&self) -> f64 {
        self.bench.motion(self.seat, Axis(0)).speed.to_num()
    }
}

/// 512 Hz ticks between two instants.
pub(crate) fn number(at: Instant, power: Instant) -> u64 {
    at.since(power) / TICK
}

/// Number of the register in a command or reply, with or without spaces.
fn digits(text: &str) -> String {
    text.chars().skip(1).filter(|c| *c != ' ').take(2).collect::<String>().to_uppercase()
}
