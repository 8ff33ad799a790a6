//! Statistics of requests, from the notes of a drive.

use drivetwin_control::Statistics;
use drivetwin_firmware::device::{DropReason, LogEvent};

/// Counts the outcome of a request.
pub(crate) fn count(statistics: &mut Statistics, note: LogEvent) {
    let count = match note {
        LogEvent::Request { .. } => &mut statistics.requests,
        LogEvent::Refused { .. } => &mut statistics.refused,
        LogEvent::Dropped { why, .. } => match why {
            DropReason::Crc => &mut statistics.crc,
            DropReason::Gap => &mut statistics.gap,
            DropReason::Length => &mut statistics.length,
            DropReason::RxError => &mut statistics.spoiled,
            DropReason::Address => &mut statistics.foreign,
            DropReason::Starting => &mut statistics.starting,
        },
        LogEvent::Reason(_) => return,
    };
    *count = count.wrapping_add(1);
}
