//! An MDrive on a bench, with a client on each of its ports and a stimulus for every pin.

use drivetwin_firmware::device::{Axis, Encoder, Fault, Level, Pin, Port};
use drivetwin_firmware::mdrive::Mdrive;
use drivetwin_protocol::time::{Duration, Instant, Span};
use drivetwin_sim::bench::{Bench, Client, DriveId, Ended, Motion, PinStimulus, PowerAction, Setup};

pub(crate) const MODBUS: Port = Port(0);
pub(crate) const MCODE: Port = Port(1);

/// Duration longer than a start-up without calibration.
pub(crate) const START: Duration = Duration::secs(1);

/// Duration longer than a calibration of a Hybrid: 3.12 s with CT = 250 (MC 5-9).
pub(crate) const CALIBRATION: Duration = Duration::secs(4);

/// Duration longer than a save.
pub(crate) const SAVE: Duration = Duration::millis(100);

/// Sign-on message (MC 6-6) as the drive sends it over TCP.
pub(crate) const SIGN_ON: &str = "Copyright 2001-2010 by Schneider Electric Motion USA.";

/// The two products.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Kind {
    Plus,
    Hybrid,
}

pub(crate) const KINDS: [Kind; 2] = [Kind::Plus, Kind::Hybrid];

/// The exception code of a refusal.
pub(crate) type Exception = u8;

/// A drive with its motor. A typed line takes effect, and prints, one tick before [`say`](Rig::say) returns
/// (MC 7.1). So the time of a command is measured from then.
pub(crate) struct Rig {
    pub(crate) bench: Bench,
    pub(crate) seat: DriveId,
    pub(crate) kind: Kind,
    pub(crate) modbus: Client,
    /// Client on port 503. [`new`](Rig::new) switches its echo off: EM = 2 sends only printed output
    /// (MC 5-22).
    pub(crate) mcode: Client,
    transaction: u16,
}

/// Time, power and pins.
impl Rig {
    pub(crate) fn plus() -> Self {
        Self::new(Kind::Plus)
    }

    pub(crate) fn hybrid() -> Self {
        Self::new(Kind::Hybrid)
    }

    /// A new drive that is ready and does not echo.
    pub(crate) fn new(kind: Kind) -> Self {
        let mut rig = Self::loud(kind);
        rig.say("EM=2");
        rig
    }

    /// A new drive that is ready and has the factory settings, so that it echoes.
    pub(crate) fn loud(kind: Kind) -> Self {
        Self::set_up(kind, Setup { boot_fast: true, ..Setup::default() })
    }

    pub(crate) fn set_up(kind: Kind, setup: Setup) -> Self {
        let mut bench = Bench::new();
        let drive = match kind {
            Kind::Plus => Mdrive::plus(),
            Kind::Hybrid => Mdrive::hybrid(),
        };
        let seat = bench.add_with("x", Box::new(drive), setup).expect("a drive that can be seated");
        Self::of(kind, bench, seat)
    }

    /// A drive that has just been added to a bench.
    pub(crate) fn of(kind: Kind, mut bench: Bench, seat: DriveId) -> Self {
        bench.run_until(bench.now() + START);
        let modbus = bench.connect_to(seat, MODBUS).expect("a drive that has power");
        let mcode = bench.connect_to(seat, MCODE).expect("a drive that has power");
        let mut rig = Self { bench, seat, kind, modbus, mcode, transaction: 0 };
        rig.after(Duration::TICK);
        rig
    }

    pub(crate) fn now(&self) -> Instant {
        self.bench.now()
    }

    /// Advances the time.
    pub(crate) fn after(&mut self, span: Duration) {
        self.bench.run_until(self.now() + span);
    }

    /// Checks a condition every `step` until it is true; returns the time that this took. Fails after `most`.
    #[track_caller]
    pub(crate) fn wait(
        &mut self,
        most: Duration,
        step: Duration,
        mut is_so: impl FnMut(&mut Self) -> bool,
    ) -> Duration {
        let start = self.now();
        while !is_so(self) {
            assert!(self.now().since(start) < most, "not in {most:?}");
            self.after(step);
        }
        self.now().since(start)
    }

