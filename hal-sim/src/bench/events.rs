//! Events that a bench schedules.

use std::sync::Arc;

use drivetwin_firmware::device::{Axis, Encoder, Instant, Level, Pin, Port};
use drivetwin_protocol::modbus::{FRAME_BYTES, rtu};

use super::DriveId;
use super::tcp_faults::StreamPart;
use crate::line::Refusal;
use crate::record::trace::InputRecord;
use crate::slot::{PinStimulus, WholeFrame};

/// Characters that the ports of a line receive at the same instant, one after the other in the order of their drives.
/// If characters take no time, each port then detects the end of the frame.
#[derive(Debug)]
pub(crate) struct Heard {
    bytes: Arc<[u8]>,
    receivers: Arc<[(DriveId, Port)]>,
    /// The port that does not receive them.
    except: Option<(DriveId, Port)>,
    /// Time at which a drive of the line began to send them; `None` if a client sends them.
    pub(crate) began: Option<Instant>,
    /// True if each port detects the end of the frame at the same instant.
    ends: bool,
    /// Address of the slave, if the characters and their end are a whole RTU frame.
    address: Option<u8>,
    /// Index of the next receiver.
    next: usize,
    /// True if the next receiver has the characters already.
    has_bytes: bool,
}

impl Heard {
    /// Characters for all `receivers` but one.
    pub(crate) fn new(
        bytes: Arc<[u8]>,
        receivers: Arc<[(DriveId, Port)]>,
        except: Option<(DriveId, Port)>,
        began: Option<Instant>,
        ends: bool,
    ) -> Self {
        let is_whole = ends && bytes.len() <= FRAME_BYTES;
        let frame = if is_whole { rtu::verify_crc(&bytes) } else { None };
        let address = frame.and_then(|frame| frame.first().copied());
        Self { bytes, receivers, except, began, ends, address, next: 0, has_bytes: false }
    }

    /// The whole frame that the next receiver gets; `None` if the characters are none, or if it has them already.
    pub(crate) fn frame(&self) -> Option<WholeFrame<'_>> {
        let (&(_, port), address) =
            (self.receivers.get(self.next)?, self.address.filter(|_| !self.has_bytes)?);
        Some(WholeFrame { port, address, bytes: &self.bytes, began: self.began })
    }

    /// The drive that receives next.
    pub(crate) fn receiver(&mut self) -> Option<DriveId> {
        if self.except.is_some() && self.receivers.get(self.next).copied() == self.except {
            self.next += 1;
        }
        self.receivers.get(self.next).map(|&(drive, _)| drive)
    }

    /// The next input of the [receiver](Self::receiver).
    pub(crate) fn input(&self) -> Option<InputRecord> {
        let &(_, port) = self.receivers.get(self.next)?;
        let bytes = &self.bytes;
        let end = InputRecord::Idle { port };
        Some(if self.has_bytes { end } else { InputRecord::Bytes { port, bytes: Arc::clone(bytes) } })
    }

    /// Removes the [frame](Self::frame) of the next receiver.
    pub(crate) fn pop_frame(&mut self) {
        self.next += 1;
    }

    /// Removes the next [input](Self::input).
    pub(crate) fn pop(&mut self) {
        self.has_bytes = self.ends && !self.has_bytes;
        self.next += usize::from(!self.has_bytes);
    }
}

/// A scheduled event.
#[derive(Debug)]
pub(crate) enum EventKind {
    /// An input of a drive.
    Input(InputRecord),
    /// Characters that the ports of a line receive at the same instant.
    Heard(Heard),
    /// An input of a drive on the same line as the sending drive, which began to send at `began`.
    Overheard { input: InputRecord, began: Instant },
    /// A received character that is corrupt if it overlaps another one. `number` identifies its transmission
    /// on the line; `overheard` is true if another drive sends it.
    MayCollide { input: InputRecord, number: u32, overheard: bool },
    /// A fault answers a request on a line that ended at `end`, in place of a drive. `number` identifies the request if
    /// characters may collide.
    Refused { refusal: Refusal, request: Vec<u8>, end: Instant, number: Option<u32> },
    /// An input of a drive on a TCP connection. It is dropped if the client's connection has been closed by
    /// then.
    TcpInput { client: u32, input: InputRecord },
    /// A delayed part of the stream from a drive to its client.
    StreamPart { client: u32, part: StreamPart },
    /// A stimulus of a pin from outside.
    Stimulus { pin: Pin, stimulus: PinStimulus },
    /// The initial levels at the pins of a drive that was added at this instant.
    InitialLevels,
    /// The level at the input end of a wire changes.
    WireLevel { wire: u32, level: Level },
    /// The next edge of a pulse train. `number` distinguishes this train from earlier ones on the pin, so
    /// that an outdated event is ignored; `number` of encoders, waves and axes does the same.
    Pulse { pin: Pin, number: u32 },
    /// The next edge of an encoder.
    Encoder { encoder: Encoder, number: u32 },
    /// The next edge of a wave on an output.
    Wave { pin: Pin, number: u32 },
    /// The next edge of the step pulses of an axis.
    Steps { axis: Axis, number: u32 },
    /// A motor is due; the target of the event is its index as for [`motor_at`](super::motors::motor_at).
    /// `number` distinguishes this prediction from earlier ones.
    Motor { number: u32 },
    /// Reports of a motor arrive at its drive.
    MotorReports { motor: u32 },
    /// The next action of the scenario with that number is due.
    Scenario { number: usize },
    /// The turn of a client on a line may be over.
    TurnEnd { bus: u32 },
}
