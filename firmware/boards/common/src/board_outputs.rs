//! Outputs of a board for its drive.

use drivetwin_firmware::device::{self, Duration, Line, Pin, Plan, Port};
use drivetwin_firmware::motion::{HandOff, PlanLoader, StepTimer};
use drivetwin_firmware::shell::{Links, NoNetwork, Outputs};
use embedded_hal::digital::OutputPin;
use embedded_io::{Write, WriteReady};
use embedded_storage::Storage;

use crate::axis::{Axis, Timer};
use crate::slips;
use crate::wire::{AxisPins, End};

/// The sending half of a board's UART.
pub trait Bus: Write + WriteReady {
    /// Changes the settings of the line when all characters that were written have been sent.
    fn set_line(&mut self, line: Line);
}

/// A pin that can be released.
pub trait Release: OutputPin {
    /// If `released`, makes the pin an input; otherwise makes it an output again.
    fn release(&mut self, released: bool);
}

/// The outputs of a board with one bus, one axis and `PINS` wires.
pub struct BoardOutputs<B, P, M, T: Timer + 'static, const PINS: usize, L = NoNetwork> {
    /// Sending half of the bus.
    pub bus: B,
    /// Pins, each with the drive's pin or fault that it is wired to; `None` if the drive has no such name.
    pub pins: [(Option<End>, P); PINS],
    /// The non-volatile memory, which also gives its content as bytes.
    pub memory: M,
    /// The axis.
    pub axis: &'static Axis<T>,
    /// Location of STEP and DIR.
    pub axis_pins: AxisPins,
    /// Loader of the plans of the axis.
    pub loader: PlanLoader,
    /// The network, if the drive has TCP ports.
    pub links: Option<L>,
}

impl<B, P: Release, M, T: Timer, const PINS: usize, L> BoardOutputs<B, P, M, T, PINS, L> {
    /// Releases all pins, and ends the motion of the axis at once.
    pub(crate) fn power_off(&mut self) {
        for (_, pin) in &mut self.pins {
            pin.release(true);
        }
        if self.axis_pins != AxisPins::None {
            let _ = self.axis.with(|stepper, _| stepper.halt());
            // The drive forgets its position, and steps that slipped before mean nothing to it.
            let _ = slips::untold();
        }
        self.loader = PlanLoader::new();
    }
}

impl<B, P, M, T, const PINS: usize, L> Outputs for BoardOutputs<B, P, M, T, PINS, L>
where
    B: Bus,
    P: Release,
    M: Storage + AsRef<[u8]>,
    T: Timer,
    L: Links,
{
    type Serial = B;
    type Pin = P;
    type Memory = M;
    type Links = L;

    fn serial(&mut self, _port: Port) -> Option<&mut B> {
        Some(&mut self.bus)
    }

    fn links(&mut self) -> Option<&mut L> {
        self.links.as_mut()
    }

    fn set_line(&mut self, _port: Port, line: Line) {
        self.bus.set_line(line);
    }

    fn pin(&mut self, pin: Pin) -> Option<&mut P> {
        self.pins.iter_mut().find(|(end, _)| *end == Some(End::Pin(pin))).map(|(_, output)| output)
    }

    fn release(&mut self, pin: Pin, released: bool) {
        if self.axis_pins == AxisPins::Shared(pin) {
            // A level that the drive sets takes the pin from the axis. STEP and DIR are low when the axis
            // gets them back.
            let _ = self.axis.with(|stepper, _| stepper.release());
        }
        if let Some(pin) = self.pin(pin) {
            pin.release(released);
        }
    }

    fn memory(&mut self) -> &mut M {
        &mut self.memory
    }

    fn stored(&self) -> &[u8] {
        self.memory.as_ref()
    }

    fn plan(&mut self, _axis: device::Axis, plan: &Plan) -> Duration {
        if self.axis_pins == AxisPins::None {
            return Duration::ZERO;
        }
        let HandOff { step_skew, delay } = self.loader.load(&mut self.axis, plan);
        slips::add(step_skew);
        delay
    }

    fn wait(&mut self, late: Duration) {
        self.loader.wait(late);
    }

    fn step(&mut self, _axis: device::Axis, steps: i32) {
        if self.axis_pins != AxisPins::None {
            let _ = self.axis.with(|stepper, now| stepper.step(now, steps));
        }
    }
}
