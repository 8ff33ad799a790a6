//! Lines: what they are called, which ports are on them, and at which settings.

use drivetwin_firmware::device::{Duration, Line, Port};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::ascii;
use drivetwin_protocol::modbus::rtu::Timing;

use super::{Bench, Bus, DriveId};
use crate::line::{LineMode, SerialLine};
use crate::record::trace::{self, InputRecord};
use crate::scheduler::Phase;

/// The silence that ends a message on a line of Modbus: in ASCII none, because a line feed does.
pub(super) fn silence_after(line: Line) -> Duration {
    if ascii::is_on(line) { Duration::ZERO } else { Timing::of(line).t3_5 }
}

/// Time from the last character of a message until a drive on the line knows that it is over.
pub(super) fn judgement(line: Line) -> Duration {
    if ascii::is_on(line) { Duration::ZERO } else { silence_after(line) + line.character() }
}

/// Lines.
impl Bench {
    /// Puts several serial ports on one line. Clients connect after it.
    ///
    /// # Panics
    /// If the name is no name, or taken.
    pub fn share(&mut self, name: &str, ports: &[(DriveId, Port)]) -> Bus {
        assert!(trace::is_name(name), "\"{name}\" is no name for a line: use one word without dots");
        assert!(!self.is_taken(name), "there are two things called {name}");
        let bus = self.buses.len();
        let mut shared: Vec<(DriveId, Port)> = Vec::new();
        for &(seat, port) in ports {
            if let Some(Bus(old)) = self.bus(seat, port) {
                self.buses[old as usize].ports.retain(|&other| other != (seat, port));
                self.at_mut(seat).set_bus(port, bus);
                shared.push((seat, port));
            }
        }
        shared.sort_by(|a, b| (self.name(a.0), a.1).cmp(&(self.name(b.0), b.1)));
        self.names.insert(name.to_owned(), None);
        self.buses.push(SerialLine::shared(self.settings.seed, name, shared));
        Bus(bus as u32)
    }

    /// The line of a serial port; `None` for any other port.
    #[must_use]
    pub fn bus(&self, seat: DriveId, port: Port) -> Option<Bus> {
        self.at(seat).bus(port).map(Bus)
    }

    /// The name of a line: as given to [`share`](Self::share); of a line that a drive has for itself that of its
    /// port, or where drives are several those of both, `reader.usb`.
    #[must_use]
    pub fn bus_name(&self, bus: Bus) -> &str {
        let wire = &self.buses[bus.0 as usize];
        wire.port.filter(|_| self.seats.len() == 1).unwrap_or(&wire.name)
    }

    /// The ports on a line, by the names of their seats.
    #[must_use]
    pub fn ports(&self, bus: Bus) -> &[(DriveId, Port)] {
        &self.buses[bus.0 as usize].ports
    }

    /// All lines with a drive on them, by the names of their first drives and ports.
    #[must_use]
    pub fn buses(&self) -> Vec<Bus> {
        let lines = (0..self.buses.len() as u32).map(Bus);
        let mut lines: Vec<Bus> = lines.filter(|&bus| !self.ports(bus).is_empty()).collect();
        lines.sort_by_key(|&bus| self.ports(bus).first().map(|&(seat, port)| (self.name(seat), port)));
        lines
    }

    /// The line of that name. A line that a drive has for itself may also be called by the name of its port
    /// alone, if no other line can.
    #[must_use]
    pub fn find_bus(&self, name: &str) -> Option<Bus> {
        let lines = self.buses();
        let wire = |bus: &Bus| &self.buses[bus.0 as usize];
        let called = lines.iter().find(|bus| wire(bus).name == name);
        let mut alike = lines.iter().filter(|bus| wire(bus).port == Some(name));
        called.or_else(|| alike.next().filter(|_| alike.next().is_none())).copied()
    }

    /// The settings of a line now: those of its first drive, by name.
    #[must_use]
    pub fn line(&self, bus: Bus) -> Line {
        let first = self.ports(bus).first().and_then(|&(seat, port)| self.at(seat).line_at(port, self.now));
        first.unwrap_or(Line::new(9_600, 8, Parity::None, 1))
    }

    /// Returns whether all that was said on a line is answered. Half a message may wait for its rest there.
    #[must_use]
    pub fn is_answered(&self, bus: Bus) -> bool {
        !self.buses[bus.0 as usize].turn.is_busy()
    }

    /// Opens or closes the port at the other end of a line (DTR, a pty).
    pub fn attach(&mut self, bus: Bus, here: bool) {
        for n in 0..self.ports(bus).len() {
            let (seat, port) = self.ports(bus)[n];
            let at = self.at(seat).free(self.now, Phase::Line);
            self.send_to(at, seat.0, InputRecord::HostPresence { port, here });
        }
    }

    pub(super) fn fast(&self) -> bool {
        self.settings.line == LineMode::Fast
    }

    /// The settings of a line of Modbus, on which messages go whole; `None` where each character has its time.
    pub(super) fn framed(&self, bus: u32) -> Option<Line> {
        let &(seat, port) = self.ports(Bus(bus)).first()?;
        let serial = self.at(seat).serial(port).filter(|serial| serial.silence)?;
        Some(serial.line_at(self.now))
    }

    /// The settings of all drives on a line now.
    pub(super) fn lines(&self, bus: u32) -> impl Iterator<Item = Line> {
        self.ports(Bus(bus)).iter().filter_map(|&(seat, port)| self.at(seat).line_at(port, self.now))
    }
}