    /// Switches power off, and on again after a second; returns when the drive is ready. The echo mode is the
    /// one that was saved.
    pub(crate) fn power_cycle(&mut self) {
        self.bench.power(self.seat, PowerAction::Off);
        self.after(1.secs());
        self.bench.power(self.seat, PowerAction::On);
        self.after(START);
        self.connect();
    }

    /// Closes both connections and opens them again.
    pub(crate) fn connect(&mut self) {
        self.bench.disconnect(self.modbus);
        self.bench.disconnect(self.mcode);
        self.modbus = self.bench.connect_to(self.seat, MODBUS).expect("a drive that has power");
        self.mcode = self.bench.connect_to(self.seat, MCODE).expect("a drive that has power");
        self.after(Duration::TICK);
    }

    /// Turns an encoder at the drive's inputs.
    pub(crate) fn turn(&mut self, encoder: Encoder, counts: i32) {
        self.bench.encoder(self.seat, encoder, counts, 1_000.0).expect("none turns");
        self.after(Duration::millis(u64::from(counts.unsigned_abs()) + 1));
    }

    /// Finds a pin by its name in the manual.
    pub(crate) fn pin(&self, name: &str) -> Pin {
        self.bench.spec(self.seat).pin(name).unwrap_or_else(|| panic!("there is no {name}"))
    }

    /// Applies a stimulus to a pin; returns when the drive has received it.
    pub(crate) fn drive(&mut self, name: &str, drive: PinStimulus) {
        self.bench.set_pin(self.seat, self.pin(name), drive);
        self.after(Duration::TICK);
    }

    pub(crate) fn low(&mut self, name: &str) {
        self.drive(name, PinStimulus::Low);
    }

    pub(crate) fn high(&mut self, name: &str) {
        self.drive(name, PinStimulus::High);
    }

    pub(crate) fn open(&mut self, name: &str) {
        self.drive(name, PinStimulus::Open);
    }

    /// Level of a pin as seen from outside.
    pub(crate) fn level(&self, name: &str) -> Level {
        self.bench.level(self.seat, self.pin(name))
    }

    /// Sets or removes the cause of a fault.
    pub(crate) fn fault(&mut self, name: &str, on: bool) {
        let place = self.bench.spec(self.seat).faults.iter().position(|fault| *fault == name);
        let place = place.unwrap_or_else(|| panic!("there is no fault {name}"));
        self.bench.fault(self.seat, Fault(place as u8), on);
        self.after(Duration::TICK);
    }

    /// Motion of the motor itself, not of the drive's registers.
    pub(crate) fn motion(&self) -> Motion {
        self.bench.motion(self.seat, Axis(0))
    }

    /// Speed of the motor in steps per second, signed.
    pub(crate) fn speed(&self) -> f64 {
        self.motion().speed.to_num()
    }
}

