//! Faults of a line or TCP port: frames that are lost, corrupted, duplicated, truncated or delayed, noise
//! between frames, and connections that are closed.

use drivetwin_firmware::device::{Duration, Framing, Line, PortSpec};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::pdu::{self, EXCEPTION_BIT};
use drivetwin_protocol::modbus::server::Rules;
use drivetwin_protocol::modbus::{ascii, rtu};

use super::fault_rules::Content;
pub use super::fault_rules::{Amount, Direction, FaultRule, Party};
use crate::ids::DriveId;
use crate::record::effects::{FrameEffect, FrameEffects};
use crate::rng::Rng;

/// Maximum of [`LineFaults::delay`] and its spread: 60 s.
pub const LONGEST_DELAY: Duration = Duration::secs(60);

/// Range of [`LineFaults::baud`] in bits per second: 50 to 4,000,000.
pub const BAUDS: std::ops::RangeInclusive<u32> = 50..=4_000_000;

/// Faults of a line or of a TCP port, set by [`Bench::set_faults`](crate::bench::Bench::set_faults). A
/// [rule](FaultRule) says which frames a fault disturbs, requests and replies alike unless a field or the rule
/// says otherwise. The default has no faults. On a line with timed characters, a frame is one write of a
/// client or one output of a drive. On a Modbus/TCP port it is a request or a reply. On an MCode port a request is a
/// line or the part of a line that arrives at once, and a reply is all that the drive then sends until it takes the
/// next request: echo, answer and prompt. What a program prints meanwhile is in it; otherwise each output of a
/// program is a reply.
///
/// ```
/// use drivetwin_firmware::device::{Duration, Instant, Port};
/// use drivetwin_firmware::md3::Md3;
/// use drivetwin_protocol::modbus::rtu;
/// use drivetwin_sim::bench::Bench;
/// use drivetwin_sim::line::faults::{FaultRule, LineFaults};
///
/// let mut bench = Bench::new();
/// let drive = bench.add::<Md3>("x");
/// bench.run_until(Instant::ZERO + Duration::secs(3));
/// let bus = bench.bus(drive, Port(0)).unwrap();
/// let faults = LineFaults { drop: FaultRule::next(1), ..LineFaults::NONE };
/// assert_eq!(faults.check(), Ok(()));
/// bench.set_line_faults(bus, faults);
/// assert!(bench.ask(drive, &rtu::read(1, 0, 1)).is_empty());
/// assert_eq!(bench.ask(drive, &rtu::read(1, 0, 1)).len(), 7);
/// ```
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct LineFaults {
    /// Frames that are lost.
    pub drop: FaultRule,
    /// Frames in which one data bit is inverted. On a line with parity, drives detect a parity error in that
    /// character (BENCH-11).
    pub corrupt: FaultRule,
    /// Frames that are sent twice. A reply is repeated after an inter-frame gap, a request after its
    /// answer; on a line with timed characters, a frame is repeated at once. Replies that are more than half
    /// a second late because the line is full are sent once.
    pub duplicate: FaultRule,
    /// Truncated frames. At least one character is missing, and at least one is sent.
    pub truncate: FaultRule,
    /// Replies with a valid checksum and an address that no drive on the bus has; only with Modbus.
    pub wrong_address: FaultRule,
    /// Replies with the number of another transaction, the next higher one; only on Modbus/TCP ports.
    pub wrong_transaction: FaultRule,
    /// Requests that do not reach their drive and are answered with the exception `exception_code`; only with Modbus.
    /// A request that no drive would answer has no exception.
    pub exception: FaultRule,
    /// Code of the exception, 1 to 255.
    pub exception_code: u8,
    /// Frames that are followed, after an inter-frame gap, by one to eight characters of noise. No
    /// noise follows replies that are more than half a second late because the line is full. On a TCP port
    /// only replies have noise, and it comes before them.
    pub noise: FaultRule,
    /// True if `noise` comes right before the frame, without a gap. Always so on a TCP port.
    pub noise_before: bool,
    /// Delay of replies.
    pub delay: Duration,
    /// Greatest random addition to `delay`, chosen for each reply. Both together are up to 60 s
    /// ([`LONGEST_DELAY`]).
    pub delay_spread: Duration,
    /// The replies that are delayed; default [`FaultRule::ALL`].
    pub delayed: FaultRule,
    /// Replies that are not delivered.
    pub mute: FaultRule,
    /// Frames in the middle of which the connection is closed; only on TCP ports.
    pub close: FaultRule,
    /// Baud rate of the clients, 50 to 4,000,000 bits per second, regardless of the drives' settings. `None`:
    /// the baud rate of the drives. Only on serial lines.
    pub baud: Option<u32>,
}

