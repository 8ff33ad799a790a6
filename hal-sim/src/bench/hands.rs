//! What hands do to a bench: pins, faults, power, registers.

use standin_firmware::device::{Axis, Duration, Fault, Level, Pin, Port, Refused};

use super::{Bench, Busy, Drive, Motion, PowerAction, Seat, Statistics, tape};
use crate::schedule::{Class, What};
use crate::seat::Train;
use crate::trace::{Fed, Power};

/// Pins, faults, power and registers.
impl Bench {
    /// Drives a pin from outside, and ends a train of pulses there. It arrives a tick later.
    pub fn set_pin(&mut self, seat: Seat, pin: Pin, drive: Drive) {
        let at = self.now + Duration::TICK;
        let Some(state) = self.at_mut(seat).pin_mut(pin) else { return };
        state.train = None;
        let before = state.signal(state.outside);
        state.outside = drive;
        let signal = state.signal(drive);
        if signal != before {
            self.send_to(at, seat.0, signal.fed(pin));
        }
    }

    /// A train of `count` pulses on an input pin, away from its present level and back, `hz` a
    /// second (limited to 1 µHz to 8 MHz). Edges are made one by one as time comes to them.
    ///
    /// # Errors
    /// One runs there already.
    pub fn pulse(&mut self, seat: Seat, pin: Pin, count: u32, hz: f64) -> Result<(), Busy> {
        const EDGES_PER_SECOND: f64 = 8_000_000.0;
        let start = self.now + Duration::TICK;
        let Some(state) = self.at_mut(seat).pin_mut(pin) else { return Ok(()) };
        if state.train.is_some() {
            return Err(Busy);
        }
        if count == 0 {
            return Ok(());
        }
        // Not a number counts as the least.
        let hz = if hz > 0.0 { hz.clamp(1e-6, EDGES_PER_SECOND) } else { 1e-6 };
        state.trains += 1;
        let train = state.trains;
        state.train = Some(Train {
            start,
            ticks_per_edge: EDGES_PER_SECOND / hz,
            made: 0,
            edges: 2 * u64::from(count),
            rest: state.is_high(),
            before: state.outside,
        });
        self.schedule(start, Class::Pin, seat.0, What::Pulse { pin, train });
        Ok(())
    }

    /// The next edge of a train.
    pub(super) fn edge(&mut self, place: u32, pin: Pin, number: u32) {
        let Some(state) = self.seats[place as usize].pin_mut(pin) else { return };
        let Some(mut train) = state.train.filter(|_| state.trains == number) else { return };
        state.outside = if train.rest == (train.made % 2 == 1) { Drive::High } else { Drive::Low };
        let signal = state.signal(state.outside);
        train.made += 1;
        if train.made < train.edges {
            state.train = Some(train);
            self.schedule(train.due(), Class::Pin, place, What::Pulse { pin, train: number });
        } else {
            (state.train, state.outside) = (None, train.before);
        }
        self.deliver(place, &signal.fed(pin));
    }

    /// A pin as it is seen from outside now.
    #[must_use]
    pub fn level(&self, seat: Seat, pin: Pin) -> Level {
        self.at(seat).level(self.now, pin)
    }

    /// The cause of a fault comes or goes.
    pub fn fault(&mut self, seat: Seat, fault: Fault, on: bool) {
        let at = self.at(seat).free(self.now, Class::Fault);
        self.send_to(at, seat.0, Fed::Fault { fault, on });
    }

    /// Whether the cause of a fault is there.
    #[must_use]
    pub fn faulty(&self, seat: Seat, fault: Fault) -> bool {
        self.at(seat).body.faults.get(usize::from(fault.0)).copied().unwrap_or(false)
    }

    /// Does something to a device's power, now or a tick later.
    pub fn power(&mut self, seat: Seat, action: PowerAction) {
        let at = self.at(seat).free(self.now, Class::Power);
        let power = match action {
            PowerAction::Off | PowerAction::Cycle => Power::Off,
            PowerAction::On => Power::On,
            PowerAction::Cut => Power::Cut(None),
        };
        self.send_to(at, seat.0, Fed::Power(power));
        if action == PowerAction::Cycle {
            self.send_to(at + Duration::TICK, seat.0, Fed::Power(Power::On));
        }
    }

    /// Whether a device has power.
    #[must_use]
    pub fn powered(&self, seat: Seat) -> bool {
        self.at(seat).body.powered
    }

    /// Presets a register past the bus.
    ///
    /// # Errors
    /// The device refuses it; nothing has changed then. Without power it takes nothing.
    pub fn poke(&mut self, seat: Seat, row: usize, value: i64) -> Result<(), Refused> {
        // After all else that happens now, so that a replay does the same.
        self.run_until(self.now);
        if !self.powered(seat) {
            return Err(Refused::ReadOnly);
        }
        let mut tape = tape(&mut self.trace, &mut self.outbox, self.settings);
        let result = self.seats[seat.0 as usize].feed(self.now, &Fed::Poke { row, value }, &mut tape);
        self.after(seat.0);
        self.run_until(self.now);
        result
    }

    /// A register as it reads now, without the bus's side effects.
    #[must_use]
    pub fn peek(&self, seat: Seat, row: usize) -> i64 {
        self.at(seat).peek(self.now, row)
    }

    /// What an axis does now.
    #[must_use]
    pub fn motion(&self, seat: Seat, axis: Axis) -> Motion {
        self.at(seat).motion(self.now, axis)
    }

    /// What a port has seen since its device was seated.
    #[must_use]
    pub fn statistics(&self, seat: Seat, port: Port) -> Statistics {
        self.at(seat).body.ports.get(usize::from(port.0)).map(|port| port.statistics).unwrap_or_default()
    }

    /// The non-volatile memory of a device.
    #[must_use]
    pub fn memory(&self, seat: Seat) -> &[u8] {
        &self.at(seat).body.memory
    }
}
