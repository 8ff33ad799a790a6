//! Events that are scheduled on a bench.

use drivetwin_firmware::device::{Axis, Encoder, Instant, Level, Pin};

use crate::record::trace::InputRecord;
use crate::slot::PinStimulus;

/// A scheduled event.
#[derive(Debug)]
pub(crate) enum EventKind {
    /// An input of a drive.
    Input(InputRecord),
    /// An input of a drive that shares its line with the sender, which began to send at `began`.
    Overheard { input: InputRecord, began: Instant },
    /// A received character that is corrupt if it overlaps another one; `number` identifies its transmission on the
    /// line.
    MayCollide { input: InputRecord, number: u32 },
    /// An input of a drive on a TCP connection; dropped if the connection of the client is closed by then.
    TcpInput { client: u32, input: InputRecord },
    /// A stimulus of a pin from outside.
    Stimulus { pin: Pin, stimulus: PinStimulus },
    /// Levels at the pins of a drive that was added at this instant.
    InitialLevels,
    /// The level at the input end of a wire changes.
    WireLevel { wire: u32, level: Level },
    /// The next edge of a pulse train. `number` distinguishes it from earlier trains on the pin; likewise for
    /// encoders, waves and axes.
    Pulse { pin: Pin, number: u32 },
    /// The next edge of an encoder.
    Encoder { encoder: Encoder, number: u32 },
    /// The next edge of a wave on an output.
    Wave { pin: Pin, number: u32 },
    /// The next edge of the step pulses of an axis.
    Steps { axis: Axis, number: u32 },
    /// A motor is due, whose index is that of [`motor_at`](super::motors::motor_at); `number` distinguishes it from
    /// earlier predictions.
    Motor { number: u32 },
    /// Reports of a motor arrive at its drive.
    MotorReports { motor: u32 },
    /// The turn of a client on a line may be over.
    TurnEnd { bus: u32 },
}
