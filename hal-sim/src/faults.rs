//! What disturbs a line: frames lost, changed, doubled, cut, delayed, and noise between them.

use standin_firmware::device::Duration;

/// What disturbs a line. Shares are of its frames, requests and replies alike where nothing else is said, from
/// 0 to 1; the default disturbs nothing.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct LineFaults {
    /// Frames that are lost.
    pub drop: f64,
    /// Frames in which a bit is turned over.
    pub corrupt: f64,
    /// Frames that come twice.
    pub duplicate: f64,
    /// Frames whose end is missing.
    pub truncate: f64,
    /// Replies that bear another drive's address, with a good check sum.
    pub wrong_address: f64,
    /// Requests that are not carried out but refused, with `exception_code`.
    pub exception: f64,
    /// The code of such a refusal, 1 to 255.
    pub exception_code: u8,
    /// Frames after which the line carries some characters of noise.
    pub noise: f64,
    /// Every reply is late by that, up to a minute.
    pub delay: Duration,
    /// No reply reaches anybody.
    pub mute: bool,
    /// Clients talk and listen at that rate, whatever the drives do.
    pub baud: Option<u32>,
}

impl Default for LineFaults {
    fn default() -> Self {
        Self {
            drop: 0.0,
            corrupt: 0.0,
            duplicate: 0.0,
            truncate: 0.0,
            wrong_address: 0.0,
            exception: 0.0,
            exception_code: 4,
            noise: 0.0,
            delay: Duration::ZERO,
            mute: false,
            baud: None,
        }
    }
}
