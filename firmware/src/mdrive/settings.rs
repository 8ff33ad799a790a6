//! Settings of motion and I/O, read from the registers.

use super::hybrid::frequency;
use super::io::{self, Io};
use super::motion::{self, Motion};
use super::registers::Reg;
use super::variables::Registers;
use crate::device::{Context, Instant};
use crate::motor::stepper::StepperParameters;

/// Passes the settings to motion. The bridge is on if DE is 1, unless the circuitry has switched it off
/// (`is_disabled`).
pub(super) fn set_motion(
    at: Instant,
    registers: &mut Registers,
    io: &Io,
    is_disabled: bool,
    motion: &mut Motion,
    out: &mut dyn Context,
) {
    let settings = motion_settings(registers, Some(io));
    let enabled = settings.enabled && !is_disabled;
    if motion.set(at, motion::Settings { enabled, ..settings }, out) {
        // "Make up mode will be cleared when bridges are disabled and Hybrid is enabled" (MC 5-50).
        registers.set(Reg::MU, 0);
    }
}

/// Settings of the motion. Without `io` the motion follows no clock and has no home switch.
pub(super) fn motion_settings(bank: &Registers, io: Option<&Io>) -> motion::Settings {
    let long = |reg| u32::try_from(bank.get(reg)).unwrap_or(0);
    let byte = |reg| (bank.word(reg) & 0xFF) as u8;
    let flag = |reg| bank.word(reg) != 0;
    motion::Settings {
        start: long(Reg::VI),
        speed: long(Reg::VM),
        up: long(Reg::A),
        down: long(Reg::D),
        microsteps: bank.word(Reg::MS),
        settle_ms: bank.word(Reg::MT),
        hold_delay_ms: bank.word(Reg::HT),
        run_percent: byte(Reg::RC),
        hold_percent: byte(Reg::HC),
        enabled: flag(Reg::DE),
        response: response(bank),
        keeps_field: bank.word(Reg::AS) != 0,
        limit_mode: byte(Reg::LM),
        jogs: flag(Reg::JE),
        home_debounce_ms: io.map_or(0, Io::home_debounce_ms),
        follows_clock: io.is_some_and(Io::follows_clock),
        ratio: bank.word(Reg::CR),
        closed: flag(Reg::EE),
        lines: bank.word(Reg::EL),
        deadband: bank.word(Reg::DB),
        stall_factor: bank.word(Reg::SF),
        goes_on_stalled: flag(Reg::SM),
        maintains: flag(Reg::PM),
        machine: machine(bank),
    }
}

/// Highest speed that the rotor can follow, in steps/s. SS limits it with AS 1 and 2 only (FB 5.1); an
/// MDrivePlus has no AS.
fn response(bank: &Registers) -> u32 {
    match bank.word(Reg::AS) {
        1 | 2 => frequency(bank.word(Reg::SS).into()).unsigned_abs(),
        _ => u32::MAX,
    }
}

/// Parameters of the motor and its load.
fn machine(bank: &Registers) -> StepperParameters {
    let long = |reg| u32::try_from(bank.get(reg)).unwrap_or(0);
    StepperParameters {
        steps_per_rev: bank.word(Reg::FullSteps),
        holding_unm: long(Reg::HoldingTorque) * 1_000,
        pull_out_rpm: long(Reg::PullOutSpeed),
        inertia_gcm2: long(Reg::Inertia),
        friction_unm: long(Reg::Friction) * 1_000,
        load_unm: i32::try_from(bank.get(Reg::Load)).unwrap_or(0) * 1_000,
        ..StepperParameters::NOMINAL
    }
}

/// Settings of filters and pulses of the I/O.
pub(super) fn filters(bank: &Registers) -> io::Filters {
    let byte = |reg| (bank.word(reg) & 0xFF) as u8;
    io::Filters {
        debounce_ms: [Reg::D1, Reg::D2, Reg::D3, Reg::D4].map(byte),
        average: byte(Reg::D5),
        capture: byte(Reg::FC),
        clock: byte(Reg::FM),
        pulse: byte(Reg::CW),
        clocked: bank.word(Reg::CM) != 0,
        ratio: bank.word(Reg::CR),
    }
}
