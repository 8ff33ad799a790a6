//! Settings of a serial line, which both ends share, and the duration of a character.

use core::fmt;

use crate::time::Duration;

/// The parity bit of a character.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Parity {
    /// There is no parity bit.
    None,
    /// Data and parity bits hold an even number of ones.
    Even,
    /// Data and parity bits hold an odd number of ones.
    Odd,
}

/// The settings of a serial line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Line {
    /// Bits per second.
    pub baud: u32,
    /// Data bits of a character: 7 or 8.
    pub data: u8,
    /// Parity bit.
    pub parity: Parity,
    /// Stop bits: 1 or 2.
    pub stop: u8,
}

impl Line {
    /// A serial line with `baud` bits per second, `data` data bits, `parity` and `stop` stop bits.
    #[must_use]
    pub const fn new(baud: u32, data: u8, parity: Parity, stop: u8) -> Self {
        Self { baud, data, parity, stop }
    }

    /// Bits of a character on the wire: start, data, parity, stop.
    #[must_use]
    pub const fn bits(self) -> u32 {
        let parity = match self.parity {
            Parity::None => 0,
            Parity::Even | Parity::Odd => 1,
        };
        1 + self.data as u32 + parity + self.stop as u32
    }

    /// Duration of a character: a whole number of ticks, rounded once. So a burst has the same timestamps
    /// wherever the caller splits it (PROJECT-2).
    #[must_use]
    pub const fn character(self) -> Duration {
        Duration::of_bits(self.bits(), self.baud)
    }
}

/// Prints the settings as people write them: `9600 8E1`.
impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parity = match self.parity {
            Parity::None => 'N',
            Parity::Even => 'E',
            Parity::Odd => 'O',
        };
        write!(f, "{} {}{parity}{}", self.baud, self.data, self.stop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parity_and_stop_bits_are_independent() {
        assert_eq!(Line::new(9_600, 8, Parity::Even, 1).bits(), 11);
        assert_eq!(Line::new(9_600, 8, Parity::None, 1).bits(), 10);
        assert_eq!(Line::new(9_600, 8, Parity::Odd, 2).bits(), 12);
    }
}