impl Default for LineFaults {
    fn default() -> Self {
        Self::NONE
    }
}

/// Number of faults with a rule, `delay` apart.
const RULES: usize = 10;

impl LineFaults {
    /// No faults, the default: no rule covers a frame, and there is no delay.
    pub const NONE: Self = Self {
        drop: FaultRule::NONE,
        corrupt: FaultRule::NONE,
        duplicate: FaultRule::NONE,
        truncate: FaultRule::NONE,
        wrong_address: FaultRule::NONE,
        wrong_transaction: FaultRule::NONE,
        exception: FaultRule::NONE,
        exception_code: 4,
        noise: FaultRule::NONE,
        noise_before: false,
        delay: Duration::ZERO,
        delay_spread: Duration::ZERO,
        delayed: FaultRule::ALL,
        mute: FaultRule::NONE,
        close: FaultRule::NONE,
        baud: None,
    };

    /// The rules of all faults but the delay, with their names, for tables of settings.
    pub fn rules(&mut self) -> [(&'static str, &mut FaultRule); RULES] {
        [
            ("drop", &mut self.drop),
            ("corrupt", &mut self.corrupt),
            ("duplicate", &mut self.duplicate),
            ("truncate", &mut self.truncate),
            ("wrong_address", &mut self.wrong_address),
            ("exception", &mut self.exception),
            ("noise", &mut self.noise),
            ("mute", &mut self.mute),
            ("close", &mut self.close),
            ("wrong_transaction", &mut self.wrong_transaction),
        ]
    }

    /// All rules, with the names of their faults.
    fn all_rules(&self) -> impl Iterator<Item = (&'static str, FaultRule)> + use<> {
        let mut own = *self;
        let rules = own.rules().map(|(name, rule)| (name, *rule));
        rules.into_iter().chain([("delay_ms", self.delayed)])
    }

    /// Changes the drives that rules name, for instance from indices of a file to those on a bench.
    pub(crate) fn map_drives(&mut self, map: impl Fn(DriveId) -> DriveId) {
        let delayed = self.delayed.drive;
        self.delayed.drive = delayed.map(&map);
        for (_, rule) in self.rules() {
            rule.drive = rule.drive.map(&map);
        }
    }

    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// One sentence that names the value and its range.
    pub fn check(&self) -> Result<(), String> {
        for (name, rule) in self.all_rules() {
            match rule.amount {
                Amount::Rate(rate) if !(0.0..=1.0).contains(&rate) => {
                    return Err(format!("{name} takes a share of the frames from 0 to 1, not {rate}"));
                }
                _ => {}
            }
            match (only(name), rule.direction) {
                (Some(only), Some(direction)) if only != direction => {
                    let plural = if only == Direction::Request { "requests" } else { "replies" };
                    return Err(format!(
                        "{name} is for {plural} only; leave out direction = '{}'",
                        direction.name()
                    ));
                }
                _ => {}
            }
        }
        if self.exception_code == 0 {
            return Err("exception_code takes 1 to 255, not 0".into());
        }
        if self.delay > LONGEST_DELAY || self.delay_spread > LONGEST_DELAY - self.delay {
            return Err("delay takes 60 s at most".into());
        }
        match self.baud.filter(|baud| !BAUDS.contains(baud)) {
            Some(baud) => {
                Err(format!("baud takes {} to {} bits per second, not {baud}", BAUDS.start(), BAUDS.end()))
            }
            None => Ok(()),
        }
    }

    /// Checks that these faults are valid for a bus with that port: all values pass [`check`](Self::check),
    /// and every fault is possible there.
    ///
    /// # Errors
    /// One sentence that names the fault and the reason.
    pub fn check_for(&self, port: &PortSpec) -> Result<(), String> {
        self.check()?;
        self.impossible_on(port).map_or(Ok(()), |(_, sentence)| Err(sentence))
    }

    /// Checks that the rules name only drives on the bus, and registers that they have.
    ///
    /// # Errors
    /// One sentence that names the fault and the reason.
    pub fn check_names(&self, drives: &[Party<'_>]) -> Result<(), String> {
        for (name, rule) in self.all_rules() {
            if rule.drive.is_some_and(|id| drives.iter().all(|drive| drive.id != id)) {
                return Err(format!("{name} is for a drive that is not on this bus"));
            }
            if let Some(register) = rule.register {
                rule.register_named(register, drives).map_err(|sentence| format!("{name}: {sentence}"))?;
            }
        }
        Ok(())
    }

    /// The first fault that is not possible on a bus with that port, and the reason in one sentence.
    pub(crate) fn impossible_on(&self, port: &PortSpec) -> Option<(&'static str, String)> {
        let PortSpec { name: on, framing, .. } = *port;
        let (modbus, tcp) = (matches!(framing, Framing::Silence | Framing::Mbap), is_tcp(framing));
        let is_given = |rule: &FaultRule| rule.amount != Amount::Rate(0.0);
        for (name, rule) in self.all_rules().filter(|(_, rule)| is_given(rule)) {
            let not_one = |what: &str, of: &str| format!("{what} is for {of} only, and {on} is not one");
            let content = [("function", rule.function.is_some()), ("register", rule.register.is_some())];
            let sentence = if matches!(name, "wrong_address" | "exception") && !modbus {
                not_one(name, "Modbus lines")
            } else if name == "wrong_transaction" && framing != Framing::Mbap {
                not_one(name, "Modbus/TCP ports")
            } else if name == "close" && !tcp {
                format!("{name} is for TCP ports only, and {on} is a serial line")
            } else if name == "noise" && tcp && rule.direction == Some(Direction::Request) {
                format!("{name} is for replies only on a TCP port, and {on} is one")
            } else if let Some((key, _)) = content.iter().find(|(_, is_given)| *is_given && !modbus) {
                not_one(&format!("{key} of {name}"), "Modbus lines")
            } else {
                continue;
            };
            return Some((name, sentence));
        }
        let baud = self.baud.filter(|_| tcp);
        baud.map(|_| ("baud", format!("baud is for serial lines only, and {on} is a TCP port")))
    }
}

/// Returns true for the framing of a TCP port.
fn is_tcp(framing: Framing) -> bool {
    matches!(framing, Framing::Mbap | Framing::Return)
}

/// The only direction of a fault; `None` for a fault of requests and replies.
fn only(fault: &str) -> Option<Direction> {
    match fault {
        "exception" => Some(Direction::Request),
        "wrong_address" | "wrong_transaction" | "mute" | "delay_ms" => Some(Direction::Reply),
        _ => None,
    }
}

/// Faults of a line or TCP port, and the random numbers for its frames.
pub(crate) struct Disturbance {
    /// `None` if there are no faults.
    faults: Option<Box<LineFaults>>,
    /// True for a TCP port.
    tcp: bool,
    requests: RandomNumbers,
    replies: RandomNumbers,
}

/// Random numbers for the frames of one direction.
struct RandomNumbers {
    /// Numbers for the faults that have a rate since the first version.
    first: Rng,
    /// Numbers for all other choices, so that they do not change those of `first`.
    more: Rng,
}

impl RandomNumbers {
    fn new(seed: u64, direction: &str, line: &str) -> Self {
        Self {
            first: Rng::new(seed, &format!("faults of {direction} on {line}")),
            more: Rng::new(seed, &format!("more faults of {direction} on {line}")),
        }
    }
}

impl Disturbance {
    /// A TCP port with that name, without faults.
    pub(crate) fn of_tcp_port(seed: u64, name: &str) -> Self {
        Self { tcp: true, ..Self::new(seed, name) }
    }

    /// A line with that name, without faults.
    pub(crate) fn new(seed: u64, line: &str) -> Self {
        Self {
            faults: None,
            tcp: false,
            requests: RandomNumbers::new(seed, "requests", line),
            replies: RandomNumbers::new(seed, "replies", line),
        }
    }

    pub(crate) fn set(&mut self, faults: LineFaults) {
        let delay = faults.delay.min(LONGEST_DELAY);
        let faults = LineFaults {
            exception_code: faults.exception_code.max(1),
            delay,
            delay_spread: faults.delay_spread.min(LONGEST_DELAY - delay),
            baud: faults.baud.map(|baud| baud.clamp(*BAUDS.start(), *BAUDS.end())),
            ..faults
        };
        self.faults = (faults != LineFaults::NONE).then(|| Box::new(faults));
    }

    pub(crate) fn faults(&self) -> &LineFaults {
        self.faults.as_deref().unwrap_or(&LineFaults::NONE)
    }

    /// Returns true if there are no faults.
    pub(crate) fn is_quiet(&self) -> bool {
        self.faults.is_none()
    }

    /// Returns true if a rule needs the [content](Content) of frames.
    pub(crate) fn needs_content(&self) -> bool {
        !self.is_quiet() && self.faults().all_rules().any(|(_, rule)| rule.needs_content())
    }

    /// Greatest delay of a reply.
    pub(crate) fn longest_delay(&self) -> Duration {
        self.faults().delay + self.faults().delay_spread
    }

    /// Faults of the next request, of `count` characters; `None` if it has none. `refusable` is true if an
    /// exception can answer it.
    pub(crate) fn request(
        &mut self,
        count: usize,
        content: Option<&Content>,
        refusable: bool,
    ) -> Option<FrameFaults> {
        self.fate(Drawn { direction: Direction::Request, count, content, refusable, tcp: self.tcp })
    }

    /// Faults of the next reply, of `count` characters; `None` if it has none.
    pub(crate) fn reply(&mut self, count: usize, content: Option<&Content>) -> Option<FrameFaults> {
        let frame = Drawn { direction: Direction::Reply, count, content, refusable: false, tcp: self.tcp };
        self.fate(frame)
    }

    fn fate(&mut self, frame: Drawn<'_>) -> Option<FrameFaults> {
        let numbers = match frame.direction {
            Direction::Request => &mut self.requests,
            Direction::Reply => &mut self.replies,
        };
        let Some(faults) = &mut self.faults else {
            numbers.first.skip(FrameFaults::DRAWS);
            numbers.more.skip(FrameFaults::MORE_DRAWS);
            return None;
        };
        Some(FrameFaults::draw(faults, numbers, frame))
    }
}

/// A frame whose faults are drawn.
struct Drawn<'a> {
    direction: Direction,
    /// Number of characters.
    count: usize,
    content: Option<&'a Content>,
    /// True if an exception can answer the frame.
    refusable: bool,
    /// True on a TCP port.
    tcp: bool,
}

/// Faults of one frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct FrameFaults {
    /// The frame is lost.
    pub(crate) lost: bool,
    /// Random number for the length of a truncated frame.
    cut: Option<u64>,
    /// Random number for the inverted bit.
    flip: Option<u64>,
    /// The frame is sent twice.
    pub(crate) twice: bool,
    /// The frame has another address.
    pub(crate) wrong_address: bool,
    /// The frame has the number of another transaction.
    pub(crate) wrong_transaction: bool,
    /// The request is answered with an exception, without its drive.
    pub(crate) refused: bool,
    /// Random number for the noise beside the frame.
    noise: Option<u64>,
    /// True if the noise comes right before the frame.
    noise_before: bool,
    /// Seed of the characters that a receiver at another baud rate reads.
    garbage: u64,
    /// The reply is not delivered.
    pub(crate) muted: bool,
    /// Delay of the reply.
    pub(crate) delay: Duration,
    /// Random number that determines after how many bytes of the frame the connection is closed; `None` if it stays
    /// open.
    close: Option<u64>,
}

