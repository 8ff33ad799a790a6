//! stub
use crate::device::Instant;
#[derive(Clone, Debug)]
pub(super) struct Encoder {
    position: u16,
    index: i32,
}
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Channel {
    A,
    B,
    Index,
}
impl Encoder {
    pub(super) fn new() -> Self {
        Self { position: 0, index: 0 }
    }
    pub(super) fn configure(&mut self, _at: Instant, _configuration: u16, _max_count: u16, _enabled: bool) {}
    pub(super) fn edge(&mut self, _at: Instant, _channel: Channel, _high: bool) {}
    pub(super) fn deadline(&self) -> Instant {
        Instant::NEVER
    }
    pub(super) fn timeout(&mut self, _at: Instant) {}
    pub(super) fn count(&mut self, _steps: i32, _a: bool, _b: bool) {}
    pub(super) fn position(&self) -> u16 {
        self.position
    }
    pub(super) fn set_position(&mut self, v: u16) {
        self.position = v
    }
    pub(super) fn index_count(&self) -> i32 {
        self.index
    }
    pub(super) fn set_index_count(&mut self, v: i32) {
        self.index = v
    }
}
