//! Reactions to changes of the pins of J2 (7.8).

use super::PORT_BITS;
use super::drive::{Drive, State};
use super::motion::Motion;
use super::pins::{Mode, Pin2, Pin3};
use super::registers::Reg;
use super::registers::io_port::{J2_2, J2_3, J2_4, J2_5, J2_9, J2_10, J2_12};
use crate::counter::Channel;
use crate::device::{Context, Duration, Instant, Pin};

/// Minimum time between two step pulses: 250 kHz. Faster pulses are lost (7.8; MD3-25).
const STEP_INTERVAL: Duration = Duration::micros(4);

impl Drive {
    /// An input pin changed.
    pub(super) fn edge(&mut self, at: Instant, pin: Pin, high: bool, out: &mut dyn Context) {
        let Some(&bit) = PORT_BITS.get(usize::from(pin.0)) else { return };
        let levels = if high { self.levels | bit } else { self.levels & !bit };
        if levels == self.levels {
            return;
        }
        self.levels = levels;
        self.stale = true;
        match bit {
            J2_9 => {
                self.encoder.edge(at, Channel::Index, high);
                if self.state == State::Ready {
                    self.check_flag(at, out);
                    self.resume(at, out);
                    self.update_outputs(at, out);
                }
            }
            J2_10 => self.encoder.edge(at, Channel::A, high),
            J2_12 => self.encoder.edge(at, Channel::B, high),
            _ if self.state == State::Ready => {
                self.poll_inputs(at, out);
                self.update_outputs(at, out);
            }
            _ => {}
        }
    }

    /// A hardware counter of a board has counted quarter cycles.
    pub(super) fn on_count(&mut self, steps: i32, a: bool, b: bool) {
        self.encoder.add_counts(steps, a, b);
        let channels = if a { J2_10 } else { 0 } | if b { J2_12 } else { 0 };
        self.levels = self.levels & !(J2_10 | J2_12) | channels;
        self.stale = true;
    }

    /// Runs the functions of pins 2 to 5 after a change of their levels, polarities or functions. A new
    /// polarity is an edge if it changes the pin between active and inactive (MD3-19).
    pub(super) fn poll_inputs(&mut self, at: Instant, out: &mut dyn Context) {
        let active = self.pins.active(self.levels);
        let edges = active ^ self.active;
        let moves = edges & (J2_4 | J2_5) != 0;
        let lowered = self.cut_back;
        self.active = active;
        if edges != 0 {
            self.restart_cutback(at);
        }
        self.update_pin_2(at, out);
        self.update_pin_3(edges & active, at, out);
        if moves {
            if lowered || edges & (J2_2 | J2_3) != 0 {
                // The current changes before a step is made.
                self.update_current(at, out);
            }
            self.update_pins_4_and_5(edges, at, out);
        }
        self.resume(at, out);
    }

    fn update_pin_2(&mut self, at: Instant, out: &mut dyn Context) {
        self.check_flag(at, out);
        let alternate = self.pins.pin_2 == Pin2::SpeedSelect && self.active & J2_2 != 0;
        if alternate != self.alternate {
            self.alternate = alternate;
            if self.motion == Motion::Profile && self.bank.get(Reg::SpeedselJogsProfile) != 0 {
                self.jog_on(at, out);
            } else {
                self.speed_changed(at, out);
            }
        }
    }

    /// Stores the present state of the inputs without an edge, INHIBIT included.
    pub(super) fn latch_inputs(&mut self) {
        self.active = self.pins.active(self.levels);
        (self.inhibited, self.bus_inhibited) = self.inhibits();
    }

    /// Returns two flags: INHIBIT is active, and `INHIBIT_MODBUS_MOTION` is active.
    fn inhibits(&self) -> (bool, bool) {
        let active = self.active & J2_3 != 0;
        let is = |function| active && self.pins.pin_3 == function;
        (is(Pin3::Inhibit), is(Pin3::InhibitModbus))
    }

    fn update_pin_3(&mut self, activated: u16, at: Instant, out: &mut dyn Context) {
        let (inhibited, bus_inhibited) = self.inhibits();
        let homes = activated & J2_3 != 0 && self.pins.pin_3 == Pin3::Home;
        if homes || inhibited && !self.inhibited || bus_inhibited && !self.bus_inhibited {
            let _ = self.clear_fault(at);
        }
        self.inhibited = inhibited;
        if bus_inhibited && !self.bus_inhibited {
            // "Currently running motion is stopped" (MD3-29).
            self.stop(at, out);
        }
        self.bus_inhibited = bus_inhibited;
        if homes {
            let _ = self.home(at, out);
        }
    }

    /// Handles edges on pins 4 and 5. Moves, steps and home cycles start only if no motion is running
    /// (MD3-24).
    fn update_pins_4_and_5(&mut self, edges: u16, at: Instant, out: &mut dyn Context) {
        let fell = |pin| edges & self.active & pin != 0;
        let rose = |pin| edges & !self.active & pin != 0;
        let (fell_4, rose_4, fell_5) = (fell(J2_4), rose(J2_4), fell(J2_5));
        // While pin 5 is inactive, the sign of the register is the direction (MD3-20).
        let pin_5 = self.active & J2_5 != 0;
        match self.pins.mode {
            Mode::StepDirection if fell_4 => self.step(pin_5, at, out),
            Mode::JogDirection | Mode::JogEitherWay => {
                self.armed = true;
                self.jog_by_pins(at, out);
            }
            mode => {
                let (profile, home) = match mode {
                    Mode::MoveDirection => (fell_4.then_some(pin_5), false),
                    Mode::MoveForwardBackward => ((fell_4 || rose_4).then_some(rose_4), false),
                    Mode::MoveThenHome => (fell_4.then_some(false), rose_4),
                    Mode::MoveEitherWay => ((fell_4 || fell_5).then_some(!fell_4), false),
                    Mode::MoveOrHome => (fell_4.then_some(false), fell_5),
                    _ => (None, false),
                };
                if let Some(reversed) = profile {
                    let _ = self.profile(reversed, at, out);
                } else if home {
                    let _ = self.home(at, out);
                }
            }
        }
    }

    /// Handles a step pulse.
    fn step(&mut self, backward: bool, at: Instant, out: &mut dyn Context) {
        if at >= self.next_step_allowed && self.can_step().is_ok() {
            self.next_step_allowed = at + STEP_INTERVAL;
            self.motor.step(at, if backward { -1 } else { 1 }, out);
        }
    }
}
