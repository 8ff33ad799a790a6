//! Reasons why the drive does not do what a request says, although it accepts the request.

use super::registers::Model;
use crate::device::{Context, Instant, Reason, ReasonSpec, reported};

/// Indices in [`REASONS`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub(super) enum Why {
    NoBridge,
    TooHot,
    AtLimit,
    AfterMove,
    TakesPlace,
    AfterStop,
    AfterSettling,
    Paused,
    KeepsRates,
    NextSpeed,
    SlewHasSpeed,
    NoHolding,
    NeverHolds,
    AddsTrips,
    NothingRuns,
    NotPaused,
    EndsProgram,
    StoresLine,
    KeyIsOff,
    Stored,
    // The following reasons are of a Hybrid only.
    RotorLocked,
    TorqueMode,
    NothingToCalibrate,
    Calibrates,
    TorqueAtRest,
    TorqueBegan,
    TorqueCurrent,
}

/// Reports the reason for the request that the drive is executing, if there is one.
pub(super) fn report(done: Result<(), Why>, at: Instant, out: &mut dyn Context) {
    if let Err(why) = done {
        Reason(why as u8).put(at, out);
    }
}

/// The reasons, in the order of [`Why`].
const REASONS: &[ReasonSpec] = reported(&[
    ReasonSpec::nothing("DE is 0: the shaft does not turn, C1 only counts; write DE = 1 first", "MC 5-19"),
    ReasonSpec::nothing("too hot: the bridge is off; write DE = 1 when it has cooled down", "MDRIVE-19"),
    ReasonSpec::nothing("the limit in this direction is active: move the other way (ER 83, 84)", "MC 5-43"),
    ReasonSpec::later("a motion is in progress: it begins after its end and MT", "MDRIVE-18"),
    ReasonSpec::other("it takes the place of the command that waited, which is lost", "MDRIVE-18"),
    ReasonSpec::later("the motor turns at a speed: it stops first, and then moves", "MDRIVE-18"),
    ReasonSpec::later("MT is in progress: SL begins after it", "MC 5-49"),
    ReasonSpec::later("PS holds the motion: write RS", "MC 5-57"),
    ReasonSpec::later("a move keeps its speed and ramps: it counts from the next one", "MDRIVE-17"),
    ReasonSpec::later("SL turns the motor: it counts from the next change of speed", "MC 5-68"),
    ReasonSpec::later("SL has its own speed: VM counts from the next move; write SL", "MC 5-68"),
    ReasonSpec::nothing("HT is 0: the current stays at RC and never goes down to HC", "MDRIVE-19"),
    ReasonSpec::other(
        "0 means never: the current stays at RC; write 2 to go down to HC at once",
        "MDRIVE-19",
    ),
    ReasonSpec::other("TE switches trips on only: write 0 first to switch the others off", "MC 5-73"),
    ReasonSpec::nothing("nothing runs or moves, or PS holds it already", "MC 5-57"),
    ReasonSpec::nothing("PS holds nothing: there is nothing to resume", "MC 5-61"),
    ReasonSpec::other("E ends the program only: stop the motor by SL 0 or Esc", "MC 5-20"),
    ReasonSpec::later("program mode: the line is stored, not executed; type PG first", "MC 5-55"),
    ReasonSpec::nothing("this key is off: CE turns on Ctrl-C, ES selects Esc or Ctrl-E", "MC 5-11, 5-23"),
    ReasonSpec::stored("stored in the program", "MC 5-55"),
    ReasonSpec::nothing("the rotor was locked and the bridge is off: write CF first", "MDRIVE-30"),
    ReasonSpec::nothing("AS is 3: torque mode makes no moves; write AS = 0, 1 or 2 first", "MDRIVE-28"),
    ReasonSpec::nothing("AS or DE is 0, or the bridge is off: there is nothing to calibrate", "MC 5-67"),
    ReasonSpec::later("it calibrates first: motion commands are error 88 until that is over", "MDRIVE-26"),
    ReasonSpec::later("the motor moves: torque mode begins when it stands", "MDRIVE-28"),
    ReasonSpec::later("torque mode is on: TD counts when it begins again", "MC 5-72"),
    ReasonSpec::nothing("AS is 3: TQ is the current, and not RC and HC", "MC 5-3"),
]);

/// Number of entries at the end of [`REASONS`] that apply to the Hybrid only.
const OF_HYBRID: usize = Why::TorqueCurrent as usize - Why::Stored as usize;

/// Reasons of a model.
pub(super) const fn reasons(model: Model) -> &'static [ReasonSpec] {
    match model {
        Model::Plus => REASONS.split_at(REASONS.len().saturating_sub(OF_HYBRID)).0,
        Model::Hybrid => REASONS,
    }
}
