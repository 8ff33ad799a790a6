//! Chips on an SPI bus, so that drivers written for embedded-hal can use them on a PC.

use std::cell::{RefCell, RefMut};
use std::convert::Infallible;
use std::rc::Rc;

use drivetwin_firmware::counter::{Ls7366r, Transmission};
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};

/// An LS7366R with its own slave select; clones are the same chip.
///
/// A transaction takes no time. It happens at the present time of the counter, so call
/// [`timeout`](Ls7366r::timeout) on the counter first.
#[derive(Clone, Debug)]
pub struct Counter(Rc<RefCell<Ls7366r>>);

impl Counter {
    /// Makes a handle of a counter that is on the bus.
    #[must_use]
    pub fn new(counter: Ls7366r) -> Self {
        Self(Rc::new(RefCell::new(counter)))
    }

    /// The counter; a test drives the pins of the counter through it.
    ///
    /// # Panics
    ///
    /// If an earlier returned reference is still in use.
    #[must_use]
    pub fn chip(&self) -> RefMut<'_, Ls7366r> {
        self.0.borrow_mut()
    }
}

impl ErrorType for Counter {
    type Error = Infallible;
}

impl SpiDevice for Counter {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let mut chip = self.chip();
        let mut transmission = Transmission::new(&mut chip);
        for operation in operations {
            match operation {
                Operation::Read(read) => {
                    read.fill_with(|| transmission.exchange(0));
                }
                Operation::Write(written) => {
                    for byte in *written {
                        transmission.exchange(*byte);
                    }
                }
                // The longer of the two buffers determines the length.
                Operation::Transfer(read, written) => {
                    for index in 0..read.len().max(written.len()) {
                        let miso = transmission.exchange(written.get(index).copied().unwrap_or(0));
                        if let Some(byte) = read.get_mut(index) {
                            *byte = miso;
                        }
                    }
                }
                Operation::TransferInPlace(bytes) => {
                    for byte in bytes.iter_mut() {
                        *byte = transmission.exchange(*byte);
                    }
                }
                Operation::DelayNs(_) => {}
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Instructions: read, write and clear MDR0.
    const RD: u8 = 0x48;
    const WR: u8 = 0x88;
    const CLR: u8 = 0x08;

    #[test]
    fn a_transaction_is_one_instruction_however_it_is_cut() {
        let mut counter = Counter::new(Ls7366r::new(false, false, true));
        counter.write(&[WR, 0x23, CLR]).unwrap();
        assert_eq!(counter.chip().mdr0(), 0x23);
        let mut read = [0xFF; 2];
        counter.transaction(&mut [Operation::Write(&[RD]), Operation::Read(&mut read)]).unwrap();
        assert_eq!(read, [0x23, 0]);
        let mut read = [0xFF; 3];
        counter.transfer(&mut read, &[RD]).unwrap();
        assert_eq!(read, [0, 0x23, 0]);
        let mut read = [0xFF];
        counter.transfer(&mut read, &[WR, 0x12]).unwrap();
        assert_eq!((read, counter.chip().mdr0()), ([0], 0x12));
        let mut bytes = [RD, 0];
        counter.transfer_in_place(&mut bytes).unwrap();
        assert_eq!(bytes, [0, 0x12]);
        let pause = Operation::DelayNs(100);
        counter.transaction(&mut [Operation::Write(&[WR]), pause, Operation::Write(&[0x34])]).unwrap();
        assert_eq!(counter.chip().mdr0(), 0x34);
    }
}
