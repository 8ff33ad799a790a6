//! What the MD3's registers mean: everything but its serial port.

use fixed::types::{I24F8, U24F8};
use standin_protocol::registers::{Bank, Register};

use super::boot::{self, Boot};
use super::registers::{Reg, current_ma, eeprom_control, motion_control};
use super::{AXIS, BUSY, GPIO, INPUTS, J3_8, MEMORY, OVER_TEMPERATURE};
use crate::device::{self, Duration, Fault, Instant, Level, Output, Pin, Plan, Refused, Sink};
use crate::memory::{self, Content};
use crate::motion::Rates;

/// How long a save takes (7.20 does not say).
const SAVE: Duration = Duration::millis(20);
/// Bit of PinFunctionAndPolarity that makes J2 pins 9, 10 and 12 outputs (7.8).
const GPIO_OUTPUTS: u16 = 1 << 12;

/// Bit of IOPortData that switches J3 pin 8 to ground (7.9).
const J3_8_ON: u16 = 1 << 7;
/// Bits of IOPortData that show J2 pins 2, 3, 4, 5.
const INPUT_BITS: u16 = 0x000f;
/// Bits that show J2 pins 9, 10, 12 while they are inputs.
const GPIO_BITS: u16 = 0x0070;

/// Whether the drive listens and moves.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// It never had power.
    Off,
    /// The start-up delay runs: no current, no ears.
    Starting(Boot),
    /// Normal operation, or a fault.
    Ready,
}

/// What moves, as bits 0, 1 and 4 of MotionControl show it (7.15).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Motion {
    None,
    Profile,
    Jog,
    DecelStop,
}

/// A save that has begun.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Save {
    crc: [u8; 2],
    due: Instant,
}

/// An MD3 without its serial port.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    state: State,
    bank: Bank<Reg, { Reg::WORDS }>,
    /// CRC status, in the high byte (7.20).
    crc_status: u16,
    save: Option<Save>,
    motion: Motion,
    plan: Plan,
    /// Faults whose cause is there, a bit each.
    causes: u8,
    fault: bool,
    /// Levels of J2 pins 2, 3, 4, 5 and 9, 10, 12, a bit each in the places of IOPortData.
    levels: u16,
    /// What was last written to IOPortData.
    latch: u16,
    /// Peak phase current, in mA.
    current: u32,
    /// Whether BUSY is switched to ground.
    busy: bool,
}

impl Drive {
    pub(super) fn new() -> Self {
        Self {
            state: State::Off,
            bank: Bank::factory(),
            crc_status: eeprom_control::PASS,
            save: None,
            motion: Motion::None,
            plan: Plan::rest(Instant::ZERO, 0),
            causes: 0,
            fault: false,
            levels: INPUT_BITS,
            latch: 0,
            current: 0,
            busy: false,
        }
    }

    pub(super) fn power_on(&mut self, at: Instant, boot: device::Boot, out: &mut dyn Sink) {
        *self = Self::new();
        self.plan = Plan::rest(at, 0);
        let passed = self.load(out);
        self.latch = self.bank.word(Reg::IOPortData);
        out.put(at, Output::Plan { axis: AXIS, plan: &self.plan });
        out.put(at, Output::Current { axis: AXIS, ma: 0 });
        out.put(at, Output::Level { pin: BUSY, level: open_drain(false) });
        self.show_port(at, out);
        self.show_registers();
        if boot.fast {
            self.ready(at, out);
        } else {
            let delay = self.bank.limited(Reg::StartupDelay).unsigned_abs();
            self.state = State::Starting(Boot::begin(at, passed, delay, out));
        }
    }

    /// The start-up delay is over.
    fn ready(&mut self, at: Instant, out: &mut dyn Sink) {
        self.state = State::Ready;
        self.set_fault(self.causes != 0, at, out);
    }

