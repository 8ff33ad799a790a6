//! Server of a slave: answers requests from a register map and the rules of a manual.
//!
//! The server checks a request in the order of the specification (application, figures 9 to 21): function,
//! structure, address, value, execution. Each check covers the whole request before the next check begins. A
//! refused request changes nothing. A write of several registers is all or nothing (MODBUS-4).

use core::marker::PhantomData;

use super::pdu::{
    EXCEPTION_BIT, Exception, READ_COILS, READ_DISCRETE_INPUTS, READ_INPUT_REGISTERS, Request,
    WRITE_MULTIPLE_COILS, WRITE_SINGLE_COIL,
};
use super::tcp::{self, Adu};
use super::{DropReason, Frame, Reply, rtu};
use crate::registers::{Entries, Register, Shape, Space};

/// Rules that a manual states for its bus.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    /// Functions that the drive knows; other functions get [`Exception::IllegalFunction`].
    pub functions: &'static [u8],
    /// The address that every slave obeys and no slave answers (MODBUS-3).
    pub broadcast: Option<u8>,
    /// The most words in one read.
    pub max_read: u16,
    /// The most words in one write.
    pub max_written: u16,
    /// Number of bits that count as one word in `max_read` and `max_written`. Usually 16, because 16 bits
    /// have the size of a word. A manual may specify another number.
    pub bits_per_word: u16,
    /// True if a write may change only some of the words of a value.
    pub partial_writes: bool,
    /// Exception for a wrong quantity or byte count:
    /// - a quantity of 0, above the limit, or not that of the object;
    /// - a write of a part of a value that must be written whole;
    /// - a byte count that does not match the quantity;
    /// - a coil value that is neither on nor off.
    pub bad_quantity: Exception,
    /// Exception for a value outside the range of its row.
    pub bad_value: Exception,
    /// Exception for a write to a register that can only be read.
    pub read_only: Exception,
}

/// A drive as the server uses it while it serves one request.
pub trait RequestHandler {
    /// Registers of the drive's map.
    type Register: Register;

    /// The words of the drive's bank.
    fn words(&self) -> &[u16];

    /// The words of the drive's bank, writable.
    fn words_mut(&mut self) -> &mut [u16];

    /// Updates a live register in the bank, before it is read.
    fn refresh(&mut self, register: Self::Register);

    /// Executes a write. The bank already has the new value of the register, or of a part of it.
    fn written(&mut self, register: Self::Register);

    /// The register map that the bus uses. Variants of a product may return a map with other limits.
    fn entries(&self) -> &'static Entries {
        Self::Register::ENTRIES
    }

    /// Checks that `value` may be written now. Its row has already accepted it.
    ///
    /// # Errors
    /// The exception with which the server refuses the request.
    fn validate(&self, _register: Self::Register, _value: i64) -> Result<(), Exception> {
        Ok(())
    }

    /// Executes a whole write request. A drive implements this if it must check the values together, or if it
    /// stores other values than the request has. Before this call the rows and [`validate`](Self::validate)
    /// have accepted each value. If the drive returns `Some`, the server stores nothing and does not call
    /// [`written`](Self::written). If the drive returns `None`, the server does both.
    ///
    /// # Errors
    /// The exception with which the server refuses the request; then nothing has changed.
    fn write_multiple(&mut self, _values: &Values<'_, Self::Register>) -> Option<Result<(), Exception>> {
        None
    }

    /// Called after a value outside the range of its row was refused.
    fn on_out_of_range(&mut self, _register: Self::Register, _value: i64) {}

    /// Returns true if the drive has `register` now. Only registers that are optional, or that only some
    /// variants have, may be missing. A missing register gets [`Exception::IllegalDataAddress`].
    fn is_present(&self, _register: Self::Register) -> bool {
        true
    }

    /// Executes a request whose function is in the [`Rules`] and not implemented by this server. Appends the
    /// PDU of the reply to `reply`: first the function code, at most 253 bytes in all.
    ///
    /// # Errors
    /// The exception with which the server refuses the request. The server then removes the bytes that were
    /// already appended to `reply`.
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
    /// Values in the form of functions 15 and 16: coils as bits, lowest bit first; words with the high byte
    /// first.
    bytes: &'a [u8],
    registers: PhantomData<R>,
}

