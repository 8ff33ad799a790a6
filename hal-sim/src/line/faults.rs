//! Faults of a line: frames that are lost, corrupted, duplicated, truncated or delayed, and noise between
//! frames.

use drivetwin_firmware::device::{Duration, Framing, Line, PortSpec};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::pdu::EXCEPTION_BIT;
use drivetwin_protocol::modbus::{ascii, rtu};

use crate::rng::Rng;

/// Maximum of [`LineFaults::delay`]: 60 s.
pub const LONGEST_DELAY: Duration = Duration::secs(60);

/// Range of [`LineFaults::baud`] in bits per second: 50 to 4,000,000.
pub const BAUDS: std::ops::RangeInclusive<u32> = 50..=4_000_000;

/// Faults of a line, set by [`Bench::set_line_faults`](crate::bench::Bench::set_line_faults). Rates are
/// shares of the frames, from 0 to 1, and apply to requests and replies unless a field says otherwise. The
/// default has no faults. On a line with timed characters, a frame is one write of a client or one output of
/// a drive.
///
/// ```
/// use drivetwin_firmware::device::{Duration, Instant, Port};
/// use drivetwin_firmware::md3::Md3;
/// use drivetwin_protocol::modbus::rtu;
/// use drivetwin_sim::bench::Bench;
/// use drivetwin_sim::line::faults::LineFaults;
///
/// let mut bench = Bench::new();
/// let drive = bench.add::<Md3>("x");
/// bench.run_until(Instant::ZERO + Duration::secs(3));
/// let bus = bench.bus(drive, Port(0)).unwrap();
/// let faults = LineFaults { drop: 1.0, ..LineFaults::NONE };
/// assert_eq!(faults.check(), Ok(()));
/// bench.set_line_faults(bus, faults);
/// assert!(bench.ask(drive, &rtu::read(1, 0, 1)).is_empty());
/// bench.set_line_faults(bus, LineFaults::NONE);
/// assert_eq!(bench.ask(drive, &rtu::read(1, 0, 1)).len(), 7);
/// ```
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct LineFaults {
    /// Share of frames that are lost.
    pub drop: f64,
    /// Share of frames in which one data bit is inverted. On a line with parity, drives detect a parity error in that
    /// character (BENCH-11).
    pub corrupt: f64,
    /// Share of frames that are sent twice. A reply is repeated after an inter-frame gap, a request after its
    /// answer; on a line with timed characters, a frame is repeated at once. Replies that are more than half
    /// a second late because the line is full are sent once.
    pub duplicate: f64,
    /// Share of truncated frames. At least one character is missing, and at least one is sent.
    pub truncate: f64,
    /// Share of replies with a valid checksum and an address that no drive on the line has; only on Modbus
    /// lines.
    pub wrong_address: f64,
    /// Share of requests that are not executed but answered with the exception `exception_code`; only on Modbus lines.
    pub exception: f64,
    /// Code of the exception, 1 to 255.
    pub exception_code: u8,
    /// Share of frames that are followed, after an inter-frame gap, by one to eight characters of noise. No
    /// noise follows replies that are more than half a second late because the line is full.
    pub noise: f64,
    /// Delay of every reply, up to 60 s ([`LONGEST_DELAY`]).
    pub delay: Duration,
    /// True if no reply is delivered.
    pub mute: bool,
    /// Baud rate of the clients, 50 to 4,000,000 bits per second, regardless of the drives' settings. `None`:
    /// the baud rate of the drives.
    pub baud: Option<u32>,
}

impl Default for LineFaults {
    fn default() -> Self {
        Self::NONE
    }
}

impl LineFaults {
    /// No faults, the default: all rates are 0 and there is no delay.
    pub const NONE: Self = Self {
        drop: 0.0,
        corrupt: 0.0,
        duplicate: 0.0,
        truncate: 0.0,
        wrong_address: 0.0,
        exception: 0.0,
        exception_code: 4,
        noise: 0.0,
        delay: Duration::ZERO,
        mute: false,
        baud: None,
    };

