//! The protocol between a board and the computer at the other end of its USB cable.
//!
//! The computer sends a [`Request`] and the board answers it with a [`Message::Reply`] of the same number. Between the
//! replies the board sends [`Message::Events`], if the computer has asked for them: what the drive received and did, with
//! the board's time stamps. Each message is a frame: the message as postcard, a CRC of 16 bits, both encoded with COBS,
//! and a zero byte. So a reader that has lost its place finds the next message behind the next zero byte, and ignores
//! everything with a wrong CRC. A frame has at most [`FRAME`] bytes, with its zero byte.
//!
//! ```
//! use drivetwin_control::{Answer, Call, Decoder, FRAME, Message, Reply, Request, encode};
//!
//! let mut frame = [0; FRAME];
//! let sent = encode(&Request { number: 7, call: Call::Read { row: 0 } }, &mut frame)?;
//! let mut decoder = Decoder::new();
//! // Garbage comes before the frame.
//! let received = b"noise\0".iter().chain(sent).find_map(|byte| {
//!     let Request { number, call } = decoder.push(*byte)?;
//!     Some((number, matches!(call, Call::Read { row: 0 })))
//! });
//! assert_eq!(received, Some((7, true)));
//!
//! let reply = Message::Reply(Reply { number: 7, answer: Ok(Answer::Value(-5)) });
//! let frame = encode(&reply, &mut frame)?;
//! assert!(frame.len() < 12 && frame.ends_with(&[0]));
//! # Ok::<(), drivetwin_control::TooLong>(())
//! ```
//!
//! | module | what it holds |
//! |---|---|
//! | `frame` | frames |
//! | `calls` | requests and their answers |
//! | `events` | inputs and outputs of the drive |
#![no_std]

mod calls;
mod events;
mod frame;

pub use calls::{
    Answer, Call, Hello, Motion, PIECE, Power, Refused, Reply, Request, State, Statistics, Stimulus,
    fingerprint,
};
pub use events::{Course, Decoded, Event, Events, Level, Line, Stretch};
pub use frame::{Decoder, FRAME, TooLong, encode};

use serde::{Deserialize, Serialize};

/// Version of this protocol. A board and a computer with different versions understand only [`Call::Hello`].
pub const VERSION: u16 = 1;

/// A message of the board.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub enum Message<'a> {
    /// Reply to a request.
    #[serde(borrow)]
    Reply(Reply<'a>),
    /// Events of the drive, in the order in which they happened.
    #[serde(borrow)]
    Events(Events<'a>),
}
