//! Events that are under way on a bench.

use drivetwin_firmware::device::{Axis, Encoder, Instant, Level, Pin};

use crate::record::trace::InputRecord;
use crate::slot::PinStimulus;

/// An event that is under way.
#[derive(Debug)]
pub(crate) enum EventKind {
    /// To be fed to a device.
    InputRecord(InputRecord),
    /// To be fed to a device that shares a line with the one that began to say it then.
    Overheard { fed: InputRecord, began: Instant },
    /// A character to be fed to a device, if it overlaps no other one: it belongs to what has that number on the
    /// line.
    Exposed { fed: InputRecord, number: u32 },
    /// To be fed to a device, unless the connection on which that client said it is closed by then.
    TcpSend { client: u32, fed: InputRecord },
    /// A change of a pin from outside.
    Hand { pin: Pin, drive: PinStimulus },
    /// Levels at the pins of a device that was seated at this instant.
    Contacts,
    /// The other end of a wire takes a level.
    Wired { wire: u32, level: Level },
    /// The next edge of a train of pulses. `number` tells it from earlier trains on the pin; so it is
    /// with encoders, waves and axes.
    Pulse { pin: Pin, number: u32 },
    /// The next edge of an encoder.
    Encoder { encoder: Encoder, number: u32 },
    /// The next edge of a wave on an output.
    Wave { pin: Pin, number: u32 },
    /// The next edge of the step pulses of an axis.
    Steps { axis: Axis, number: u32 },
    /// Work is due at a motor, which has a number in place of a device; `number` tells it from earlier predictions.
    Motor { number: u32 },
    /// Reports of a motor arrive at its drive.
    MotorReports { motor: u32 },
    /// The turn of a client on a line may end.
    Turn { bus: u32 },
}
