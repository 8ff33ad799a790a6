//! Readings of the sensors and the motor: speed, current, and the applied duty.

use fixed::types::I40F24;

use super::{ControlModel, Edges, FULL_DUTY, OUTPUTS, Parameters, Rotation, Sensor, Servo};
use crate::device::{Context, Instant};

impl Servo {
    /// Handles a level of a sensor.
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

    /// Handles counts that the Hall sensors made, positive forward.
    fn counted(&mut self, at: Instant, counts: i8) {
        for _ in 0..counts.unsigned_abs() {
            self.hall_edges.edge(at, counts > 0, self.settings.counts(), &self.feedback);
        }
        if counts != 0 && self.settings.enc_ppr > 0 && self.is_controlling() {
            let (count, settings) = (self.halls.count(), &self.settings);
            self.alarms |= self.faults.hall_edge(at, count, settings.counts(), settings.turn());
        }
    }

    /// The motor reports its current, in mA.
    pub(in crate::mdrobot) fn draws(&mut self, ma: i32) {
        self.feedback.ma = ma;
    }

    /// The motor reports its parameters.
    pub(in crate::mdrobot) fn motor(&mut self, parameters: &Parameters) {
        self.feedback.motor = ControlModel::of(parameters);
    }

    /// The motor reports its rotation from now on.
    pub(in crate::mdrobot) fn turned(&mut self, at: Instant, rotation: Rotation) {
        self.feedback.turns(at, rotation);
    }

    /// Swaps two wires of the motor, which reverses the direction of the duty, or restores them.
    pub(in crate::mdrobot) fn swap(&mut self, at: Instant, swapped: bool, out: &mut dyn Context) {
        if swapped != self.swapped {
            self.swapped = swapped;
            self.put_duty(at, out);
        }
    }

    /// Breaks or repairs the wire of a Hall sensor, and the wires of the encoder. The drive reads high from a
    /// broken wire.
    pub(in crate::mdrobot) fn cut(&mut self, at: Instant, halls: bool, encoder: bool) {
        self.encoder.cut(encoder);
        let counts = self.halls.cut(at, halls);
        self.counted(at, counts);
    }

    /// Levels of channels A and B of the encoder, even while its wires are broken.
    pub(in crate::mdrobot) fn encoder_levels(&self) -> [bool; 2] {
        self.encoder.levels()
    }

    /// Edges of the speed sensor.
    pub(super) fn speed(&self) -> &Edges {
        if self.settings.enc_ppr > 0 { &self.encoder_edges } else { &self.hall_edges }
    }

    /// Speed in rpm that the speed sensor reads, also between two edges.
    pub(super) fn reading(&self, at: Instant) -> I40F24 {
        self.speed().reading(at, self.settings.turn(), &self.feedback)
    }

    /// The back-EMF, as a duty, at the speed `rpm` that the sensor reads.
    pub(super) fn duty_of(&self, rpm: I40F24) -> I40F24 {
        self.feedback.motor.duty(self.speed().of_shaft(rpm, self.settings.turn()))
    }

    /// Present back-EMF, as a duty.
    pub(super) fn back_emf(&self, at: Instant) -> I40F24 {
        self.duty_of(self.reading(at))
    }

    /// Speed in rpm from the edges of the speed sensor alone, positive CCW, not limited.
    pub(in crate::mdrobot) fn rpm(&self, at: Instant) -> i32 {
        self.speed().rpm(at, self.settings.turn())
    }

    /// Current in mA. Its sign refers to the direction of the output.
    pub(in crate::mdrobot) fn current(&self) -> i32 {
        if self.swapped { self.feedback.ma.saturating_neg() } else { self.feedback.ma }
    }

    /// The output in 1/1023 of the supply, reduced by the current limit.
    pub(in crate::mdrobot) fn output(&self, at: Instant) -> i16 {
        (self.applied_duty(at) * i64::from(OUTPUTS) / i64::from(FULL_DUTY)).round().to_num()
    }

    /// The output as a duty, reduced by the current limit.
    pub(super) fn applied_duty(&self, at: Instant) -> I40F24 {
        let sign = if self.swapped { -1 } else { 1 };
        I40F24::from_num(sign * self.feedback.applied(at, sign * self.duty, self.limit_out_ma))
    }

    /// Returns the alarms that have occurred since the last call, as bits of
    /// [`status`](crate::mdrobot::alarm::status).
    pub(in crate::mdrobot) fn alarms(&mut self) -> u16 {
        core::mem::take(&mut self.alarms)
    }

    /// Returns true if the Hall sensors have had an impossible code for too long.
    pub(in crate::mdrobot) fn halls_are_broken(&self) -> bool {
        self.halls.are_broken()
    }
}
