//! The answering half of a slave: a register map and the rules of a manual in, replies out.
//!
//! The checks are in the order of the specification (application, figures 9 to 21): function, structure, address,
//! value, execution, each for the whole request before the next. A refused request changes nothing; a write of several
//! registers is all or nothing (MODBUS-4).

use core::marker::PhantomData;

use super::pdu::{
    EXCEPTION_BIT, Exception, READ_COILS, READ_DISCRETE_INPUTS, READ_INPUT_REGISTERS, Request,
    WRITE_MULTIPLE_COILS, WRITE_SINGLE_COIL,
};
use super::tcp::{self, Adu};
use super::{DropReason, Frame, Reply, rtu};
use crate::registers::{Entries, Register, Shape, Space};

/// Rules of a manual for its bus.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    /// The functions it knows; others are [`Exception::IllegalFunction`].
    pub functions: &'static [u8],
    /// The address that every slave obeys and none answers (MODBUS-3).
    pub broadcast: Option<u8>,
    /// Words that one read may cover.
    pub max_read: u16,
    /// Words that one write may cover.
    pub max_written: u16,
    /// Bits that a read or a write may cover for each word: 16, which take the same room, unless a manual specifies
    /// another number.
    pub bits_per_word: u16,
    /// True if a write may bring a part of a value of several words.
    pub partial_writes: bool,
    /// For a quantity of 0 or beyond the most, one that is not that of an object, a part of a value where that
    /// cannot be written, a byte count that does not match, and a coil's value that is neither on nor off.
    pub bad_quantity: Exception,
    /// For a value outside the range of its row.
    pub bad_value: Exception,
    /// For a write to what can only be read.
    pub read_only: Exception,
}

/// A drive as its bus sees it: for the time of one request.
pub trait RequestHandler {
    /// Registers of the map.
    type Register: Register;

    /// The words of its bank.
    fn words(&self) -> &[u16];

    /// The words of its bank, to be written.
    fn words_mut(&mut self) -> &mut [u16];

    /// Brings a live register up to date, before it is read.
    fn refresh(&mut self, register: Self::Register);

    /// Carries out a write: the register, or a half of it, has a new value in the bank.
    fn written(&mut self, register: Self::Register);

    /// The register map for the bus; variants of a product may return one with other limits.
    fn entries(&self) -> &'static Entries {
        Self::Register::ENTRIES
    }

    /// Checks that a value that its row accepts may be written now.
    ///
    /// # Errors
    /// The exception that refuses it.
    fn validate(&self, _register: Self::Register, _value: i64) -> Result<(), Exception> {
        Ok(())
    }

    /// Carries out all that a write brings, where its values are judged together or make others than they are: its
    /// rows accept each, [`validate`](Self::validate) too. Nothing is stored by the server then, and
    /// [`written`](Self::written) is not called; `None` leaves both to the server.
    ///
    /// # Errors
    /// The exception that refuses it; nothing has changed then.
    fn write_multiple(&mut self, _values: &Values<'_, Self::Register>) -> Option<Result<(), Exception>> {
        None
    }

    /// A value outside the range of its row was refused.
    fn on_out_of_range(&mut self, _register: Self::Register, _value: i64) {}

    /// Returns whether a register is present now, of those that only some variants have or that are optional; one that
    /// is not is [`Exception::IllegalDataAddress`].
    fn is_present(&self, _register: Self::Register) -> bool {
        true
    }

    /// Carries out a request whose function the [`Rules`] list and this server does not implement. Appends the reply's
    /// PDU to `reply`: its function code first, at most 253 bytes.
    ///
    /// # Errors
    /// The exception that refuses it; bytes already appended to `reply` are dropped then.
    fn custom_function(&mut self, _pdu: &[u8], _reply: &mut Reply) -> Result<(), Exception> {
        Err(Exception::IllegalFunction)
    }
}

/// Values of a write request, for [`RequestHandler::write_multiple`].
#[derive(Debug)]
pub struct Values<'a, R> {
    entries: &'static Entries,
    space: Space,
    first: u16,
    count: u16,
    /// As functions 15 and 16 bring them: bits of coils from the lowest one up, words with the high byte first.
    bytes: &'a [u8],
    registers: PhantomData<R>,
}