impl FrameFaults {
    /// Number of random numbers per frame, regardless of the faults, so that one rate does not change the
    /// effect of another (BENCH-10).
    const DRAWS: u64 = 11;
    /// Number of random numbers per frame from the second stream.
    const MORE_DRAWS: u64 = 6;

    fn draw(faults: &mut LineFaults, numbers: &mut RandomNumbers, frame: Drawn<'_>) -> Self {
        let Drawn { direction, count, content, refusable, tcp } = frame;
        let RandomNumbers { first, more } = numbers;
        let choose = |rng: &mut Rng, rule: &FaultRule| match rule.amount {
            Amount::Rate(rate) => rng.gen_bool(rate),
            Amount::Count(_) => rng.gen_bool(0.0),
        };
        // All numbers are drawn first, in a fixed order.
        let cut = (choose(first, &faults.truncate), first.next());
        let flip = (choose(first, &faults.corrupt), first.next());
        let noise = (choose(first, &faults.noise), first.next());
        let lost = choose(first, &faults.drop);
        let twice = choose(first, &faults.duplicate);
        let wrong_address = choose(first, &faults.wrong_address);
        let refused = choose(first, &faults.exception);
        let garbage = first.next();
        let delayed = (choose(more, &faults.delayed), more.next());
        let muted = choose(more, &faults.mute);
        let close = (choose(more, &faults.close), more.next());
        let wrong_transaction = choose(more, &faults.wrong_transaction);

        let replies = direction == Direction::Reply;
        let hits = |rule: &mut FaultRule, chosen: bool, possible: bool| {
            rule.hits(chosen, possible, direction, content)
        };
        // A frame that is lost has no other faults.
        let lost = hits(&mut faults.drop, lost, true);
        let muted = replies && hits(&mut faults.mute, muted, !lost);
        let sent = !lost && !muted;
        let which = |rule: &mut FaultRule, (chosen, number): (bool, u64), possible: bool| {
            hits(rule, chosen, possible).then_some(number)
        };
        let spread = |number: u64| {
            let ticks = u128::from(faults.delay_spread.ticks()) + 1;
            Duration::from_ticks(((ticks * u128::from(number)) >> 64) as u64)
        };
        let has_delay = faults.delay + faults.delay_spread > Duration::ZERO;
        let delayed = if replies && has_delay { which(&mut faults.delayed, delayed, sent) } else { None };
        let cut = which(&mut faults.truncate, cut, sent && count > 1);
        let flip = which(&mut faults.corrupt, flip, sent);
        let noise = which(&mut faults.noise, noise, sent && (replies || !tcp));
        let noise_before = faults.noise_before && !tcp;
        let close = which(&mut faults.close, close, sent && tcp);
        let is_whole = cut.is_none() && flip.is_none() && close.is_none();
        let arrives = !replies && sent && is_whole && !(noise_before && noise.is_some());
        Self {
            lost,
            cut,
            flip,
            twice: hits(&mut faults.duplicate, twice, sent),
            wrong_address: replies && hits(&mut faults.wrong_address, wrong_address, sent),
            wrong_transaction: replies && hits(&mut faults.wrong_transaction, wrong_transaction, sent && tcp),
            refused: arrives && refusable && hits(&mut faults.exception, refused, true),
            noise,
            noise_before,
            garbage,
            muted,
            delay: delayed.map_or(Duration::ZERO, |number| faults.delay + spread(number)),
            close,
        }
    }

