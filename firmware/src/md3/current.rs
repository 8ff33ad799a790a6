//! Faults, and the current of the motor (7.2, 7.3, 7.15).

use super::drive::{Drive, State};
use super::motion::Motion;
use super::pins::Pin2;
use super::reasons::Why;
use super::registers::io_port::J2_2;
use super::registers::{Reg, current_ma, microstepping_percent};
use super::startup::Lights;
use super::{AXIS, OVER_TEMPERATURE};
use crate::device::{Context, Duration, Fault, Instant, Output};

/// A unit of the cutback timeout (7.3).
const TIMEOUT_UNIT: Duration = Duration::millis(100);

impl Drive {
    /// The cause of a fault appears or ends. The fault stays when its cause has ended (7.15).
    pub(super) fn set_fault(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Context) {
        let bit = 1_u8.checked_shl(u32::from(fault.0)).unwrap_or(0);
        if on {
            self.causes |= bit;
        } else {
            self.causes &= !bit;
        }
        if self.state == State::Ready && self.causes != 0 && !self.fault {
            self.fault = true;
            self.halt(at, out);
            self.update_outputs(at, out);
        }
    }

    /// Clears a fault, unless the drive is still too hot (7.15; MD3-14). The other causes end when the fault
    /// switches the current off. Afterwards the levels of the pins and the endless modes may move the motor
    /// again.
    ///
    /// # Errors
    /// The reason why the fault stays.
    pub(super) fn clear_fault(&mut self, at: Instant) -> Result<(), Why> {
        self.causes &= 1 << OVER_TEMPERATURE.0;
        if !self.fault {
            return Ok(());
        }
        if self.causes != 0 {
            return Err(Why::TooHot);
        }
        self.fault = false;
        self.armed = true;
        self.restart_cutback(at);
        Ok(())
    }

    /// Restarts the cutback timeout: after a command, after an input change, and when a motion begins or ends
    /// (7.3; MD3-31).
    pub(super) fn restart_cutback(&mut self, at: Instant) {
        self.quiet_since = at;
        self.cut_back = false;
    }

    /// Time at which the cutback begins.
    pub(super) fn cutback_due(&self) -> Instant {
        let timeout = self.bank.word(Reg::CurrentCutbackSettings) >> 8;
        let waits =
            self.state == State::Ready && !self.cut_back && !self.fault && self.motion == Motion::None;
        if waits && timeout > 0 {
            self.quiet_since + TIMEOUT_UNIT * u64::from(timeout)
        } else {
            Instant::NEVER
        }
    }

    /// Sets the motor's current and the lights.
    pub(super) fn update_current(&mut self, at: Instant, out: &mut dyn Context) {
        if self.state != State::Ready {
            return;
        }
        // LOWCURRENT lowers the current independently of the timeout (MD3-39).
        let lowered = self.cut_back || self.pins.pin_2 == Pin2::LowCurrent && self.active & J2_2 != 0;
        let lights = match (self.fault, lowered) {
            (true, _) => Lights::Fault,
            (false, true) => Lights::Cutback,
            (false, false) => Lights::Normal,
        };
        self.lights.change(lights, at, out);
        let setting = self.bank.word(Reg::MotorCurrentAndMicrostepping);
        let code = if lowered { self.bank.word(Reg::CurrentCutbackSettings) } else { setting };
        let ma = if self.can_move().is_ok() && !self.inhibited {
            current_ma(self.version, code) * microstepping_percent(setting) / 100
        } else {
            0
        };
        if self.current != ma {
            self.current = ma;
            out.put(at, Output::CurrentLimit { axis: AXIS, ma });
            self.motor.energize(at, ma > 0, out);
        }
    }
}
