//! Inputs of a drive on a board with a cable: those of the hardware, of the cable and of stimuli, in the order of their
//! times.

use core::marker::PhantomData;

use drivetwin_control::{Refused, Stimulus};
use drivetwin_firmware::device::{Duration, Encoder, Fault, Instant, Line, Pin, Port, Role, Spec};
use drivetwin_firmware::shell::{BoardEvent, Inputs};

use super::Events;
use super::pins::Pins;
use super::receiver::Receiver;
use super::trains::Trains;
use crate::board::{Board, BoardInputs};
use crate::bus::Uart;
use crate::cable::{Cable, CablePort};
use crate::wire::is_full_duplex;

/// The only port of a board.
const PORT: Port = Port(0);

/// Inputs of a drive on a board with a cable.
pub(crate) struct StationInputs<B> {
    spec: &'static Spec,
    pins: Pins,
    /// One bit for each fault: its cause is present.
    faults: u32,
    host: Host,
    trains: Trains,
    receiver: Receiver,
    /// Events that are due.
    events: Events,
    /// Time of the next input that is not one of the hardware.
    due: Instant,
    /// Report of the state at power-on: its time, and the number of the next fault or pin.
    report: Option<(Instant, u8)>,
    board: BoardInputs<B>,
}

/// Presence of a host at the port, by the wire DTR and by the cable.
#[derive(Debug, Default)]
struct Host {
    wire: bool,
    cable: bool,
}

impl Host {
    fn is_present(&self) -> bool {
        self.wire || self.cable
    }

    /// Changes the presence. Returns the event for the drive, if there is one.
    fn change(&mut self, change: impl FnOnce(&mut Self)) -> Option<BoardEvent> {
        let before = self.is_present();
        change(self);
        let now = self.is_present();
        (now != before).then_some(BoardEvent::HostPresence(PORT, now))
    }
}

impl<B: Board> StationInputs<B> {
    pub(crate) fn new(spec: &'static Spec) -> Self {
        Self {
            spec,
            pins: Pins::new(spec),
            faults: 0,
            host: Host::default(),
            trains: Trains::default(),
            receiver: Receiver::new(),
            events: Events::new(),
            due: Instant::NEVER,
            report: None,
            board: BoardInputs(PhantomData),
        }
    }

    /// Takes what the computer has sent to the port of the bus, and whether it has the port open.
    pub(crate) fn listen(&mut self, now: Instant, cable: &mut B::Cable, line: Line) {
        if is_full_duplex(self.spec) {
            let is_open = cable.is_open(CablePort::Bus);
            self.events.push(now, self.host.change(|host| host.cable = is_open));
        }
        self.receiver.listen(now, cable, line);
        self.update_due();
    }

    /// Reports the present state to a drive that gets power at `at`: first the faults, then the pins.
    pub(crate) fn report(&mut self, at: Instant) {
        self.report = Some((at, 0));
        self.update_due();
    }

    /// Time of the next input of the cable or of a stimulus.
    pub(crate) fn due(&self) -> Instant {
        self.due
    }

    /// Finds the time of the next input. Called after each change.
    #[inline(never)]
    fn update_due(&mut self) {
        let due = self.events.due().min(self.trains.due()).min(self.receiver.due());
        self.due = self.report.map_or(due, |(at, _)| at.min(due));
    }

    /// Notes all inputs up to `now`, for a drive without power.
    pub(crate) fn skip(&mut self, now: Instant) {
        while self.next_event(now).is_some() {}
    }

    /// The pins.
    pub(crate) fn pins(&self) -> &Pins {
        &self.pins
    }

    /// One bit for each fault whose cause is present.
    pub(crate) fn faults(&self) -> u32 {
        self.faults
    }

    /// Drives an input pin at `at`. A train at the pin ends.
    ///
    /// # Errors
    /// There is no such pin, it does not take the level, or the drive has not taken the inputs before.
    pub(crate) fn drive(&mut self, at: Instant, pin: Pin, stimulus: Stimulus) -> Result<(), Refused> {
        let takes = match (self.input(pin)?, stimulus) {
            (Role::Analogue, Stimulus::Low | Stimulus::High) => false,
            (role, Stimulus::Millivolts(_)) => matches!(role, Role::Analogue | Role::AnalogueOrDigital),
            _ => true,
        };
        if !takes {
            return Err(Refused::OutOfRange);
        }
        if self.events.is_full() {
            return Err(Refused::Busy);
        }
        self.trains.end(pin);
        self.events.push(at, self.pins.drive(pin, stimulus));
        self.update_due();
        Ok(())
    }

    /// Begins a train of pulses after `at`.
    ///
    /// # Errors
    /// There is no such pin, it takes no pulses, a train drives it already, or the pulses are too fast.
    pub(crate) fn pulse(
        &mut self,
        at: Instant,
        pin: Pin,
        count: u32,
        (period, high): (u64, u64),
    ) -> Result<(), Refused> {
        if self.input(pin)? == Role::Analogue || count == 0 || high == 0 || high >= period {
            return Err(Refused::OutOfRange);
        }
        let spans = (Duration::from_ticks(period), Duration::from_ticks(high));
        self.trains.pulse(at + Duration::TICK, &self.pins, pin, count, spans)?;
        self.update_due();
        Ok(())
    }