    /// The effects on the frame, for journals.
    pub(crate) fn effects(&self) -> FrameEffects {
        FrameEffects::NONE
            .with(FrameEffect::Dropped, self.lost)
            .with(FrameEffect::Muted, self.muted)
            .with(FrameEffect::Truncated, self.cut.is_some())
            .with(FrameEffect::Corrupted, self.flip.is_some())
            .with(FrameEffect::Duplicated, self.twice)
            .with(FrameEffect::Readdressed, self.wrong_address)
            .with(FrameEffect::WrongTransaction, self.wrong_transaction)
            .with(FrameEffect::Delayed, self.delay > Duration::ZERO)
            .with(FrameEffect::Closed, self.close.is_some())
            .with(FrameEffect::WithNoise, self.noise.is_some())
    }

    /// Returns true if the client cannot know when the line is free after the frame: when its drive has sent the reply,
    /// or if more is sent.
    pub(crate) fn hides_end(&self) -> bool {
        let is_part = self.lost || self.muted || self.cut.is_some();
        is_part || self.twice || self.noise.is_some() || self.delay > Duration::ZERO
    }

    /// Returns true if the effects depend on the length of the frame.
    pub(crate) fn needs_whole_frame(&self) -> bool {
        self.cut.is_some() || self.flip.is_some() || self.twice || self.close.is_some()
    }