    pub(super) fn deadline(&self) -> Instant {
        let starting = match self.state {
            State::Starting(boot) => boot.due,
            State::Off | State::Ready => Instant::NEVER,
        };
        // A jog goes on when its ramp has reached standstill: the speed may rise again.
        let moving = match self.motion {
            Motion::Profile | Motion::DecelStop => self.plan.end(),
            Motion::None | Motion::Jog => Instant::NEVER,
        };
        let saving = self.save.map_or(Instant::NEVER, |save| save.due);
        starting.min(moving).min(saving)
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Sink) {
        if let State::Starting(boot) = self.state
            && boot.due <= at
        {
            match boot.next(at, out) {
                Some(next) => self.state = State::Starting(next),
                None => self.ready(at, out),
            }
        }
        if matches!(self.motion, Motion::Profile | Motion::DecelStop) && self.plan.end() <= at {
            self.enter(Motion::None, at, out);
        }
        if let Some(save) = self.save
            && save.due <= at
        {
            memory::finish::<MEMORY>(save.crc, at, out);
            self.save = None;
            self.crc_status = 0;
            self.show_registers();
        }
    }

    /// The last instant at which the drive hears nothing; `None` once it listens.
    pub(super) fn deaf_until(&self) -> Option<Instant> {
        match self.state {
            State::Off => Some(Instant::NEVER),
            State::Starting(boot) => Some(boot.ready),
            State::Ready => None,
        }
    }

    /// The bus address (7.1).
    pub(super) fn address(&self) -> u8 {
        (self.bank.word(Reg::DeviceAddress) & 0xFF) as u8
    }

    /// SerialPortConfiguration (7.22).
    pub(super) fn serial_port(&self) -> u16 {
        self.bank.word(Reg::SerialPortConfiguration)
    }

    pub(super) fn words(&self) -> &[u16] {
        self.bank.words()
    }

    pub(super) fn words_mut(&mut self) -> &mut [u16] {
        self.bank.words_mut()
    }

    pub(super) fn peek(&self, row: usize) -> i64 {
        Reg::TABLE.value(self.bank.words(), row)
    }

    pub(super) fn poke(
        &mut self,
        at: Instant,
        reg: Reg,
        value: i64,
        out: &mut dyn Sink,
    ) -> Result<(), Refused> {
        let row = Reg::TABLE.rows.get(reg.row()).ok_or(Refused::NoSuchRegister)?;
        if !row.accepts(value) {
            return Err(Refused::OutOfRange);
        }
        if row.saved == 0 && (self.state == State::Off || !row.access.writes()) {
            return Err(Refused::ReadOnly);
        }
        if self.state == State::Off {
            if !self.load(out) {
                return Err(Refused::BadMemory);
            }
            self.bank.set(reg, value);
            let crc = memory::begin::<MEMORY>(Reg::TABLE, self.bank.words(), at, out);
            memory::finish::<MEMORY>(crc, at, out);
        } else {
            self.bank.set(reg, value);
            self.written(at, reg, out);
        }
        Ok(())
    }

    /// Something was written: what it means, in the manual's order.
    pub(super) fn written(&mut self, at: Instant, reg: Reg, out: &mut dyn Sink) {
        match reg {
            Reg::MotorCurrentAndMicrostepping => self.show_current(at, out),
            Reg::PinFunctionAndPolarity => self.show_port(at, out),
            Reg::IOPortData => {
                self.latch = self.bank.word(reg);
                self.show_port(at, out);
            }
            Reg::MotionControl => self.command(at, self.bank.word(reg), out),
            // Speed counts at once in a jog and not at all in a profile move (7.17).
            Reg::Speed if self.motion == Motion::Jog => self.jog(at, out),
            // "Changing the acceleration while the motor is moving will cause the motor to stop" (7.17).
            Reg::AccelDecel if self.motion == Motion::Profile => self.halt(at, out),
            Reg::EEPROMControl => self.eeprom(at, self.bank.word(reg), out),
            // DeviceAddress and SerialPortConfiguration hold from the next frame; the others are
            // looked at when they are used.
            _ => {}
        }
    }

    /// A write of MotionControl (7.15): the fault first, then Disable, which is a level and forbids the
    /// rest, then the first bit that is set.
    fn command(&mut self, at: Instant, word: u16, out: &mut dyn Sink) {
        let has = |bit| word & bit != 0;
        self.bank.set(Reg::MotionControl, i64::from(word & motion_control::DISABLE));
        if has(motion_control::FAULT) {
            self.clear_fault(at, out);
        }
        self.show_current(at, out);
        if has(motion_control::DISABLE | motion_control::STOP) {
            self.halt(at, out);
        } else if has(motion_control::DECEL_STOP) {
            self.decelerate(at, out);
        } else if has(motion_control::HOME) {
            // It completes at once: homing is not modelled yet.
        } else if has(motion_control::JOG) {
            self.jog(at, out);
        } else if has(motion_control::MOVE) {
            self.profile(at, out);
        }
        self.show_registers();
    }