/// Requests on port 502.
impl Rig {
    /// Reply of the drive to a PDU. Its header must be that of the request (FB 3.2.1).
    #[track_caller]
    pub(crate) fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        self.transaction = self.transaction.wrapping_add(1);
        let request = adu(self.transaction, 1, pdu);
        let client = self.modbus;
        self.bench.send(client, &request);
        self.bench.run_until_idle();
        let mut reply = Vec::new();
        self.bench.receive(client, &mut reply);
        assert!(reply.len() > 7, "to {pdu:02X?} came {reply:02X?}, {:?}", self.bench.ended(client));
        assert_eq!(reply[..4], request[..4], "transaction and protocol");
        assert_eq!(usize::from(u16::from_be_bytes([reply[4], reply[5]])), reply.len() - 6, "its length");
        assert_eq!(reply[6], 1, "its unit");
        reply[7..].to_vec()
    }

    /// Sends a request; returns the reply, or the exception of a refusal.
    #[track_caller]
    pub(crate) fn try_ask(&mut self, pdu: &[u8]) -> Result<Vec<u8>, Exception> {
        let reply = self.ask(pdu);
        if reply[0] == pdu[0] | 0x80 {
            assert_eq!(reply.len(), 2, "a refusal is two bytes: {reply:02X?}");
            return Err(reply[1]);
        }
        assert_eq!(reply[0], pdu[0], "to {pdu:02X?} came {reply:02X?}");
        Ok(reply)
    }

    /// Reads registers with function 3 (FB 4.2.4).
    #[track_caller]
    pub(crate) fn try_words(&mut self, address: u16, count: u16) -> Result<Vec<u16>, Exception> {
        let reply = self.try_ask(&request(3, address, count))?;
        assert_eq!(usize::from(reply[1]), 2 * usize::from(count), "its byte count");
        assert_eq!(reply.len(), 2 + usize::from(reply[1]));
        Ok(reply[2..].chunks(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect())
    }

    /// Reads a register of one word.
    #[track_caller]
    pub(crate) fn word(&mut self, address: u16) -> u16 {
        self.try_words(address, 1).unwrap_or_else(|code| panic!("{address:04X}: exception {code:02X}"))[0]
    }

    /// Reads two registers, the high word first.
    #[track_caller]
    pub(crate) fn long(&mut self, address: u16) -> i32 {
        let words = self.try_words(address, 2);
        let words = words.unwrap_or_else(|code| panic!("{address:04X}: exception {code:02X}"));
        (u32::from(words[0]) << 16 | u32::from(words[1])).cast_signed()
    }

    /// Writes registers with function 16 (FB 4.2.5). The reply has the address and the quantity, as in the
    /// Modbus specification.
    #[track_caller]
    pub(crate) fn try_write(&mut self, address: u16, words: &[u16]) -> Result<(), Exception> {
        let head = request(16, address, words.len() as u16);
        let mut pdu = head.to_vec();
        pdu.push(2 * words.len() as u8);
        pdu.extend(words.iter().flat_map(|word| word.to_be_bytes()));
        assert_eq!(self.try_ask(&pdu)?, head, "the reply to function 16");
        Ok(())
    }

    #[track_caller]
    pub(crate) fn write(&mut self, address: u16, word: u16) {
        assert_eq!(self.try_write(address, &[word]), Ok(()), "{word} to {address:04X}");
    }

    #[track_caller]
    pub(crate) fn write_long(&mut self, address: u16, value: i32) {
        assert_eq!(self.try_write(address, &halves(value)), Ok(()), "{value} to {address:04X}");
    }

    /// Reads EF and then ER, which clears both (FB 5).
    #[track_caller]
    pub(crate) fn ef_er(&mut self) -> (u16, u16) {
        let flag = self.word(0x001F);
        (flag, self.word(0x0021))
    }

    /// Asserts that the drive has no error.
    #[track_caller]
    pub(crate) fn assert_no_error(&mut self) {
        assert_eq!(self.ef_er(), (0, 0), "EF and ER");
    }

    /// Reads with function 65 (FB 4.3.2); returns the characters of the reply.
    #[track_caller]
    pub(crate) fn try_read_specific(&mut self, mnemonic: &[u8; 4]) -> Result<String, Exception> {
        let mut pdu = vec![65];
        pdu.extend(mnemonic);
        let reply = self.try_ask(&pdu)?;
        assert_eq!(usize::from(reply[1]), reply.len() - 2, "its byte count: {reply:02X?}");
        Ok(String::from_utf8(reply[2..].to_vec()).expect("characters"))
    }

    /// Writes with function 66 (FB 4.3.3). The reply has the mnemonic.
    #[track_caller]
    pub(crate) fn try_write_specific(&mut self, mnemonic: &[u8; 4], text: &str) -> Result<(), Exception> {
        let mut pdu = vec![66];
        pdu.extend(mnemonic);
        pdu.push(text.len() as u8);
        pdu.extend(text.as_bytes());
        let reply = self.try_ask(&pdu)?;
        assert_eq!(reply[1], 4, "four bytes follow");
        assert_eq!(reply[2..], mnemonic[..], "the mnemonic");
        Ok(())
    }
}

/// Lines on port 503.
impl Rig {
    /// Sends characters unchanged; returns the text that the drive sends until it has executed their lines.
    pub(crate) fn key(&mut self, bytes: &[u8]) -> String {
        self.bench.send(self.mcode, bytes);
        self.bench.run_until_idle();
        self.after(Duration::TICK);
        self.heard()
    }

    /// Sends a line; returns the text that the drive prints at once.
    pub(crate) fn say(&mut self, line: &str) -> String {
        self.key(format!("{line}\r").as_bytes())
    }

