//! MDrive Motion Control with Ethernet: an integrated stepper motor and drive, MDrivePlus² or Hybrid, with
//! Modbus/TCP on port 502 and MCode on port 503.
//!
//! The code follows *MODBUS/TCP Fieldbus Manual* R040611 (FB, cited by section) and *MCode Programming and
//! Software Reference* R062812 (MC, cited by page or section).

mod drive;
mod error;
mod fields;
mod hybrid;
mod interpreter;
mod io;
mod mcode;
mod modbus;
mod motion;
mod reader;
mod reasons;
mod registers;
mod saved;
mod startup;
mod variables;

#[cfg(test)]
mod tests;

use drivetwin_protocol::registers::{Register, Table};

use self::drive::Drive;
use self::interpreter::Interpreter;
use self::mcode::console::note_lost_input;
pub use self::mcode::program::lines as program_lines;
use self::registers::Model;
pub use self::registers::Reg;
use crate::device::{
    AxisSpec, Boot, Context, Device, EncoderSpec, Fault, Framing, Input, Instant, Level, Pin, PinSpec, Port,
    PortSpec, PresetError, Role, Spec, Writes, reported,
};

const MODBUS: Port = Port(0);
const MCODE: Port = Port(1);

const IO1: Pin = Pin(0);
const IO2: Pin = Pin(1);
const IO3: Pin = Pin(2);
const IO4: Pin = Pin(3);
const IO7: Pin = Pin(4);
const IO8: Pin = Pin(5);
const ANALOG: Pin = Pin(6);
const CAPTURE: Pin = Pin(7);
const A: Pin = Pin(8);
const B: Pin = Pin(9);
const INDEX: Pin = Pin(10);

/// Fault `stall`: the shaft is blocked.
const STALL: Fault = Fault(0);
/// Fault `over_temperature`: the electronics become too hot.
const OVER_TEMPERATURE: Fault = Fault(1);
/// Fault `locked_rotor`. This fault and those below exist on a Hybrid only.
const LOCKED_ROTOR: Fault = Fault(2);
const LEAD_LIMIT: Fault = Fault(3);
const LAG_LIMIT: Fault = Fault(4);
const CALIBRATION: Fault = Fault(5);

/// Size of the non-volatile memory, in bytes.
pub const MEMORY: usize = saved::MEMORY;

/// Shunt resistor of the ANALOG input for a current: 20 mA give 5 V. The manuals do not specify it.
const SHUNT_OHM: u16 = 250;

const fn pin(name: &'static str, role: Role, idle: Level) -> PinSpec {
    PinSpec::new(name, role, idle)
}

// `Level::Float` as idle level tells the drive that an input is open: an open sinking input reads high, an
// open
// sourcing input low. A remote encoder counts once its channels are driven.
#[rustfmt::skip]
static PINS: [PinSpec; 11] = [
    pin("IO1", Role::Both, Level::Float),
    pin("IO2", Role::Both, Level::Float),
    pin("IO3", Role::Both, Level::Float),
    pin("IO4", Role::Both, Level::Float),
    pin("IO7", Role::Both, Level::High),
    pin("IO8", Role::Both, Level::High),
    PinSpec { shunt_ohm: SHUNT_OHM, ..pin("ANALOG", Role::Analogue, Level::Low) },
    pin("CAPTURE", Role::Both, Level::High),
    pin("A", Role::Input, Level::Float),
    pin("B", Role::Input, Level::Float),
    pin("I", Role::Input, Level::Float),
];

static WRITES: Writes =
    Writes { language: |row| Reg::from_row(row).and_then(registers::mcode_range), refuses: reader::refuses };

static MDRIVE: Spec = spec(
    "mdrive",
    "MDrive 23 Plus2 Motion Control, Ethernet",
    Model::Plus,
    Reg::TABLE,
    &["stall", "over_temperature"],
);
static MDRIVE_HYBRID: Spec = spec(
    "mdrive-hybrid",
    "MDrive 23 Hybrid Motion Control, Ethernet",
    Model::Hybrid,
    &registers::TABLE_HYBRID,
    &["stall", "over_temperature", "locked_rotor", "lead_limit", "lag_limit", "calibration"],
);

/// Parts that are not modelled, and why. The last [`OF_HYBRID`] entries apply to the Hybrid only.
static NOT_MODELLED: [&str; 23] = [
    "MCode over UDP (FB 6.3, MC 1.2.2)",
    "BD, CK, DG, DN, PY, QD, Ctrl-J (MC 1.2.2): commands of drives with a serial port; error 37. With \
     SerialCommands 1 TCP has them, but BD has no effect, and answers of several drives do not collide",
    "D9 to D12, I9 to I12, O9 to O12, S9 to S12, IH, OH (FB 1.2.1): drives with Ethernet have no such I/O; \
     error 37",
    "AT, FT, I7, I8, I13 (MC 5-3, 5-27, 5-34, 5-35): reserved; error 37",
    "PW (MC 5-58): of another product; users may define it",
    "UG (MC 5-77) and the upgrade of the Ethernet controller (FB 6.6): there is no other firmware; error 37",
    "setting IP address, netmask and MAC address (FB 6.3): the protocol is not published",
    "error 88, following error (MC 9.6): MC does not say when it occurs; a stall is error 86",
    "errors 47 and 63 (MC 9): this memory never fails, and TCP loses nothing",
    "resonance, ringing, ripple of speed and current: the motor follows its steps exactly, or is out of step",
    "the angle by which a load turns a shaft that is in step (up to a full step): it is where its steps are",
    "momentum of a shaft that falls out of step: it stops at once, then its load turns it",
    "detent torque: no manual gives it; without current only Friction holds the shaft",
    "a load that turns the shaft without power: the drive gets no event when power fails. C2 then begins at \
     0, and the index (I6, HI) is where it was. A [[motor]] does turn",
    "the supply: MC has no register of it; a load that drives the motor does not raise it, and the torque \
     does not depend on it",
    "the configuration test (SC = 1, MC 4-8) and its errors 100 to 103: this encoder has no errors; error 37",
    "a current that varies with the load (AS 2, MC 5-3): it is RC, as with AS 1",
    "torque compensation (CA = 0,1, MC 5-9): this motor needs none",
    "make-up steps during a move (MC 5-50): they are made after it",
    "a rotor that creeps at the bounds of CB (MC 5-10): it stands still, unless its load turns it",
    "heat of the motor's own current (IT, MC 5-38): MC has no figures; only the fault over_temperature heats \
     it",
    "AF 4, maximum lead/lag limit reached (MC 5-2): a rotor is locked before the 32 bits of LL are full",
    "effect of the circuitry on a rotor out of step, at a [[motor]] of a bench: that motor gets only steps \
     and current, and falls into step as an MDrivePlus2's does; C2, LL and LR are right",
];