impl<R: Register> Values<'_, R> {
    /// The registers that it brings whole and their values, in the order of their addresses.
    pub fn iter(&self) -> impl Iterator<Item = (R, i64)> + '_ {
        self.spans().flatten().filter_map(|span| {
            let shape = self.entries.list.get(span.row)?.shape;
            let value = (span.words == shape.words()).then(|| self.value(&span, shape))?;
            Some((R::from_row(span.row)?, value))
        })
    }

    /// The value that the request writes to a register; `None` if it writes none, or a part of it.
    #[must_use]
    pub fn get(&self, register: R) -> Option<i64> {
        self.iter().find_map(|(brought, value)| (brought.row() == register.row()).then_some(value))
    }

    /// The spans of the request, one for each row it touches.
    fn spans(&self) -> Spans {
        Spans { entries: self.entries, space: self.space, address: self.first, left: self.count, offset: 0 }
    }

    fn value(&self, span: &Span, shape: Shape) -> i64 {
        self.entries.assemble(shape, |n| self.word(span.offset + n))
    }

    fn word(&self, n: usize) -> u16 {
        match self.space {
            Space::Coil => self.bytes.get(n / 8).map_or(0, |byte| u16::from(byte >> (n % 8) & 1)),
            _ => {
                let word = self.bytes.get(2 * n..).and_then(<[u8]>::first_chunk);
                word.map_or(0, |&word| u16::from_be_bytes(word))
            }
        }
    }
}

/// Outcome of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Outcome {
    /// Carried out, or refused; `reply` holds the answer unless it was a broadcast.
    Served {
        /// The address it was for.
        unit: u8,
        /// Function code.
        function: u8,
        /// Exception that refused it.
        refused: Option<Exception>,
    },
    /// Ignored.
    Dropped(DropReason),
}

/// Carries out one RTU frame for the slave `unit`. `reply` then holds the reply; it is empty after a broadcast and
/// after a dropped frame.
///
/// ```
/// use drivetwin_protocol::modbus::pdu::Exception;
/// use drivetwin_protocol::modbus::server::{Outcome, RequestHandler, Rules, serve_rtu};
/// use drivetwin_protocol::modbus::{Frame, rtu};
/// use drivetwin_protocol::registers::Bank;
///
/// drivetwin_protocol::registers! {
///     /// Registers of a heater.
///     pub enum Reg: HighFirst {
///         /// Target in 0.1 °C.
///         Target = rw(0x10, "1.1").range(0, 900).reset(200),
///         /// Temperature in 0.1 °C.
///         Temperature = ro(0x11, "1.2").live(),
///     }
/// }
///
/// struct Heater {
///     bank: Bank<Reg, { Reg::WORDS }>,
/// }
///
/// impl RequestHandler for Heater {
///     type Register = Reg;
///
///     fn words(&self) -> &[u16] {
///         self.bank.words()
///     }
///
///     fn words_mut(&mut self) -> &mut [u16] {
///         self.bank.words_mut()
///     }
///
///     fn refresh(&mut self, register: Reg) {
///         assert_eq!(register, Reg::Temperature);
///         self.bank.set(Reg::Temperature, 215);
///     }
///
///     fn written(&mut self, _register: Reg) {}
/// }
///
/// const RULES: Rules = Rules {
///     functions: &[3, 6],
///     broadcast: Some(0),
///     max_read: 16,
///     max_written: 1,
///     bits_per_word: 16,
///     partial_writes: false,
///     bad_quantity: Exception::IllegalDataValue,
///     bad_value: Exception::IllegalDataValue,
///     read_only: Exception::IllegalDataAddress,
/// };
///
/// # fn main() {
/// let mut heater = Heater { bank: Bank::factory() };
/// let mut reply = Frame::new();
/// // Slave 1: read both registers. 200 is 0x00C8, 215 is 0x00D7.
/// let outcome = serve_rtu(&rtu::read(1, 0x10, 2), 1, &RULES, &mut heater, &mut reply);
/// assert_eq!(outcome, Outcome::Served { unit: 1, function: 3, refused: None });
/// assert_eq!(reply, rtu::frame(1, &[3, 4, 0x00, 0xC8, 0x00, 0xD7]));
/// // 1,000 is out of range: exception 3, and the register keeps its value.
/// serve_rtu(&rtu::write(1, 0x10, 1_000), 1, &RULES, &mut heater, &mut reply);
/// assert_eq!(reply, rtu::frame(1, &[0x86, 3]));
/// assert_eq!(heater.bank.get(Reg::Target), 200);
/// # }
/// ```
pub fn serve_rtu<M: RequestHandler>(
    frame: &[u8],
    unit: u8,
    rules: &Rules,
    handler: &mut M,
    reply: &mut Frame,
) -> Outcome {
    reply.clear();
    let Some(body) = rtu::verify_crc(frame) else { return Outcome::Dropped(DropReason::Crc) };
    let outcome = serve_serial(body, unit, rules, handler, reply);
    if !reply.is_empty() {
        rtu::append_crc(reply);
    }
    outcome
}