    /// Removes the noise, because it has been sent.
    pub(crate) fn clear_noise(&mut self) {
        self.noise = None;
    }

    /// Returns true if the connection is closed in the middle of the frame.
    pub(crate) fn is_closing(&self) -> bool {
        self.close.is_some()
    }

    /// The part of the frame after which the connection is closed, if it is.
    pub(crate) fn closes_after<'a>(&self, bytes: &'a [u8]) -> Option<&'a [u8]> {
        let number = self.close?;
        Some(&bytes[..shortened(bytes.len(), number)])
    }

    /// The frame with its faults applied.
    pub(crate) fn apply(&self, line: Line, bytes: &[u8]) -> Text {
        if self.lost {
            return Text::default();
        }
        let kept = self.cut.map_or(bytes.len(), |cut| shortened(bytes.len(), cut));
        let mut text = Text { bytes: bytes[..kept].to_vec(), unreadable: Vec::new() };
        if let Some(flip) = self.flip.filter(|_| kept > 0) {
            let place = (flip % kept as u64) as usize;
            text.bytes[place] ^= 1 << ((flip >> 32) % u64::from(line.data));
            if line.parity != Parity::None {
                text.unreadable.push(place);
            }
        }
        match self.noise_characters(line).filter(|_| self.noise_before) {
            Some(noise) => noise.then(&text),
            None => text,
        }
    }

    /// The noise apart from the frame, if any.
    pub(crate) fn noise(&self, line: Line) -> Option<Text> {
        self.noise_characters(line).filter(|_| !self.noise_before)
    }

    fn noise_characters(&self, line: Line) -> Option<Text> {
        let mut rng = Rng::branch(self.noise?);
        let mut text = Text::default();
        for place in 0..=(rng.next() % 8) as usize {
            let number = rng.next();
            text.bytes.push(number as u8 & data_bits(line));
            if number >> 63 == 1 {
                text.unreadable.push(place);
            }
        }
        Some(text)
    }

    /// Random bytes in place of `count` characters of `line`, for a receiver at `baud` bits per second: as many bytes as
    /// it can read in that time, but at most `count`.
    pub(crate) fn garbage(&self, line: Line, baud: u32, count: usize) -> Vec<u8> {
        let room = count as u64 * u64::from(baud) / u64::from(line.baud.max(1));
        let mut rng = Rng::branch(self.garbage);
        (0..room.min(count as u64)).map(|_| rng.next() as u8 & data_bits(line)).collect()
    }
}

