//! GPIO pins (8.5 of the datasheet).

use crate::inputs;
use crate::registers::Register;

/// A port of eight pins.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Port(usize);

/// Port A.
pub const A: Port = Port(0x4000_4000);
/// Port B.
pub const B: Port = Port(0x4000_5000);
/// Port C.
pub const C: Port = Port(0x4000_6000);
/// Port D.
pub const D: Port = Port(0x4000_7000);
/// Port E.
pub const E: Port = Port(0x4002_4000);
/// Port F.
pub const F: Port = Port(0x4002_5000);
/// Port G.
pub const G: Port = Port(0x4002_6000);

const DIR: usize = 0x400;
const IBE: usize = 0x408;
const IM: usize = 0x410;
const RIS: usize = 0x414;
const MIS: usize = 0x418;
const ICR: usize = 0x41C;
const AFSEL: usize = 0x420;
const ODR: usize = 0x50C;
const PUR: usize = 0x510;
const PDR: usize = 0x514;
const DEN: usize = 0x51C;

impl Port {
    /// Pin `n` of the port, 0 to 7.
    #[must_use]
    pub const fn pin(self, n: u32) -> Gpio {
        Gpio { port: self, bit: 1 << (n & 7) }
    }

    /// Pins whose interrupt is pending, one bit each.
    pub(crate) fn changed(self) -> u32 {
        self.register(MIS).read()
    }

    /// Assigns pins to their peripheral.
    pub(crate) fn give(self, pins: u32) {
        self.register(AFSEL).set(pins);
        self.register(DEN).set(pins);
    }

    const fn register(self, offset: usize) -> Register {
        Register::at(self.0, offset)
    }
}

/// A pin of a port.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Gpio {
    port: Port,
    bit: u32,
}

impl Gpio {
    /// Makes the pin a push-pull output, low at first.
    pub(crate) fn push_pull(self) {
        self.write(false);
        self.drive(true);
        self.register(DEN).set(self.bit);
    }

    /// Makes the pin an open-drain output, released at first.
    pub(crate) fn open_drain(self) {
        self.register(ODR).set(self.bit);
        self.push_pull();
        self.write(true);
    }

    /// Makes the pin an input that is pulled up or down.
    pub(crate) fn pulled(self, high: bool) {
        self.register(if high { PUR } else { PDR }).set(self.bit);
        self.register(DEN).set(self.bit);
    }

    /// Makes the pin an input with the idle level `high` when nothing is wired to it. QEMU has no pull-ups,
    /// but an input keeps the level that it had as an output. Therefore the pin is first an output: as a
    /// released open drain it does no harm.
    pub(crate) fn resting(self, high: bool) {
        self.pulled(high);
        self.release(high);
    }

    /// Makes the pin an input with the idle level `high`.
    pub(crate) fn release(self, high: bool) {
        if high {
            self.take();
            self.write(true);
        }
        self.drive(false);
        self.register(ODR).clear(self.bit);
    }

    /// Makes the pin an open-drain output, so that it drives nothing high before [`push`](Self::push) sets a
    /// level.
    pub(crate) fn take(self) {
        self.register(ODR).set(self.bit);
        self.drive(true);
    }

    /// Drives an output that [`take`](Self::take) has made to this level.
    fn push(self, high: bool) {
        self.write(high);
        self.register(ODR).clear(self.bit);
    }

    /// Makes the pin an output, or an input again.
    pub(crate) fn drive(self, driven: bool) {
        let direction = self.register(DIR);
        if driven { direction.set(self.bit) } else { direction.clear(self.bit) }
    }

    /// Level of the pin. For an output it is the level that the output drives.
    #[inline]
    pub(crate) fn is_high(self) -> bool {
        self.data().read() != 0
    }

    #[inline]
    pub(crate) fn write(self, high: bool) {
        self.data().write(if high { self.bit } else { 0 });
    }

    /// Returns whether the pin is in `port` and in the mask `pins`.
    pub(crate) fn is_in(self, port: Port, pins: u32) -> bool {
        self.port == port && pins & self.bit != 0
    }

    /// Enables interrupts at both edges, or disables them.
    pub(crate) fn listen(self, listens: bool) {
        let mask = self.register(IM);
        if listens {
            self.register(IBE).set(self.bit);
            self.register(ICR).write(self.bit);
            mask.set(self.bit);
        } else {
            mask.clear(self.bit);
        }
    }

    /// Clears a pending edge and returns the level of the pin after it.
    pub(crate) fn settle(self) -> bool {
        loop {
            self.register(ICR).write(self.bit);
            let high = self.is_high();
            if self.register(RIS).read() & self.bit == 0 {
                return high;
            }
        }
    }

    /// The port's data register, with an address that masks all pins except this one.
    const fn data(self) -> Register {
        self.register((self.bit << 2) as usize)
    }

    const fn register(self, offset: usize) -> Register {
        Register::at(self.port.0, offset)
    }
}

/// A pin that is wired to a pin or fault of the drive.
pub(crate) struct Wired {
    pub(crate) gpio: Gpio,
    /// Idle level while the pin is released, if the drive reads it then; `None` for an output only.
    pub(crate) rests_high: Option<bool>,
}

impl drivetwin_board::Gpio for Wired {
    fn set(&self, high: bool, released: bool) {
        match self.rests_high {
            Some(_) if released => {}
            Some(_) => self.gpio.push(high),
            None => self.gpio.write(high),
        }
    }

    fn release(&self, released: bool) {
        match self.rests_high {
            Some(rests_high) if released => inputs::let_go(self.gpio, rests_high),
            Some(_) => inputs::take(self.gpio),
            None => {}
        }
    }
}
