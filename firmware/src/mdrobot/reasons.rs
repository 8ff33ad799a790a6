//! Reasons why the drive does not do what a request says, although it accepts the request.

use crate::device::{Context, Instant, Reason, ReasonSpec, reported};

/// Indices in [`REASONS`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub(super) enum Why {
    Inputs,
    ArmsLater,
    StopsNothing,
    NotArmed,
    ArmsOnly,
    OtherCommand,
    OnlyFunction,
    Alarm,
    AlarmFunction,
    NoFunction,
    SignalOn,
    FunctionRuns,
    NoRunTime,
    LimitSwitch,
    NoCurrent,
    NoSpeed,
    NoGain,
    NoMaxRpm,
    MaxRpm,
    Unsigned,
    CauseStays,
    NoKey,
    NextPowerOn,
    NoDefaultKey,
    NotModelled,
    NoSuchCode,
    Limit,
}

impl Why {
    /// Reports the reason for the request that the drive is executing.
    pub(super) fn put(self, at: Instant, out: &mut dyn Context) {
        Reason(self as u8).put(at, out);
    }
}

/// The reasons, in the order of [`Why`].
pub(super) const REASONS: &[ReasonSpec] = reported(&[
    ReasonSpec::nothing("UI_COM is 0: the inputs command; write UI_COM = 1 first", "p. 7"),
    ReasonSpec::later("UI_COM is 0: it arms when UI_COM is 1; write START_STOP again then", "MDROBOT-12"),
    ReasonSpec::nothing("the bus does not command: START_STOP = 0 stops nothing; write TQ_OFF", "p. 12"),
    ReasonSpec::nothing("START_STOP is 0: write 1 or 2 first, then the command again", "p. 12"),
    ReasonSpec::other("COM_TAR_SPEED is 0: START_STOP only arms; VEL_CMD or COM_TAR_SPEED drives", "p. 12"),
    ReasonSpec::nothing("another command drives: COM_TAR_SPEED = 0 does not end it", "MDROBOT-13"),
    ReasonSpec::nothing("FUNC_CMD_TYPE is not 0: only FUNC_CMD drives; write 0 there first", "p. 15"),
    ReasonSpec::nothing("an alarm is on (CTRL_STATUS): write ALARM_RESET, then the command again", "p. 9"),
    ReasonSpec::nothing("an alarm is on (CTRL_STATUS): write ALARM_RESET, then FUNC_CMD 0 and 1", "p. 9"),
    ReasonSpec::nothing("FUNC_CMD_TYPE is 0: there is no function to start", "p. 16"),
    ReasonSpec::nothing("the start signal is ON already: write FUNC_CMD 0, then 1", "p. 17"),
    ReasonSpec::nothing("a function runs: the signal is ignored until it ends", "MDROBOT-20"),
    ReasonSpec::nothing("the run time in FUNC_SPEED is 0: nothing runs", "p. 16"),
    ReasonSpec::nothing(
        "the limit switch ahead (DIR: CW, START/STOP: CCW) is open; or USE_LIMIT_SW = 0",
        "p. 7",
    ),
    ReasonSpec::nothing("MAX_LOAD is 0: the motor gets no current", "p. 16"),
    ReasonSpec::nothing(
        "the speed of the position (or TAR_POSI_VEL) is 0: the motor does not move",
        "MDROBOT-19",
    ),
    ReasonSpec::nothing("PV_GAIN is 0: a position error gives no speed", "p. 15"),
    ReasonSpec::nothing("MAX_RPM is 0: the motor does not turn", "p. 16"),
    ReasonSpec::other("more than MAX_RPM: it acts as MAX_RPM", "MDROBOT-18"),
    ReasonSpec::other("this speed has no sign: a negative number acts as MAX_RPM", "p. 15"),
    ReasonSpec::nothing("the cause is still there: the alarm stays (see CTRL_STATUS)", "MDROBOT-31"),
    ReasonSpec::nothing("the key is missing: DL must be 0xAA, DH the value", "p. 12"),
    ReasonSpec::later("saved: it counts from the next power-on", "p. 12"),
    ReasonSpec::nothing("the key is missing: write 0x55", "p. 6"),
    ReasonSpec::nothing("this command is not modelled: it is echoed and does nothing", "MDROBOT-10"),
    ReasonSpec::nothing("there is no such command: it is echoed and does nothing", "MDROBOT-10"),
    ReasonSpec::other("more than the limit: MAX_LOAD acts as 200 and MAX_RPM as 5,000 at most", "MDROBOT-8"),
]);
