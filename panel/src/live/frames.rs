//! Messages in words.

use drivetwin_sim::bench::{News, OwnNews, ReceivedMessage, Receiver, SentMessage};
use drivetwin_sim::decode::{Exchange, Verdict};
use serde::Serialize;
use utoipa::ToSchema;

use super::MOST_FRAMES;
use super::seen::Layout;
use crate::units::{hex, seconds};

/// A message to a drive, with its outcome, or a message that a drive has sent by itself.
#[derive(Debug, Serialize, ToSchema)]
pub struct Frame {
    /// Number of a message to a drive on the bench.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub number: Option<u64>,
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
    /// True if no whole answer reached the client: nobody executed or refused the message, or the answer was lost;
    /// otherwise absent.
    #[serde(skip_serializing_if = "is_false")]
    pub unanswered: bool,
    /// Registers that the message has written, or that its refusal is about; absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(example = json!(["Reserved"]))]
    pub registers: Vec<&'static str>,
    /// The bytes in hexadecimal.
    #[schema(example = "0106000B0005399B")]
    pub bytes: String,
    /// The bytes of the answer; absent if there was none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub answer: Option<String>,
    /// True if the drive has sent the message by itself, as a QSB that streams; otherwise absent.
    #[serde(skip_serializing_if = "is_false")]
    pub sent: bool,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "the signature that serde asks for")]
fn is_false(flag: &bool) -> bool {
    !flag
}

/// The newest messages of some news, and the number of those that are left out.
pub(super) fn of(news: &News, own: &OwnNews, layout: &Layout) -> (Vec<Frame>, u64) {
    let received = news.messages().map(|(receiver, message)| {
        let ReceivedMessage { number, at, port, bytes, answer, unanswered, exchange } = message;
        let Exchange { request, verdict, reason, outcome, blamed } = exchange;
        let (drive, bus) = match receiver {
            Receiver::Drive(id) => (layout.drive_name(id).map(ToOwned::to_owned), None),
            Receiver::Line(bus) => (None, layout.bus_name(bus).map(ToOwned::to_owned)),
        };
        let written =
            || request.registers.iter().filter(|register| register.written).map(|register| register.row);
        let rows: Vec<usize> = match verdict {
            Verdict::Refused => blamed,
            Verdict::Done | Verdict::WithoutEffect => written().collect(),
            _ => Vec::new(),
        };
        let of = match receiver {
            Receiver::Drive(id) => layout.spec(id),
            Receiver::Line(_) => None,
        };
        let registers = rows.iter().filter_map(|&row| Some(of?.registers.rows.get(row)?.name)).collect();
        Frame {
            number: Some(number),
            at: seconds(at),
            drive,
            bus,
            port,
            text: request.text,
            outcome,
            verdict: verdict.as_str(),
            reason,
            unanswered,
            registers,
            bytes: hex(&bytes),
            answer: (!answer.is_empty()).then(|| hex(&answer)),
            sent: false,
        }
    });
    let sent = own.messages().filter(|message| !message.text.is_empty()).map(|message| {
        let SentMessage { drive, at, port, bytes, text } = message;
        Frame {
            number: None,
            at: seconds(at),
            drive: layout.drive_name(drive).map(ToOwned::to_owned),
            bus: None,
            port,
            text,
            outcome: "sent by itself".to_owned(),
            verdict: Verdict::Done.as_str(),
            reason: None,
            unanswered: false,
            registers: Vec::new(),
            bytes: hex(&bytes),
            answer: None,
            sent: true,
        }
    });
    let (mut sent, mut frames) = (sent.peekable(), Vec::new());
    // Received messages keep their order, which is not always that of their times.
    for frame in received {
        while let Some(earlier) = sent.next_if(|sent| sent.at < frame.at) {
            frames.push(earlier);
        }
        frames.push(frame);
    }
    frames.extend(sent);
    let further = frames.len().saturating_sub(MOST_FRAMES);
    frames.drain(..further);
    (frames, news.lost() + own.left_out() + further as u64)
}
