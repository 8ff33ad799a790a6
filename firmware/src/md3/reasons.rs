//! Reasons why the drive does not do what a request says, although it accepts the request.

use crate::device::{Context, Instant, Reason, ReasonSpec, reported};

/// Indices in [`REASONS`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub(super) enum Why {
    Fault,
    Disabled,
    BusInhibited,
    Inhibited,
    NoCurrent,
    Moves,
    NoSteps,
    NoSpeed,
    NoAlternateSpeed,
    NoAcceleration,
    DcMotor,
    NoHomingMode,
    AtHome,
    SeveralBits,
    TooHot,
    NextMove,
    SpeedLimit,
    CurrentCode,
    ParameterCode,
    NextPowerOn,
    SavesOnly,
    Saves,
    BadCrc,
}

impl Why {
    /// Reports the reason for the request that the drive is executing.
    pub(super) fn put(self, at: Instant, out: &mut dyn Context) {
        Reason(self as u8).put(at, out);
    }
}

/// The reasons, in the order of [`Why`].
pub(super) const REASONS: &[ReasonSpec] = reported(&[
    ReasonSpec::nothing("Fault is 1: the motor does not move; write 1 to bit 15 first", "7.15"),
    ReasonSpec::other("Disable (bit 5) is 1 in this write: write Move, Jog or Home without it", "7.15"),
    ReasonSpec::nothing("INHIBIT_MODBUS_MOTION (J2 pin 3) is active: only Disable counts", "7.8"),
    ReasonSpec::nothing("INHIBIT (J2 pin 3) is active: no current, the steps are lost", "7.8"),
    ReasonSpec::nothing("the current is 0: set bits 7:0 of MotorCurrentAndMicrostepping (or of 0x02)", "7.2"),
    ReasonSpec::nothing("a motion runs: ignored, not queued; Stop, or wait until bits 4:0 are 0", "MD3-4"),
    ReasonSpec::nothing("MoveSteps is 0: there is nothing to move", "7.16"),
    ReasonSpec::nothing("Speed is 0: nothing moves", "7.17"),
    ReasonSpec::nothing("SPEEDSEL selects AlternateSpeed, which is 0: nothing moves", "7.18"),
    ReasonSpec::nothing("AccelDecel is 0: nothing moves", "7.19"),
    ReasonSpec::nothing("the motor mode is DC (0x01 bit 13): only Jog works", "7.2"),
    ReasonSpec::nothing("this homing mode (0x04 bits 3:1) does not exist: Home does nothing", "7.5"),
    ReasonSpec::nothing("the home flag is active already, HomeOffset is 0: Home does not move", "7.5"),
    ReasonSpec::other("several bits: only the first of Stop, Decel-stop, Home, Jog, Move counts", "7.15"),
    ReasonSpec::nothing("still too hot: Fault stays 1; write bit 15 again when it has cooled", "7.15"),
    ReasonSpec::later("a move runs: the new value counts from the next move", "7.17"),
    ReasonSpec::other("a speed acts as 40,000 at most", "7.17"),
    ReasonSpec::other("this current code is not in the table: it acts as the last one", "7.2"),
    ReasonSpec::other("this microstepping or PWM code is not in the table: it acts as 8", "7.2"),
    ReasonSpec::later("StartupDelay counts from the next power-on, if EEPROMControl saves it", "7.4"),
    ReasonSpec::other("bits 0 and 1 together: it saves, and does not read", "7.20"),
    ReasonSpec::nothing("a save runs: ignored; wait until bit 0 reads 0", "7.20"),
    ReasonSpec::nothing("the EEPROM's CRC fails (0xF1): nothing is read; save first", "7.20"),
]);
