//! Modbus requests and answers over a register map.

use drivetwin_firmware::device::{Framing, Spec};
use drivetwin_protocol::modbus::pdu::{
    self, ENCAPSULATED_INTERFACE, EXCEPTION_BIT, READ_COILS, READ_DISCRETE_INPUTS, READ_INPUT_REGISTERS,
    WRITE_MULTIPLE_COILS, WRITE_SINGLE_COIL,
};
use drivetwin_protocol::modbus::server::Rules;
use drivetwin_protocol::registers::{Legal, Order, Row, Shape, Space};

use super::{Message, Register, Request, bytes};
use crate::value::Value;

/// Maximum number of registers that a text lists.
const FEW: usize = 6;

/// The largest quantity of a request (application 6.1). A larger one is not taken apart.
const LARGEST: u16 = 2_000;

/// A part of a request: words of one row, or addresses without a row.
struct Part {
    address: u16,
    row: Option<(usize, &'static Row)>,
    /// First word of the row, in bus order.
    word: u16,
    /// Number of words, or of addresses.
    count: u16,
    /// First word of the request's data.
    offset: usize,
}

impl Part {
    fn is_whole(&self) -> bool {
        self.row.is_some_and(|(_, row)| row.shape.words() == self.count)
    }
}

/// Space, first address, quantity and, if it writes, the data of a request.
struct Access<'a> {
    space: Space,
    first: u16,
    count: u16,
    data: Option<Data<'a>>,
}

/// Words of a request or an answer.
#[derive(Clone, Copy)]
enum Data<'a> {
    Word(u16),
    Words(&'a [u8]),
    Bits(&'a [u8]),
}

impl Data<'_> {
    fn word(&self, n: usize) -> Option<u16> {
        match *self {
            Self::Word(word) => (n == 0).then_some(word),
            Self::Words(bytes) => bytes.get(2 * n..)?.first_chunk().map(|&word| u16::from_be_bytes(word)),
            Self::Bits(bytes) => bytes.get(n / 8).map(|byte| u16::from(byte >> (n % 8) & 1)),
        }
    }
}

impl<'a> Access<'a> {
    /// The access of a request; `None` for other functions.
    fn of(request: pdu::Request<'a>) -> Option<Self> {
        Some(match request {
            pdu::Request::Read { function, first, count } => {
                let space = match function {
                    READ_COILS => Space::Coil,
                    READ_DISCRETE_INPUTS => Space::Discrete,
                    READ_INPUT_REGISTERS => Space::Input,
                    _ => Space::Holding,
                };
                Self { space, first, count, data: None }
            }
            pdu::Request::WriteSingle { function: WRITE_SINGLE_COIL, address, value } => {
                let data = Some(Data::Word(u16::from(value == 0xFF00)));
                Self { space: Space::Coil, first: address, count: 1, data }
            }
            pdu::Request::WriteSingle { address, value, .. } => {
                Self { space: Space::Holding, first: address, count: 1, data: Some(Data::Word(value)) }
            }
            pdu::Request::WriteMultiple { function: WRITE_MULTIPLE_COILS, first, count, values, .. } => {
                Self { space: Space::Coil, first, count, data: Some(Data::Bits(values)) }
            }
            pdu::Request::WriteMultiple { first, count, values, .. } => {
                Self { space: Space::Holding, first, count, data: Some(Data::Words(values)) }
            }
            pdu::Request::Other { .. } => return None,
        })
    }

    /// The parts of the access, in the order of their addresses.
    fn parts(&self, spec: &Spec) -> Vec<Part> {
        let mut parts: Vec<Part> = Vec::new();
        let count = self.count.min(LARGEST);
        let mut done = 0;
        while done < count {
            let Some(address) = self.first.checked_add(done) else { break };
            let row = row(spec, self.space, address);
            let (row, word, words) = match row {
                Some((index, row, _)) if spec.registers.layout.objects => {
                    (Some((index, row)), 0, count - done)
                }
                Some((index, row, word)) => {
                    (Some((index, row)), word, (row.shape.words() - word).min(count - done))
                }
                None => (None, 0, 1),
            };
            match parts.last_mut() {
                Some(last) if row.is_none() && last.row.is_none() => last.count += 1,
                _ => parts.push(Part { address, row, word, count: words, offset: done.into() }),
            }
            done += words.max(1);
        }
        parts
    }