    /// A profile move, from standstill only.
    fn profile(&mut self, at: Instant, out: &mut dyn Sink) {
        if self.may_move() && self.motion == Motion::None {
            let steps = self.bank.get(Reg::MoveSteps) as i32;
            let plan = Plan::profile(at, self.plan.position_at(at), steps, self.rates());
            self.go(Motion::Profile, plan, at, out);
        }
    }

    /// Jog from standstill, or at a new speed; nothing while something else moves, and nothing without
    /// an acceleration, which would take for ever.
    fn jog(&mut self, at: Instant, out: &mut dyn Sink) {
        let Rates { speed, up: acceleration, .. } = self.rates();
        let starts = self.may_move() && self.motion == Motion::None && speed > 0;
        if (starts || self.motion == Motion::Jog) && acceleration > 0 {
            let plan = self.plan.towards(at, I24F8::from_num(self.jog_speed()), acceleration);
            self.go(Motion::Jog, plan, at, out);
        }
    }

    /// Speed and acceleration as they act, the speed without its sign (7.17).
    fn rates(&self) -> Rates {
        let speed = U24F8::from_num(self.jog_speed().unsigned_abs());
        Rates::even(speed, self.bank.limited(Reg::AccelDecel) as u32)
    }

    /// Speed of a jog, in steps/s, with its direction.
    fn jog_speed(&self) -> i32 {
        self.bank.limited(Reg::Speed) as i32
    }

    /// Whether a command may set the motor in motion.
    fn may_move(&self) -> bool {
        self.state == State::Ready && !self.fault
    }

    /// Ends any motion with a ramp.
    fn decelerate(&mut self, at: Instant, out: &mut dyn Sink) {
        if self.motion != Motion::None {
            let plan = self.plan.towards(at, I24F8::ZERO, self.rates().down);
            self.go(Motion::DecelStop, plan, at, out);
        }
    }

    /// Follows `plan` from `at` on; one that ends at once is no motion.
    fn go(&mut self, motion: Motion, plan: Plan, at: Instant, out: &mut dyn Sink) {
        self.plan = plan;
        out.put(at, Output::Plan { axis: AXIS, plan: &self.plan });
        let over = self.plan.end() <= at && motion != Motion::Jog;
        self.enter(if over { Motion::None } else { motion }, at, out);
    }

    /// Stops at once, with the motor where it is.
    fn halt(&mut self, at: Instant, out: &mut dyn Sink) {
        if self.motion != Motion::None {
            let plan = self.plan.halt(at);
            self.go(Motion::None, plan, at, out);
        }
    }

    fn enter(&mut self, motion: Motion, at: Instant, out: &mut dyn Sink) {
        if self.motion != motion {
            self.motion = motion;
            self.show_busy(at, out);
            self.show_registers();
        }
    }

    /// The cause of a fault comes or goes. A fault stays when its cause has gone (7.15).
    pub(super) fn fault(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Sink) {
        let bit = 1_u8.checked_shl(u32::from(fault.0)).unwrap_or(0);
        if on {
            self.causes |= bit;
        } else {
            self.causes &= !bit;
        }
        if self.state == State::Ready && self.causes != 0 && !self.fault {
            self.set_fault(true, at, out);
        }
    }

    /// Clears a fault, unless the drive is still too hot (7.15). Any other cause went with the current.
    fn clear_fault(&mut self, at: Instant, out: &mut dyn Sink) {
        let thermal = 1 << OVER_TEMPERATURE.0;
        self.causes &= thermal;
        if self.fault && self.causes == 0 {
            self.set_fault(false, at, out);
        }
    }

    fn set_fault(&mut self, fault: bool, at: Instant, out: &mut dyn Sink) {
        self.fault = fault;
        if fault {
            self.halt(at, out);
        }
        boot::show(at, fault, out);
        self.show_current(at, out);
        self.show_busy(at, out);
        self.show_registers();
    }

    /// An input pin changed.
    pub(super) fn edge(&mut self, pin: Pin, high: bool) {
        let Some(&(_, bit)) = INPUTS.iter().chain(&GPIO).find(|(input, _)| *input == pin) else { return };
        if high {
            self.levels |= bit;
        } else {
            self.levels &= !bit;
        }
        self.show_registers();
    }

