//! The motor's current: faults, Disable and cutback (7.2, 7.3, 7.15), and the lights that show them.

use super::io::Io;
use super::motor::Setting;
use super::reasons::Why;
use super::registers::{Reg, Version, motion_control};
use super::startup::Lights;
use super::{OVER_TEMPERATURE, Words};
use crate::device::{Context, Duration, Fault, Instant};

/// A unit of the cutback timeout (7.3).
const TIMEOUT_UNIT: Duration = Duration::millis(100);

/// Permission for the current, and the cutback that lowers it.
#[derive(Clone, Debug)]
pub(super) struct Current {
    version: Version,
    /// True after the start-up.
    is_on: bool,
    /// True while MotionControl's Disable bit is set: the motor has no current (7.15).
    disabled: bool,
    /// Bits of the faults that have their cause present.
    causes: u8,
    fault: bool,
    /// Time of the last command, input change, or start or end of a motion.
    quiet_since: Instant,
    /// Time of the next cutback.
    cutback_at: Instant,
    lights: Lights,
}

impl Current {
    /// No current, as during start-up.
    pub(super) fn new(version: Version) -> Self {
        Self {
            version,
            is_on: false,
            disabled: false,
            causes: 0,
            fault: false,
            quiet_since: Instant::ZERO,
            cutback_at: Instant::NEVER,
            lights: Lights::Starting,
        }
    }

    /// The version of the drive.
    pub(super) fn version(&self) -> Version {
        self.version
    }

    /// Permits current at the end of the start-up. If the cause of a fault is present now, the drive is in a
    /// fault (MD3-15).
    pub(super) fn switch_on(&mut self, at: Instant) {
        self.is_on = true;
        self.fault = self.causes != 0;
        self.restart_cutback(at);
    }

    /// The cause of a fault appears or ends. The fault stays when its cause has ended (7.15). Returns true if
    /// a fault begins.
    pub(super) fn set_cause(&mut self, fault: Fault, on: bool) -> bool {
        let bit = 1_u8.checked_shl(u32::from(fault.0)).unwrap_or(0);
        if on {
            self.causes |= bit;
        } else {
            self.causes &= !bit;
        }
        let begins = self.is_on && self.causes != 0 && !self.fault;
        self.fault |= begins;
        begins
    }

    /// Clears a fault, unless the drive is still too hot (7.15; MD3-14). The other causes end when the fault
    /// switches the current off. Returns true if there was a fault.
    ///
    /// # Errors
    /// The reason why the fault stays.
    pub(super) fn clear_fault(&mut self, at: Instant) -> Result<bool, Why> {
        self.causes &= 1 << OVER_TEMPERATURE.0;
        if !self.fault {
            return Ok(false);
        }
        if self.causes != 0 {
            return Err(Why::TooHot);
        }
        self.fault = false;
        self.restart_cutback(at);
        Ok(true)
    }

    /// Returns true in a fault.
    pub(super) fn has_fault(&self) -> bool {
        self.fault
    }

    /// Sets Disable. Returns true if this enables the motor.
    pub(super) fn disable(&mut self, disabled: bool) -> bool {
        let was_disabled = core::mem::replace(&mut self.disabled, disabled);
        was_disabled && !disabled
    }

    /// Checks that a command may start a motion.
    pub(super) fn can_move(&self) -> Result<(), Why> {
        if self.fault {
            Err(Why::Fault)
        } else if self.disabled || !self.is_on {
            Err(Why::Disabled)
        } else {
            Ok(())
        }
    }

    /// The bits of Fault and Disable in `MotionControl` (7.15).
    pub(super) fn control(&self) -> u16 {
        let disable = if self.disabled { motion_control::DISABLE } else { 0 };
        let fault = if self.fault { motion_control::FAULT } else { 0 };
        disable | fault
    }

    /// Restarts the cutback timeout: after a command, after an input change, and when a motion begins or ends
    /// (7.3; MD3-31). An [`update`](Self::update) follows.
    pub(super) fn restart_cutback(&mut self, at: Instant) {
        self.quiet_since = at;
    }

    /// Returns true while the current is lowered.
    pub(super) fn is_lowered(&self) -> bool {
        self.lights == Lights::Cutback
    }

    /// Time of the next [`update`](Self::update): the cutback begins.
    pub(super) fn deadline(&self) -> Instant {
        self.cutback_at
    }

    /// Updates the lights and the time of the cutback; `stands` is true if no motion runs. Returns the peak
    /// phase current in mA.
    pub(super) fn update(
        &mut self,
        at: Instant,
        bank: &Words,
        io: &Io,
        stands: bool,
        out: &mut dyn Context,
    ) -> u32 {
        if !self.is_on {
            return 0;
        }
        let cutback = bank.word(Reg::CurrentCutbackSettings);
        let timeout = cutback >> 8;
        let due = if stands && !self.fault && timeout > 0 {
            self.quiet_since + TIMEOUT_UNIT * u64::from(timeout)
        } else {
            Instant::NEVER
        };
        self.cutback_at = if due > at { due } else { Instant::NEVER };
        // LOWCURRENT lowers the current independently of the timeout (MD3-39).
        let lowered = due <= at || io.lowers_current();
        let lights = match (self.fault, lowered) {
            (true, _) => Lights::Fault,
            (false, true) => Lights::Cutback,
            (false, false) => Lights::Normal,
        };
        self.lights.change(lights, at, out);
        if self.can_move().is_err() || io.is_inhibited() {
            return 0;
        }
        let setting = bank.word(Reg::MotorCurrentAndMicrostepping);
        let code = if lowered { cutback } else { setting };
        // At full step the phases get 71 % of the peak current (7.2).
        let percent = if Setting(setting).is_full_step() { 71 } else { 100 };
        self.milliamperes(code) * percent / 100
    }

    /// Returns true if the table of currents has a code (7.2).
    pub(super) fn has_code(&self, code: u16) -> bool {
        code & 0xFF <= self.last_code()
    }

    /// Peak phase current in mA of a code (7.2). Above 2 A a step of the high current version is larger. Codes
    /// beyond the table act as its last row (MD3-10).
    fn milliamperes(&self, code: u16) -> u32 {
        let code = u32::from((code & 0xFF).min(self.last_code()));
        match (self.version, code) {
            (Version::HighCurrent, 0..=0x14) => 100 * code,
            (Version::HighCurrent, _) => 2_000 + 500 * (code - 0x14),
            (Version::LowCurrent, _) => 50 * code,
        }
    }

    /// Last code of the table of currents (7.2).
    fn last_code(&self) -> u16 {
        match self.version {
            Version::HighCurrent => 0x1e,
            Version::LowCurrent => 0x24,
        }
    }
}