    fn has_bits(&self) -> bool {
        matches!(self.space, Space::Coil | Space::Discrete)
    }

    /// The largest quantity that rules allow for such an access.
    fn most(&self, rules: &Rules) -> u16 {
        let words = if self.data.is_some() { rules.max_written } else { rules.max_read };
        if self.has_bits() { words.saturating_mul(rules.bits_per_word) } else { words }
    }

    fn way_and_unit(&self) -> (&'static str, &'static str) {
        let way = if self.data.is_some() { "writes" } else { "reads" };
        (way, if self.has_bits() { "bits" } else { "registers" })
    }

    /// The registers of the access, with values from `data`.
    fn registers(&self, spec: &Spec, data: Option<&Data<'_>>) -> Vec<Register> {
        let written = self.data.is_some();
        let parts = self.parts(spec);
        let registers = parts.iter().filter_map(|part| {
            let (row, _) = part.row?;
            let value = data.and_then(|data| value(spec, part, data));
            Some(Register { row, name: name(spec, part, self.space), value, written })
        });
        registers.collect()
    }
}

/// The row at an address, if this variant has it, and the word of the row.
fn row(spec: &Spec, space: Space, address: u16) -> Option<(usize, &'static Row, u16)> {
    let (index, word) = spec.registers.at(space, address)?;
    let row = spec.registers.rows.get(index)?;
    (row.variants & spec.variant != 0).then_some((index, row, word))
}

/// An address as the manual writes it.
fn address(spec: &Spec, address: u16) -> String {
    if spec.decimal { address.to_string() } else { format!("0x{address:04X}") }
}

/// Name of a part, or its addresses; of coils and inputs with the kind, so that they do not read as registers.
fn name(spec: &Spec, part: &Part, space: Space) -> String {
    let Some((_, row)) = part.row else {
        let last = part.address.saturating_add(part.count - 1);
        let (several, addresses) = match part.count {
            1 => ("", address(spec, part.address)),
            _ => ("s", format!("{} to {}", address(spec, part.address), address(spec, last))),
        };
        return match space {
            Space::Coil | Space::Discrete | Space::Input => format!("{}{several} {addresses}", kind(space)),
            Space::Holding | Space::Variable | Space::Setting => addresses,
        };
    };
    if part.is_whole() || spec.registers.layout.objects {
        return row.name.to_owned();
    }
    match row.shape {
        Shape::U32 | Shape::I32 => {
            let high = (spec.registers.layout.order == Order::HighFirst) == (part.word == 0);
            format!("{}{}", row.name, if high { "High" } else { "Low" })
        }
        _ if part.count == 1 => format!("{}[{}]", row.name, part.word),
        _ => format!("{}[{} to {}]", row.name, part.word, part.word + part.count - 1),
    }
}

/// Value of a part; `None` if the data is too short.
fn value(spec: &Spec, part: &Part, data: &Data<'_>) -> Option<Value> {
    let (_, row) = part.row?;
    let words: Vec<u16> =
        (0..usize::from(part.count)).map(|n| data.word(part.offset + n)).collect::<Option<_>>()?;
    let word = |n: usize| words.get(n).copied().unwrap_or(0);
    if part.is_whole() {
        let number = spec.registers.assemble(row.shape, word);
        return Some(Value::with_words(row.shape, number, word));
    }
    Some(match words.as_slice() {
        [one] => Value::Number((*one).into()),
        words => Value::Words(words.iter().map(|&word| word.into()).collect()),
    })
}

