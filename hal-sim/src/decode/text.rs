//! Commands and lines of text: a QSB's, and MCode.

use drivetwin_firmware::device::Spec;
use drivetwin_protocol::registers::{Row, Shape, Space};

use super::modbus::legal;
use super::{Register, Request};
use crate::value::Value;

/// Maximum number of characters of a text.
const LONGEST: usize = 80;

/// The key that erases a character of a line.
pub(crate) const BACKSPACE: u8 = 0x08;
const DELETE: u8 = 0x7F;

/// Keys of MCode that act without the end of a line, with their names.
const KEYS: [(u8, &str); 3] = [(0x03, "Ctrl-C"), (0x05, "Ctrl-E"), (0x1B, "Esc")];

/// Returns true for a key of MCode that acts without the end of a line.
pub(crate) fn is_key(byte: u8) -> bool {
    KEYS.iter().any(|(key, _)| *key == byte)
}

/// The key of MCode at the end of a text, with the text before it.
pub(crate) fn key_at_end(text: &[u8]) -> Option<(&'static str, &[u8])> {
    let (last, before) = text.split_last()?;
    KEYS.iter().find(|(key, _)| key == last).map(|(_, name)| (*name, before))
}

/// The line that is left of typed characters: without those that are erased, and without control characters.
pub(crate) fn typed(line: &[u8]) -> Vec<u8> {
    let mut typed = Vec::new();
    for &byte in line {
        match byte {
            BACKSPACE | DELETE => _ = typed.pop(),
            b'\t' | b' '.. => typed.push(byte),
            _ => {}
        }
    }
    typed
}

/// A line without its end, printable. Quotes stay as they are, because MCode has texts between quotes.
pub(super) fn printable(line: &[u8]) -> String {
    let line = line.trim_ascii_end();
    let dots = if line.len() > LONGEST { "…" } else { "" };
    let mut text = String::new();
    for &byte in &line[..line.len().min(LONGEST)] {
        match byte {
            b'"' | b'\'' => text.push(char::from(byte)),
            _ => text.extend(byte.escape_ascii().map(char::from)),
        }
    }
    text + dots
}

/// Number of hexadecimal digits.
fn number(digits: &[u8]) -> Option<u32> {
    if digits.is_empty() || digits.len() > 8 {
        return None;
    }
    digits.iter().try_fold(0, |number, digit| Some(number << 4 | char::from(*digit).to_digit(16)?))
}

/// Parts of a QSB's command or response: letter, number of the register, the register if there is one, data.
type Parts<'a> = (u8, u32, Option<(usize, &'static Row)>, &'a [u8]);

/// The register of a command or response of a QSB, and its data: a letter, two digits, up to eight digits.
fn parse<'a>(spec: &Spec, line: &'a [u8]) -> Option<Parts<'a>> {
    let (&[letter, high, low], data) = line.trim_ascii_end().split_first_chunk()?;
    let number = number(&[high, low])?;
    let row = spec.registers.at(Space::Holding, number as u16).and_then(|(index, _)| {
        let row = spec.registers.rows.get(index)?;
        (row.variants & spec.variant != 0).then_some((index, row))
    });
    Some((letter, number, row, data))
}

/// The value of 32 bits for a row.
fn value(row: &Row, data: u32) -> Value {
    Value::Number(if row.shape == Shape::I32 { data.cast_signed().into() } else { data.into() })
}

/// A command of a QSB: `R0E`, `W0B5`, `S0E`.
pub(super) fn command(spec: &Spec, line: &[u8]) -> Request {
    let plain = || Request { text: printable(line), ..Request::default() };
    let Some((letter, _, Some((index, row)), data)) = parse(spec, line) else { return plain() };
    let register = |value: Option<Value>| {
        let written = value.is_some();
        vec![Register { row: index, name: row.name.to_owned(), value, written }]
    };
    let (text, registers) = match (letter, data) {
        (b'R', []) => (format!("read {}", row.name), register(None)),
        (b'S', []) => (format!("stream {}", row.name), register(None)),
        (b'W', data) => match number(data) {
            Some(data) => {
                let value = value(row, data);
                (format!("write {} = {value}", row.name), register(Some(value)))
            }
            None => return plain(),
        },
        _ => return plain(),
    };
    Request { text, registers, ..Request::default() }
}

/// Reason why a QSB refuses a command: `x` for an unknown command, `e` for a value.
pub(super) fn refused_command(spec: &Spec, line: &[u8], code: u8) -> String {
    let letter = char::from(code).escape_default();
    let why = match parse(spec, line) {
        Some((_, register, None, _)) => format!("there is no register {register:02X}"),
        Some((b'W', register, Some((_, row)), _)) if !row.access.writes() => {
            format!("{register:02X} {} is read only", row.name)
        }
        Some((b'R', register, Some((_, row)), [])) if !row.access.reads() => {
            format!("{register:02X} {} is write only", row.name)
        }
        Some((b'S', register, Some((_, row)), [])) if !row.streams => {
            format!("{register:02X} {} cannot be streamed", row.name)
        }
        Some((b'W', register, Some((_, row)), data)) => match number(data) {
            Some(data) if code == b'e' => {
                format!("{register:02X} {} = {} is not allowed, {}", row.name, value(row, data), legal(row))
            }
            _ => "this is no command".to_owned(),
        },
        _ => "this is no command".to_owned(),
    };
    format!("{why} ({letter})")
}

