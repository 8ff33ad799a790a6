//! Faults of a line: frames lost, changed, doubled, cut, delayed, and noise between them.

use drivetwin_firmware::device::{Duration, Framing, Line, PortSpec};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::pdu::EXCEPTION_BIT;
use drivetwin_protocol::modbus::{ascii, rtu};

use crate::rng::Rng;

/// The longest that a reply may be late.
pub const LONGEST_DELAY: Duration = Duration::secs(60);

/// The slowest and the fastest rate at which clients may talk.
pub const BAUDS: std::ops::RangeInclusive<u32> = 50..=4_000_000;

/// Faults of a line. Rates are per frame, for requests and replies alike unless a field says otherwise, from 0 to 1; by
/// default there are none. Where each character has its time, a frame is what a client has written at once, or what a
/// drive has sent at once.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct LineFaults {
    /// Frames that are lost.
    pub drop: f64,
    /// Frames in which a data bit is turned over (BENCH-11). Drives on a line with parity notice it in that character.
    pub corrupt: f64,
    /// Frames that come twice: a reply again when the line has been silent behind it, a request again when its
    /// answer is over; what was written to a line on which each character has its time, at once. Replies that lag
    /// by half a second, because the line is full, come once.
    pub duplicate: f64,
    /// Frames whose end is missing: at least a character, and all but one at most.
    pub truncate: f64,
    /// Replies that bear the address of no drive of the line, with a good check sum; only of Modbus.
    pub wrong_address: f64,
    /// Requests that are not carried out but refused, with `exception_code`; only of Modbus.
    pub exception: f64,
    /// The code of such a refusal, 1 to 255.
    pub exception_code: u8,
    /// Frames after which, when the line has been silent, it carries one to eight characters of noise;
    /// not behind replies that lag by half a second, because the line is full.
    pub noise: f64,
    /// Every reply is late by that, up to a minute.
    pub delay: Duration,
    /// No reply reaches anybody.
    pub mute: bool,
    /// Clients talk and listen at that rate, 50 to 4,000,000 bits per second, whatever the drives do.
    pub baud: Option<u32>,
}

impl Default for LineFaults {
    fn default() -> Self {
        Self::NONE
    }
}

impl LineFaults {
    /// No faults.
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

    /// The rates, by name.
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
    /// One sentence: which is not, and what it takes.
    pub fn check(&self) -> Result<(), String> {
        let mut own = *self;
        if let Some((name, share)) = own.shares().iter().find(|(_, share)| !(0.0..=1.0).contains(&**share)) {
            return Err(format!("{name} takes a share of the frames from 0 to 1, not {share}"));
        }
        if self.exception_code == 0 {
            return Err("exception_code takes 1 to 255, not 0".into());
        }
        if self.delay > LONGEST_DELAY {
            return Err("a reply can be late by 60 s at most".into());
        }
        match self.baud.filter(|baud| !BAUDS.contains(baud)) {
            Some(baud) => {
                Err(format!("baud takes {} to {} bits per second, not {baud}", BAUDS.start(), BAUDS.end()))
            }
            None => Ok(()),
        }
    }

    /// Checks that a line with that port can have these faults: [`check`](Self::check), and addresses and exceptions
    /// only on lines of Modbus.
    ///
    /// # Errors
    /// One sentence: what cannot be.
    pub fn check_for(&self, port: &PortSpec) -> Result<(), String> {
        self.check()?;
        let needs_modbus = [("wrong_address", self.wrong_address), ("exception", self.exception)];
        match needs_modbus.iter().find(|(_, share)| *share > 0.0) {
            Some((name, _)) if port.framing != Framing::Silence => {
                Err(format!("{name} is for lines of Modbus, and {} is none", port.name))
            }
            _ => Ok(()),
        }
    }
}

/// Faults of a line, and the random stream that decides about its frames.
pub(crate) struct Disturbance {
    faults: LineFaults,
    /// True if there are no faults.
    quiet: bool,
    requests: Rng,
    replies: Rng,
}

impl Disturbance {
    /// No faults yet, on the line of that name.
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

    /// Faults of the next request; `None`: it has none.
    pub(crate) fn request(&mut self) -> Option<Fate> {
        self.fate(|this| &mut this.requests)
    }

    /// Faults of the next reply; `None`: it has none.
    pub(crate) fn reply(&mut self) -> Option<Fate> {
        self.fate(|this| &mut this.replies)
    }

    fn fate(&mut self, dice: impl Fn(&mut Self) -> &mut Rng) -> Option<Fate> {
        let faults = self.faults;
        if self.quiet {
            dice(self).skip(Fate::THROWS);
            return None;
        }
        Some(Fate::throw(&faults, dice(self)))
    }
}

/// Faults of one frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct Fate {
    /// The frame is lost.
    pub(crate) lost: bool,
    /// Random number that says where it ends too early.
    cut: Option<u64>,
    /// Random number that says which bits are inverted.
    flip: Option<u64>,
    /// The frame comes twice.
    pub(crate) twice: bool,
    /// The frame has another address.
    pub(crate) elsewhere: bool,
    /// The request is refused with an exception.
    pub(crate) refused: bool,
    /// Random number that gives noise behind it.
    noise: Option<u64>,
    /// The seed of the characters that somebody at another baud rate takes it for.
    garbage: u64,
}

