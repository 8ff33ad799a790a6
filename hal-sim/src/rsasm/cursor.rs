//! Tokens of a text line.

use super::Error;

/// Position in the text: line and column, from 1.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Position {
    pub(super) line: usize,
    pub(super) column: usize,
}

impl Position {
    /// An error at this position.
    pub(super) fn error(self, what: impl Into<String>) -> Error {
        Error { line: self.line, column: self.column, what: what.into() }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Token<'a> {
    /// A name, or another word.
    Word(&'a str),
    Number(i64),
    /// A sign: `,`, `:` or `=`.
    Sign(char),
    /// End of the line, or start of a comment.
    End,
}

/// A position in a text line, with the rest of the line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cursor<'a> {
    position: Position,
    rest: &'a str,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(line: usize, text: &'a str) -> Self {
        Self { position: Position { line, column: 1 }, rest: text }
    }

    /// Reads the next token, and returns it with its position.
    pub(super) fn next(&mut self) -> Result<(Position, Token<'a>), Error> {
        self.take(char::is_whitespace);
        let position = self.position;
        let token = match self.rest.chars().next() {
            None | Some(';') => Token::End,
            Some(sign @ (',' | ':' | '=')) => {
                self.step(sign.len_utf8());
                Token::Sign(sign)
            }
            Some('+' | '-' | '0'..='9') => {
                let start = self.rest;
                self.step(1);
                let digits = self.take(is_of_a_word);
                let text = &start[..1 + digits.len()];
                Token::Number(number(text).ok_or_else(|| {
                    position.error(format!("'{text}' is no number of a program; 500, -5 and 0x1F4 are"))
                })?)
            }
            Some(first) if is_of_a_word(first) => Token::Word(self.take(is_of_a_word)),
            Some(other) => return Err(position.error(format!("{other:?} is not allowed here"))),
        };
        Ok((position, token))
    }

    /// Skips a sign (`,`, `:` or `=`) if it comes next. Returns true if it did.
    pub(super) fn skips(&mut self, sign: char) -> Result<bool, Error> {
        self.skips_token(Token::Sign(sign))
    }

    /// Skips a word if it comes next. Returns true if it did.
    pub(super) fn skips_word(&mut self, word: &str) -> Result<bool, Error> {
        self.skips_token(Token::Word(word))
    }

    fn skips_token(&mut self, token: Token<'_>) -> Result<bool, Error> {
        let mut beyond = *self;
        let found = beyond.next()?.1 == token;
        if found {
            *self = beyond;
        }
        Ok(found)
    }

    /// Skips a comma, which must come next.
    pub(super) fn comma(&mut self) -> Result<(), Error> {
        match self.next()? {
            (_, Token::Sign(',')) => Ok(()),
            (position, _) => Err(position.error("a comma is missing")),
        }
    }

    /// Checks that nothing more follows in the line.
    pub(super) fn end(&mut self) -> Result<(), Error> {
        match self.next()? {
            (_, Token::End) => Ok(()),
            (position, _) => {
                Err(position.error("unexpected text after the command; a comment begins with ;"))
            }
        }
    }

    /// Takes all next characters for which `belongs` is true.
    fn take(&mut self, belongs: fn(char) -> bool) -> &'a str {
        let length = self.rest.find(|next| !belongs(next)).unwrap_or(self.rest.len());
        self.step(length)
    }

    /// Takes the next `length` bytes.
    fn step(&mut self, length: usize) -> &'a str {
        let (taken, rest) = self.rest.split_at(length);
        self.rest = rest;
        self.position.column += taken.chars().count();
        taken
    }
}

fn is_of_a_word(character: char) -> bool {
    character.is_alphanumeric() || matches!(character, '_' | '.')
}

/// Reads `500`, `-5`, `+5` or `0x1F4`.
fn number(text: &str) -> Option<i64> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let size = match digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
        Some(hex) => i64::from_str_radix(hex, 16).ok()?,
        None => digits.parse().ok()?,
    };
    Some(if negative { -size } else { size })
}
