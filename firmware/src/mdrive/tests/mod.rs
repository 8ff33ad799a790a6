//! What the manuals say of registers, of the bus, of what is saved and of how it starts.

mod bus;
mod hybrid;
mod inputs;
mod io;
mod motion;
mod registers;
mod saved;
mod specific;
mod startup;

use std::string::String;
use std::vec;
use std::vec::Vec;

use drivetwin_protocol::modbus::tcp::{self, Header};
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::Span;

use super::{MCODE, MEMORY, MODBUS, Mdrive, Reg};
use crate::device::{
    Boot, Device, Duration, Fault, Input, Instant, Level, Link, Note, Output, Pin, Port, Refused, Sink,
    advance,
};

const CLIENT: Link = Link(0);

/// What a drive did.
#[derive(Default)]
struct World {
    memory: Vec<u8>,
    /// What it said, and where.
    said: Vec<(Port, Link, Vec<u8>)>,
    notes: Vec<Note>,
    levels: Vec<(Instant, Pin, Level)>,
    stores: Vec<(Instant, u16, Vec<u8>)>,
}

impl Sink for World {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::Message { port, link, bytes } => self.said.push((port, link, bytes.to_vec())),
            Output::Note(note) => self.notes.push(note),
            Output::Level { pin, level } => self.levels.push((at, pin, level)),
            Output::Store { offset, bytes } => {
                let place = usize::from(offset);
                self.stores.push((at, offset, bytes.to_vec()));
                self.memory[place..place + bytes.len()].copy_from_slice(bytes);
            }
            _ => {}
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// A drive, its world, and what time it is.
struct Bed {
    drive: Mdrive,
    world: World,
    now: Instant,
}

impl Bed {
    /// A drive without power, with this memory.
    fn off(drive: Mdrive, memory: Vec<u8>) -> Self {
        Self { drive, world: World { memory, ..World::default() }, now: Instant::ZERO }
    }

    /// A new drive that is ready at 0.
    fn ready(drive: Mdrive) -> Self {
        let mut bed = Self::off(drive, vec![0xFF; MEMORY]);
        bed.power_on(true);
        bed
    }

    fn plus() -> Self {
        Self::ready(Mdrive::plus())
    }

    fn hybrid() -> Self {
        Self::ready(Mdrive::hybrid())
    }

    fn power_on(&mut self, fast: bool) {
        self.drive.power_on(self.now, Boot { fast, ..Boot::default() }, &mut self.world);
        self.run_until(self.now);
    }

    /// Power goes, and comes again 1 s later.
    fn cycle(&mut self) {
        self.now += 1.secs();
        self.power_on(true);
    }

    fn run_until(&mut self, at: impl Into<Instant>) {
        self.now = at.into();
        advance(&mut self.drive, self.now, core::iter::empty(), &mut self.world);
    }

    fn wait(&mut self, span: Duration) {
        self.run_until(self.now + span);
    }

    fn input(&mut self, input: Input<'_>) {
        advance(&mut self.drive, self.now, core::iter::once((self.now, input)), &mut self.world);
    }

    /// A request and the PDU of its reply, at once.
    fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        let header = Header { transaction: 0x1234, unit: 1 };
        let request = tcp::frame(header, pdu);
        let before = self.world.said.len();
        self.input(Input::Message { port: MODBUS, link: CLIENT, bytes: &request });
        let mut said = self.world.said[before..].iter().filter(|(port, ..)| *port == MODBUS);
        let (_, link, reply) = said.next().unwrap();
        assert!(said.next().is_none(), "one reply");
        let (answered, pdu) = tcp::parse(reply).unwrap();
        assert_eq!((*link, answered), (CLIENT, header));
        pdu.to_vec()
    }

    /// Function 3 of a value of so many registers.
    fn read(&mut self, address: u8, words: u8) -> i64 {
        let reply = self.ask(&[3, 0, address, 0, words]);
        assert_eq!(reply[..2], [3, 2 * words], "{address:#04x}");
        number(&reply[2..])
    }

    /// Function 16, and its reply.
    fn try_write(&mut self, address: u8, words: u8, value: i64) -> Vec<u8> {
        let bytes = value.to_be_bytes();
        let mut pdu = vec![16, 0, address, 0, words, 2 * words];
        pdu.extend_from_slice(&bytes[8 - 2 * usize::from(words)..]);
        self.ask(&pdu)
    }

    /// Function 16, which is accepted.
    fn write(&mut self, address: u8, words: u8, value: i64) {
        assert_eq!(
            self.try_write(address, words, value),
            [16, 0, address, 0, words],
            "{address:#04x} = {value}"
        );
    }

    /// EF and ER, which that clears.
    fn error(&mut self) -> i64 {
        let flag = self.read(0x1F, 1);
        let error = self.read(0x21, 1);
        assert_eq!(flag, i64::from(error != 0));
        assert_eq!((self.read(0x1F, 1), self.read(0x21, 1)), (0, 0), "read");
        error
    }

    /// A request that is refused with this exception and this error of MCode.
    #[track_caller]
    fn refused(&mut self, pdu: &[u8], exception: u8, error: i64) {
        assert_eq!(self.ask(pdu), [pdu[0] | 0x80, exception], "{pdu:02x?}");
        assert_eq!(self.error(), error, "{pdu:02x?}");
    }

    /// Types on a connection of MCode; returns what comes back until its last line is executed.
    fn type_in(&mut self, link: Link, text: &str) -> String {
        let before = self.world.said.len();
        for line in text.split_inclusive('\r') {
            self.input(Input::Message { port: MCODE, link, bytes: line.as_bytes() });
            while !self.drive.takes(MCODE) {
                self.run_until(self.drive.deadline());
            }
        }
        self.mcode_said(before, link)
    }

    /// What it said to a connection of MCode.
    fn mcode_said(&self, from: usize, link: Link) -> String {
        let said = self.world.said[from..].iter().filter(|(port, to, _)| (*port, *to) == (MCODE, link));
        String::from_utf8(said.flat_map(|(.., bytes)| bytes.clone()).collect()).unwrap()
    }

    /// IO1 to IO4 driven low, or high.
    fn drive(&mut self, n: u8, high: bool) {
        self.input(Input::Edge { pin: Pin(n - 1), high });
    }

    fn connect(&mut self, link: Link) {
        self.input(Input::Opened { port: MCODE, link });
    }

    fn get(&self, reg: Reg) -> i64 {
        self.drive.peek(self.now, reg.row())
    }

    fn set(&mut self, reg: Reg, value: i64) {
        assert_eq!(self.try_set(reg, value), Ok(()), "{reg:?} = {value}");
    }

    fn try_set(&mut self, reg: Reg, value: i64) -> Result<(), Refused> {
        self.drive.poke(self.now, reg.row(), value, &mut self.world)
    }

    fn fault(&mut self, name: &str, on: bool) {
        let place = self.drive.spec().faults.iter().position(|known| *known == name).unwrap();
        self.input(Input::Fault { fault: Fault(place as u8), on });
    }
}

/// Words, the high one first: four bytes are signed.
fn number(bytes: &[u8]) -> i64 {
    match *bytes {
        [a, b] => u16::from_be_bytes([a, b]).into(),
        [a, b, c, d] => i32::from_be_bytes([a, b, c, d]).into(),
        _ => panic!("{bytes:?}"),
    }
}
