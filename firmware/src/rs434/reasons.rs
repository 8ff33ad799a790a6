//! Reasons why the drive does not do what a request says, although it accepts the request.

use crate::device::{Context, Instant, Reason, ReasonSpec, reported};

/// Indices in [`REASONS`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub(super) enum Why {
    StartedByInputs,
    HasError,
    MoveRuns,
    Rotates,
    TooFewHalls,
    NoOffset,
    IsThere,
    Compensated,
    ZeroCoil,
    StartOfBus,
    StartOfProgram,
    ProgramRuns,
    NoProgram,
    BadProgram,
    ShownLine,
    NoKey,
    ErrorStays,
    CauseRemains,
    CopiedPosition,
    CopiedOffset,
    CountedOffset,
    DirectionOfInputs,
    KeepsRates,
    NextStart,
    TooFast,
}

impl Why {
    /// Reports the reason for the request that the drive is executing.
    pub(super) fn put(self, at: Instant, out: &mut dyn Context) {
        Reason(self as u8).put(at, out);
    }

    /// Reports the reason if there is one.
    pub(super) fn put_if(at: Instant, done: Result<(), Self>, out: &mut dyn Context) {
        if let Err(why) = done {
            why.put(at, out);
        }
    }
}

/// The reasons, in the order of [`Why`].
pub(super) const REASONS: &[ReasonSpec] = reported(&[
    ReasonSpec::nothing("MODE_DEVICE is 2: only IN1 and IN2 start the motor; write 1 first", "6.5"),
    ReasonSpec::nothing("ERROR stops the motor: take the cause away, then restart by FLAG_RESTART", "6.5"),
    ReasonSpec::nothing("a move runs: START_bit is ignored and not queued; STOP_bit first", "RS434-15"),
    ReasonSpec::nothing("the motor rotates: STOP_bit first, then START_bit of a move", "RS434-15"),
    ReasonSpec::nothing("a move needs USE_HALL = 2: bit 15 of ERROR is set", "RS434-18"),
    ReasonSpec::nothing("OFFSET is 0 (a move counts it down): write it again, or OFFSET_CONST", "6.5"),
    ReasonSpec::nothing("CURRENT_POSITION is the selected TARGET_POSITION already", "6.5"),
    ReasonSpec::nothing("OFFSET_COMPENSATION takes the whole distance: no motion", "RS434-17"),
    ReasonSpec::nothing("0 does nothing: to stop the motor write 1 to STOP_bit", "6.2"),
    ReasonSpec::later("it counts after FLAG_SAVE_INI = 37FAh and FLAG_RESTART = 95AFh", "6.4"),
    ReasonSpec::later("the program starts at power-on, if FLAG_SAVE_INI has saved this", "6.5"),
    ReasonSpec::nothing("the program runs already: write MODE_USER_PROGRAM = 1 first", "RS434-26"),
    ReasonSpec::nothing("no program is saved: write 8426h to FLAG_SAVE_USER_PROGRAM first", "RS434-28"),
    ReasonSpec::nothing("the program in flash is bad: save it again by 8426h", "RS434-11"),
    ReasonSpec::nothing("CMD_R only shows the line of READ_CMD: write CMD_W and WRITE_CMD", "6.6"),
    ReasonSpec::nothing(
        "0 is no key: write the key of this register (37FAh, 8426h, 9346h, 95AFh)",
        "RS434-2",
    ),
    ReasonSpec::nothing("bits 0 to 7, 9 and 10 stay until a restart: FLAG_RESTART = 95AFh", "RS434-23"),
    ReasonSpec::nothing("the cause remains and sets the bit again: take it away first", "RS434-23"),
    ReasonSpec::nothing("START_bit overwrites it: write TARGET_POSITION1 to 4 and POSITION_N", "6.5"),
    ReasonSpec::nothing("OFFSET_CONST is not 0: START_bit copies it to OFFSET; write OFFSET_CONST", "6.5"),
    ReasonSpec::nothing("a move runs and counts OFFSET down: write it when the motor stands", "RS434-16"),
    ReasonSpec::nothing("MODE_EXT_IN is 5: IN1 and IN2 give the direction", "6.5"),
    ReasonSpec::later("a move keeps its speed and ramps: it counts from the next START_bit", "RS434-15"),
    ReasonSpec::later("the motor turns: it counts from the next START_bit", "RS434-15"),
    ReasonSpec::other("more than RATED_SPEED: as fast as the supply allows", "RS434-19"),
]);