/// A request as text and as fields.
pub(super) fn request(spec: &Spec, pdu: &[u8]) -> Request {
    let function = pdu.first().copied();
    let Some(parsed) = pdu::Request::parse(pdu) else {
        let text = format!(
            "function {}, {}",
            number(function.unwrap_or(0)),
            bytes(pdu.get(1..).unwrap_or_default())
        );
        return Request { text, function, ..Request::default() };
    };
    let Some(access) = Access::of(parsed) else {
        return Request { text: other(pdu), function, ..Request::default() };
    };
    let data = access.data;
    let registers = access.registers(spec, data.as_ref());
    let text = match data {
        None => format!("read {}", names(spec, &access)),
        // Neither on nor off.
        Some(Data::Word(0))
            if !matches!(pdu, [WRITE_SINGLE_COIL, _, _, 0, 0]) && function == Some(WRITE_SINGLE_COIL) =>
        {
            let value = pdu
                .get(3..5)
                .and_then(|value| value.first_chunk())
                .map_or(0, |value| u16::from_be_bytes(*value));
            format!("write {} = 0x{value:04X}", names(spec, &access))
        }
        Some(data) => format!("write {}", values(spec, &access, &data)),
    };
    Request { text, address: None, function, registers }
}

/// Returns true if a request reads, and is for all drives of a line.
pub(super) fn is_read_of_all(message: &Message<'_>) -> bool {
    if message.framing != Framing::Silence || message.address() != Some(0) {
        return false;
    }
    let pdu = message.body().map(|(_, pdu)| pdu).unwrap_or_default();
    pdu::Request::parse(&pdu).and_then(Access::of).is_some_and(|access| access.data.is_none())
}

/// The number of a function; that of an exception in hexadecimal.
fn number(function: u8) -> String {
    if function & EXCEPTION_BIT != 0 { format!("0x{function:02X}") } else { function.to_string() }
}

/// A request of a function that reads and writes no registers (application, chapter 6).
fn other(pdu: &[u8]) -> String {
    let (function, data) = pdu.split_first().map_or((0, pdu), |(&function, data)| (function, data));
    let name = match (function, data) {
        (7, _) => "read the exception status",
        (8, _) => "diagnostics",
        (11, _) => "read the event counter",
        (12, _) => "read the event log",
        (17, _) => "report the server's id",
        (20, _) => "read a file record",
        (21, _) => "write a file record",
        (22, _) => "mask a register",
        (23, _) => "read and write registers",
        (24, _) => "read a FIFO",
        (ENCAPSULATED_INTERFACE, [14, ..]) => "read the identification",
        _ if data.is_empty() => return format!("function {}", number(function)),
        _ => return format!("function {}, {}", number(function), bytes(data)),
    };
    name.to_owned()
}

/// Names of what an access reads.
fn names(spec: &Spec, access: &Access<'_>) -> String {
    let parts = access.parts(spec);
    match parts.as_slice() {
        [] => format!("nothing at {}", address(spec, access.first)),
        [first, .., last] if parts.len() > FEW || access.count > LARGEST => {
            let edge = |part: &Part, at: u16| match part.row {
                Some(_) => name(spec, part, access.space),
                None => address(spec, at),
            };
            let end = last.address.saturating_add(last.count.saturating_sub(1));
            format!("{} from {} to {}", quantity(access), edge(first, first.address), edge(last, end))
        }
        parts => parts.iter().map(|part| name(spec, part, access.space)).collect::<Vec<_>>().join(", "),
    }
}

fn quantity(access: &Access<'_>) -> String {
    let bits = matches!(access.space, Space::Coil | Space::Discrete);
    match (access.count, bits) {
        (1, true) => "1 bit".to_owned(),
        (1, false) => "1 register".to_owned(),
        (count, true) => format!("{count} bits"),
        (count, false) => format!("{count} registers"),
    }
}

