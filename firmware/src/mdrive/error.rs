//! Errors of MCode (MC 9), and the last error (EF, ER).

use drivetwin_protocol::modbus::pdu::Exception;

use super::registers::Reg;
use crate::device::reported;

/// An error, by its number (MC 9.1 to 9.7).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
#[expect(clippy::enum_variant_names, reason = "the names are the manual's")]
pub(super) enum Error {
    /// Another I/O already has this type.
    TypeTaken = 6,
    /// This I/O has no such type.
    IllegalType = 8,
    /// Only a general purpose output can be written: not an input, not an output with a type.
    NoOutput = 9,
    IllegalIo = 10,
    IllegalClockType = 11,
    IllegalTrip = 12,

    Unknown = 20,
    IllegalValue = 21,
    /// VI is not below VM.
    InitialVelocity = 22,
    /// VM is not above VI.
    MaximumVelocity = 23,
    IllegalData = 24,
    ReadOnly = 25,
    /// IC and DC cannot count this name.
    NotCountable = 26,
    TripNotDefined = 27,
    Redefined = 28,
    BuiltIn = 29,
    UnknownLabel = 30,
    LabelsFull = 31,
    /// A label cannot be set to a value.
    IsLabel = 32,
    IsInstruction = 33,
    /// A line has only the name of a variable, which is not an instruction.
    IsVariable = 34,
    NotPrintable = 35,
    /// Encoder lines (EL) and microsteps (MS) do not fit each other.
    IllegalRatio = 36,
    NotAvailable = 37,
    MissingSeparator = 38,
    /// TP and TR exclude each other.
    TripsTogether = 39,

    /// H while no program runs.
    NotRunning = 40,
    StackOverflow = 41,
    IllegalAddress = 42,
    /// Too many nested calls.
    TooManyCalls = 43,
    Locked = 44,
    ProgramFull = 45,
    NotInProgramMode = 46,
    /// An input stopped the program.
    StoppedProgram = 48,

    IllegalBaud = 61,
    InputPending = 62,
    /// The calibration at start-up failed (Hybrid only).
    StartupCalibration = 64,

    Flash = 70,
    TemperatureWarning = 71,
    OverTemperature = 72,
    SaveInMotion = 73,
    /// IP or CP in motion.
    ClearInMotion = 74,
    /// Over-temperature of a product without an internal temperature sensor.
    LinearOverTemperature = 75,

    NoHomeSwitch = 80,
    HomeType = 81,
    BothLimits = 82,
    PlusLimit = 83,
    MinusLimit = 84,
    /// A move during homing, or homing during a motion.
    Homing = 85,
    Stall = 86,
    /// A jog in clock mode. On a Hybrid, writing AS during a calibration.
    JogInClockMode = 87,
    /// On a Hybrid, a motion command during a calibration.
    Calibrating = 88,
    CalibrationInMotion = 89,
    /// The motion variables are too low for EE = 1.
    TooSlowForEncoder = 90,
    /// An input stopped the motion.
    StoppedMotion = 91,
    PositionError = 92,
    Correcting = 93,
    ClearLockedInMotion = 94,

    LockedRotor = 104,
    MaximumPosition = 105,
    LeadLimit = 106,
    LagLimit = 107,
    CalibrationFailed = 109,
}

