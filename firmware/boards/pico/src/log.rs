//! Log of the board: with the feature `defmt` one text line through the debug probe, otherwise none.

pub(crate) use self::probe::power;

#[cfg(feature = "defmt")]
mod probe {
    use defmt_rtt as _;
    use drivetwin_firmware::device::Boot;

    use crate::{timer, watchdog};

    defmt::timestamp!("{=u64:us}", timer::micros());

    /// Logs that a drive has power.
    pub(crate) fn power(kind: &str, boot: Boot) {
        let cause = match watchdog::reason() {
            0 => "power, the RUN pin or a debugger",
            0b01 => "the loop hung",
            _ => "a fault or a panic",
        };
        defmt::info!("{} has power, fast: {}; reset by: {}", kind, boot.fast, cause);
    }
}

#[cfg(not(feature = "defmt"))]
mod probe {
    use drivetwin_firmware::device::Boot;

    pub(crate) fn power(_kind: &str, _boot: Boot) {}
}