/// Number of entries at the end of [`NOT_MODELLED`] that apply to the Hybrid only.
const OF_HYBRID: usize = 8;

/// Description of a product. The arguments are what differs between the two products.
const fn spec(
    kind: &'static str,
    product: &'static str,
    model: Model,
    registers: &'static Table,
    faults: &'static [&'static str],
) -> Spec {
    Spec {
        kind,
        product,
        manual: "MODBUS/TCP Fieldbus Manual R040611, MCode Programming and Software Reference R062812",
        ports: &[
            PortSpec { name: "modbus", framing: Framing::Mbap, line: None },
            PortSpec { name: "mcode", framing: Framing::Return, line: None },
        ],
        pins: &PINS,
        axes: &[AxisSpec { name: "motor", step_dir: None }],
        encoders: &[EncoderSpec { a: A, b: B, index: Some(INDEX) }],
        faults,
        memory: MEMORY as u16,
        registers,
        variant: model.variant(),
        writes: WRITES.reported(),
        reasons: reasons::reasons(model),
        rules: Some(&modbus::RULES),
        errors: error::TEXTS,
        last_error: Some(Reg::ER as usize),
        not_modelled: match model {
            Model::Plus => reported(NOT_MODELLED.split_at(NOT_MODELLED.len() - OF_HYBRID).0),
            Model::Hybrid => reported(&NOT_MODELLED),
        },
        ..Spec::EMPTY
    }
}

/// An MDrive with its motor.
#[derive(Clone, Debug)]
pub struct Mdrive {
    drive: Drive,
}

impl Mdrive {
    /// An MDrivePlus², without power.
    // Inlined to build the value in its final place: a copy would need room on a board's stack.
    #[inline(always)]
    #[must_use]
    pub fn plus() -> Self {
        Self { drive: Drive::new(Model::Plus) }
    }

    /// An MDrive Hybrid, without power.
    #[inline(always)]
    #[must_use]
    pub fn hybrid() -> Self {
        Self { drive: Drive::new(Model::Hybrid) }
    }
}

impl Device for Mdrive {
    fn spec(&self) -> &'static Spec {
        match self.drive.bank.model() {
            Model::Plus => &MDRIVE,
            Model::Hybrid => &MDRIVE_HYBRID,
        }
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.drive.power_on(at, boot, out);
    }

    fn power_off(&mut self, _at: Instant) {
        self.drive.power_off();
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        let drive = &mut self.drive;
        match input {
            Input::Message { port: MODBUS, link, bytes } => modbus::serve(drive, at, link, bytes, out),
            Input::Message { link, bytes, .. } if drive.startup.is_started() => {
                Interpreter::new(drive, at, out).received(link, bytes);
            }
            // Each character is noted, because pieces of input are not lines.
            Input::Message { bytes, .. } => bytes.iter().for_each(|_| note_lost_input(at, out)),
            Input::Opened { port: MCODE, link } => drive.mcode.consoles.opened(at, link, out),
            Input::Closed { port: MCODE, link } => Interpreter::new(drive, at, out).closed(link),
            Input::Edge { pin, high } => drive.io.edge(at, pin, high, out),
            Input::Open { pin } => drive.io.opened(at, pin, out),
            Input::Millivolts { pin: ANALOG, mv } => drive.io.voltage(at, mv),
            // A board's counter reports edges of a remote encoder and the present levels of its channels A
            // and B.
            Input::Count { steps, a, b, .. } => drive.motion.count(at, steps, [a, b], out),
            Input::Fault { fault, on } => drive.set_fault(at, fault, on, out),
            _ => {}
        }
        drive.dispatch_events(at, out);
    }

    fn accepts(&self, _port: Port) -> bool {
        self.drive.startup.accepts_connections()
    }

    fn takes(&self, port: Port) -> bool {
        port != MCODE || self.drive.mcode.consoles.takes()
    }

    fn receives_from(&self) -> Instant {
        self.drive.startup.receives_from()
    }

    fn deadline(&self) -> Instant {
        self.drive.deadline()
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.drive.deadline() <= at {
            self.drive.timeout(at, out);
            Interpreter::new(&mut self.drive, at, out).timeout();
        }
    }

    fn peek(&self, at: Instant, row: usize) -> i64 {
        Reg::from_row(row).map_or(0, |reg| self.drive.peek(at, reg))
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let reg = Reg::from_row(row).ok_or(PresetError::NoSuchRegister)?;
        self.drive.poke(at, reg, value, out)
    }

    fn microsteps(&self, _axis: crate::device::Axis) -> u16 {
        self.drive.bank.word(Reg::MS)
    }

    fn program_line(&self) -> Option<u16> {
        self.drive.mcode.vm.next_line()
    }
}
