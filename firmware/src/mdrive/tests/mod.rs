//! Tests typed from the manuals: registers, the bus, saved values, start-up.

mod bus;
mod hybrid;
mod inputs;
mod io;
mod motion;
mod reasons;
mod registers;
mod saved;
mod specific;
mod startup;

use core::ops::{Deref, DerefMut};
use std::string::String;
use std::vec;
use std::vec::Vec;

use drivetwin_protocol::modbus::tcp::{self, Header};
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::Span;

use super::{MCODE, MEMORY, MODBUS, Mdrive, Reg};
use crate::device::{
    Boot, Device, Duration, Input, Instant, Level, Link, LogEvent, Output, Pin, PresetError,
};
use crate::testing::{Fixture, Treatment};

const CLIENT: Link = Link(0);

/// A drive on a network.
struct Dut {
    fixture: Fixture<Mdrive>,
}

impl Deref for Dut {
    type Target = Fixture<Mdrive>;

    fn deref(&self) -> &Self::Target {
        &self.fixture
    }
}

impl DerefMut for Dut {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.fixture
    }
}

impl Dut {
    /// A drive without power, with this content of its memory.
    fn off(drive: Mdrive, memory: Vec<u8>) -> Self {
        let fixture = Fixture::with_memory(drive, memory).ruled(|output| match output {
            Output::Message { .. } | Output::Log(_) | Output::Level { .. } | Output::Store { .. } => {
                Treatment::Keep
            }
            _ => Treatment::Ignore,
        });
        Self { fixture }
    }

    /// A new drive that is ready at time 0.
    fn ready(drive: Mdrive) -> Self {
        let mut dut = Self::off(drive, vec![0xFF; MEMORY]);
        dut.power_on(true);
        dut
    }

    fn plus() -> Self {
        Self::ready(Mdrive::plus())
    }

    fn hybrid() -> Self {
        Self::ready(Mdrive::hybrid())
    }

    fn power_on(&mut self, fast: bool) {
        self.fixture.power_on(Boot { fast, ..Boot::default() });
        self.wait(Duration::ZERO);
    }

    /// Sends a request, and returns the PDU of the reply, which must come at once.
    fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        let header = Header { transaction: 0x1234, unit: 1 };
        let request = tcp::frame(header, pdu);
        let before = self.out.messages.len();
        self.feed(Input::Message { port: MODBUS, link: CLIENT, bytes: &request });
        let mut said = self.out.messages[before..].iter().filter(|(_, port, ..)| *port == MODBUS);
        let (_, _, link, reply) = said.next().unwrap();
        assert!(said.next().is_none(), "one reply");
        let (answered, pdu) = tcp::parse(reply).unwrap();
        assert_eq!((*link, answered), (CLIENT, header));
        pdu.to_vec()
    }

    /// Reads `words` registers with function 3, as one number.
    fn read(&mut self, address: u8, words: u8) -> i64 {
        let reply = self.ask(&[3, 0, address, 0, words]);
        assert_eq!(reply[..2], [3, 2 * words], "{address:#04x}");
        number(&reply[2..])
    }

    /// Writes with function 16, and returns the reply.
    fn try_write(&mut self, address: u8, words: u8, value: i64) -> Vec<u8> {
        let bytes = value.to_be_bytes();
        let mut pdu = vec![16, 0, address, 0, words, 2 * words];
        pdu.extend_from_slice(&bytes[8 - 2 * usize::from(words)..]);
        self.ask(&pdu)
    }

    /// Writes with function 16, which must be accepted.
    fn write(&mut self, address: u8, words: u8, value: i64) {
        assert_eq!(
            self.try_write(address, words, value),
            [16, 0, address, 0, words],
            "{address:#04x} = {value}"
        );
    }

    /// Number of the last error (ER). Reading it clears EF and ER.
    fn error(&mut self) -> i64 {
        let flag = self.read(0x1F, 1);
        let error = self.read(0x21, 1);
        assert_eq!(flag, i64::from(error != 0));
        assert_eq!((self.read(0x1F, 1), self.read(0x21, 1)), (0, 0), "read");
        error
    }

    /// Sends a request that must be refused with this exception and this error of MCode.
    #[track_caller]
    fn refused(&mut self, pdu: &[u8], exception: u8, error: i64) {
        assert_eq!(self.ask(pdu), [pdu[0] | 0x80, exception], "{pdu:02x?}");
        assert_eq!(self.error(), error, "{pdu:02x?}");
    }

    /// Types text on a connection of MCode. Returns the output up to the execution of the last line.
    fn type_in(&mut self, link: Link, text: &str) -> String {
        let before = self.out.messages.len();
        for line in text.split_inclusive('\r') {
            self.feed(Input::Message { port: MCODE, link, bytes: line.as_bytes() });
            while !self.drive.takes(MCODE) {
                let due = self.drive.deadline();
                self.run_until(due);
            }
        }
        self.mcode_said(before, link)
    }

    /// Output on a connection of MCode, from message `from` on.
    fn mcode_said(&self, from: usize, link: Link) -> String {
        let said = self.out.messages[from..].iter().filter(|(_, port, to, _)| (*port, *to) == (MCODE, link));
        String::from_utf8(said.flat_map(|(.., bytes)| bytes.clone()).collect()).unwrap()
    }

    /// Drives one of IO1 to IO4 high or low.
    fn drive(&mut self, n: u8, high: bool) {
        self.feed(Input::Edge { pin: Pin(n - 1), high });
    }

    fn connect(&mut self, link: Link) {
        self.feed(Input::Opened { port: MCODE, link });
    }
}

/// Joins words, the high one first. Four bytes are a signed number.
fn number(bytes: &[u8]) -> i64 {
    match *bytes {
        [a, b] => u16::from_be_bytes([a, b]).into(),
        [a, b, c, d] => i32::from_be_bytes([a, b, c, d]).into(),
        _ => panic!("{bytes:?}"),
    }
}