/// Length of a frame of `count` characters without its end: at least 1, and less than `count` if possible.
fn shortened(count: usize, number: u64) -> usize {
    let longest = count.saturating_sub(1) as u64;
    if longest == 0 { count } else { 1 + (number % longest) as usize }
}

/// Mask of the data bits of a character.
pub(crate) fn data_bits(line: Line) -> u8 {
    if line.data == 7 { 0x7F } else { 0xFF }
}

/// Characters as transmitted on a line.
#[derive(Clone, Debug, Default)]
pub(crate) struct Text {
    pub(crate) bytes: Vec<u8>,
    /// Indices of characters with a parity or framing error.
    pub(crate) unreadable: Vec<usize>,
}

impl Text {
    /// Returns true if a receiver of Modbus ASCII finds the begin and the end of a message in these characters.
    pub(crate) fn has_ends_of_ascii(&self) -> bool {
        let readable = |place: usize| !self.unreadable.contains(&place);
        let colon = (0..).zip(&self.bytes).find(|&(place, byte)| *byte == b':' && readable(place));
        colon.is_some() && self.bytes.last() == Some(&b'\n') && readable(self.bytes.len() - 1)
    }

    /// These characters, then those of `other`.
    fn then(mut self, other: &Self) -> Self {
        let before = self.bytes.len();
        self.bytes.extend_from_slice(&other.bytes);
        self.unreadable.extend(other.unreadable.iter().map(|place| place + before));
        self
    }
}

