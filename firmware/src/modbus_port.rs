//! The serial Modbus port of a slave: its receiver, start-up, replies, and changes of the line.

use drivetwin_protocol::modbus::server::{Outcome, RequestHandler, Rules, serve_serial};
use drivetwin_protocol::modbus::{DropReason, Frame, Receiver};

use crate::device::{Context, Duration, Input, Instant, Line, LogEvent, Output, Port};

/// A serial Modbus port. The drive passes it its [inputs](Self::input), and calls [`serve`](Self::serve) when a message
/// [is over](Self::is_over).
///
/// All drives with this port have two rules for what falls into one instant (MODBUS-7). What is due then, a message that is
/// over included, comes before a [reception](is_reception). And a character whose last bit ends before the port receives
/// is lost; after a start-up delay it receives from the tick after its end on.
#[derive(Clone, Debug)]
pub struct ModbusPort<R> {
    port: Port,
    receiver: R,
    /// Duration of a character.
    character: Duration,
    receives_from: Instant,
}

impl<R: Receiver> ModbusPort<R> {
    /// A port without power.
    #[must_use]
    #[inline]
    pub fn new(port: Port, line: Line) -> Self {
        Self { port, receiver: R::new(line), character: line.character(), receives_from: Instant::NEVER }
    }

    /// Starts the port at power-on or at a restart, with the settings `line`. `ready` is the end of the start-up; without
    /// a delay it is not after `at`. An incomplete message is lost.
    pub fn start(&mut self, at: Instant, line: Line, ready: Instant, out: &mut dyn Context) {
        self.receiver.clear();
        self.receives_from = if ready > at { ready + Duration::TICK } else { Instant::ZERO };
        self.set_line(at, line, out);
    }

    /// Drops an incomplete message, and all characters until the next [`start`](Self::start).
    pub fn mute(&mut self) {
        self.receiver.clear();
        self.receives_from = Instant::NEVER;
    }

    /// Time from which the port receives.
    #[must_use]
    pub fn receives_from(&self) -> Instant {
        self.receives_from
    }

    /// Changes the settings of the line for all further messages; the drive changes its transmitter at `from`, the end of
    /// a reply with the old settings. A message that begins before is misread.
    pub fn set_line(&mut self, from: Instant, line: Line, out: &mut dyn Context) {
        self.receiver.set_line(from, line);
        self.character = line.character();
        out.put(from, Output::Line { port: self.port, line });
    }

    /// Handles an input if it concerns this port. Returns true if it ends a message, which the drive then
    /// [serves](Self::serve).
    #[inline]
    pub fn input(&mut self, at: Instant, input: &Input<'_>, out: &mut dyn Context) -> bool {
        match *input {
            Input::Bytes { port, bytes } if port == self.port => self.bytes(at, bytes, out),
            Input::RxError { port } if port == self.port && at >= self.receives_from => {
                self.receiver.rx_error(at);
            }
            Input::Idle { port } => return port == self.port,
            _ => {}
        }
        false
    }

    /// Handles received characters that follow each other without a gap; `at` is the end of the first one.
    fn bytes(&mut self, at: Instant, bytes: &[u8], out: &mut dyn Context) {
        let (first, received) = self.received(at, bytes);
        if received.len() < bytes.len() {
            out.put(at, Output::Log(LogEvent::Dropped { port: self.port, why: DropReason::Starting }));
        }
        self.receiver.bytes(first, received);
    }

    /// Removes the characters that end before the port receives. Returns the end of the first remaining character, and
    /// the remaining characters.
    fn received<'a>(&self, at: Instant, bytes: &'a [u8]) -> (Instant, &'a [u8]) {
        if at >= self.receives_from {
            return (at, bytes);
        }
        let missed = (self.receives_from - Duration::TICK).since(at) / self.character + 1;
        let received = usize::try_from(missed).ok().and_then(|missed| bytes.get(missed..)).unwrap_or(&[]);
        (at + self.character * missed, received)
    }

    /// Returns true if the slave `unit` would only drop a whole frame for the slave `address` that ends at `at`.
    #[must_use]
    pub fn is_for_others(&self, at: Instant, unit: u8, rules: &Rules, address: u8) -> bool {
        let is_silent = self.deadline() == Instant::NEVER;
        is_silent && at >= self.receives_from && address != unit && rules.broadcast != Some(address)
    }

    /// Time at which a message ends if no more characters follow.
    #[must_use]
    pub fn deadline(&self) -> Instant {
        self.receiver.deadline()
    }

    /// Returns true if a message has ended at `at`, or before a character that ends at `at`.
    #[must_use]
    pub fn is_over(&self, at: Instant) -> bool {
        self.deadline() <= at
    }

    /// Serves the message that has ended, for the slave `unit`. Writes the body of the reply into `reply`, which is empty
    /// if the slave does not reply. Returns `None` without a message.
    #[inline]
    pub fn serve<M: RequestHandler>(
        &mut self,
        unit: u8,
        rules: &Rules,
        handler: &mut M,
        reply: &mut Frame,
    ) -> Option<Outcome> {
        reply.clear();
        Some(match self.receiver.take_body()? {
            Ok(body) => serve_serial(body, unit, rules, handler, reply),
            Err(why) => Outcome::Dropped(why),
        })
    }

    /// Notes the outcome of a message, and sends the reply `delay` after `at`. Returns the number of characters that it
    /// sends, 0 without a reply. `reply` has any content afterwards.
    #[inline]
    pub fn answer(
        &self,
        at: Instant,
        delay: Duration,
        outcome: Outcome,
        reply: &mut Frame,
        out: &mut dyn Context,
    ) -> usize {
        let port = self.port;
        out.put(at, Output::Log(LogEvent::of(port, outcome)));
        if reply.is_empty() {
            return 0;
        }
        let message = self.receiver.message(reply);
        let bytes = message.as_ref();
        out.put(at + delay, Output::Bytes { port, bytes });
        bytes.len()
    }

    /// Duration of characters on the line.
    #[must_use]
    pub fn duration(&self, characters: usize) -> Duration {
        self.character * characters as u64
    }
}

/// Returns true for an input that comes after all other inputs of its instant: characters, and the end of a frame. Before
/// it, a drive with a [`ModbusPort`] handles what is [due](crate::device::Device::timeout), so that one that starts without
/// a delay is ready.
#[must_use]
pub fn is_reception(input: &Input<'_>) -> bool {
    matches!(input, Input::Bytes { .. } | Input::RxError { .. } | Input::Idle { .. })
}

#[cfg(test)]
mod tests;