impl Fate {
    /// Random numbers that a frame takes, whatever the faults are: so no rate changes what another one does (BENCH-10).
    const THROWS: u64 = 11;

    fn throw(faults: &LineFaults, dice: &mut Rng) -> Self {
        let mut which = |share: f64| {
            let (gen_bool, number) = (dice.gen_bool(share), dice.next());
            gen_bool.then_some(number)
        };
        let (cut, flip, noise) = (which(faults.truncate), which(faults.corrupt), which(faults.noise));
        Self {
            lost: dice.gen_bool(faults.drop),
            cut,
            flip,
            twice: dice.gen_bool(faults.duplicate),
            elsewhere: dice.gen_bool(faults.wrong_address),
            refused: dice.gen_bool(faults.exception),
            noise,
            garbage: dice.next(),
        }
    }

    /// The frame as its faults leave it.
    pub(crate) fn spoil(&self, line: Line, bytes: &[u8]) -> Text {
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

    /// The noise behind it.
    pub(crate) fn noise(&self, line: Line) -> Option<Text> {
        let mut dice = Rng::branch(self.noise?);
        let mut text = Text::default();
        for place in 0..=(dice.next() % 8) as usize {
            let number = dice.next();
            text.bytes.push(number as u8 & data_bits(line));
            if number >> 63 == 1 {
                text.unreadable.push(place);
            }
        }
        Some(text)
    }

    /// Bytes that a reader at `baud` bits per second makes of `count` characters of `line`: as many as fit into their
    /// time, and no more.
    pub(crate) fn garbage(&self, line: Line, baud: u32, count: usize) -> Vec<u8> {
        let room = count as u64 * u64::from(baud) / u64::from(line.baud.max(1));
        let mut dice = Rng::branch(self.garbage);
        (0..room.min(count as u64)).map(|_| dice.next() as u8 & data_bits(line)).collect()
    }
}

/// The bits that a character of a line has.
pub(crate) fn data_bits(line: Line) -> u8 {
    if line.data == 7 { 0x7F } else { 0xFF }
}

/// Characters as they are on a line.
#[derive(Clone, Debug, Default)]
pub(crate) struct Text {
    pub(crate) bytes: Vec<u8>,
    /// Places of those in which a drive finds that they are wrong.
    pub(crate) unreadable: Vec<usize>,
}

/// A request that is refused without being carried out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refusal {
    unit: u8,
    function: u8,
    code: u8,
}

impl Refusal {
    /// A user-defined function (application, 5) that no drive has (BENCH-12).
    const NOBODYS: u8 = 110;

    /// Refusal of a request on a line of Modbus, and what the drives get instead. `None` where it cannot be refused: a
    /// broadcast, or no request.
    pub(crate) fn of(line: Line, request: &[u8], code: u8) -> Option<(Self, Vec<u8>)> {
        let (unit, mut pdu) = opened(line, request)?;
        let function = pdu.first_mut().filter(|function| unit != 0 && **function & EXCEPTION_BIT == 0)?;
        let refusal = Self { unit, function: *function, code };
        *function = Self::NOBODYS;
        Some((refusal, framed(line, unit, &pdu)))
    }

    /// The answer that replaces a drive's reply, if that is the reply to the request.
    pub(crate) fn answer(self, line: Line, reply: &[u8]) -> Option<Vec<u8>> {
        let (unit, pdu) = opened(line, reply)?;
        let refused = unit == self.unit && pdu.first() == Some(&(Self::NOBODYS | EXCEPTION_BIT));
        refused.then(|| framed(line, unit, &[self.function | EXCEPTION_BIT, self.code]))
    }
}

/// A reply from another address, with a good check sum: the next one up of 1 to 247 that is free, or where none is
/// one of those that are reserved (serial, 2.2; BENCH-13). `None` where even they are taken.
pub(crate) fn readdressed(line: Line, reply: &[u8], taken: &[i64]) -> Option<Vec<u8>> {
    let (unit, pdu) = opened(line, reply)?;
    let others = (1..247).map(|up| (u32::from(unit) + up - 1) % 247 + 1).map(|other| other as u8);
    let other = others.chain(248..=255).find(|&other| !taken.contains(&i64::from(other)))?;
    Some(framed(line, other, &pdu))
}

/// Address and PDU of a good frame on a line of Modbus.
fn opened(line: Line, frame: &[u8]) -> Option<(u8, Vec<u8>)> {
    let split = |body: &[u8]| body.split_first().map(|(&unit, pdu)| (unit, pdu.to_vec()));
    if ascii::is_on(line) { split(&ascii::decode(frame)?) } else { split(rtu::verify_crc(frame)?) }
}

/// The frame of an address and a PDU on a line of Modbus.
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
            (
                LineFaults { delay: LONGEST_DELAY + Duration::TICK, ..quiet },
                "a reply can be late by 60 s at most",
            ),
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
        assert_eq!(faults.check_for(&usb).unwrap_err(), "exception is for lines of Modbus, and usb is none");
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