/// The unit that a request on a Modbus line is for, and the exception with this code that answers the request. `None`
/// if no drive answers it: it is a broadcast, or no request.
pub(crate) fn exception(
    line: Line,
    rules: Option<&Rules>,
    request: &[u8],
    code: u8,
) -> Option<(u8, Vec<u8>)> {
    let (unit, pdu) = opened(line, request)?;
    let function = answered_function(&pdu, rules).filter(|_| unit != 0)?;
    Some((unit, framed(line, unit, &[function | EXCEPTION_BIT, code])))
}

/// The function of a request that a drive with these rules answers on a serial line. `None` for an exception, and for a
/// PDU that is shorter or longer than its function requires: drives drop it, unless they do not have the function.
fn answered_function(pdu: &[u8], rules: Option<&Rules>) -> Option<u8> {
    let function = pdu.first().copied().filter(|function| function & EXCEPTION_BIT == 0)?;
    let is_known = rules.is_none_or(|rules| rules.functions.contains(&function));
    let is_whole = match pdu::Request::parse(pdu) {
        Some(pdu::Request::WriteMultiple { values, bytes, .. }) => values.len() == usize::from(bytes),
        Some(_) => true,
        None => false,
    };
    (is_whole || !is_known).then_some(function)
}

/// The same reply with another address and a valid checksum. The address is the next higher free one of 1 to
/// 247 or, if none is free, a reserved one (serial, 2.2). `None` if all of these are in use (BENCH-13).
pub(crate) fn readdressed(line: Line, reply: &[u8], taken: &[i64]) -> Option<Vec<u8>> {
    let (unit, pdu) = opened(line, reply)?;
    let others = (1..247).map(|up| (u32::from(unit) + up - 1) % 247 + 1).map(|other| other as u8);
    let other = others.chain(248..=255).find(|&other| !taken.contains(&i64::from(other)))?;
    Some(framed(line, other, &pdu))
}

/// Address and PDU of a frame on a Modbus line; `None` if the frame is not valid.
pub(crate) fn opened(line: Line, frame: &[u8]) -> Option<(u8, Vec<u8>)> {
    let split = |body: &[u8]| body.split_first().map(|(&unit, pdu)| (unit, pdu.to_vec()));
    if ascii::is_on(line) { split(&ascii::decode(frame)?) } else { split(rtu::verify_crc(frame)?) }
}

/// The frame on a Modbus line for an address and a PDU.
fn framed(line: Line, unit: u8, pdu: &[u8]) -> Vec<u8> {
    if ascii::is_on(line) { ascii::frame(unit, pdu).to_vec() } else { rtu::frame(unit, pdu).to_vec() }
}

#[cfg(test)]
mod tests {
    use drivetwin_firmware::device::Device as _;
    use drivetwin_firmware::md3::Md3;

    use super::*;

    fn rate(rate: f64) -> FaultRule {
        FaultRule::rate(rate)
    }

