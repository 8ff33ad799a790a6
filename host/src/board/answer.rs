//! Messages of a board as values that own their data.

use std::sync::mpsc::SyncSender;

use drivetwin_control::{Answer, Message, Refused, State, Statistics};

/// Answer of a board.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Answered {
    Done,
    Hello(Hello),
    State(State),
    Value(i64),
    /// Values of successive rows.
    Values(usize, Vec<i64>),
    Words(Vec<u16>),
    Statistics(Box<Statistics>),
    Memory(Vec<u8>),
    Kind(Option<String>),
}

/// Description of a board.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Hello {
    pub(super) version: u16,
    pub(super) kind: String,
    pub(super) image: String,
    pub(super) tables: u16,
    pub(super) fast_boot: bool,
    /// Name of the board for `drivetwin flash`; empty if its image does not say it.
    pub(super) board: String,
}

impl From<Answer<'_>> for Answered {
    fn from(answer: Answer<'_>) -> Self {
        match answer {
            Answer::Done => Self::Done,
            Answer::Hello(hello) => Self::Hello(Hello {
                version: hello.version,
                kind: hello.kind.to_owned(),
                image: hello.image.to_owned(),
                tables: hello.tables,
                fast_boot: hello.fast_boot,
                board: hello.board.to_owned(),
            }),
            Answer::State(state) => Self::State(state),
            Answer::Value(value) => Self::Value(value),
            Answer::Values { row, count, bytes } => Self::Values(row.into(), values(count, bytes)),
            Answer::Words(bytes) => {
                Self::Words(bytes.as_chunks().0.iter().map(|word| u16::from_be_bytes(*word)).collect())
            }
            Answer::Statistics(statistics) => Self::Statistics(Box::new(statistics)),
            Answer::Memory(bytes) => Self::Memory(bytes.to_vec()),
            Answer::Kind(kind) => Self::Kind(kind.map(ToOwned::to_owned)),
        }
    }
}

/// Values as postcard; fewer than `count` if they cannot all be read.
fn values(count: u8, mut bytes: &[u8]) -> Vec<i64> {
    let next = || {
        let (value, rest) = postcard::take_from_bytes::<i64>(bytes).ok()?;
        bytes = rest;
        Some(value)
    };
    std::iter::from_fn(next).take(count.into()).collect()
}

/// Why a call has no answer.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Failure {
    /// The board refuses it.
    Refused(Refused),
    /// The board cannot be reached, in one sentence.
    Away(String),
}

/// Place for the answer of a call.
pub(super) type AnswerTo = SyncSender<Result<Answered, Failure>>;

/// The number and the answer of a reply; `None` if the message is no reply.
pub(super) fn reply(message: &Message<'_>) -> Option<(u16, Result<Answered, Failure>)> {
    match *message {
        Message::Reply(reply) => {
            Some((reply.number, reply.answer.map(Answered::from).map_err(Failure::Refused)))
        }
        Message::Events(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_cannot_be_read_are_left_out() {
        let mut bytes = [0; 16];
        let mut used = 0;
        for value in [-5_i64, 70_000] {
            used += postcard::to_slice(&value, &mut bytes[used..]).unwrap().len();
        }
        assert_eq!(values(2, &bytes[..used]), [-5, 70_000]);
        assert_eq!(values(1, &bytes[..used]), [-5]);
        assert_eq!(values(9, &bytes[..used]), [-5, 70_000]);
        assert_eq!(values(2, &bytes[..used - 1]), [-5]);
    }
}