/// The errors by their numbers, in the words of MC 9, shortened.
pub(super) const TEXTS: &[(u8, &str)] = reported(&[
    (6, "an I/O is already set to this type"),
    (8, "tried to set an I/O to an incorrect I/O type"),
    (9, "tried to write to an I/O that is set as input or has a type"),
    (10, "illegal I/O number"),
    (11, "incorrect clock type"),
    (12, "illegal trip or capture"),
    (20, "tried to set an unknown variable or flag"),
    (21, "tried to set an incorrect value"),
    (22, "VI is set greater than or equal to VM"),
    (23, "VM is set less than or equal to VI"),
    (24, "illegal data entered"),
    (25, "variable or flag is read only"),
    (26, "variable or flag is not allowed to be incremented or decremented"),
    (27, "trip not defined"),
    (28, "trying to redefine a program label or variable"),
    (29, "trying to redefine a built in command, variable or flag"),
    (30, "unknown label or user variable"),
    (31, "program label or user variable table is full"),
    (32, "trying to set a label (LB)"),
    (33, "trying to set an instruction"),
    (34, "trying to execute a variable or flag"),
    (35, "trying to print an illegal variable or flag"),
    (36, "illegal motor count to encoder count ratio"),
    (37, "command, variable or flag not available in drive"),
    (38, "missing parameter separator"),
    (39, "trip on position and trip on relative distance not allowed together"),
    (40, "program not running"),
    (41, "stack overflow"),
    (42, "illegal program address"),
    (43, "tried to overflow program stack"),
    (44, "program locked"),
    (45, "trying to overflow program space"),
    (46, "not in program mode"),
    (48, "program execution stopped by I/O set as stop"),
    (61, "trying to set illegal BAUD rate"),
    (62, "IV already pending or IF flag already true"),
    (64, "startup calibration failed"),
    (70, "FLASH check sum fault"),
    (71, "internal temperature warning"),
    (72, "internal over temp fault, disabling drive"),
    (73, "tried to save while moving"),
    (74, "tried to initialize parameters (IP) or clear program (CP) while moving"),
    (75, "linear overtemperature error"),
    (80, "HOME switch not defined"),
    (81, "HOME type not defined"),
    (82, "went to both limits and did not find home"),
    (83, "reached plus LIMIT switch"),
    (84, "reached minus LIMIT switch"),
    (85, "MA or MR is not allowed during a HOME, and a HOME not while in motion"),
    (86, "stall detected"),
    (87, "JOG not allowed in clock mode; Hybrid: AS not allowed while calibrating"),
    (88, "moves not allowed while calibration is in progress"),
    (89, "calibration not allowed while motion is in progress"),
    (90, "motion variables are too low switching to EE=1"),
    (91, "motion stopped by I/O set as stop"),
    (92, "position error in closed loop"),
    (93, "MR or MA not allowed while correcting position at end of previous MR or MA"),
    (94, "clear locked rotor fault not allowed while in motion"),
    (104, "locked rotor"),
    (105, "maximum position count reached"),
    (106, "lead limit reached"),
    (107, "lag limit reached"),
    (109, "calibration failed"),
]);

impl Error {
    /// Returns true if this error ends the program, provided that OE's handler is not called. After any other
    /// error the program continues with its next line.
    pub(super) fn ends_program(self) -> bool {
        matches!(self, Self::UnknownLabel | Self::StackOverflow | Self::IllegalAddress | Self::TooManyCalls)
    }

    /// Modbus exception for a request that this error refuses: 04 if the drive's state forbids a request that
    /// is otherwise legal, 03 for all others (MDRIVE-4).
    pub(super) fn exception(self) -> Exception {
        match self {
            Self::NoOutput
            | Self::TripNotDefined
            | Self::SaveInMotion
            | Self::NoHomeSwitch
            | Self::Homing
            | Self::JogInClockMode
            | Self::Calibrating
            | Self::CalibrationInMotion
            | Self::ClearLockedInMotion => Exception::ServerDeviceFailure,
            _ => Exception::IllegalDataValue,
        }
    }
}

/// Error for a value outside of its range.
pub(super) fn illegal(reg: Reg) -> Error {
    match reg {
        Reg::HM => Error::HomeType,
        Reg::IC | Reg::DC => Error::NotCountable,
        Reg::BD => Error::IllegalBaud,
        _ => Error::IllegalValue,
    }
}

/// The last error: EF and ER.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Errors {
    /// Number of the error, 0 for none.
    last: u8,
}

impl Errors {
    pub(super) const NONE: Self = Self { last: 0 };

    /// ER: the number of the last error, 0 for none.
    pub(super) fn number(self) -> u8 {
        self.last
    }

    /// EF: true if there is an error.
    pub(super) fn is_set(self) -> bool {
        self.last != 0
    }

    pub(super) fn set(&mut self, error: Error) {
        self.put(error as u8);
    }

    /// Stores the number of an error, 0 for none. A write of ER uses this directly, because it does not call
    /// OE's handler.
    pub(super) fn put(&mut self, number: u8) {
        self.last = number;
    }

    /// Clears the error when ER has been read or a program starts.
    pub(super) fn clear(&mut self) {
        self.put(0);
    }
}
