//! Received commands and sent responses, in ASCII.

use drivetwin_protocol::text::TextLine;
use heapless::Vec;

/// The number of characters of a line that are stored. A longer line is not a command.
pub(super) const LINE_CHARACTERS: usize = 16;

/// Letter of a command.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Verb {
    /// `R`
    Read,
    /// `W` with this value of 32 bits.
    Write(u32),
    /// `S`
    Stream,
}

/// A line in the form of a command. Its register may not exist.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Command {
    pub(super) verb: Verb,
    pub(super) register: u8,
}

/// Parses a line.
///
/// # Errors
/// The line is not a command. The error is the register to show in the response: as typed if it has two
/// digits, else 0.
pub(super) fn parse(line: &TextLine<LINE_CHARACTERS>) -> Result<Command, u8> {
    let (letter, register, data) = match &*line.text {
        [letter, high, low, data @ ..] => (*letter, number(&[*high, *low]), data),
        _ => return Err(0),
    };
    let register = register.ok_or(0)?;
    let verb = match (letter, data) {
        (b'R', []) => Some(Verb::Read),
        (b'S', []) => Some(Verb::Stream),
        (b'W', [_, ..]) => number(data).map(Verb::Write),
        _ => None,
    };
    match verb {
        Some(verb) if line.flaw.is_none() => Ok(Command { verb, register: register as u8 }),
        _ => Err(register as u8),
    }
}

/// The number that up to eight hexadecimal digits form (QSB-3); `None` if there are more than eight digits, or other
/// characters.
fn number(digits: &[u8]) -> Option<u32> {
    if digits.len() > 8 {
        return None;
    }
    digits.iter().try_fold(0, |number, digit| Some(number << 4 | char::from(*digit).to_digit(16)?))
}

/// Bits of EOR.
const LF: u16 = 1 << 0;
const CR: u16 = 1 << 1;
const TIME_STAMP: u16 = 1 << 2;
const SPACES: u16 = 1 << 3;

/// A response before it is formatted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Response {
    /// `r`, `w`, `s`, `e` or `x`.
    pub(super) letter: u8,
    pub(super) register: u8,
    pub(super) data: u32,
}

impl Response {
    /// Formats the response as EOR selects, with a time stamp if EOR has its bit set (QSB-5).
    pub(super) fn text(self, eor: u16, time_stamp: u32) -> Text {
        let mut text = Text { characters: Vec::new(), spaces: eor & SPACES != 0 };
        text.put(self.letter);
        text.field(u32::from(self.register), 2);
        text.field(self.data, 8);
        if eor & TIME_STAMP != 0 {
            text.field(time_stamp, 8);
        }
        text.space();
        text.put(b'!');
        for (bit, character) in [(CR, b'\r'), (LF, b'\n')] {
            if eor & bit != 0 {
                text.put(character);
            }
        }
        text
    }
}

/// The banner that is sent after the start-up, with the variant's letter and the version of the firmware.
pub(super) fn banner(letter: u8, firmware: u8) -> [u8; 12] {
    let (high, low) = (digit(firmware >> 4), digit(firmware));
    [b'Q', b'S', b'B', b'-', letter, b' ', b' ', high, low, b'!', b'\r', b'\n']
}

/// Characters of a response, 26 at most.
pub(super) struct Text {
    characters: Vec<u8, 26>,
    spaces: bool,
}

impl Text {
    pub(super) fn as_bytes(&self) -> &[u8] {
        &self.characters
    }

    fn put(&mut self, character: u8) {
        // The longest response fits.
        let _ = self.characters.push(character);
    }

    fn space(&mut self) {
        if self.spaces {
            self.put(b' ');
        }
    }

    /// Appends a field with `digits` digits, after a space if spaces are on.
    fn field(&mut self, value: u32, digits: u32) {
        self.space();
        for place in (0..digits).rev() {
            self.put(digit((value >> (4 * place)) as u8));
        }
    }
}

/// The lowest four bits as an upper-case hexadecimal digit.
fn digit(value: u8) -> u8 {
    match value & 0xF {
        ten @ 10.. => b'A' + (ten - 10),
        nine => b'0' + nine,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_protocol::text::Lines;

    fn parsed(text: &str) -> Result<(Verb, u8), u8> {
        let mut lines = Lines::new();
        for character in text.bytes() {
            assert_eq!(lines.push(character), None);
        }
        parse(&lines.push(b'\r').unwrap()).map(|command| (command.verb, command.register))
    }

    #[test]
    fn commands_of_the_list() {
        assert_eq!(parsed("R0E"), Ok((Verb::Read, 0x0E)));
        assert_eq!(parsed("R0b"), Ok((Verb::Read, 0x0B)));
        assert_eq!(parsed("S0E"), Ok((Verb::Stream, 0x0E)));
        assert_eq!(parsed("W0001"), Ok((Verb::Write(1), 0)));
        assert_eq!(parsed("W10186A0"), Ok((Verb::Write(100_000), 0x10)));
        assert_eq!(parsed("W1180000001"), Ok((Verb::Write(0x8000_0001), 0x11)));
        assert_eq!(parsed("W0c0"), Ok((Verb::Write(0), 0x0C)));
    }

    #[test]
    fn what_is_no_command_shows_its_register() {
        for (line, register) in [
            ("R", 0),
            ("R0", 0),
            ("r0E", 0x0E),
            ("Q0e", 0x0E),
            ("R0G", 0),
            ("R0E1", 0x0E),
            ("S0E0", 0x0E),
            ("W0E", 0x0E),
            ("W0C12G", 0x0C),
            ("W0C+1", 0x0C),
            ("W08000000000", 0x08),
            ("W08000000000000000000000", 0x08),
            (" R0E", 0),
        ] {
            assert_eq!(parsed(line), Err(register), "{line}");
        }
    }

    #[test]
    fn eor_formats_the_response() {
        let response = Response { letter: b'r', register: 0x0E, data: 0x1F3 };
        let text = |eor| std::string::String::from_utf8(response.text(eor, 10).as_bytes().to_vec()).unwrap();
        for (eor, expected) in [
            (0x0, "r0E000001F3!"),
            (0x1, "r0E000001F3!\n"),
            (0x2, "r0E000001F3!\r"),
            (0x3, "r0E000001F3!\r\n"),
            (0x4, "r0E000001F30000000A!"),
            (0x8, "r 0E 000001F3 !"),
            (0xB, "r 0E 000001F3 !\r\n"),
            (0xC, "r 0E 000001F3 0000000A !"),
            (0xF, "r 0E 000001F3 0000000A !\r\n"),
        ] {
            assert_eq!(text(eor), expected);
        }
    }
}
