//! The pin-out of the board, typed by hand from its README. A wrong wire in an image makes its traces fail.

use drivetwin_firmware::device::Pin;
use drivetwin_sim::record::trace::Trace;

use crate::machine::Gpio;

/// A jumper that disables the start-up delay if it is low at reset.
pub(crate) const FAST: Gpio = Gpio('B', 6);
/// The direction of the RS-485 transceiver, which sends while this pin is high.
pub(crate) const DE: Gpio = Gpio('B', 5);
/// The step pulses of the axis.
pub(crate) const STEP: Gpio = Gpio('B', 3);
/// The direction of the axis: high is forward.
pub(crate) const DIR: Gpio = Gpio('B', 4);

/// Names of a drive's pins and faults, each with its pin of the board.
pub(crate) type Wires = Vec<(&'static str, Gpio)>;

/// The wires of a kind of drive.
pub(crate) fn wires(kind: &str) -> Wires {
    match kind {
        "md3" | "md3-low" => MD3.to_vec(),
        "qsb-d" | "qsb-m" | "qsb-s" => QSB.to_vec(),
        "rs434544" | "rs434546" => RS434.to_vec(),
        "mdrobot" => MDROBOT.to_vec(),
        "mdrive" | "mdrive-hybrid" => MDRIVE.to_vec(),
        _ => panic!("the pin-out of a {kind} is missing here"),
    }
}

/// STEP and DIR of the drive of a trace, if their pins also serve other purposes.
pub(crate) fn shared(trace: &Trace, wires: &Wires) -> Option<(Pin, Pin)> {
    let spec = trace.drives.first()?.spec;
    let (step, dir) = spec.axes.first()?.step_dir?;
    let name = spec.pins.get(usize::from(step.0))?.name;
    wires.iter().any(|(wired, _)| *wired == name).then_some((step, dir))
}

static MD3: [(&str, Gpio); 13] = [
    ("J2.2", Gpio('D', 4)),
    ("J2.3", Gpio('D', 5)),
    ("J2.4", Gpio('D', 6)),
    ("J2.5", Gpio('D', 7)),
    ("J2.9", Gpio('C', 4)),
    ("J2.10", Gpio('C', 5)),
    ("J2.12", Gpio('C', 6)),
    ("J3.7", Gpio('B', 1)),
    ("J3.8", Gpio('B', 2)),
    ("D5", Gpio('B', 0)),
    ("D6", Gpio('F', 0)),
    ("over_temperature", Gpio('A', 7)),
    ("over_current", Gpio('G', 0)),
];

static QSB: [(&str, Gpio); 8] = [
    ("A", Gpio('D', 4)),
    ("B", Gpio('D', 5)),
    ("I", Gpio('D', 6)),
    ("DTR", Gpio('D', 7)),
    ("DIO0", Gpio('C', 4)),
    ("DIO1", STEP),
    ("DIO2", DIR),
    ("DIO3", Gpio('C', 5)),
];

static RS434: [(&str, Gpio); 17] = [
    ("IN1", Gpio('D', 4)),
    ("IN2", Gpio('D', 5)),
    ("HARD_STOP", Gpio('D', 6)),
    ("CLR_FLASH", Gpio('D', 7)),
    ("HA", Gpio('C', 4)),
    ("HB", Gpio('C', 5)),
    ("RED", Gpio('B', 0)),
    ("GREEN", Gpio('F', 0)),
    ("supply_voltage", Gpio('A', 2)),
    ("short_circuit", Gpio('A', 3)),
    ("brake_overheat", Gpio('A', 4)),
    ("power_overheat", Gpio('A', 5)),
    ("hall", Gpio('A', 6)),
    ("mcu_overheat", Gpio('A', 7)),
    ("switches", Gpio('G', 0)),
    ("current_limit", Gpio('G', 1)),
    ("stall", Gpio('C', 6)),
];

static MDROBOT: [(&str, Gpio); 24] = [
    ("INT_SPEED", Gpio('D', 0)),
    ("ALARM_RESET", Gpio('D', 1)),
    ("DIR", Gpio('D', 4)),
    ("RUN_BRAKE", Gpio('D', 5)),
    ("START_STOP", Gpio('D', 6)),
    ("ENC_A", Gpio('D', 7)),
    ("ENC_B", Gpio('C', 4)),
    ("SPEED_IN", Gpio('C', 5)),
    ("PULSE_IN", Gpio('C', 6)),
    ("ALARM", Gpio('B', 0)),
    ("CLUTCH", Gpio('B', 1)),
    ("FAN", Gpio('F', 0)),
    ("HU", Gpio('E', 0)),
    ("HV", Gpio('E', 1)),
    ("HW", Gpio('E', 2)),
    ("over_voltage", Gpio('A', 2)),
    ("over_temperature", Gpio('A', 3)),
    ("overload", Gpio('A', 4)),
    ("hall_fail", Gpio('A', 5)),
    ("encoder_fail", Gpio('A', 6)),
    ("inverse_velocity", Gpio('A', 7)),
    ("stall", Gpio('G', 0)),
    ("ctrl_fail", Gpio('G', 1)),
    ("regen_over_temperature", Gpio('C', 7)),
];

static MDRIVE: [(&str, Gpio); 16] = [
    ("IO1", Gpio('D', 4)),
    ("IO2", Gpio('D', 5)),
    ("IO3", Gpio('D', 6)),
    ("IO4", Gpio('D', 7)),
    ("IO7", Gpio('C', 4)),
    ("IO8", Gpio('C', 5)),
    ("CAPTURE", Gpio('C', 6)),
    ("A", Gpio('E', 0)),
    ("B", Gpio('E', 1)),
    ("I", Gpio('E', 2)),
    ("stall", Gpio('A', 2)),
    ("locked_rotor", Gpio('A', 3)),
    ("lead_limit", Gpio('A', 4)),
    ("lag_limit", Gpio('A', 5)),
    ("over_temperature", Gpio('A', 6)),
    ("calibration", Gpio('A', 7)),
];
