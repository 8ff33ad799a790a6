//! Errors of MCode (MC 9), and the flag and number of the last one.

use drivetwin_protocol::modbus::pdu::Exception;

/// An error, by its number (MC 9.1 to 9.7).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
#[expect(clippy::enum_variant_names, reason = "the names are the manual's")]
pub(super) enum Error {
    /// Another I/O has this type already.
    TypeTaken = 6,
    /// There is no such type of this I/O.
    IllegalType = 8,
    /// An I/O that is an input, or has a type, cannot be written.
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
    /// IC and DC do not count this.
    NotCountable = 26,
    TripNotDefined = 27,
    Redefined = 28,
    BuiltIn = 29,
    UnknownLabel = 30,
    LabelsFull = 31,
    /// A label has no value.
    IsLabel = 32,
    IsInstruction = 33,
    /// A variable is no instruction.
    IsVariable = 34,
    NotPrintable = 35,
    /// Steps and counts do not fit.
    IllegalRatio = 36,
    NotAvailable = 37,
    MissingSeparator = 38,
    /// TP and TR exclude each other.
    TripsTogether = 39,

    /// H without a program.
    NotRunning = 40,
    StackOverflow = 41,
    IllegalAddress = 42,
    /// Calls without a return.
    TooManyCalls = 43,
    Locked = 44,
    ProgramFull = 45,
    NotInProgramMode = 46,
    /// An input stopped the program.
    StoppedProgram = 48,

    IllegalBaud = 61,
    InputPending = 62,
    /// A Hybrid's.
    StartupCalibration = 64,

    Flash = 70,
    TemperatureWarning = 71,
    OverTemperature = 72,
    SaveInMotion = 73,
    /// IP or CP in motion.
    ClearInMotion = 74,
    /// A unit's without a sensor of its temperature.
    LinearOverTemperature = 75,

    NoHomeSwitch = 80,
    HomeType = 81,
    BothLimits = 82,
    PlusLimit = 83,
    MinusLimit = 84,
    /// A move while it homes, or a homing in motion.
    Homing = 85,
    Stall = 86,
    /// A jog in clock mode; on a Hybrid AS while it calibrates.
    JogInClockMode = 87,
    /// On a Hybrid, a move while it calibrates.
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
    /// Returns whether a program ends with it if OE's handler does not see it; after others it goes on with its next
    /// line.
    pub(super) fn ends_program(self) -> bool {
        matches!(self, Self::UnknownLabel | Self::StackOverflow | Self::IllegalAddress | Self::TooManyCalls)
    }

    /// Exception of the bus when this error refuses a request: 04 where the drive's state forbids a request that is
    /// legal otherwise, 03 for all others (MDRIVE-4).
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

/// EF and ER.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Errors {
    /// 0 if there is none.
    last: u8,
}

impl Errors {
    pub(super) const NONE: Self = Self { last: 0 };

    /// ER: the number of the last error, 0 without one.
    pub(super) fn number(self) -> u8 {
        self.last
    }

    /// EF.
    pub(super) fn is_set(self) -> bool {
        self.last != 0
    }

    pub(super) fn set(&mut self, error: Error) {
        self.put(error as u8);
    }

    /// ER is written, with 0 for none. That is no error that OE's handler is called for.
    pub(super) fn put(&mut self, number: u8) {
        self.last = number;
    }

    /// ER was read, or a program starts.
    pub(super) fn clear(&mut self) {
        self.put(0);
    }
}
