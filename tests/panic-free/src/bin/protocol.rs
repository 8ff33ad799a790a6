//! The protocol: every function that a drive may call, with a small register map.
#![no_std]
#![no_main]

use drivetwin_protocol::line::Line;
use drivetwin_protocol::modbus::pdu::{Exception, Request};
use drivetwin_protocol::modbus::rtu::{self, RtuReceiver, Timing};
use drivetwin_protocol::modbus::server::{RequestHandler, Rules, Values, serve_rtu, serve_serial, serve_tcp};
use drivetwin_protocol::modbus::tcp::{self, Adu, Header, Splitter};
use drivetwin_protocol::modbus::{Expect, Frame, Reply, ascii, identification, scan};
use drivetwin_protocol::registers::{Bank, Register, Space};
use drivetwin_protocol::time::{Duration, Instant};
use panic_free::{opaque, perhaps_panic};

drivetwin_protocol::registers! {
    /// A map with a row for each shape of register.
    enum Reg: LowFirst {
        /// A word with a range, which is also a coil.
        Word = rw(0, "1").range(0, 9).saved().also_coil(),
        /// Two words.
        Pair = rw(1, "2").i32().clamped(-5, 5).live(),
        /// More words.
        Words = rw(3, "3").words(3).optional(),
        /// A bit.
        Coil = coil(1, "4").one_of(&[0, 1]),
    }
}

struct Slave(Bank<Reg, { Reg::WORDS }>);

impl RequestHandler for Slave {
    type Register = Reg;

    fn words(&self) -> &[u16] {
        self.0.words()
    }

    fn words_mut(&mut self) -> &mut [u16] {
        self.0.words_mut()
    }

    fn refresh(&mut self, register: Reg) {
        opaque(register);
    }

    fn written(&mut self, register: Reg) {
        opaque(register);
    }

    fn write_multiple(&mut self, values: &Values<'_, Reg>) -> Option<Result<(), Exception>> {
        opaque(values.get(opaque(Reg::Pair)));
        opaque(None)
    }

    fn is_present(&self, register: Reg) -> bool {
        opaque(register) != opaque(Reg::Words)
    }

    fn custom_function(&mut self, pdu: &[u8], reply: &mut Reply) -> Result<(), Exception> {
        identification::answer(pdu, opaque(0x82), opaque(&[(0, b"")]), reply)
    }
}

/// Entry point for the linker.
#[unsafe(no_mangle)]
extern "C" fn start() -> ! {
    let mut slave = Slave(Bank::factory());
    loop {
        let slave = opaque(&mut slave);
        let bytes: &[u8] = opaque(&[]);
        let at: Instant = opaque(Instant::ZERO);
        serve(slave, bytes);
        map(slave, bytes);
        receive(bytes, at);
        split(bytes);
        time(at);
        perhaps_panic(bytes, opaque(0));
    }
}

fn serve(slave: &mut Slave, bytes: &[u8]) {
    let rules = opaque(Rules {
        functions: opaque(&[3]),
        broadcast: opaque(None),
        max_read: opaque(32),
        max_written: opaque(32),
        bits_per_word: opaque(16),
        partial_writes: opaque(true),
        bad_quantity: opaque(Exception::IllegalDataValue),
        bad_value: opaque(Exception::IllegalDataValue),
        read_only: opaque(Exception::IllegalDataAddress),
    });
    let mut reply: Frame = opaque(Frame::new());
    opaque(serve_rtu(bytes, opaque(1), &rules, slave, &mut reply));
    opaque(serve_serial(bytes, opaque(1), &rules, slave, &mut reply));
    let mut adu: Adu = opaque(Adu::new());
    opaque(serve_tcp(bytes, &rules, slave, &mut adu));
    opaque(Request::parse(bytes));
    opaque(rtu::frame(opaque(1), bytes));
    opaque(rtu::read(opaque(1), opaque(0), opaque(1)));
    opaque(rtu::write(opaque(1), opaque(0), opaque(1)));
    opaque(ascii::decode(bytes));
    opaque(ascii::frame(opaque(1), bytes));
    opaque(ascii::read(opaque(1), opaque(0), opaque(1)));
    opaque(ascii::write(opaque(1), opaque(0), opaque(1)));
    let header = opaque(Header { transaction: 1, unit: 1 });
    opaque(tcp::read(header, opaque(0), opaque(1)));
    opaque(tcp::frame(header, bytes));
}

fn map(slave: &mut Slave, bytes: &[u8]) {
    let bank = &mut slave.0;
    let register: Reg = opaque(Reg::Pair);
    bank.set(register, opaque(0));
    opaque((bank.get(register), bank.clamped_value(register), bank.word(register)));
    let table = opaque(Reg::TABLE);
    opaque(table.readable(opaque(Space::Coil), opaque(0), opaque(1)));
    opaque(table.at(opaque(Space::Coil), opaque(0)));
    opaque(table.value(bank.words(), opaque(0)));
    table.put(bank.words_mut(), opaque(0), opaque(0));
    for row in table.live_rows_at(&opaque(0..1)) {
        opaque(Reg::from_row(row));
    }
    if let Ok(name) = str::from_utf8(bytes) {
        opaque(table.find(name));
    }
    if let Some(row) = table.rows.get(opaque(0)) {
        opaque((row.accepts(opaque(0)), row.clamped_value(opaque(0))));
    }
}

fn receive(bytes: &[u8], at: Instant) {
    let line: Line = opaque(Line::new(9_600, 8, drivetwin_protocol::line::Parity::Even, 1));
    opaque((line.character(), Timing::of(line), scan(line, bytes, opaque(Expect::Both))));
    let mut receiver = opaque(RtuReceiver::new(line));
    receiver.bytes(at, bytes);
    receiver.rx_error(at);
    receiver.set_line(at, line);
    opaque((receiver.deadline(), receiver.is_over(at)));
    opaque(receiver.take());
    receiver.clear();
    let mut receiver = opaque(ascii::AsciiReceiver::new(line));
    receiver.bytes(at, bytes);
    receiver.rx_error(at);
    opaque((receiver.deadline(), receiver.is_over(at)));
    opaque(receiver.take());
    receiver.clear();
}

fn split(mut segment: &[u8]) {
    let mut splitter = opaque(Splitter::new());
    while let Ok(Some(adu)) = splitter.next(&mut segment) {
        opaque(tcp::parse(adu));
    }
    opaque(splitter);
}

fn time(at: Instant) {
    let span: Duration = opaque(Duration::TICK);
    let other: Duration = opaque(Duration::TICK);
    opaque((at + span, at - span, at.since(at), span + other, span - other, span * opaque(2), span / other));
    opaque((Duration::micros(opaque(1)), Duration::millis(opaque(1)), Duration::secs(opaque(1))));
    opaque(Duration::of_bits(opaque(1), opaque(1)));
}
