//! Lines of text, as drives take them that are spoken to in ASCII.

use core::mem;

use heapless::Vec;

const CR: u8 = b'\r';
const LF: u8 = b'\n';

/// Error of a line, whatever its text.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LineError {
    /// More characters than there is room for; the first ones are kept.
    TooLong,
    /// A character with a parity or framing error; none are kept.
    RxError,
}

/// A line that has ended, without its end.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct TextLine<const N: usize> {
    /// Characters of the line.
    pub text: Vec<u8, N>,
    /// Error of the line.
    pub flaw: Option<LineError>,
}

/// Takes the next line, with the CR or LF that ends it, off the front of `text`; if none ends there, the whole text.
/// `None` for an empty text. An LF at the front belongs to the CR before it and ends no line.
pub fn next_line<'a>(text: &mut &'a [u8]) -> Option<&'a [u8]> {
    let ends = |(n, &character): (usize, &u8)| character == CR || (character == LF && n > 0);
    let last = text.iter().enumerate().position(ends);
    let (line, rest) = last.and_then(|last| text.split_at_checked(last + 1)).unwrap_or((*text, &[]));
    *text = rest;
    (!line.is_empty()).then_some(line)
}

/// Gathers the characters of lines of up to `N` characters.
///
/// CR or LF ends a line. Empty lines are ignored, so CR LF and LF CR end one line as well.
#[derive(Clone, Debug, Default)]
pub struct Lines<const N: usize> {
    text: Vec<u8, N>,
    flaw: Option<LineError>,
}

impl<const N: usize> Lines<N> {
    /// An empty line.
    #[must_use]
    pub const fn new() -> Self {
        Self { text: Vec::new(), flaw: None }
    }

    /// A character has come; returns the line that it ends.
    pub fn push(&mut self, character: u8) -> Option<TextLine<N>> {
        if matches!(character, CR | LF) {
            let line = TextLine { text: mem::take(&mut self.text), flaw: self.flaw.take() };
            return (!line.text.is_empty() || line.flaw.is_some()).then_some(line);
        }
        if self.flaw.is_none() && self.text.push(character).is_err() {
            self.flaw = Some(LineError::TooLong);
        }
        None
    }

    /// A character with an error has come.
    pub fn rx_error(&mut self) {
        self.text.clear();
        self.flaw = Some(LineError::RxError);
    }

    /// Drops the part of a line received so far, and its error.
    pub fn clear(&mut self) {
        *self = Self::new();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// The lines that come out of `characters`, with what is wrong with them.
    fn lines(characters: &[u8]) -> Vec<(Vec<u8>, Option<LineError>)> {
        let mut lines = Lines::<4>::new();
        characters
            .iter()
            .filter_map(|character| lines.push(*character))
            .map(|line| (line.text.to_vec(), line.flaw))
            .collect()
    }

    #[test]
    fn any_single_or_double_combination_of_cr_and_lf_ends_one_line() {
        for end in ["\r", "\n", "\r\n", "\n\r"] {
            let sent = std::format!("R0E{end}W1{end}{end}");
            assert_eq!(lines(sent.as_bytes()), [(b"R0E".to_vec(), None), (b"W1".to_vec(), None)]);
        }
    }

    #[test]
    fn next_line_cuts_behind_the_end_of_a_line() {
        let mut text = &b"PR V\r\nPR P\nPR T\n\rPS"[..];
        let lines: Vec<&[u8]> = core::iter::from_fn(|| next_line(&mut text)).collect();
        assert_eq!(lines, [&b"PR V\r"[..], b"\nPR P\n", b"PR T\n", b"\r", b"PS"]);
        assert!(text.is_empty());
    }

    #[test]
    fn a_line_is_not_whole_without_its_end() {
        assert_eq!(lines(b"R0E"), []);
    }

    #[test]
    fn a_line_may_fill_its_room_and_no_more() {
        assert_eq!(lines(b"1234\r"), [(b"1234".to_vec(), None)]);
        assert_eq!(
            lines(b"12345\r67\r"),
            [(b"1234".to_vec(), Some(LineError::TooLong)), (b"67".to_vec(), None)]
        );
    }

    #[test]
    fn a_spoiled_character_spoils_its_line_only() {
        let mut lines = Lines::<4>::new();
        assert_eq!(lines.push(b'R'), None);
        lines.rx_error();
        assert_eq!(lines.push(b'E'), None);
        let spoiled = lines.push(b'\r').unwrap();
        assert_eq!((&spoiled.text[..], spoiled.flaw), (&b""[..], Some(LineError::RxError)));
        assert_eq!(lines.push(b'R'), None);
        assert_eq!(lines.push(b'\r').unwrap().flaw, None);
    }

    #[test]
    fn clearing_forgets_characters_and_flaws() {
        let mut lines = Lines::<4>::new();
        for character in b"12345" {
            lines.push(*character);
        }
        lines.clear();
        assert_eq!(lines.push(b'\r'), None, "nothing is left of it");
        lines.rx_error();
        lines.clear();
        lines.push(b'R');
        let line = lines.push(b'\n').unwrap();
        assert_eq!((&line.text[..], line.flaw), (&b"R"[..], None));
    }
}
