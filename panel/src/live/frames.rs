//! Messages in words.

use drivetwin_sim::bench::{News, ReceivedMessage, Receiver};
use drivetwin_sim::decode::Exchange;
use serde::Serialize;
use utoipa::ToSchema;

use super::seen::Layout;
use crate::units::{hex, seconds};

/// A message to a drive, with its outcome.
#[derive(Debug, Serialize, ToSchema)]
pub struct Frame {
    /// Number of the message on the bench.
    pub number: u64,
    /// Bench time of its end, in seconds.
    #[schema(example = 2.513176875)]
    pub at: f64,
    /// The drive; absent for a message on a shared line that was for no drive or corrupt.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub drive: Option<String>,
    /// The shared line of such a message.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub bus: Option<String>,
    /// The port of the drive.
    #[schema(example = "rs485")]
    pub port: &'static str,
    /// The message in the names of the manual.
    #[schema(example = "write SpeedLow = 200")]
    pub text: String,
    /// The outcome in one clause.
    #[schema(example = "refused: 0x000B Reserved is read only (02)")]
    pub outcome: String,
    /// The outcome in one word, as in the journal of the drive.
    #[schema(example = "refused")]
    pub verdict: &'static str,
    /// Reason of the verdict, or the limit of its effect.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub reason: Option<String>,
    /// The bytes in hexadecimal.
    #[schema(example = "0106000B0005399B")]
    pub bytes: String,
    /// The bytes of the answer; absent if there was none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub answer: Option<String>,
}

/// The messages of some news, and the number of those that are left out.
pub(super) fn of(news: &News, layout: &Layout) -> (Vec<Frame>, u64) {
    let frames = news.messages().map(|(receiver, message)| {
        let ReceivedMessage { number, at, port, bytes, answer, exchange } = message;
        let Exchange { request, verdict, reason, outcome } = exchange;
        let (drive, bus) = match receiver {
            Receiver::Drive(id) => (layout.drive_name(id).map(ToOwned::to_owned), None),
            Receiver::Line(bus) => (None, layout.bus_name(bus).map(ToOwned::to_owned)),
        };
        Frame {
            number,
            at: seconds(at),
            drive,
            bus,
            port,
            text: request.text,
            outcome,
            verdict: verdict.as_str(),
            reason,
            bytes: hex(&bytes),
            answer: (!answer.is_empty()).then(|| hex(&answer)),
        }
    });
    (frames.collect(), news.lost())
}
