//! Readings of the sensors and the motor: count, speed, current, and the applied duty.

use fixed::types::I40F24;

use super::encoder::Encoder;
use super::halls::Halls;
use super::settings::MOTOR;
use super::{Sensor, Settings};
use crate::device::{Input, Instant};
use crate::motor::{ControlModel, Edges, Feedback};

/// An edge that was counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Counted {
    Halls,
    Encoder,
}

/// The sensors of the motor, and its reports.
#[derive(Clone, Debug)]
pub(super) struct Sensing {
    feedback: Feedback,
    halls: Halls,
    encoder: Encoder,
    /// Edges of the Hall sensors.
    hall_edges: Edges,
    /// Edges of the encoder.
    encoder_edges: Edges,
}

impl Sensing {
    pub(super) fn new(settings: &Settings) -> Self {
        Self::with(Feedback::new(&MOTOR), settings)
    }

    /// The state at power-on. What the motor has reported stays.
    pub(super) fn restarted(&self, settings: &Settings) -> Self {
        Self::with(self.feedback, settings)
    }

    /// Applies new settings.
    pub(super) fn set(&mut self, settings: &Settings) {
        self.hall_edges.set_turn(settings.counts());
        self.encoder_edges.set_turn(settings.encoder_counts());
    }

    fn with(feedback: Feedback, settings: &Settings) -> Self {
        Self {
            feedback,
            halls: Halls::NEW,
            encoder: Encoder::NEW,
            hall_edges: Edges::new(settings.counts()),
            encoder_edges: Edges::new(settings.encoder_counts()),
        }
    }

    /// Handles a report of the motor.
    #[inline]
    pub(super) fn report(&mut self, at: Instant, input: &Input<'_>) {
        self.feedback.report(at, input);
    }

    /// Handles a level of a sensor.
    pub(super) fn edge(&mut self, at: Instant, sensor: Sensor, high: bool) -> Option<Counted> {
        if let Sensor::Hall(place) = sensor {
            let counts = self.halls.edge(at, place, high);
            return self.hall_counts(at, counts);
        }
        let forward = self.encoder.edge(sensor == Sensor::EncoderA, high)?;
        self.encoder_edges.edge(at, forward, &self.feedback);
        Some(Counted::Encoder)
    }

    /// Breaks or repairs the wire of a Hall sensor, and the wires of the encoder. The drive reads high from a
    /// broken wire.
    pub(super) fn cut(&mut self, at: Instant, halls: bool, encoder: bool) -> Option<Counted> {
        self.encoder.cut(encoder);
        let counts = self.halls.cut(at, halls);
        self.hall_counts(at, counts)
    }

    /// Handles counts that the Hall sensors made, positive forward.
    fn hall_counts(&mut self, at: Instant, counts: i8) -> Option<Counted> {
        for _ in 0..counts.unsigned_abs() {
            self.hall_edges.edge(at, counts > 0, &self.feedback);
        }
        (counts != 0).then_some(Counted::Halls)
    }

    /// Takes the present angle as the reference, at the start of a motion.
    pub(super) fn begin(&mut self, at: Instant) {
        self.hall_edges.begin(at, &self.feedback);
        self.encoder_edges.begin(at, &self.feedback);
    }

    /// Sets the measured speed to 0.
    pub(super) fn set_standstill(&mut self) {
        self.hall_edges.set_standstill();
        self.encoder_edges.set_standstill();
    }

    /// Time of the check of an impossible Hall code.
    pub(super) fn deadline(&self) -> Instant {
        self.halls.deadline()
    }

    /// Checks an impossible Hall code.
    pub(super) fn timeout(&mut self, at: Instant) {
        self.halls.check_code(at);
    }

    /// Returns true if the Hall sensors have had an impossible code for too long.
    pub(super) fn halls_are_broken(&self) -> bool {
        self.halls.are_broken()
    }

    /// Count of the Hall sensors.
    pub(super) fn count(&self) -> i64 {
        self.halls.count()
    }

    /// Time of the last edge of a Hall sensor.
    pub(super) fn last_hall_edge(&self) -> Option<Instant> {
        self.hall_edges.last()
    }

    /// Levels of channels A and B of the encoder, even while its wires are broken.
    pub(super) fn encoder_levels(&self) -> [bool; 2] {
        self.encoder.levels()
    }

    /// Distance in counts of the Hall sensors from the shaft to the middle of the count that is `counts` ahead, limited
    /// to `most`.
    pub(super) fn distance(&self, counts: i64, most: i64, at: Instant) -> I40F24 {
        self.hall_edges.distance(counts, most, at, &self.feedback)
    }

    /// Speed that the Hall sensors show for a speed of the shaft, in rpm.
    pub(super) fn of_halls(&self, rpm: I40F24) -> I40F24 {
        self.hall_edges.of_sensor(rpm)
    }

    /// Counts of the Hall sensors in a turn.
    pub(super) fn turn(&self) -> i64 {
        self.hall_edges.turn()
    }

    /// Edges of the speed sensor: the encoder, if there is one.
    fn speed(&self) -> &Edges {
        if self.encoder_edges.turn() > 0 { &self.encoder_edges } else { &self.hall_edges }
    }

    /// Speed in rpm from the edges of the speed sensor alone, positive CCW, not limited.
    pub(super) fn rpm(&self, at: Instant) -> i32 {
        self.speed().rpm(at)
    }

    /// Speed in rpm that the speed sensor reads, also between two edges.
    pub(super) fn reading(&self, at: Instant) -> I40F24 {
        self.speed().reading(at, &self.feedback)
    }

    /// The back-EMF, as a duty, at the speed `rpm` that the sensor reads.
    pub(super) fn duty_of(&self, rpm: I40F24) -> I40F24 {
        self.feedback.motor.duty(self.speed().of_shaft(rpm))
    }

    /// Present back-EMF, as a duty.
    pub(super) fn back_emf(&self, at: Instant) -> I40F24 {
        self.duty_of(self.reading(at))
    }

    /// Current in mA, with the sign of the duty.
    pub(super) fn ma(&self) -> i32 {
        self.feedback.ma
    }

    /// The effective duty at the terminals, reduced by the current limit.
    pub(super) fn applied(&self, at: Instant, duty: i32, limit_ma: u32) -> i32 {
        self.feedback.applied(at, duty, limit_ma)
    }

    pub(super) fn motor(&self) -> &ControlModel {
        &self.feedback.motor
    }
}
