//! Text lines, for drives with an ASCII protocol.

use core::{fmt, mem};

use heapless::Vec;

const CR: u8 = b'\r';
const LF: u8 = b'\n';

/// Error of a text line. The error does not depend on the text.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LineError {
    /// More than `N` characters; the first `N` are kept.
    TooLong,
    /// A character had a parity or framing error; the line has no text then.
    RxError,
}

impl fmt::Display for LineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TooLong => "the line is too long",
            Self::RxError => "a character was received with an error",
        })
    }
}

impl core::error::Error for LineError {}

/// A complete text line, without the CR or LF that ended it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct TextLine<const N: usize> {
    /// Characters of the line.
    pub text: Vec<u8, N>,
    /// Error of the line.
    pub flaw: Option<LineError>,
}

/// Removes the next text line, including the CR or LF that ends it, from the front of `text` and returns it.
/// If no line ends in `text`, the whole text is the line. Returns `None` if `text` is empty. An LF at the
/// front belongs to the CR before it and does not end a line.
pub fn next_line<'a>(text: &mut &'a [u8]) -> Option<&'a [u8]> {
    let ends = |(n, &character): (usize, &u8)| character == CR || (character == LF && n > 0);
    let last = text.iter().enumerate().position(ends);
    let (line, rest) = last.and_then(|last| text.split_at_checked(last + 1)).unwrap_or((*text, &[]));
    *text = rest;
    (!line.is_empty()).then_some(line)
}

/// Collects received characters into text lines of up to `N` characters.
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

    /// Adds a received character. Returns the line if the character ends one.
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

    /// Handles a character that was received with an error.
    pub fn rx_error(&mut self) {
        self.text.clear();
        self.flaw = Some(LineError::RxError);
    }

    /// Drops the characters received so far of an incomplete line, and its error.
    pub fn clear(&mut self) {
        *self = Self::new();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// The lines received from `characters`, and their errors.
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