/// Carries out the body of a serial frame, an address and a PDU, for the slave `unit`. `reply` then holds the body of
/// the reply; it is empty after a broadcast and after a dropped frame (MODBUS-2).
pub fn serve_serial<M: RequestHandler>(
    body: &[u8],
    unit: u8,
    rules: &Rules,
    handler: &mut M,
    reply: &mut Frame,
) -> Outcome {
    reply.clear();
    let Some((&address, pdu)) = body.split_first() else { return Outcome::Dropped(DropReason::Length) };
    let broadcast = rules.broadcast == Some(address);
    if address != unit && !broadcast {
        return Outcome::Dropped(DropReason::Address);
    }
    let Some(&function) = pdu.first() else { return Outcome::Dropped(DropReason::Length) };
    let _ = reply.push(address);
    let refused = match serve(pdu, rules, handler, reply) {
        Ok(()) => None,
        Err(Refusal::Drop(why)) => {
            reply.clear();
            return Outcome::Dropped(why);
        }
        Err(Refusal::Exception(exception)) => {
            refuse(function, exception, 1, reply);
            Some(exception)
        }
    };
    if broadcast {
        reply.clear();
    }
    Outcome::Served { unit: address, function, refused }
}

/// Carries out a whole ADU of a connection, whatever its unit, and leaves the reply in `reply`, which stays empty only
/// if `adu` is not an ADU. A client waits for its reply: a length that a serial line would drop is refused with the
/// rules' `bad_quantity`, and there is no broadcast (MDRIVE-5).
pub fn serve_tcp<M: RequestHandler>(adu: &[u8], rules: &Rules, handler: &mut M, reply: &mut Adu) -> Outcome {
    reply.clear();
    let Some((header, pdu @ &[function, ..])) = tcp::parse(adu) else {
        return Outcome::Dropped(DropReason::Length);
    };
    tcp::begin(reply, header);
    let refused = serve(pdu, rules, handler, reply).err().map(|refusal| match refusal {
        Refusal::Exception(exception) => exception,
        Refusal::Drop(_) => rules.bad_quantity,
    });
    if let Some(exception) = refused {
        refuse(function, exception, tcp::HEADER_BYTES, reply);
    }
    tcp::set_length(reply);
    Outcome::Served { unit: header.unit, function, refused }
}

/// Refuses a whole ADU of a connection, whatever its request, and leaves the exception in `reply`, which stays empty
/// only if `adu` is not an ADU.
pub fn refuse_tcp(adu: &[u8], exception: Exception, reply: &mut Adu) -> Outcome {
    reply.clear();
    let Some((header, &[function, ..])) = tcp::parse(adu) else {
        return Outcome::Dropped(DropReason::Length);
    };
    tcp::begin(reply, header);
    refuse(function, exception, tcp::HEADER_BYTES, reply);
    tcp::set_length(reply);
    Outcome::Served { unit: header.unit, function, refused: Some(exception) }
}

/// Puts an exception in place of all that is behind the first `head` bytes of `reply`.
fn refuse(function: u8, exception: Exception, head: usize, reply: &mut Reply) {
    reply.truncate(head);
    let _ = reply.extend_from_slice(&[function | EXCEPTION_BIT, exception.code()]);
}

/// Reason why a request has no normal reply.
enum Refusal {
    Exception(Exception),
    Drop(DropReason),
}