/// The value in the response of a QSB to a read or a stream, with or without spaces.
pub(super) fn response(spec: &Spec, bytes: &[u8], request: &mut Request) -> Option<String> {
    let response: Vec<u8> = bytes.iter().copied().filter(|byte| !matches!(byte, b' ' | b'!')).collect();
    let (letter, _, Some((_, row)), data) = parse(spec, &response)? else { return None };
    let value = value(row, number(data.get(..8)?)?);
    if !matches!(letter, b'r' | b's') {
        return None;
    }
    if let [register] = request.registers.as_mut_slice() {
        register.value = Some(value.clone());
    }
    Some(format!("{} = {value}", row.name))
}

/// The code of a line of MCode: without texts between quotes, and without the comment after an apostrophe (MC 3.3.1).
fn code(line: &[u8]) -> String {
    let line = String::from_utf8_lossy(line);
    let mut code = String::new();
    for part in line.split('"').step_by(2) {
        let (before, comment) = part.split_once('\'').map_or((part, false), |(before, _)| (before, true));
        code += before;
        code.push(' ');
        if comment {
            break;
        }
    }
    code
}

/// A line of MCode. Its registers are the variables that it names.
pub(super) fn line(spec: &Spec, line: &[u8]) -> Request {
    if let Some((key, before)) = key_at_end(line) {
        let unfinished = printable(&typed(before));
        let text = if unfinished.is_empty() { key.to_owned() } else { format!("{key} after {unfinished}") };
        return Request { text, ..Request::default() };
    }
    let typed = typed(line);
    if typed.trim_ascii().is_empty() {
        return Request { text: "a blank line".to_owned(), ..Request::default() };
    }
    let text = printable(&typed);
    let code = code(&typed);
    let words = code.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    let words: Vec<&str> = words.collect();
    let counts =
        ["IC", "DC"].iter().any(|name| words.first().is_some_and(|word| word.eq_ignore_ascii_case(name)));
    let registers = words.iter().enumerate().filter_map(|(n, word)| {
        let word = word.to_ascii_uppercase();
        let row = spec.find(&word).filter(|named| named.word.is_none() && (n > 0 || !counts))?.row;
        // `VM 1000` and `VM=1000` set the variable, `IC VM` and `DC VM` count it, `PR VM` and `A VM` only name it. `S`
        // alone is the command that is a register of the bus.
        let number = words.get(1).and_then(|word| word.parse::<i64>().ok());
        let negative = code.contains('-');
        let written = n == usize::from(counts);
        let number = number.filter(|_| n == 0 && words.len() == 2 && !code.contains('.'));
        let value = number.map(|number| Value::Number(if negative { -number } else { number }));
        Some(Register { row, name: word, value, written })
    });
    let registers = registers.collect();
    Request { text, registers, ..Request::default() }
}

/// The lines that MCode printed, without prompts and acknowledgements. The first one that is the line `echo` is its
/// echo: it is left out and removed from `echo`.
pub(super) fn printed_lines(bytes: &[u8], echo: &mut Option<Vec<u8>>) -> Vec<String> {
    let is_prompt = |byte: &u8| matches!(byte, b'>' | b'?' | b' ' | 0x06 | 0x15);
    let lines = bytes.split(|byte| matches!(byte, b'\r' | b'\n')).filter_map(|line| {
        let start = line.iter().position(|byte| !is_prompt(byte))?;
        let line = typed(&line[start..]);
        let line = line.trim_ascii();
        if line.is_empty() || echo.take_if(|echo| echo.trim_ascii() == line).is_some() {
            return None;
        }
        Some(printable(line))
    });
    lines.collect()
}

/// What a line of MCode printed: the answer without echo and prompt.
pub(super) fn printed(spec: &Spec, line: &[u8], bytes: &[u8], request: &mut Request) -> Option<String> {
    if key_at_end(line).is_some() {
        return None;
    }
    let printed = printed_lines(bytes, &mut Some(typed(line)));
    if printed.is_empty() {
        return None;
    }
    // `PR P` alone prints the value of a variable.
    if let ([register], [value]) = (request.registers.as_mut_slice(), printed.as_slice())
        && !register.written
        && let Ok(value) = value.parse()
        && spec.registers.rows.get(register.row).is_some()
    {
        register.value = Some(Value::Number(value));
    }
    Some(printed.join(" / "))
}