    /// Text received since the last call.
    pub(crate) fn heard(&mut self) -> String {
        let mut bytes = Vec::new();
        self.bench.receive(self.mcode, &mut bytes);
        String::from_utf8(bytes).expect("MCode is ASCII")
    }

    /// Sends lines; asserts that none of them prints or fails.
    #[track_caller]
    pub(crate) fn set(&mut self, lines: &[&str]) {
        for line in lines {
            assert_eq!(self.say(line), "", "{line} prints nothing");
            assert_eq!(self.peek("ER"), 0, "{line}: the error");
        }
    }

    /// Types a program with its PG lines.
    #[track_caller]
    pub(crate) fn program(&mut self, lines: &str) {
        for line in lines.lines() {
            assert_eq!(self.say(line), "", "{line} prints nothing");
        }
        assert_eq!(self.peek("ER"), 0, "the error");
    }

    /// Present value of a variable, without the time that PR takes.
    #[track_caller]
    pub(crate) fn peek(&self, name: &str) -> i64 {
        let row = self.bench.spec(self.seat).find(name).expect("a variable").row;
        self.bench.peek(self.seat, row)
    }

    /// Text that PR prints for an item, without its CR LF.
    #[track_caller]
    pub(crate) fn show(&mut self, item: &str) -> String {
        let text = self.say(&format!("PR {item}"));
        let line = text.strip_suffix("\r\n");
        line.unwrap_or_else(|| panic!("PR {item} printed {text:?}: no CR LF at its end")).to_owned()
    }

    /// Number that PR prints for an item.
    #[track_caller]
    pub(crate) fn value(&mut self, item: &str) -> i64 {
        let text = self.show(item);
        text.parse().unwrap_or_else(|_| panic!("PR {item} printed {text:?}"))
    }

    /// Sends a line that must fail with `error`; reading the error clears it.
    #[track_caller]
    pub(crate) fn refused(&mut self, line: &str, error: i64) {
        assert_eq!(self.show("ER"), "0", "there was an error before {line}");
        self.say(line);
        assert_eq!(self.value("ER"), error, "{line}: the error");
        assert_eq!(self.show("EF"), "0", "reading ER clears EF");
    }

    #[track_caller]
    pub(crate) fn assert_values(&mut self, values: &[(&str, i64)]) {
        for &(item, value) in values {
            assert_eq!(self.value(item), value, "{item}");
        }
    }

    /// Asserts present values, without the time that PR takes.
    #[track_caller]
    pub(crate) fn assert_now(&self, values: &[(&str, i64)]) {
        for &(name, value) in values {
            assert_eq!(self.peek(name), value, "{name}");
        }
    }

    /// Waits until MV is 0.
    #[track_caller]
    pub(crate) fn wait_still(&mut self, most: Duration) -> Duration {
        self.wait(most, 1.millis(), |rig| rig.word(0x004A) == 0)
    }

    /// Waits until no program runs.
    #[track_caller]
    pub(crate) fn wait_end(&mut self, most: Duration) -> Duration {
        self.wait(most, 1.millis(), |rig| rig.peek("BY") == 0)
    }

    /// Reason why the connection of `client` is closed, or `None` while it is open.
    pub(crate) fn ended(&self, client: Client) -> Option<Ended> {
        self.bench.ended(client)
    }
}

/// A whole message: MBAP header and PDU.
pub(crate) fn adu(transaction: u16, unit: u8, pdu: &[u8]) -> Vec<u8> {
    let mut bytes = transaction.to_be_bytes().to_vec();
    bytes.extend([0, 0]);
    bytes.extend((pdu.len() as u16 + 1).to_be_bytes());
    bytes.push(unit);
    bytes.extend(pdu);
    bytes
}

/// A request with a function, an address and a word.
pub(crate) fn request(function: u8, address: u16, word: u16) -> [u8; 5] {
    let ([a, b], [c, d]) = (address.to_be_bytes(), word.to_be_bytes());
    [function, a, b, c, d]
}

/// High and low word of a value.
pub(crate) fn halves(value: i32) -> [u16; 2] {
    let value = value.cast_unsigned();
    [(value >> 16) as u16, value as u16]
}