impl<R: Register> Values<'_, R> {
    /// The registers that the request writes as a whole, and their values, in the order of their addresses.
    pub fn iter(&self) -> impl Iterator<Item = (R, i64)> + '_ {
        self.spans().flatten().filter_map(|span| {
            let shape = self.entries.list.get(span.row)?.shape;
            let value = (span.words == shape.words()).then(|| self.value(&span, shape))?;
            Some((R::from_row(span.row)?, value))
        })
    }

    /// The value that the request writes to `register`; `None` if it writes none, or only a part of the
    /// register.
    #[must_use]
    pub fn get(&self, register: R) -> Option<i64> {
        self.iter().find_map(|(brought, value)| (brought.row() == register.row()).then_some(value))
    }

    /// The spans of the request, one for each row that it writes.
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

/// Result of serving a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Outcome {
    /// The request was executed or refused. `reply` has the answer, unless the request was a broadcast.
    Served {
        /// The address in the request.
        unit: u8,
        /// Function code.
        function: u8,
        /// Exception of a refused request.
        refused: Option<Exception>,
    },
    /// The frame was ignored.
    Dropped(DropReason),
}

/// Serves one RTU frame for the slave `unit` and writes the reply into `reply`. `reply` is empty after a
/// broadcast and after a dropped frame.
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

/// Serves the body of a serial frame, an address and a PDU, for the slave `unit`. Writes the body of the
/// reply into `reply`, which is empty after a broadcast and after a dropped frame (MODBUS-2).
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

/// Serves a whole ADU of a connection, for any unit, and writes the reply into `reply`. `reply` is empty only
/// if `adu` is not an ADU. A client always waits for its reply. So a request of a wrong length, which a
/// serial line would drop, is refused with the rules' `bad_quantity`, and there is no broadcast (MDRIVE-5).
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

/// Refuses a whole ADU of a connection, for any request, and writes the exception into `reply`. `reply` is
/// empty only if `adu` is not an ADU.
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

/// Replaces everything after the first `head` bytes of `reply` by an exception.
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

/// Executes a request and appends the PDU of the reply to `reply`.
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

/// Serves functions 1 to 4.
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
        // If a readable object has this address, only the quantity is wrong.
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

/// Returns true if the drive has all these rows now.
fn all_present<M: RequestHandler>(mut rows: impl Iterator<Item = usize>, handler: &M) -> bool {
    rows.all(|row| M::Register::from_row(row).is_some_and(|register| handler.is_present(register)))
}

/// Serves functions 5, 6, 15 and 16. Checks all addresses, then all values, then whether each may be written
/// now. Then stores all values and calls `written` for each register, unless the drive executes the whole
/// write itself.
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
        // A part of a value is checked later, when the drive uses the value (MODBUS-6).
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

/// Part of a write request that goes to one row.
struct Span {
    row: usize,
    /// First word of the row that the request writes, in bus order.
    first: u16,
    /// Number of words.
    words: u16,
    /// Word of the request at which this part begins.
    offset: usize,
}

/// Iterator over the parts of a write request, one for each row.
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
        // In a map of objects the whole quantity is meant for this row. The caller checks if the row has this
        // number of words.
        let words = if self.entries.layout.objects { self.left } else { room.min(self.left) };
        let span = Span { row, first, words, offset: self.offset };
        self.offset += usize::from(words);
        self.left -= words;
        self.address = self.address.wrapping_add(words);
        // Addresses end at 65,535; they do not continue at 0.
        if self.left > 0 && self.address < words {
            self.left = 0;
            return Some(Err(Exception::IllegalDataAddress));
        }
        Some(Ok(span))
    }
}