/// Names of an access, each with its value.
fn values(spec: &Spec, access: &Access<'_>, data: &Data<'_>) -> String {
    let parts = access.parts(spec);
    let one = |part: &Part| {
        let one = |word: u16| match (access.has_bits(), word) {
            (true, 0) => "off".to_owned(),
            (true, _) => "on".to_owned(),
            (false, word) => word.to_string(),
        };
        let raw = || {
            let words = (0..usize::from(part.count.min(FEW as u16))).map(|n| data.word(part.offset + n));
            words.map_while(|word| Some(one(word?))).collect::<Vec<_>>().join(", ")
        };
        let value = match part.row {
            Some(_) if !access.has_bits() => {
                value(spec, part, data).map(|value| value.to_string()).unwrap_or_default()
            }
            _ => raw(),
        };
        let name = name(spec, part, access.space);
        if value.is_empty() { name } else { format!("{name} = {value}") }
    };
    let mut texts: Vec<String> = parts.iter().take(FEW).map(one).collect();
    if parts.is_empty() {
        texts.push(format!("nothing at {}", address(spec, access.first)));
    }
    if parts.len() > FEW {
        texts.push(format!("{} more", parts.len() - FEW));
    }
    texts.join(", ")
}

/// The values in the answer to a read; `None` if the answer has no values.
pub(super) fn answer(spec: &Spec, pdu: &[u8], reply: &[u8], request: &mut Request) -> Option<String> {
    let access = Access::of(pdu::Request::parse(pdu)?)?;
    let (&[function, count], data) = reply.split_first_chunk()?;
    if access.data.is_some() || function != *pdu.first()? || usize::from(count) != data.len() {
        return None;
    }
    let bits = matches!(access.space, Space::Coil | Space::Discrete);
    let data = if bits { Data::Bits(data) } else { Data::Words(data) };
    request.registers = access.registers(spec, Some(&data));
    Some(values(spec, &access, &data))
}

/// Reason of an exception, as far as the register map states it, with the code.
///
/// `error` is the number of the drive's last error. It belongs to this message if the drive itself refused it: a
/// register that exists, with a value that its row takes, or anything with exception 04.
pub(super) fn refusal(spec: &Spec, pdu: &[u8], code: u8, error: Option<u8>) -> String {
    let is_access = || pdu::Request::parse(pdu).is_some_and(|request| Access::of(request).is_some());
    let of_drive = || {
        let number = error.filter(|_| code == 4 || (code == 3 && is_access()))?;
        super::error(spec, number).map(|text| format!("{text} (error {number})"))
    };
    let why = if code == 4 { None } else { cause(spec, pdu, code) };
    let why = why.map(|cause| cause.text).or_else(of_drive).unwrap_or_else(|| {
        match code {
            1 => "illegal function",
            2 => "illegal data address",
            3 if is_access() => "the drive does not take this value",
            3 => "illegal data value",
            4 if !spec.failure.is_empty() => spec.failure,
            4 => "the drive cannot execute it now",
            6 => "busy",
            _ => "exception",
        }
        .to_owned()
    });
    format!("{why} ({code:02})")
}

/// Rows that are the cause of an exception: none if the request itself is, all if only the drive knows.
pub(super) fn blamed(spec: &Spec, pdu: &[u8], code: u8, registers: &[Register]) -> Vec<usize> {
    match cause(spec, pdu, code).filter(|_| code != 4) {
        Some(cause) => cause.row.into_iter().collect(),
        None => registers.iter().map(|register| register.row).collect(),
    }
}

/// Cause of an exception.
struct Cause {
    /// The row that is the cause; `None` if the request itself is.
    row: Option<usize>,
    text: String,
}

impl Cause {
    fn of_request(text: String) -> Self {
        Self { row: None, text }
    }

    fn of_row(row: usize, text: String) -> Self {
        Self { row: Some(row), text }
    }
}

