//! Log of the board: one text line on UART1 and, with the feature `defmt`, more through the debug probe.

use drivetwin_board::Pl011Uart;
use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;

use crate::clock::MHZ;
use crate::gpio;
use crate::registers::{Lm3s6965, Register};

/// The UART for the log, for bring-up of the board (12.6).
const LOG: Pl011Uart<Lm3s6965> = Pl011Uart::at(Register::at(0x4000_D000, 0), MHZ);
const LINE: Line = Line::new(115_200, 8, Parity::None, 1);

/// Logs that a drive has power.
pub(crate) fn power(kind: &str) {
    gpio::D.give(1 << 3);
    LOG.set_line(LINE);
    for text in ["drivetwin: ", kind, " has power\r\n"] {
        for byte in text.bytes() {
            while !LOG.has_room() {}
            LOG.write(byte);
        }
    }
    probe::power(kind);
}

#[cfg(feature = "defmt")]
mod probe {
    use defmt_rtt as _;

    use crate::clock;
    use crate::registers::Register;

    /// Cause of the reset (5.5).
    const RESC: Register = Register::at(0x400F_E000, 0x05C);

    defmt::timestamp!("{=u64:us}", clock::now().ticks() / 16);

    pub(super) fn power(kind: &str) {
        defmt::info!("{} has power: {}", kind, take_reset());
    }

    fn take_reset() -> &'static str {
        let causes = RESC.read();
        RESC.write(0);
        match causes {
            _ if causes & 1 << 1 != 0 => "power came",
            _ if causes & 1 << 3 != 0 => "the watchdog bit",
            _ if causes & 1 << 4 != 0 => "a fault or a debugger",
            _ if causes & 1 << 2 != 0 => "the supply broke down",
            _ if causes & 1 << 0 != 0 => "the reset button",
            _ => "for no known reason",
        }
    }
}

#[cfg(not(feature = "defmt"))]
mod probe {
    pub(super) fn power(_kind: &str) {}
}
