//! Messages to a drive, each with its answer.

use drivetwin_firmware::device::Instant;

use super::tracks::Words;
use crate::decode::Mark;

/// A message to a drive with its answer, or an answer alone.
pub struct Exchange<'a> {
    /// The message to the drive; `None` for an answer alone.
    pub received: Option<&'a Words>,
    /// The answer.
    pub sent: Option<&'a Words>,
}

/// Joins each message with the first answer before the next message.
#[must_use]
pub fn exchanges<'a>(received: &'a [Words], sent: &'a [Words]) -> Vec<Exchange<'a>> {
    let mut exchanges: Vec<Exchange<'_>> = Vec::new();
    let mut sent = sent.iter().peekable();
    for (index, message) in received.iter().enumerate() {
        let next = received.get(index + 1).map_or(Instant::NEVER, |next| next.begin);
        while let Some(early) = sent.next_if(|answer| answer.begin < message.begin) {
            exchanges.push(Exchange { received: None, sent: Some(early) });
        }
        let answer = sent.next_if(|answer| answer.begin < next);
        exchanges.push(Exchange { received: Some(message), sent: answer });
    }
    exchanges.extend(sent.map(|alone| Exchange { received: None, sent: Some(alone) }));
    exchanges
}

impl Exchange<'_> {
    /// Begin of the first one.
    #[must_use]
    pub fn begin(&self) -> Instant {
        self.received.or(self.sent).map_or(Instant::ZERO, |words| words.begin)
    }

    /// Words of the message to the drive.
    pub(super) fn request(&self) -> Option<&str> {
        self.received.map(|received| received.text.as_str())
    }

    /// The message and its answer in one clause, with the outcome if it is not as usual.
    #[must_use]
    pub fn text(&self) -> String {
        let outcome = self.received.and_then(|received| received.outcome.as_ref());
        let is_plain = outcome.is_none_or(|(_, mark)| *mark == Mark::Done);
        match (self.received, self.sent, outcome) {
            (Some(received), _, Some((outcome, _))) if !is_plain || outcome.starts_with("accepted") => {
                format!("{} → {outcome}", received.text)
            }
            (Some(received), None, Some((outcome, _))) if outcome == "done" => received.text.clone(),
            (Some(received), None, Some((outcome, _))) => format!("{} → {outcome}", received.text),
            (Some(received), Some(sent), _) if sent.text == "done" => received.text.clone(),
            // `read P` and `P = 5` are `read P = 5`.
            (Some(received), Some(sent), _)
                if received.text.strip_prefix("read ").is_some_and(|name| {
                    sent.text.strip_prefix(name).is_some_and(|rest| rest.starts_with(" = "))
                }) =>
            {
                format!("read {}", sent.text)
            }
            (Some(received), Some(sent), _) => format!("{} → {}", received.text, sent.text),
            (Some(only), None, _) | (None, Some(only), _) => only.text.clone(),
            (None, None, _) => String::new(),
        }
    }

    /// The mark of the message.
    #[must_use]
    pub fn mark(&self) -> Mark {
        let outcome = self.received.and_then(|received| received.outcome.as_ref());
        match (outcome, self.sent) {
            (Some((_, mark)), _) => *mark,
            (None, Some(sent)) if sent.text.starts_with("refused") => Mark::Refused,
            (None, _) => Mark::Done,
        }
    }

    /// Returns true if the drive has not done what the message says, or a fault acted on it.
    pub(super) fn is_bad(&self) -> bool {
        self.mark() != Mark::Done
    }
}
