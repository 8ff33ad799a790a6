//! The codes of COMMAND (p. 6): the effect of each, or the reason why it has none.

use super::registers::{LATER, Pid};
use super::{CLUTCH, FAN};
use crate::device::{CommandSpec, Level, Pin};

/// Action of a code.
#[derive(Clone, Copy, Debug)]
pub(super) enum Act {
    /// Acts like a write of any word to that PID.
    As(Pid),
    /// Acts like a write of that value to that PID.
    Set(Pid, i64),
    /// Restores the factory values of those PIDs.
    Erase(&'static [Pid]),
    /// Sets an output to a level.
    Switch(Pin, Level),
    /// No effect.
    Nothing,
}

use Act::{As, Erase, Nothing, Set, Switch};

const OWN_PROTOCOL: &str = "broadcasts use the maker's own protocol";
const ONE_MOTOR: &str = "an MD400 has one motor";
const NO_CAN: &str = "there is no CAN";

const fn does(code: u16, name: &'static str, doc: &'static str, act: Act) -> (CommandSpec, Act) {
    (CommandSpec { code, name, section: page(code), doc, missing: "" }, act)
}

const fn known(
    code: u16,
    name: &'static str,
    doc: &'static str,
    missing: &'static str,
) -> (CommandSpec, Act) {
    (CommandSpec { code, name, section: page(code), doc, missing }, Nothing)
}

/// The page of the manual that lists a code.
const fn page(code: u16) -> &'static str {
    match code {
        ..32 => "p. 6",
        32..56 => "p. 7",
        _ => LATER,
    }
}

/// The codes of the manual, with the header's names where it has them, and two more that public clients use
/// (MDROBOT-7).
#[rustfmt::skip]
const ROWS: [(CommandSpec, Act); 38] = [
    does(2, "TQ_OFF", "as TQ_OFF", As(Pid::TQ_OFF)),
    does(4, "BRAKE", "as BRAKE", As(Pid::BRAKE)),
    known(5, "MAIN_DATA_BC_ON", "sends MAIN_DATA repeatedly", OWN_PROTOCOL),
    known(6, "MAIN_DATA_BC_OFF", "stops MAIN_DATA", OWN_PROTOCOL),
    does(8, "ALARM_RESET", "as ALARM_RESET", As(Pid::ALARM_RESET)),
    does(10, "POSI_RESET", "as POSI_RESET", As(Pid::POSI_RESET)),
    known(11, "MONITOR_BC_ON", "sends MONITOR repeatedly", OWN_PROTOCOL),
    known(12, "MONITOR_BC_OFF", "stops MONITOR", OWN_PROTOCOL),
    known(13, "IO_MONITOR_BC_ON", "sends IO_MONITOR repeatedly", OWN_PROTOCOL),
    known(14, "IO_MONITOR_BC_OFF", "stops IO_MONITOR", OWN_PROTOCOL),
    does(15, "FAN_ON", "FAN is high", Switch(FAN, Level::High)),
    does(16, "FAN_OFF", "FAN is low", Switch(FAN, Level::Low)),
    does(17, "CLUTCH_ON", "CLUTCH is high; the brake itself is not modelled", Switch(CLUTCH, Level::High)),
    does(18, "CLUTCH_OFF", "CLUTCH is low", Switch(CLUTCH, Level::Low)),
    does(20, "TAR_VEL_OFF", "TAR_VEL is 0", Erase(&[Pid::TAR_VEL])),
    does(21, "SLOW_START_OFF", "SLOW_START is 0", Erase(&[Pid::SLOW_START])),
    does(22, "SLOW_DOWN_OFF", "SLOW_DOWN is 0", Erase(&[Pid::SLOW_DOWN])),
    known(23, "CAN_RESEND_ON", "forwards messages of CAN", NO_CAN),
    known(24, "CAN_RESEND_OFF", "stops that", NO_CAN),
    does(25, "MAX_LOAD_OFF", "MAX_LOAD is 200", Erase(&[Pid::MAX_LOAD])),
    does(26, "ENC_PPR_OFF", "ENC_PPR is 0", Erase(&[Pid::ENC_PPR])),
    does(27, "LOW_SPEED_LIMIT_OFF", "LOW_SPEED_LIMIT is 0", Erase(&[Pid::LOW_SPEED_LIMIT])),
    does(28, "HIGH_SPEED_LIMIT_OFF", "HIGH_SPEED_LIMIT is 0", Erase(&[Pid::HIGH_SPEED_LIMIT])),
    does(29, "SPEED_LIMIT_OFF", "LOW_SPEED_LIMIT and HIGH_SPEED_LIMIT are 0", Erase(&[Pid::LOW_SPEED_LIMIT, Pid::HIGH_SPEED_LIMIT])),
    known(31, "CURVE_OFF", "cancels the fitted curve of the speed input", "the manual does not describe it"),
    does(32, "STEP_OFF", "INPUT_TYPE is 0", Erase(&[Pid::INPUT_TYPE])),
    does(44, "UI_COM_OFF", "as UI_COM with 0", Set(Pid::UI_COM, 0)),
    does(45, "UI_COM_ON", "as UI_COM with 1", Set(Pid::UI_COM, 1)),
    does(46, "MAX_RPM_OFF", "MAX_RPM is 3,000", Erase(&[Pid::MAX_RPM])),
    does(47, "HALL_TYPE_OFF", "HALL_TYPE is 0", Erase(&[Pid::HALL_TYPE])),
    known(50, "MAIN_BC_ON2", "as 5, for the second motor", ONE_MOTOR),
    known(51, "MAIN_BC_OFF2", "as 6, for the second motor", ONE_MOTOR),
    known(52, "MONITOR_BC_ON2", "as 11, for the second motor", ONE_MOTOR),
    known(53, "MONITOR_BC_OFF2", "as 12, for the second motor", ONE_MOTOR),
    known(54, "IO_MONITOR_BC_ON2", "as 13, for the second motor", ONE_MOTOR),
    known(55, "IO_MONITOR_BC_OFF2", "as 14, for the second motor", ONE_MOTOR),
    does(71, "POSI_SS_OFF", "POSI_SS is 0", Erase(&[Pid::POSI_SS])),
    does(72, "POSI_SD_OFF", "POSI_SD is 0", Erase(&[Pid::POSI_SD])),
];

/// Descriptions of the commands, for `describe`.
pub(super) static COMMANDS: [CommandSpec; ROWS.len()] = SPLIT.0;

/// Actions of the commands, for the drive.
static ACTS: [(u16, Act); ROWS.len()] = SPLIT.1;

const SPLIT: ([CommandSpec; ROWS.len()], [(u16, Act); ROWS.len()]) = split(ROWS);

/// Separates descriptions and actions, because a drive needs no text.
#[expect(clippy::indexing_slicing, reason = "only ever evaluated by the compiler")]
const fn split<const N: usize>(rows: [(CommandSpec, Act); N]) -> ([CommandSpec; N], [(u16, Act); N]) {
    let mut commands = [CommandSpec { code: 0, name: "", section: "", doc: "", missing: "" }; N];
    let mut acts = [(0, Nothing); N];
    let mut i = 0;
    while i < N {
        (commands[i], acts[i]) = (rows[i].0, (rows[i].0.code, rows[i].1));
        i += 1;
    }
    (commands, acts)
}

/// The action of a code; `None` if the code has no row (newer controllers have more codes).
pub(super) fn act(code: u16) -> Option<Act> {
    ACTS.iter().find(|(known, _)| *known == code).map(|&(_, act)| act)
}
