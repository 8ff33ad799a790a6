//! Ports that send back what they receive, for tests of the controller. Nothing reaches the drive.

use drivetwin_board::UsbSerial;

use crate::usb_bus::Controller;

/// The echo of one port.
pub(crate) struct Echo {
    bytes: [u8; 63],
    /// Number of bytes that were received, and for which there was no room yet.
    held: usize,
}

impl Echo {
    /// An echo with nothing to send back.
    pub(crate) const fn new() -> Self {
        Self { bytes: [0; 63], held: 0 }
    }

    /// Sends back what there is room for.
    pub(crate) fn turn(&mut self, port: &mut UsbSerial<'static, Controller>) {
        loop {
            if self.held == 0 {
                self.held = port.read(&mut self.bytes);
            }
            let bytes = self.bytes.get(..self.held).unwrap_or_default();
            if bytes.is_empty() || port.write(bytes) == 0 {
                return;
            }
            self.held = 0;
        }
    }
}
