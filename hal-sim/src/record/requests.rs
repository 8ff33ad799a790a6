//! Statistics of what masters do: silence, retries, requests to a drive that starts.

use drivetwin_firmware::device::Duration;

/// Statistics of the requests on a Modbus line or Modbus/TCP port so far.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct RequestStatistics {
    /// Number of requests.
    pub requests: u64,
    /// Number of requests that were too early.
    pub early: u64,
    /// Number of requests that repeat the request before them, which had no answer.
    pub retries: u64,
    /// Shortest silence between a reply and the next request. `None` if there was none, or if the silence is not known:
    /// in manual time, with `--line fast`, on a serial port, on a line with faults, on a TCP port.
    pub shortest_silence: Option<Duration>,
}

/// Requests to a drive that was starting, so that it did not receive them.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct StartingRequests {
    /// Number of these requests.
    pub count: u64,
    /// Time from the last of these requests until the drive receives; `None` if unknown.
    pub left: Option<Duration>,
}

/// Requests on a line, as far as their statistics need them.
#[derive(Debug, Default)]
pub(crate) struct RequestLog {
    count: u64,
    retries: u64,
    shortest_silence: Option<Duration>,
    /// The last request.
    last: Vec<u8>,
    /// True if the last request had an answer, or was executed without one.
    is_answered: bool,
}

impl RequestLog {
    /// Notes a request.
    pub(crate) fn request(&mut self, bytes: &[u8]) {
        self.count += 1;
        self.retries += u64::from(!self.is_answered && self.last == bytes);
        self.last.clear();
        self.last.extend_from_slice(bytes);
        self.is_answered = false;
    }

    /// Notes that the last request had an answer, or needs none.
    pub(crate) fn answer(&mut self) {
        self.is_answered = true;
    }

    /// Returns true if the last request had an answer, or needs none.
    pub(crate) fn is_answered(&self) -> bool {
        self.is_answered
    }

    /// The address, or its first digit, of the last request.
    pub(crate) fn address(&self) -> Option<&[u8]> {
        self.last.get(..1)
    }

    /// Notes the silence before a request.
    pub(crate) fn silence(&mut self, silence: Duration) {
        self.shortest_silence = Some(self.shortest_silence.map_or(silence, |shortest| shortest.min(silence)));
    }

    /// The statistics, with the number of requests that were too early.
    pub(crate) fn statistics(&self, early: u64) -> RequestStatistics {
        let &Self { count: requests, retries, shortest_silence, .. } = self;
        RequestStatistics { requests, early, retries, shortest_silence }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_retry_repeats_a_request_without_an_answer() {
        let mut log = RequestLog::default();
        for (bytes, answered, retries) in [
            (b"a", true, 0),
            (b"a", false, 0),
            (b"a", false, 1),
            (b"a", true, 2),
            (b"a", false, 2),
            (b"b", true, 2),
        ] {
            log.request(bytes);
            if answered {
                log.answer();
            }
            assert_eq!(log.statistics(0).retries, retries);
        }
        assert_eq!(
            log.statistics(7),
            RequestStatistics { requests: 6, early: 7, retries: 2, shortest_silence: None }
        );
    }
}