    /// A write of EEPROMControl (7.20); with both bits it is a save.
    fn eeprom(&mut self, at: Instant, word: u16, out: &mut dyn Sink) {
        if word & eeprom_control::WRITE != 0 {
            if self.save.is_none() {
                // What the pins show is not what was written to them.
                self.bank.set(Reg::IOPortData, i64::from(self.latch));
                let crc = memory::begin::<MEMORY>(Reg::TABLE, self.bank.words(), at, out);
                self.save = Some(Save { crc, due: at + SAVE });
            }
        } else if word & eeprom_control::READ != 0 && self.load(out) {
            for (index, _) in Reg::TABLE.rows.iter().enumerate().filter(|(_, row)| row.saved != 0) {
                if let Some(reg) = Reg::from_row(index) {
                    self.written(at, reg, out);
                }
            }
        }
        self.show_registers();
    }

    /// Loads the saved registers, those of a new drive from the factory; leaves them alone if the
    /// memory is bad. Returns whether it passed.
    fn load(&mut self, out: &dyn Sink) -> bool {
        let content = memory::content(out.memory(), Reg::SAVED_WORDS);
        match content {
            Content::New => memory::reset(Reg::TABLE, self.bank.words_mut()),
            Content::Good => memory::load(Reg::TABLE, out.memory(), self.bank.words_mut()),
            Content::Bad => {}
        }
        let passed = content != Content::Bad;
        self.crc_status = if passed { eeprom_control::PASS } else { eeprom_control::FAIL };
        passed
    }

    /// Brings the registers that show something up to date.
    fn show_registers(&mut self) {
        let saving = if self.save.is_some() { eeprom_control::WRITE } else { 0 };
        self.bank.set(Reg::EEPROMControl, i64::from(self.crc_status | saving));

        let fault = if self.fault { motion_control::FAULT } else { 0 };
        let moving = match self.motion {
            Motion::None => 0,
            Motion::Profile => motion_control::MOVE,
            Motion::Jog => motion_control::JOG,
            Motion::DecelStop => motion_control::DECEL_STOP,
        };
        let disable = self.bank.word(Reg::MotionControl) & motion_control::DISABLE;
        self.bank.set(Reg::MotionControl, i64::from(fault | disable | moving));

        // Inputs show their pins, outputs what was written.
        let pins = if self.gpio_outputs() { INPUT_BITS } else { INPUT_BITS | GPIO_BITS };
        let port = self.latch & !pins | self.levels & pins;
        self.bank.set(Reg::IOPortData, i64::from(port));
    }

    /// Whether J2 pins 9, 10 and 12 are outputs.
    fn gpio_outputs(&self) -> bool {
        self.bank.word(Reg::PinFunctionAndPolarity) & GPIO_OUTPUTS != 0
    }

    /// J3 pin 7 is switched to ground while the motor moves and in a fault (section 2).
    fn show_busy(&mut self, at: Instant, out: &mut dyn Sink) {
        let busy = self.motion != Motion::None || self.fault;
        if self.busy != busy {
            self.busy = busy;
            out.put(at, Output::Level { pin: BUSY, level: open_drain(busy) });
        }
    }

    /// Drives the outputs of IOPortData, and shows it (7.9).
    fn show_port(&mut self, at: Instant, out: &mut dyn Sink) {
        out.put(at, Output::Level { pin: J3_8, level: open_drain(self.latch & J3_8_ON != 0) });
        for (pin, bit) in GPIO {
            let level = match (self.gpio_outputs(), self.latch & bit != 0) {
                (false, _) => Level::Float,
                (true, false) => Level::Low,
                (true, true) => Level::High,
            };
            out.put(at, Output::Level { pin, level });
        }
        self.show_registers();
    }

    /// Gives the motor its current.
    fn show_current(&mut self, at: Instant, out: &mut dyn Sink) {
        let disabled = self.bank.word(Reg::MotionControl) & motion_control::DISABLE != 0;
        let on = self.may_move() && !disabled;
        let ma = if on { current_ma(self.bank.word(Reg::MotorCurrentAndMicrostepping)) } else { 0 };
        if self.current != ma {
            self.current = ma;
            out.put(at, Output::Current { axis: AXIS, ma });
        }
    }
}

/// An output transistor to ground.
fn open_drain(on: bool) -> Level {
    if on { Level::Low } else { Level::Float }
}
