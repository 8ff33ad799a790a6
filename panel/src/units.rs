//! Times and bytes as they are in JSON.

use drivetwin_firmware::device::Instant;
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// Bytes in hexadecimal.
#[must_use]
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}

/// Time since the start of the bench, in seconds.
#[must_use]
pub fn seconds(at: Instant) -> f64 {
    at.ticks() as f64 / TICKS_PER_SECOND as f64
}
