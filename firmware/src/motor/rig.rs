//! A drive and the motor that it turns, as one device.

use super::Parameters;
use crate::device::{Boot, Device, Fault, Input, Instant, Pin, Refused, Sink, Spec};

/// A drive that turns a motor.
pub trait Turns: Device {
    /// The pins of its Hall sensors, which the motor drives.
    const HALLS: &'static [Pin];
    /// The fault of its list that holds the motor's shaft.
    const STALL: Option<Fault>;

    /// The motor that its registers describe.
    fn motor(&self) -> Parameters;
}

/// A drive with its motor.
#[derive(Clone, Debug)]
pub struct Rig<D> {
    drive: D,
}

impl<D: Turns> Rig<D> {
    /// `drive` and the motor that its registers describe.
    pub fn new(drive: D) -> Self {
        Self { drive }
    }
}

impl<D: Turns> Device for Rig<D> {
    fn spec(&self) -> &'static Spec {
        self.drive.spec()
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Sink) {
        self.drive.power_on(at, boot, out);
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Sink) {
        self.drive.input(at, input, out);
    }

    fn deadline(&self) -> Instant {
        self.drive.deadline()
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Sink) {
        self.drive.timeout(at, out);
    }

    fn peek(&self, at: Instant, row: usize) -> i64 {
        self.drive.peek(at, row)
    }

    fn poke(&mut self, at: Instant, row: usize, value: i64, out: &mut dyn Sink) -> Result<(), Refused> {
        self.drive.poke(at, row, value, out)
    }
}
