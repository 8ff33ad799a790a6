//! A USB cable to a computer.

use drivetwin_firmware::device::Line;

/// A serial port of a [`Cable`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum CablePort {
    /// The line of the drive, beside the UART.
    Bus,
    /// Control of the board: `drivetwin_control`.
    Control,
}

/// A USB cable to a computer, which sees two serial ports. All functions are called in the loop, never in an interrupt, and
/// none of them masks interrupts.
pub trait Cable {
    /// False on a board without a cable, whose image has no code for one.
    const IS_THERE: bool = true;

    /// Returns `true` if an interrupt has reported work since the last [`poll`](Self::poll). The loop does not sleep then.
    fn is_pending() -> bool;

    /// Does the work that is due: answers the computer, takes and gives packets.
    fn poll(&mut self);

    /// Takes bytes that the computer has sent to a port. Returns their number; 0 if there are none. While nobody takes them,
    /// the computer waits.
    fn read(&mut self, port: CablePort, bytes: &mut [u8]) -> usize;

    /// Gives bytes to the computer. Returns the number of bytes that there was room for.
    fn write(&mut self, port: CablePort, bytes: &[u8]) -> usize;

    /// Returns `true` while a program on the computer has the port open: while it asserts DTR.
    fn is_open(&self, port: CablePort) -> bool;

    /// Settings that the computer has given to the port of the bus; `None` if it has not set any since the cable was plugged
    /// in, or if they are none of a UART.
    fn line(&self) -> Option<Line>;
}

/// The cable of a board without one.
#[derive(Clone, Copy, Debug)]
pub struct NoCable;

impl Cable for NoCable {
    const IS_THERE: bool = false;

    fn is_pending() -> bool {
        false
    }

    fn poll(&mut self) {}

    fn read(&mut self, _port: CablePort, _bytes: &mut [u8]) -> usize {
        0
    }

    fn write(&mut self, _port: CablePort, bytes: &[u8]) -> usize {
        bytes.len()
    }

    fn is_open(&self, _port: CablePort) -> bool {
        false
    }

    fn line(&self) -> Option<Line> {
        None
    }
}
