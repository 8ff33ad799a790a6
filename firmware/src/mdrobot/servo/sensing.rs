//! What the sensors and the current tell: how fast the motor turns, and what it gets.

use fixed::types::I40F24;

use super::pi::{FULL, FULL_DUTY};
use super::speed::{Speed, Window};
use super::{OUTPUTS, Sensor, Servo};
use crate::device::{Instant, Sink};

impl Servo {
    /// A sensor changed, or its level is told.
    pub(in crate::mdrobot) fn edge(&mut self, at: Instant, sensor: Sensor, high: bool) {
        match sensor {
            Sensor::Hall(place) => {
                let counts = self.halls.edge(at, place, high);
                self.counted(at, counts);
            }
            Sensor::EncoderA | Sensor::EncoderB => {
                let Some(forward) = self.encoder.edge(sensor == Sensor::EncoderA, high) else { return };
                self.watch.encoder_edge();
                let window = self.encoded.edge(at, forward);
                if self.settings.enc_ppr > 0 {
                    self.measured(at, window);
                }
            }
        }
    }

    /// The Hall sensors made so many counts.
    fn counted(&mut self, at: Instant, counts: i8) {
        for _ in 0..counts.unsigned_abs() {
            let window = self.turns.edge(at, counts > 0);
            if self.settings.enc_ppr == 0 {
                self.measured(at, window);
            }
        }
        if counts != 0 && self.settings.enc_ppr > 0 && self.looks() {
            let (count, settings) = (self.halls.count(), &self.settings);
            self.alarms |= self.watch.hall_edge(at, count, settings.counts(), settings.turn());
        }
    }

    /// What the sensor that tells the speed says.
    fn measured(&mut self, at: Instant, window: Window) {
        match window {
            Window::Begins => self.emf.begin(at, true),
            Window::GoesOn => {}
            Window::Ends { counts, span } => self.emf.learn(at, counts, span, self.settings.turn()),
        }
    }

    /// The motor draws so many mA.
    pub(in crate::mdrobot) fn draws(&mut self, at: Instant, ma: i32) {
        self.emf.draws(at, if self.swapped { ma.saturating_neg() } else { ma });
    }

    /// Two wires of the motor are swapped: what is put out turns it the other way.
    pub(in crate::mdrobot) fn swap(&mut self, at: Instant, swapped: bool, out: &mut dyn Sink) {
        if swapped != self.swapped {
            self.swapped = swapped;
            self.emf.draws(at, self.emf.ma().saturating_neg());
            self.put(at, out);
        }
    }

    /// The wire of a Hall sensor, or those of the encoder, are broken: the drive reads high there.
    pub(in crate::mdrobot) fn cut(&mut self, at: Instant, halls: bool, encoder: bool) {
        self.encoder.cut(encoder);
        let counts = self.halls.cut(at, halls);
        self.counted(at, counts);
    }

    /// Channels A and B of the encoder, whether its wires are broken or not.
    pub(in crate::mdrobot) fn encoder_levels(&self) -> [bool; 2] {
        self.encoder.levels()
    }

    /// By the sensor that tells it.
    pub(super) fn speed(&self) -> &Speed {
        if self.settings.enc_ppr > 0 { &self.encoded } else { &self.turns }
    }

    /// The back-EMF, as the duty that makes it.
    pub(super) fn felt(&self) -> I40F24 {
        self.emf.now(self.speed().counts(), self.settings.turn())
    }

    /// How fast it turns, in rpm, positive CCW, not limited: as the edges of its sensor tell, and in between two of
    /// them its current, while it is controlled.
    pub(in crate::mdrobot) fn rpm(&self, at: Instant) -> i32 {
        // Which way it turns is for the edges to say.
        if !self.looks() || self.emf.is_limited() || self.emf.is_opposed() {
            return self.speed().rpm(at, self.settings.turn());
        }
        self.felt().checked_div(self.emf.per_rpm()).unwrap_or(I40F24::ZERO).round().to_num()
    }

    /// Current in mA, with the sign of its torque.
    pub(in crate::mdrobot) fn current(&self) -> i32 {
        self.emf.ma()
    }

    /// The output as far as the limit of the current lets it, in 1/1023 of the supply.
    pub(in crate::mdrobot) fn output(&self, at: Instant) -> i16 {
        (self.put_out(at) * i64::from(OUTPUTS) / i64::from(FULL_DUTY)).round().to_num()
    }

    /// The same as a duty.
    pub(super) fn put_out(&self, at: Instant) -> I40F24 {
        if self.carries == 0 || self.duty == 0 {
            I40F24::ZERO
        } else if self.emf.is_limited() {
            // At its limit the current does not tell how fast the motor turns.
            let emf = I40F24::from_num(self.rpm(at)).saturating_mul(self.emf.per_rpm());
            (emf + self.emf.lost(self.emf.ma())).clamp(-FULL, FULL)
        } else {
            I40F24::from_num(self.duty)
        }
    }

    /// Alarms that have come up since it was asked last, bits of [`status`](crate::mdrobot::alarm::status).
    pub(in crate::mdrobot) fn alarms(&mut self) -> u16 {
        core::mem::take(&mut self.alarms)
    }

    /// Whether the Hall sensors are in a state that cannot be.
    pub(in crate::mdrobot) fn halls_are_broken(&self) -> bool {
        self.halls.are_broken()
    }
}