    /// Begins to turn an encoder after `at`.
    ///
    /// # Errors
    /// There is no such encoder, it does not turn, a train drives a channel already, or the edges are too fast.
    pub(crate) fn turn(
        &mut self,
        at: Instant,
        encoder: Encoder,
        counts: i32,
        period: u64,
    ) -> Result<(), Refused> {
        let spec = self.spec.encoders.get(usize::from(encoder.0)).ok_or(Refused::Unknown)?;
        if counts == 0 || period == 0 {
            return Err(Refused::OutOfRange);
        }
        self.trains.turn(at + Duration::TICK, spec, counts, Duration::from_ticks(period))?;
        self.update_due();
        Ok(())
    }

    /// Sets or clears the cause of a fault at `at`.
    ///
    /// # Errors
    /// There is no such fault, or the drive has not taken the inputs before.
    pub(crate) fn fault(&mut self, at: Instant, fault: Fault, on: bool) -> Result<(), Refused> {
        if usize::from(fault.0) >= self.spec.faults.len() {
            return Err(Refused::Unknown);
        }
        if self.events.is_full() {
            return Err(Refused::Busy);
        }
        self.note_fault(fault, on);
        self.events.push(at, Some(BoardEvent::Fault(fault, on)));
        self.update_due();
        Ok(())
    }

    /// Role of a pin that can be driven from outside.
    fn input(&self, pin: Pin) -> Result<Role, Refused> {
        match self.pins.spec(pin).ok_or(Refused::Unknown)?.role {
            Role::Output | Role::Led => Err(Refused::OutOfRange),
            role => Ok(role),
        }
    }

    fn note_fault(&mut self, fault: Fault, on: bool) {
        let bit = 1_u32.checked_shl(fault.0.into()).unwrap_or(0);
        self.faults = if on { self.faults | bit } else { self.faults & !bit };
    }

    /// Notes an event of the hardware. Returns the event for the drive, if there is one.
    fn hardware_event(&mut self, event: BoardEvent) -> Option<BoardEvent> {
        match event {
            BoardEvent::Edge(pin, high) => self.pins.edge(pin, high).then_some(event),
            BoardEvent::Fault(fault, on) => {
                self.note_fault(fault, on);
                Some(event)
            }
            BoardEvent::HostPresence(_, here) => self.host.change(|host| host.wire = here),
            _ => Some(event),
        }
    }

    /// The next event of the report at power-on.
    fn next_report(&mut self) -> Option<(Instant, BoardEvent)> {
        let (at, place) = self.report.as_mut()?;
        let faults = self.spec.faults.len() as u8;
        while usize::from(*place) < self.spec.faults.len() + self.spec.pins.len() {
            let number = *place;
            *place += 1;
            let news = match number.checked_sub(faults) {
                None => {
                    let is_on = self.faults >> (number & 31) & 1 == 1;
                    is_on.then_some(BoardEvent::Fault(Fault(number), true))
                }
                Some(pin) => self.pins.news(Pin(pin)),
            };
            if let Some(event) = news {
                return Some((*at, event));
            }
        }
        self.report = None;
        None
    }

    /// The next event of the report, of the queue, of a train or of the cable, which is due. `None` if it is none for the
    /// drive, or if a train has queued it.
    #[inline(never)]
    fn next_own(&mut self) -> Option<(Instant, BoardEvent)> {
        if self.report.is_some() {
            return self.next_report();
        }
        if self.due == self.events.due() {
            return self.events.take();
        }
        if self.due == self.trains.due() {
            self.trains.make(&mut self.pins, &mut self.events);
            return None;
        }
        self.next_character()
    }

    /// The character that arrives now, if the drive hears it.
    fn next_character(&mut self) -> Option<(Instant, BoardEvent)> {
        let (at, character) = self.receiver.take()?;
        let event = character.map_or(BoardEvent::RxError(PORT), |byte| BoardEvent::Byte(PORT, byte));
        B::Uart::bus().hears().then_some((at, event))
    }
}

impl<B: Board> Inputs for StationInputs<B> {
    fn now(&self) -> Instant {
        self.board.now()
    }

    fn next_event(&mut self, until: Instant) -> Option<(Instant, BoardEvent)> {
        loop {
            // The events of the hardware first: a fast encoder has one every few microseconds.
            while let Some((at, event)) = self.board.next_event(until.min(self.due)) {
                if let Some(event) = self.hardware_event(event) {
                    return Some((at, event));
                }
            }
            if self.due > until {
                return None;
            }
            let next = self.next_own();
            self.update_due();
            if next.is_some() {
                return next;
            }
        }
    }
}
