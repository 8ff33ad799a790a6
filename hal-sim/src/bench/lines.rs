//! Serial lines: names, ports and settings.

use drivetwin_firmware::device::{Duration, Line, Port};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::ascii;
use drivetwin_protocol::modbus::rtu::Timing;

use super::{Bench, Bus, DriveId};
use crate::line::{LineMode, SerialLine};
use crate::record::trace::{self, InputRecord};
use crate::scheduler::Phase;

/// Inter-frame gap on a Modbus line; zero for Modbus ASCII, where a line feed ends a frame.
pub(super) fn inter_frame_gap(line: Line) -> Duration {
    if ascii::is_on(line) { Duration::ZERO } else { Timing::of(line).t3_5 }
}

/// Time from the end of a frame's last character until the drives on the line detect the end of the frame.
pub(super) fn end_detection_time(line: Line) -> Duration {
    if ascii::is_on(line) { Duration::ZERO } else { inter_frame_gap(line) + line.character() }
}

/// Serial lines.
impl Bench {
    /// Connects several serial ports to one shared line. Connect clients after this call.
    ///
    /// # Panics
    /// If the name is not valid or is taken.
    pub fn share(&mut self, name: &str, ports: &[(DriveId, Port)]) -> Bus {
        assert!(trace::is_name(name), "\"{name}\" is not a valid name for a line: use one word without dots");
        assert!(!self.is_taken(name), "the name {name} is in use already");
        let bus = self.buses.len();
        let mut shared: Vec<(DriveId, Port)> = Vec::new();
        for &(drive, port) in ports {
            if let Some(Bus(old)) = self.bus(drive, port) {
                let ports = &mut self.buses[old as usize].ports;
                *ports = ports.iter().copied().filter(|&other| other != (drive, port)).collect();
                self.at_mut(drive).set_bus(port, bus);
                shared.push((drive, port));
            }
        }
        shared.sort_by(|a, b| (self.name(a.0), a.1).cmp(&(self.name(b.0), b.1)));
        self.names.insert(name.to_owned(), None);
        self.buses.push(SerialLine::shared(self.settings.seed, name, shared));
        Bus(bus as u32)
    }

    /// The line of a serial port; `None` for any other port.
    #[must_use]
    pub fn bus(&self, drive: DriveId, port: Port) -> Option<Bus> {
        self.at(drive).bus(port).map(Bus)
    }

    /// The name of a line. A shared line has the name given to [`share`](Self::share). The line of a single
    /// port has the name of the port, or on a bench of several drives `drive.port`, for instance
    /// `reader.usb`.
    #[must_use]
    pub fn bus_name(&self, bus: Bus) -> &str {
        let serial_line = &self.buses[bus.0 as usize];
        serial_line.port.filter(|_| self.slots.len() == 1).unwrap_or(&serial_line.name)
    }

    /// The ports on a line, sorted by the names of their drives.
    #[must_use]
    pub fn ports(&self, bus: Bus) -> &[(DriveId, Port)] {
        &self.buses[bus.0 as usize].ports
    }

    /// All lines with at least one drive, sorted by the names of their first drives and ports.
    #[must_use]
    pub fn buses(&self) -> Vec<Bus> {
        let lines = (0..self.buses.len() as u32).map(Bus);
        let mut lines: Vec<Bus> = lines.filter(|&bus| !self.ports(bus).is_empty()).collect();
        lines.sort_by_key(|&bus| self.ports(bus).first().map(|&(drive, port)| (self.name(drive), port)));
        lines
    }

    /// The lines of [`share`](Self::share), in the order of these calls.
    pub fn shared_buses(&self) -> impl Iterator<Item = Bus> {
        (0..).map(Bus).zip(&self.buses).filter(|(_, line)| line.port.is_none()).map(|(bus, _)| bus)
    }

    /// The line with the name `name`. If there is none, `name` may be the name of a port. Then the result is the
    /// line of this port, provided that only one line has a port with this name.
    #[must_use]
    pub fn find_bus(&self, name: &str) -> Option<Bus> {
        let lines = self.buses();
        let serial_line = |bus: &Bus| &self.buses[bus.0 as usize];
        let called = lines.iter().find(|bus| serial_line(bus).name == name);
        let mut alike = lines.iter().filter(|bus| serial_line(bus).port == Some(name));
        called.or_else(|| alike.next().filter(|_| alike.next().is_none())).copied()
    }

    /// The present serial settings of a line: those of its first drive by name.
    #[must_use]
    pub fn line(&self, bus: Bus) -> Line {
        let first = self.ports(bus).first().and_then(|&(drive, port)| self.at(drive).line_at(port, self.now));
        first.unwrap_or(Line::new(9_600, 8, Parity::None, 1))
    }

    /// The present serial settings of a port; `None` if the port is not serial.
    #[must_use]
    pub fn port_line(&self, drive: DriveId, port: Port) -> Option<Line> {
        self.at(drive).line_at(port, self.now)
    }

    /// Returns true if all requests on a line are answered. A partial frame may still wait for its rest.
    #[must_use]
    pub fn is_answered(&self, bus: Bus) -> bool {
        !self.buses[bus.0 as usize].turn.is_busy()
    }

    /// Tells the drives of a line that a program has opened (`true`) or closed the port at the other end
    /// (DTR, a pty).
    pub fn attach(&mut self, bus: Bus, here: bool) {
        for n in 0..self.ports(bus).len() {
            let (drive, port) = self.ports(bus)[n];
            let at = self.at(drive).free(self.now, Phase::Line);
            self.send_to(at, drive.0, InputRecord::HostPresence { port, here });
        }
    }

    pub(super) fn fast(&self) -> bool {
        self.settings.line == LineMode::Fast
    }

    /// The settings of a Modbus line, on which whole frames are sent; `None` on a line with timed characters.
    pub(super) fn framed(&self, bus: u32) -> Option<Line> {
        let &(drive, port) = self.ports(Bus(bus)).first()?;
        let serial = self.at(drive).serial(port).filter(|serial| serial.framed)?;
        Some(serial.line_at(self.now))
    }

    /// The longest of the times that a line has with the present settings of its drives; they seldom differ.
    pub(super) fn longest(&self, bus: u32, time: fn(Line) -> Duration) -> Duration {
        let mut last = None;
        let lines = self.lines(bus).filter(|line| last.replace(*line) != Some(*line));
        lines.map(time).max().unwrap_or(Duration::ZERO)
    }

    /// The present serial settings of all drives on a line.
    pub(super) fn lines(&self, bus: u32) -> impl Iterator<Item = Line> {
        self.ports(Bus(bus)).iter().filter_map(|&(drive, port)| self.at(drive).line_at(port, self.now))
    }
}