impl From<Exception> for Refusal {
    fn from(exception: Exception) -> Self {
        Self::Exception(exception)
    }
}

/// Carries out a request and appends the reply's PDU to `reply`.
fn serve<M: RequestHandler>(
    pdu: &[u8],
    rules: &Rules,
    handler: &mut M,
    reply: &mut Reply,
) -> Result<(), Refusal> {
    if !pdu.first().is_some_and(|function| rules.functions.contains(function)) {
        return Err(Exception::IllegalFunction.into());
    }
    match Request::parse(pdu).ok_or(Refusal::Drop(DropReason::Length))? {
        Request::Read { function, first, count } => read(function, first, count, rules, handler, reply)?,
        Request::WriteSingle { function, address, value } => {
            let (space, bytes) = match (function, value) {
                (WRITE_SINGLE_COIL, 0xFF00) => (Space::Coil, [1, 0]),
                (WRITE_SINGLE_COIL, 0x0000) => (Space::Coil, [0, 0]),
                (WRITE_SINGLE_COIL, _) => return Err(rules.bad_quantity.into()),
                _ => (Space::Holding, value.to_be_bytes()),
            };
            write(space, address, 1, &bytes, rules, handler)?;
            let _ = reply.extend_from_slice(pdu);
        }
        Request::WriteMultiple { function, first, count, values, bytes } => {
            let coils = function == WRITE_MULTIPLE_COILS;
            let expected = if coils { usize::from(count).div_ceil(8) } else { 2 * usize::from(count) };
            if values.len() != usize::from(bytes) {
                return Err(Refusal::Drop(DropReason::Length));
            }
            let most =
                if coils { rules.max_written.saturating_mul(rules.bits_per_word) } else { rules.max_written };
            if count == 0 || count > most || values.len() != expected {
                return Err(rules.bad_quantity.into());
            }
            let space = if coils { Space::Coil } else { Space::Holding };
            write(space, first, count, values, rules, handler)?;
            let _ = reply.extend_from_slice(pdu.get(..5).unwrap_or(pdu));
        }
        Request::Other { .. } => handler.custom_function(pdu, reply)?,
    }
    Ok(())
}

/// Functions 1 to 4.
fn read<M: RequestHandler>(
    function: u8,
    first: u16,
    count: u16,
    rules: &Rules,
    handler: &mut M,
    reply: &mut Reply,
) -> Result<(), Exception> {
    let bits = matches!(function, READ_COILS | READ_DISCRETE_INPUTS);
    let most = if bits { rules.max_read.saturating_mul(rules.bits_per_word) } else { rules.max_read };
    if count == 0 || count > most {
        return Err(rules.bad_quantity);
    }
    let space = match function {
        READ_COILS => Space::Coil,
        READ_DISCRETE_INPUTS => Space::Discrete,
        READ_INPUT_REGISTERS => Space::Input,
        _ => Space::Holding,
    };
    let entries = handler.entries();
    let range = entries.readable(space, first, count).ok_or_else(|| {
        // Of an object that can be read only the quantity is wrong.
        let row = entries.at(space, first).and_then(|(row, _)| entries.list.get(row));
        let object = row.is_some_and(|row| entries.layout.objects && row.access.reads());
        if object { rules.bad_quantity } else { Exception::IllegalDataAddress }
    })?;
    if entries.has_conditional() && !all_present(entries.conditional_rows_at(&range), handler) {
        return Err(Exception::IllegalDataAddress);
    }
    if entries.has_live() {
        for row in entries.live_rows_at(&range) {
            if let Some(register) = M::Register::from_row(row) {
                handler.refresh(register);
            }
        }
    }
    let words = handler.words().get(range).unwrap_or(&[]);
    let packed = matches!(space, Space::Coil | Space::Discrete);
    let bytes = if packed { words.len().div_ceil(8) } else { 2 * words.len() };
    let _ = reply.extend_from_slice(&[function, (bytes & 0xFF) as u8]);
    let head = reply.len();
    let _ = reply.resize_default(head + bytes);
    let Some(data) = reply.get_mut(head..) else { return Ok(()) };
    if packed {
        for (byte, bits) in data.iter_mut().zip(words.chunks(8)) {
            *byte = bits.iter().rev().fold(0, |byte, &bit| byte << 1 | u8::from(bit != 0));
        }
    } else {
        for (bytes, word) in data.chunks_exact_mut(2).zip(words) {
            bytes.copy_from_slice(&word.to_be_bytes());
        }
    }
    Ok(())
}