/// Cause of an exception: the first one in the order in which a drive checks a request.
fn cause(spec: &Spec, pdu: &[u8], code: u8) -> Option<Cause> {
    let function = pdu.first()? & !EXCEPTION_BIT;
    if code == 1 {
        return Some(Cause::of_request(match pdu.first()? {
            exception if exception & EXCEPTION_BIT != 0 => {
                format!("the drive has no function 0x{exception:02X}, a code of answers")
            }
            _ => format!("the drive has no function {function}"),
        }));
    }
    if let &[WRITE_SINGLE_COIL, _, _, high, low] = pdu
        && !matches!([high, low], [0xFF | 0, 0])
    {
        let text = format!("a coil takes 0x0000 or 0xFF00, not 0x{high:02X}{low:02X}");
        return Some(Cause::of_request(text));
    }
    let request = pdu::Request::parse(pdu)?;
    let access = Access::of(request)?;
    if access.count == 0 {
        return Some(Cause::of_request("a quantity of 0 is not allowed".to_owned()));
    }
    let most = spec.rules.map_or(LARGEST, |rules| access.most(rules));
    if access.count > most {
        let (way, unit) = access.way_and_unit();
        return Some(Cause::of_request(format!(
            "a quantity of {} is not allowed, a request {way} at most {most} {unit}",
            access.count
        )));
    }
    if let pdu::Request::WriteMultiple { count, values, bytes, .. } = request {
        let expected = if access.has_bits() { count.div_ceil(8) } else { count.saturating_mul(2) };
        if u16::from(bytes) != expected {
            return Some(Cause::of_request(format!("the byte count is {bytes}, not {expected}")));
        }
        if values.len() != usize::from(bytes) {
            let text = format!("the byte count is {bytes}, and {} bytes follow", values.len());
            return Some(Cause::of_request(text));
        }
    }
    let parts = access.parts(spec);
    let (writes, objects) = (access.data.is_some(), spec.registers.layout.objects);
    for part in &parts {
        let at = address(spec, part.address);
        let Some((index, row)) = part.row else {
            return Some(Cause::of_request(format!("there is no {} at {at}", kind(access.space))));
        };
        if writes && !row.access.writes() {
            return Some(Cause::of_row(index, format!("{at} {} is read only", row.name)));
        }
        if !writes && !row.access.reads() {
            return Some(Cause::of_row(index, format!("{at} {} is write only", row.name)));
        }
    }
    if access.first.checked_add(access.count - 1).is_none() {
        return Some(Cause::of_request("addresses end at 65535".to_owned()));
    }
    for part in &parts {
        let Some((index, row)) = part.row else { continue };
        let words = row.shape.words();
        if part.count != words && (objects || (writes && code == 3)) {
            let text = format!("{} has {words} words, not {}", row.name, part.count);
            return Some(Cause::of_row(index, text));
        }
    }
    let data = access.data?;
    for part in parts.iter().filter(|part| part.is_whole()) {
        let Some((index, row)) = part.row else { continue };
        let number = spec.registers.assemble(row.shape, |n| data.word(part.offset + n).unwrap_or(0));
        if !row.accepts(number) {
            let at = address(spec, part.address);
            let value = Value::of(spec.registers.entries, row.shape, number);
            let text = format!("{at} {} = {value} is not allowed, {}", row.name, legal(row));
            return Some(Cause::of_row(index, text));
        }
    }
    None
}

fn kind(space: Space) -> &'static str {
    match space {
        Space::Coil => "coil",
        Space::Discrete => "discrete input",
        Space::Input => "input register",
        Space::Holding | Space::Variable | Space::Setting => "register",
    }
}

/// The values that a row takes.
pub(crate) fn legal(row: &Row) -> String {
    let between = |least: i64, greatest: i64| format!("it takes {least} to {greatest}");
    match row.legal {
        Legal::Range(least, greatest) => between(least, greatest),
        Legal::OneOf(codes) => {
            let codes: Vec<String> = codes.iter().map(i64::to_string).collect();
            format!("it takes {}", codes.join(", "))
        }
        Legal::Each(ranges) => {
            let words: Vec<String> =
                ranges.iter().map(|(least, greatest)| format!("{least} to {greatest}")).collect();
            format!("its words take {}", words.join(", "))
        }
        Legal::Text => "it takes text of up to eight characters".to_owned(),
        Legal::Any => {
            let (least, greatest) = row.shape.limits();
            between(least, greatest)
        }
    }
}
