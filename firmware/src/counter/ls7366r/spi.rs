//! The chip as a slave on SPI.

#[cfg(test)]
mod tests;

use super::Ls7366r;

/// A transmission while SS/ is low: an instruction and its data. Dropping it sets SS/ high and ends the
/// transmission.
///
/// Call [`Ls7366r::timeout`] before, so that the counter is up to date.
#[derive(Debug)]
pub struct Transmission<'a> {
    counter: &'a mut Ls7366r,
    stage: Stage,
}

#[derive(Debug)]
enum Stage {
    Instruction,
    /// Data still to be sent, highest byte first.
    Read(u32),
    /// The register, the data received so far, and the number of bytes still to come.
    Write(Register, u32, u8),
    /// Complete: further bytes have no effect until SS/ is high.
    Over,
}

/// A register that bits 5:3 of the instruction select.
#[derive(Clone, Copy, Debug)]
enum Register {
    None,
    Mdr0,
    Mdr1,
    Dtr,
    Cntr,
    Otr,
    Str,
}

impl Register {
    const fn of(instruction: u8) -> Self {
        match instruction >> 3 & 7 {
            1 => Self::Mdr0,
            2 => Self::Mdr1,
            3 => Self::Dtr,
            4 => Self::Cntr,
            5 => Self::Otr,
            6 => Self::Str,
            _ => Self::None,
        }
    }
}

impl<'a> Transmission<'a> {
    /// Starts a transmission: SS/ becomes low.
    #[must_use]
    pub fn new(counter: &'a mut Ls7366r) -> Self {
        Self { counter, stage: Stage::Instruction }
    }

    /// Transfers a byte of MOSI, and returns the byte of MISO: 0 if the chip sends nothing. A write takes
    /// effect with its last byte.
    pub fn exchange(&mut self, mosi: u8) -> u8 {
        match &mut self.stage {
            Stage::Instruction => {
                self.stage = self.obey(mosi);
                0
            }
            Stage::Read(rest) => {
                let [miso, ..] = rest.to_be_bytes();
                *rest <<= 8;
                miso
            }
            Stage::Write(register, value, missing) => {
                *value = *value << 8 | u32::from(mosi);
                *missing -= 1;
                if *missing == 0 {
                    match register {
                        Register::Mdr0 => self.counter.set_mdr0(mosi),
                        Register::Mdr1 => self.counter.set_mdr1(mosi),
                        _ => self.counter.set_dtr(*value),
                    }
                    self.stage = Stage::Over;
                }
                0
            }
            Stage::Over => 0,
        }
    }

    /// Executes an instruction of table 1.
    fn obey(&mut self, instruction: u8) -> Stage {
        let counter = &mut *self.counter;
        let register = Register::of(instruction);
        let byte = |value: u8| Stage::Read(u32::from(value) << 24);
        let (width, unused) = (counter.width(), 32 - 8 * u32::from(counter.width()));
        match (instruction >> 6, register) {
            (0, Register::Mdr0) => counter.set_mdr0(0),
            (0, Register::Mdr1) => counter.set_mdr1(0),
            (0, Register::Cntr) => counter.clear_cntr(),
            (0, Register::Str) => counter.clear_status(),
            (1, Register::Mdr0) => return byte(counter.mdr0()),
            (1, Register::Mdr1) => return byte(counter.mdr1()),
            (1, Register::Cntr) => {
                counter.load_otr();
                return Stage::Read(counter.otr() << unused);
            }
            (1, Register::Otr) => return Stage::Read(counter.otr() << unused),
            (1, Register::Str) => return byte(counter.status()),
            (2, Register::Mdr0 | Register::Mdr1) => return Stage::Write(register, 0, 1),
            (2, Register::Dtr) => return Stage::Write(register, 0, width),
            (3, Register::Cntr) => counter.load_cntr(),
            (3, Register::Otr) => counter.load_otr(),
            _ => {}
        }
        Stage::Over
    }
}
