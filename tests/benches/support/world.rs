//! A context for a drive that only gets requests.

use drivetwin_firmware::device::{Context, Instant, Output};

/// Stores the last reply.
#[derive(Default)]
pub(crate) struct World {
    pub(crate) answer: Vec<u8>,
}

impl Context for World {
    fn put(&mut self, _at: Instant, output: Output<'_>) {
        if let Output::Bytes { bytes, .. } = output {
            self.answer.clear();
            self.answer.extend_from_slice(bytes);
        }
    }

    fn memory(&self) -> &[u8] {
        &[0xFF; 128]
    }
}