    #[test]
    fn what_is_out_of_range_is_named() {
        let wrong = |faults: LineFaults| faults.check().unwrap_err();
        let quiet = LineFaults::NONE;
        assert_eq!(quiet, LineFaults::default());
        assert_eq!(quiet.check(), Ok(()));
        assert_eq!(
            LineFaults { drop: rate(1.0), mute: FaultRule::ALL, baud: Some(50), ..quiet }.check(),
            Ok(())
        );
        for (faults, message) in [
            (
                LineFaults { drop: rate(1.5), ..quiet },
                "drop takes a share of the frames from 0 to 1, not 1.5",
            ),
            (
                LineFaults { noise: rate(-0.1), ..quiet },
                "noise takes a share of the frames from 0 to 1, not -0.1",
            ),
            (
                LineFaults { corrupt: rate(f64::NAN), ..quiet },
                "corrupt takes a share of the frames from 0 to 1, not NaN",
            ),
            (LineFaults { exception_code: 0, ..quiet }, "exception_code takes 1 to 255, not 0"),
            (LineFaults { delay: LONGEST_DELAY + Duration::TICK, ..quiet }, "delay takes 60 s at most"),
            (LineFaults { baud: Some(49), ..quiet }, "baud takes 50 to 4000000 bits per second, not 49"),
        ] {
            assert_eq!(wrong(faults), message);
        }
    }

    #[test]
    fn only_modbus_knows_addresses_and_exceptions() {
        let port = |name, framing| PortSpec { name, framing, line: None };
        let (rs485, usb) = (port("rs485", Framing::Silence), port("usb", Framing::Character));
        let faults = LineFaults { exception: rate(0.1), ..LineFaults::NONE };
        assert_eq!(faults.check_for(&rs485), Ok(()));
        assert_eq!(
            faults.check_for(&usb).unwrap_err(),
            "exception is for Modbus lines only, and usb is not one"
        );
        let both = LineFaults { drop: rate(2.0), ..faults };
        assert!(both.check_for(&usb).unwrap_err().starts_with("drop "));
        assert_eq!(LineFaults { drop: rate(0.5), ..LineFaults::NONE }.check_for(&usb), Ok(()));
    }

    /// Drives drop a request of a wrong length (application, figures 9 to 21).
    #[test]
    fn a_request_of_a_wrong_length_has_no_exception() {
        let whole: [&[u8]; 4] = [&[3, 0, 1, 0, 1], &[6, 0, 1, 0, 2], &[16, 0, 0, 0, 1, 2, 0, 1], &[0x6E]];
        let answered = |pdu: &[u8]| answered_function(pdu, None);
        assert_eq!(whole.map(answered), [Some(3), Some(6), Some(16), Some(0x6E)]);
        let wrong: [&[u8]; 6] =
            [&[], &[3, 0, 1], &[6, 0, 1, 0, 2, 3], &[3, 2, 0, 1], &[16, 0, 0, 0, 1, 4, 0, 1], &[0x83, 4]];
        assert_eq!(wrong.map(answered), [None; 6]);
        // An MD3 has functions 3 and 6 only, and refuses the others with 01 (MD3 chapter 7).
        let answered = |pdu: &[u8]| answered_function(pdu, Md3::default().spec().rules);
        assert_eq!(wrong.map(answered), [None, None, None, None, Some(16), None]);
    }

    #[test]
    fn a_reply_bears_the_next_address_that_is_free() {
        let line = Line::new(9_600, 8, Parity::Even, 1);
        let answers = |unit, taken: std::ops::RangeInclusive<i64>| {
            let reply = readdressed(line, &rtu::frame(unit, &[3, 2, 0, 1]), &taken.collect::<Vec<_>>())?;
            Some(rtu::verify_crc(&reply)?[0])
        };
        assert_eq!(answers(5, 5..=5), Some(6));
        assert_eq!(answers(5, 5..=246), Some(247));
        assert_eq!(answers(247, 1..=247), Some(248), "248 to 255 are reserved, and nobody's");
        assert_eq!(answers(5, 1..=254), Some(255));
        assert_eq!(answers(5, 1..=255), None);
    }
}
