//! Records of outputs, by kind.

use std::vec::Vec;

use super::{new_memory, store};
use crate::device::{Axis, Context, Duration, Instant, Level, Line, Link, LogEvent, Output, Pin, Plan, Port};

/// Treatment of an output by a [`Recorder`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Treatment {
    /// The output is recorded.
    Keep,
    /// The output is not recorded, but a store is still written into the memory.
    Ignore,
    /// The device must not put this output; the test fails.
    Refuse,
}

/// A function that decides the treatment of each output.
pub type Rule = fn(&Output<'_>) -> Treatment;

/// Records the outputs of a device, by kind and with their timestamps, and writes stores into its memory.
///
/// A [`Rule`] decides which outputs the device may make. A [refused](Treatment::Refuse) output causes a
/// panic.
#[derive(Clone, Debug)]
pub struct Recorder {
    /// Non-volatile memory.
    pub memory: Vec<u8>,
    /// Number of bytes that can be stored before power is lost; `usize::MAX` at first.
    pub bytes_left: usize,
    /// Rule for the treatment of each output.
    pub rule: Rule,
    /// Records of [`Output::Bytes`].
    pub bytes: Vec<(Instant, Port, Vec<u8>)>,
    /// Records of [`Output::Message`].
    pub messages: Vec<(Instant, Port, Link, Vec<u8>)>,
    /// Records of [`Output::Close`].
    pub closed: Vec<(Instant, Port, Link)>,
    /// Records of [`Output::Line`].
    pub lines: Vec<(Instant, Port, Line)>,
    /// Records of [`Output::Level`].
    pub levels: Vec<(Instant, Pin, Level)>,
    /// Records of [`Output::Wave`]: period and high time.
    pub waves: Vec<(Instant, Pin, Duration, Duration)>,
    /// Records of [`Output::Plan`].
    pub plans: Vec<(Instant, Axis, Plan)>,
    /// Records of [`Output::Step`].
    pub steps: Vec<(Instant, Axis, i32)>,
    /// Records of [`Output::CurrentLimit`], in mA.
    pub currents: Vec<(Instant, Axis, u32)>,
    /// Records of [`Output::Duty`], in 1/65536.
    pub duties: Vec<(Instant, Axis, i32)>,
    /// Records of [`Output::Store`]: offset and bytes, also bytes that were not written because power was
    /// lost.
    pub stores: Vec<(Instant, u16, Vec<u8>)>,
    /// Records of [`Output::Log`].
    pub notes: Vec<(Instant, LogEvent)>,
    /// Steps put since the last plan.
    beside: i32,
}

/// A recorder without a memory, for devices that save nothing.
impl Default for Recorder {
    fn default() -> Self {
        Self::new(0)
    }
}

impl Recorder {
    /// A recorder of all outputs with a new memory of `size` bytes.
    #[must_use]
    pub fn new(size: usize) -> Self {
        Self::with_memory(new_memory(size))
    }

    /// A recorder of all outputs with the memory `memory`.
    #[must_use]
    pub fn with_memory(memory: Vec<u8>) -> Self {
        Self {
            memory,
            bytes_left: usize::MAX,
            rule: |_| Treatment::Keep,
            bytes: Vec::new(),
            messages: Vec::new(),
            closed: Vec::new(),
            lines: Vec::new(),
            levels: Vec::new(),
            waves: Vec::new(),
            plans: Vec::new(),
            steps: Vec::new(),
            currents: Vec::new(),
            duties: Vec::new(),
            stores: Vec::new(),
            notes: Vec::new(),
            beside: 0,
        }
    }

    /// The same recorder, with the rule `rule`.
    #[must_use]
    pub fn ruled(mut self, rule: Rule) -> Self {
        self.rule = rule;
        self
    }

    /// The same recorder, which records nothing and only keeps its memory.
    #[must_use]
    pub fn memory_only(self) -> Self {
        self.ruled(|_| Treatment::Ignore)
    }

    /// Deletes the records of all outputs. Memory and rule are kept.
    pub fn clear(&mut self) {
        let memory = core::mem::take(&mut self.memory);
        *self = Self { bytes_left: self.bytes_left, rule: self.rule, ..Self::with_memory(memory) };
    }

    /// The notes without their timestamps.
    #[must_use]
    pub fn noted(&self) -> Vec<LogEvent> {
        self.notes.iter().map(|(_, note)| *note).collect()
    }

    /// Offset and length of each store, with its timestamp.
    #[must_use]
    pub fn stored(&self) -> Vec<(Instant, u16, usize)> {
        self.stores.iter().map(|(at, offset, bytes)| (*at, *offset, bytes.len())).collect()
    }

    /// Bytes put at a port, with their timestamps.
    #[must_use]
    pub fn sent(&self, port: Port) -> Vec<(Instant, Vec<u8>)> {
        let of_port = self.bytes.iter().filter(|(_, known, _)| *known == port);
        of_port.map(|(at, _, bytes)| (*at, bytes.clone())).collect()
    }

    /// The last level of a pin; `None` if the device has put no level.
    #[must_use]
    pub fn level(&self, pin: Pin) -> Option<Level> {
        self.levels.iter().rfind(|(_, known, _)| *known == pin).map(|(_, _, level)| *level)
    }

    /// The last plan. Panics if there is none.
    #[must_use]
    #[track_caller]
    pub fn plan(&self) -> Plan {
        self.plans.last().expect("the device has put no plan").2
    }

    /// Steps put since the last plan.
    #[must_use]
    pub fn steps_since_plan(&self) -> i32 {
        self.beside
    }
}

impl Context for Recorder {
    #[track_caller]
    fn put(&mut self, at: Instant, output: Output<'_>) {
        let treatment = (self.rule)(&output);
        assert_ne!(treatment, Treatment::Refuse, "the device must not put {output:?}");
        if let Output::Store { offset, bytes } = output {
            store(&mut self.memory, &mut self.bytes_left, offset, bytes);
        }
        if treatment == Treatment::Ignore {
            return;
        }
        match output {
            Output::Bytes { port, bytes } => self.bytes.push((at, port, bytes.to_vec())),
            Output::Message { port, link, bytes } => self.messages.push((at, port, link, bytes.to_vec())),
            Output::Close { port, link } => self.closed.push((at, port, link)),
            Output::Line { port, line } => self.lines.push((at, port, line)),
            Output::Level { pin, level } => self.levels.push((at, pin, level)),
            Output::Wave { pin, period, high } => self.waves.push((at, pin, period, high)),
            Output::Plan { axis, plan } => {
                self.plans.push((at, axis, *plan));
                self.beside = 0;
            }
            Output::Step { axis, steps } => {
                self.steps.push((at, axis, steps));
                self.beside += steps;
            }
            Output::CurrentLimit { axis, ma } => self.currents.push((at, axis, ma)),
            Output::Duty { axis, duty } => self.duties.push((at, axis, duty)),
            Output::Store { offset, bytes } => self.stores.push((at, offset, bytes.to_vec())),
            Output::Log(note) => self.notes.push((at, note)),
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}
