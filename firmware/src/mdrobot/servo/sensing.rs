//! Readings of the sensors and the motor: speed, and the effect of the duty.

use fixed::types::I40F24;

use super::{ControlModel, Edges, FULL_DUTY, OUTPUTS, Parameters, Rotation, Sensor, Servo};
use crate::device::{Context, Instant};

impl Servo {
    /// A level of a sensor.
    pub(in crate::mdrobot) fn edge(&mut self, at: Instant, sensor: Sensor, high: bool) {
        match sensor {
            Sensor::Hall(place) => {
                let counts = self.halls.edge(at, place, high);
                self.counted(at, counts);
            }
            Sensor::EncoderA | Sensor::EncoderB => {
                let Some(forward) = self.encoder.edge(sensor == Sensor::EncoderA, high) else { return };
                self.faults.encoder_edge();
                self.encoder_edges.edge(at, forward, self.settings.encoder_counts(), &self.feedback);
            }
        }
    }

    /// The Hall sensors made so many counts.
    fn counted(&mut self, at: Instant, counts: i8) {
        for _ in 0..counts.unsigned_abs() {
            self.hall_edges.edge(at, counts > 0, self.settings.counts(), &self.feedback);
        }
        if counts != 0 && self.settings.enc_ppr > 0 && self.is_controlling() {
            let (count, settings) = (self.halls.count(), &self.settings);
            self.alarms |= self.faults.hall_edge(at, count, settings.counts(), settings.turn());
        }
    }

    /// The motor draws so many mA.
    pub(in crate::mdrobot) fn draws(&mut self, ma: i32) {
        self.feedback.ma = ma;
    }

    /// The motor is this one.
    pub(in crate::mdrobot) fn motor(&mut self, parameters: &Parameters) {
        self.feedback.motor = ControlModel::of(parameters);
    }

    /// The motor turns like this from now on.
    pub(in crate::mdrobot) fn turned(&mut self, at: Instant, rotation: Rotation) {
        self.feedback.turns(at, rotation);
    }

    /// Two wires of the motor are swapped: the duty turns it the other way.
    pub(in crate::mdrobot) fn swap(&mut self, at: Instant, swapped: bool, out: &mut dyn Context) {
        if swapped != self.swapped {
            self.swapped = swapped;
            self.put_duty(at, out);
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

    /// Edges of the speed sensor.
    pub(super) fn speed(&self) -> &Edges {
        if self.settings.enc_ppr > 0 { &self.encoder_edges } else { &self.hall_edges }
    }

    /// Speed that this sensor reads at any instant, in rpm.
    pub(super) fn reading(&self, at: Instant) -> I40F24 {
        self.speed().reading(at, self.settings.turn(), &self.feedback)
    }

    /// A speed that it reads, as the duty of the back-EMF at that speed.
    pub(super) fn duty_of(&self, rpm: I40F24) -> I40F24 {
        self.feedback.motor.duty(self.speed().of_shaft(rpm, self.settings.turn()))
    }

    /// The back-EMF at present, as a duty.
    pub(super) fn back_emf(&self, at: Instant) -> I40F24 {
        self.duty_of(self.reading(at))
    }

    /// Speed by the edges of its sensor, in rpm, positive CCW, not limited.
    pub(in crate::mdrobot) fn rpm(&self, at: Instant) -> i32 {
        self.speed().rpm(at, self.settings.turn())
    }

    /// Current in mA, with the sign of the output that it comes from.
    pub(in crate::mdrobot) fn current(&self) -> i32 {
        if self.swapped { self.feedback.ma.saturating_neg() } else { self.feedback.ma }
    }

    /// The output as far as the limit of the current lets it, in 1/1023 of the supply.
    pub(in crate::mdrobot) fn output(&self, at: Instant) -> i16 {
        (self.applied_duty(at) * i64::from(OUTPUTS) / i64::from(FULL_DUTY)).round().to_num()
    }

    /// The same as a duty.
    pub(super) fn applied_duty(&self, at: Instant) -> I40F24 {
        let sign = if self.swapped { -1 } else { 1 };
        I40F24::from_num(sign * self.feedback.applied(at, sign * self.duty, self.limit_out_ma))
    }

    /// Alarms that have come up since it was asked last, bits of [`status`](crate::mdrobot::alarm::status).
    pub(in crate::mdrobot) fn alarms(&mut self) -> u16 {
        core::mem::take(&mut self.alarms)
    }

    /// Returns whether the Hall sensors have an impossible code.
    pub(in crate::mdrobot) fn halls_are_broken(&self) -> bool {
        self.halls.are_broken()
    }
}
