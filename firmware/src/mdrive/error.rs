//! Errors of MCode (MC 9), and the last error (EF, ER).

use drivetwin_protocol::modbus::pdu::Exception;

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
