//! Reasons why the adapter does not do what a request says, although it accepts the request.

use crate::device::{Context, Instant, Reason, ReasonSpec, reported};

/// Indices in [`REASONS`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub(super) enum Why {
    IntervalPaused,
    StreamsRun,
    InputPins,
    MotorLines,
    NoSuchLines,
    AllHigh,
    HiddenOtr,
    TimeStampKey,
    NotActive,
    NothingMoves,
    NotPaused,
    NoSteps,
    NoJogRate,
    NextCommand,
    Rounded,
}

impl Why {
    /// Reports the reason for the request that the adapter is executing.
    pub(super) fn put(self, at: Instant, out: &mut dyn Context) {
        Reason(self as u8).put(at, out);
    }
}

/// The reasons, in the order of [`Why`].
pub(super) const REASONS: &[ReasonSpec] = reported(&[
    ReasonSpec::nothing("INTERVAL RATE is FFFF: nothing streams; write W0C first", "INTERVAL RATE"),
    ReasonSpec::nothing("streams of 05 and 06 go on: end them by R05, R06", "QSB-12"),
    ReasonSpec::nothing("the pin is an input: set bits 11:8 of DIG I/O CONFIG first (W02)", "DIG I/O CONFIG"),
    ReasonSpec::nothing("the motor drive has DIO1 and DIO2: no effect until W160", "QSB-26"),
    ReasonSpec::nothing("a QSB-D has DIO0 only: the other bits do nothing", "QSB-23"),
    ReasonSpec::other("all pins are high now: write their levels again by W01", "DIG I/O CONFIG"),
    ReasonSpec::nothing("R07 shows the present count: a loaded OTR cannot be read", "QSB-9"),
    ReasonSpec::nothing("only W0D1 clears the time stamp", "QSB-10"),
    ReasonSpec::nothing("the motor drive is not active: write W162 first", "QSB-27"),
    ReasonSpec::nothing("nothing moves: there is nothing to stop, pause or resume", "QSB-27"),
    ReasonSpec::nothing("nothing is paused: there is nothing to resume", "QSB-28"),
    ReasonSpec::nothing("MD MOVE STEPS is 0: the move is over at once", "QSB-29"),
    ReasonSpec::nothing("MD JOG RATE is below 16: no steps", "QSB-29"),
    ReasonSpec::later("the motor moves: the new value counts from the next command", "QSB-27"),
    ReasonSpec::other("no multiple of 16: it is rounded towards 0 when it is used", "QSB-27"),
]);