/// Returns whether the drive has each of these rows now.
fn all_present<M: RequestHandler>(mut rows: impl Iterator<Item = usize>, handler: &M) -> bool {
    rows.all(|row| M::Register::from_row(row).is_some_and(|register| handler.is_present(register)))
}

/// Functions 5, 6, 15 and 16: checks all addresses, then all values, then whether they may be written now; then stores
/// everything and calls `written` for each register, unless the drive handles the whole write itself.
fn write<M: RequestHandler>(
    space: Space,
    first: u16,
    count: u16,
    bytes: &[u8],
    rules: &Rules,
    handler: &mut M,
) -> Result<(), Exception> {
    let entries = handler.entries();
    let values = Values { entries, space, first, count, bytes, registers: PhantomData };
    let whole = entries.layout.objects || !rules.partial_writes;
    let mut quantity = Ok(());
    for span in values.spans() {
        let span = span?;
        let row = entries.list.get(span.row).ok_or(Exception::IllegalDataAddress)?;
        if row.is_conditional() && !all_present(core::iter::once(span.row), handler) {
            return Err(Exception::IllegalDataAddress);
        }
        if !row.access.writes() {
            return Err(rules.read_only);
        }
        if whole && span.words != row.shape.words() {
            quantity = Err(rules.bad_quantity);
        }
    }
    quantity?;
    let mut permitted = Ok(());
    for span in values.spans().flatten() {
        let row = entries.list.get(span.row).ok_or(Exception::IllegalDataAddress)?;
        // Halves are judged when the value is used (MODBUS-6).
        if span.words != row.shape.words() {
            continue;
        }
        let value = values.value(&span, row.shape);
        let register = M::Register::from_row(span.row).ok_or(Exception::IllegalDataAddress)?;
        if !row.accepts(value) {
            handler.on_out_of_range(register, value);
            return Err(rules.bad_value);
        }
        permitted = permitted.and_then(|()| handler.validate(register, value));
    }
    permitted?;
    if let Some(done) = handler.write_multiple(&values) {
        return done;
    }
    for span in values.spans().flatten() {
        let place = entries.offset(span.row) + usize::from(span.first);
        let words = handler.words_mut().get_mut(place..).unwrap_or(&mut []);
        for (n, target) in words.iter_mut().take(usize::from(span.words)).enumerate() {
            *target = values.word(span.offset + n);
        }
    }
    for span in values.spans().flatten() {
        if let Some(register) = M::Register::from_row(span.row) {
            handler.written(register);
        }
    }
    Ok(())
}

/// Part of a write for one row.
struct Span {
    row: usize,
    /// The first word of the row that it brings, in bus order.
    first: u16,
    /// Number of words.
    words: u16,
    /// Offset in the request at which they begin, in words.
    offset: usize,
}

/// The parts of a write, one for each row it touches.
struct Spans {
    entries: &'static Entries,
    space: Space,
    address: u16,
    left: u16,
    offset: usize,
}

impl Iterator for Spans {
    type Item = Result<Span, Exception>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.left == 0 {
            return None;
        }
        let Some((row, first)) = self.entries.at(self.space, self.address) else {
            self.left = 0;
            return Some(Err(Exception::IllegalDataAddress));
        };
        let room = self.entries.list.get(row).map_or(1, |row| row.shape.words()).saturating_sub(first);
        // Of an object the whole quantity is meant for this row, be it right or wrong.
        let words = if self.entries.layout.objects { self.left } else { room.min(self.left) };
        let span = Span { row, first, words, offset: self.offset };
        self.offset += usize::from(words);
        self.left -= words;
        self.address = self.address.wrapping_add(words);
        // Past the last address there is nothing, not address 0.
        if self.left > 0 && self.address < words {
            self.left = 0;
            return Some(Err(Exception::IllegalDataAddress));
        }
        Some(Ok(span))
    }
}