    /// The seven rates with their names, for tables of settings.
    pub fn shares(&mut self) -> [(&'static str, &mut f64); 7] {
        [
            ("drop", &mut self.drop),
            ("corrupt", &mut self.corrupt),
            ("duplicate", &mut self.duplicate),
            ("truncate", &mut self.truncate),
            ("wrong_address", &mut self.wrong_address),
            ("exception", &mut self.exception),
            ("noise", &mut self.noise),
        ]
    }

    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// One sentence that names the value and its range.
    pub fn check(&self) -> Result<(), String> {
        let mut own = *self;
        if let Some((name, share)) = own.shares().iter().find(|(_, share)| !(0.0..=1.0).contains(&**share)) {
            return Err(format!("{name} takes a share of the frames from 0 to 1, not {share}"));
        }
        if self.exception_code == 0 {
            return Err("exception_code takes 1 to 255, not 0".into());
        }
        if self.delay > LONGEST_DELAY {
            return Err("delay takes 60 s at most".into());
        }
        match self.baud.filter(|baud| !BAUDS.contains(baud)) {
            Some(baud) => {
                Err(format!("baud takes {} to {} bits per second, not {baud}", BAUDS.start(), BAUDS.end()))
            }
            None => Ok(()),
        }
    }

    /// Checks that these faults are valid for a line with that port: all values pass [`check`](Self::check),
    /// and `wrong_address` and `exception` are used only on a Modbus line.
    ///
    /// # Errors
    /// One sentence that names the fault and the reason.
    pub fn check_for(&self, port: &PortSpec) -> Result<(), String> {
        self.check()?;
        let needs_modbus = [("wrong_address", self.wrong_address), ("exception", self.exception)];
        match needs_modbus.iter().find(|(_, share)| *share > 0.0) {
            Some((name, _)) if port.framing != Framing::Silence => {
                Err(format!("{name} is for Modbus lines only, and {} is not one", port.name))
            }
            _ => Ok(()),
        }
    }
}

/// Faults of a line, and the random numbers for its frames.
pub(crate) struct Disturbance {
    faults: LineFaults,
    /// True if there are no faults.
    quiet: bool,
    requests: Rng,
    replies: Rng,
}

impl Disturbance {
    /// A line with that name, without faults.
    pub(crate) fn new(seed: u64, line: &str) -> Self {
        Self {
            faults: LineFaults::NONE,
            quiet: true,
            requests: Rng::new(seed, &format!("faults of requests on {line}")),
            replies: Rng::new(seed, &format!("faults of replies on {line}")),
        }
    }

    pub(crate) fn set(&mut self, faults: LineFaults) {
        self.faults = LineFaults {
            exception_code: faults.exception_code.max(1),
            delay: faults.delay.min(LONGEST_DELAY),
            baud: faults.baud.map(|baud| baud.clamp(*BAUDS.start(), *BAUDS.end())),
            ..faults
        };
        self.quiet = self.faults == LineFaults::NONE;
    }

    pub(crate) fn faults(&self) -> &LineFaults {
        &self.faults
    }

    /// Faults of the next request; `None` if it has none.
    pub(crate) fn request(&mut self) -> Option<FrameFaults> {
        self.fate(|this| &mut this.requests)
    }

    /// Faults of the next reply; `None` if it has none.
    pub(crate) fn reply(&mut self) -> Option<FrameFaults> {
        self.fate(|this| &mut this.replies)
    }

    fn fate(&mut self, rng: impl Fn(&mut Self) -> &mut Rng) -> Option<FrameFaults> {
        let faults = self.faults;
        if self.quiet {
            rng(self).skip(FrameFaults::DRAWS);
            return None;
        }
        Some(FrameFaults::draw(&faults, rng(self)))
    }
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
    /// The request is refused with an exception.
    pub(crate) refused: bool,
    /// Random number for the noise after the frame.
    noise: Option<u64>,
    /// Seed of the characters that a receiver at another baud rate reads.
    garbage: u64,
}

impl FrameFaults {
    /// Number of random numbers per frame, regardless of the faults, so that one rate does not change the
    /// effect of another (BENCH-10).
    const DRAWS: u64 = 11;

    fn draw(faults: &LineFaults, rng: &mut Rng) -> Self {
        let mut which = |share: f64| {
            let (is_hit, number) = (rng.gen_bool(share), rng.next());
            is_hit.then_some(number)
        };
        let (cut, flip, noise) = (which(faults.truncate), which(faults.corrupt), which(faults.noise));
        Self {
            lost: rng.gen_bool(faults.drop),
            cut,
            flip,
            twice: rng.gen_bool(faults.duplicate),
            wrong_address: rng.gen_bool(faults.wrong_address),
            refused: rng.gen_bool(faults.exception),
            noise,
            garbage: rng.next(),
        }
    }

