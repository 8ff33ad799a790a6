//! Log of the board: with the feature `defmt` one text line through the debug probe, otherwise none.

pub(crate) use self::probe::power;

#[cfg(feature = "defmt")]
mod probe {
    use defmt_rtt as _;
    use drivetwin_firmware::device::Boot;

    use crate::registers::Register;
    use crate::{clock, timer};

    /// Register for the parts that run while the processor sleeps (23.16.3).
    const DEBUG: Register = Register::at(0xE004_2000, 0x04);

    defmt::timestamp!("{=u64:us}", timer::now().ticks() / 16);

    /// Logs that a drive has power.
    pub(crate) fn power(kind: &str, boot: Boot) {
        const IN_SLEEP: u32 = 1 << 0;
        // Otherwise the probe could not read the log most of the time.
        DEBUG.set(IN_SLEEP);
        let cause = match clock::take_reset() {
            causes if causes & 1 << 29 != 0 => "the loop hung",
            causes if causes & 1 << 28 != 0 => "a fault, a panic or a debugger",
            causes if causes & (1 << 27 | 1 << 25) != 0 => "power",
            _ => "the reset button or a debugger",
        };
        defmt::info!("{} has power, fast: {}; reset by: {}", kind, boot.fast, cause);
    }
}

#[cfg(not(feature = "defmt"))]
mod probe {
    use drivetwin_firmware::device::Boot;

    pub(crate) fn power(_kind: &str, _boot: Boot) {}
}