    /// The frame with its faults applied.
    pub(crate) fn apply(&self, line: Line, bytes: &[u8]) -> Text {
        if self.lost {
            return Text::default();
        }
        let longest = bytes.len().saturating_sub(1) as u64;
        let kept = self.cut.filter(|_| longest > 0).map_or(bytes.len(), |cut| 1 + (cut % longest) as usize);
        let mut text = Text { bytes: bytes[..kept].to_vec(), unreadable: Vec::new() };
        if let Some(flip) = self.flip.filter(|_| kept > 0) {
            let place = (flip % kept as u64) as usize;
            text.bytes[place] ^= 1 << ((flip >> 32) % u64::from(line.data));
            if line.parity != Parity::None {
                text.unreadable.push(place);
            }
        }
        text
    }

    /// The noise after the frame, if any.
    pub(crate) fn noise(&self, line: Line) -> Option<Text> {
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

    /// Bytes that a receiver at `baud` bits per second reads in the time of `count` characters of `line`: as
    /// many as fit into that time, but at most `count`.
    pub(crate) fn garbage(&self, line: Line, baud: u32, count: usize) -> Vec<u8> {
        let room = count as u64 * u64::from(baud) / u64::from(line.baud.max(1));
        let mut rng = Rng::branch(self.garbage);
        (0..room.min(count as u64)).map(|_| rng.next() as u8 & data_bits(line)).collect()
    }
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

/// A request that is refused without being executed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refusal {
    unit: u8,
    function: u8,
    code: u8,
}

impl Refusal {
    /// A user-defined function code (application, 5) that no drive supports (BENCH-12).
    const UNUSED_FUNCTION: u8 = 110;

    /// Refusal of a request on a Modbus line, and the request that the drives receive instead. `None` if the
    /// message cannot be refused, because it is a broadcast or no request.
    pub(crate) fn of(line: Line, request: &[u8], code: u8) -> Option<(Self, Vec<u8>)> {
        let (unit, mut pdu) = opened(line, request)?;
        let function = pdu.first_mut().filter(|function| unit != 0 && **function & EXCEPTION_BIT == 0)?;
        let refusal = Self { unit, function: *function, code };
        *function = Self::UNUSED_FUNCTION;
        Some((refusal, framed(line, unit, &pdu)))
    }

    /// The exception that replaces a drive's reply; `None` if `reply` does not answer the refused request.
    pub(crate) fn answer(self, line: Line, reply: &[u8]) -> Option<Vec<u8>> {
        let (unit, pdu) = opened(line, reply)?;
        let refused = unit == self.unit && pdu.first() == Some(&(Self::UNUSED_FUNCTION | EXCEPTION_BIT));
        refused.then(|| framed(line, unit, &[self.function | EXCEPTION_BIT, self.code]))
    }
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
fn opened(line: Line, frame: &[u8]) -> Option<(u8, Vec<u8>)> {
    let split = |body: &[u8]| body.split_first().map(|(&unit, pdu)| (unit, pdu.to_vec()));
    if ascii::is_on(line) { split(&ascii::decode(frame)?) } else { split(rtu::verify_crc(frame)?) }
}

/// The frame on a Modbus line for an address and a PDU.
fn framed(line: Line, unit: u8, pdu: &[u8]) -> Vec<u8> {
    if ascii::is_on(line) { ascii::frame(unit, pdu).to_vec() } else { rtu::frame(unit, pdu).to_vec() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_out_of_range_is_named() {
        let wrong = |faults: LineFaults| faults.check().unwrap_err();
        let quiet = LineFaults::NONE;
        assert_eq!(quiet, LineFaults::default());
        assert_eq!(quiet.check(), Ok(()));
        assert_eq!(LineFaults { drop: 1.0, mute: true, baud: Some(50), ..quiet }.check(), Ok(()));
        for (faults, message) in [
            (LineFaults { drop: 1.5, ..quiet }, "drop takes a share of the frames from 0 to 1, not 1.5"),
            (LineFaults { noise: -0.1, ..quiet }, "noise takes a share of the frames from 0 to 1, not -0.1"),
            (
                LineFaults { corrupt: f64::NAN, ..quiet },
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
        let faults = LineFaults { exception: 0.1, ..LineFaults::NONE };
        assert_eq!(faults.check_for(&rs485), Ok(()));
        assert_eq!(
            faults.check_for(&usb).unwrap_err(),
            "exception is for Modbus lines only, and usb is not one"
        );
        let both = LineFaults { drop: 2.0, ..faults };
        assert!(both.check_for(&usb).unwrap_err().starts_with("drop "));
        assert_eq!(LineFaults { drop: 0.5, ..LineFaults::NONE }.check_for(&usb), Ok(()));
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
