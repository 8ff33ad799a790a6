//! Requests to drives and the exact replies, typed from the manuals.

use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::modbus::tcp::{self, Header};

/// Language of a port, with a register that a master may write at any time without an effect on anything else.
#[derive(Clone, Copy)]
pub(crate) enum Dialect {
    /// Modbus RTU: unit, a register of one word, and the greatest value that it takes.
    Rtu { unit: u8, register: u16, most: u16 },
    /// Modbus/TCP of an MDrive: a register of two words (FB 5).
    Tcp { register: u16 },
    /// Modbus/TCP of an MDrive, reading only: the maximum velocity, 768,000 steps per second (FB 5).
    TcpConstant,
    /// ASCII of a QSB: the register DTR (x08).
    Qsb,
    /// MCode of an MDrive: the variable `R1`.
    Mcode,
}

/// UserRegister of an MD3 (7.23).
pub(crate) const fn md3(unit: u8) -> Dialect {
    Dialect::Rtu { unit, register: 0x1D, most: 0xFFFF }
}

/// The low word of TARGET_POSITION1 of an RS drive (6.5).
pub(crate) const fn rs(unit: u8) -> Dialect {
    Dialect::Rtu { unit, register: 0x501B, most: 0xFFFF }
}

/// TQ_RATIO of an MDROBOT, a byte that is read back as written until power-off.
pub(crate) const MDROBOT: Dialect = Dialect::Rtu { unit: 1, register: 66, most: 0xFF };

/// `R1` of an MDrive.
pub(crate) const R1: Dialect = Dialect::Tcp { register: 0x5F };

/// A request and its only right reply.
pub(crate) struct Exchange {
    pub(crate) request: Vec<u8>,
    pub(crate) reply: Vec<u8>,
}

impl Dialect {
    /// Returns true if the register can be written.
    pub(crate) fn can_write(self) -> bool {
        !matches!(self, Self::TcpConstant)
    }

    /// The value that the register has after a write of `number`.
    pub(crate) fn value(self, number: u32) -> u32 {
        match self {
            Self::Rtu { most, .. } => number % (u32::from(most) + 1),
            Self::TcpConstant => 768_000,
            // MCode prints no more digits than this.
            Self::Mcode | Self::Qsb | Self::Tcp { .. } => number % 1_000_000,
        }
    }

    /// Writes a value.
    pub(crate) fn write(self, number: u16, value: u32) -> Exchange {
        match self {
            Self::Rtu { unit, register, .. } => {
                let request = rtu::write(unit, register, value as u16).to_vec();
                Exchange { reply: request.clone(), request }
            }
            Self::Tcp { register } => {
                let [high, low] = register.to_be_bytes();
                let mut pdu = vec![16, high, low, 0, 2, 4];
                pdu.extend(value.to_be_bytes());
                Exchange { request: adu(number, &pdu), reply: adu(number, &pdu[..5]) }
            }
            Self::TcpConstant => self.read(number, value),
            Self::Qsb => text(&format!("W08{value:08X}\r"), &format!("w 08 {value:08X} !\r\n")),
            Self::Mcode => text(&format!("R1={value}\r"), &format!("R1={value}\r\n>")),
        }
    }

    /// Reads a register that has this value.
    pub(crate) fn read(self, number: u16, value: u32) -> Exchange {
        let long = value.to_be_bytes();
        match self {
            Self::Rtu { unit, register, .. } => Exchange {
                request: rtu::read(unit, register, 1).to_vec(),
                reply: rtu::frame(unit, &[3, 2, long[2], long[3]]).to_vec(),
            },
            Self::Tcp { .. } | Self::TcpConstant => {
                let register = if let Self::Tcp { register } = self { register } else { 0x8B };
                let [high, low] = register.to_be_bytes();
                let reply = [3, 4, long[0], long[1], long[2], long[3]];
                Exchange { request: adu(number, &[3, high, low, 0, 2]), reply: adu(number, &reply) }
            }
            Self::Qsb => text("R08\r", &format!("r 08 {value:08X} !\r\n")),
            Self::Mcode => text("PR R1\r", &format!("PR R1\r\n{value}\r\n>")),
        }
    }

    /// Returns true if a request that arrived in part stays with a drive until a later request completes it.
    pub(crate) fn has_no_frames(self) -> bool {
        matches!(self, Self::Qsb)
    }
}

fn adu(transaction: u16, pdu: &[u8]) -> Vec<u8> {
    tcp::frame(Header { transaction, unit: 1 }, pdu).to_vec()
}

fn text(request: &str, reply: &str) -> Exchange {
    Exchange { request: request.into(), reply: reply.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exchanges_are_as_in_the_manuals() {
        let Exchange { request, reply } = R1.read(7, 9);
        assert_eq!(request, [0, 7, 0, 0, 0, 6, 1, 3, 0, 0x5F, 0, 2]);
        assert_eq!(reply, [0, 7, 0, 0, 0, 7, 1, 3, 4, 0, 0, 0, 9]);
        let Exchange { request, reply } = Dialect::Qsb.write(0, 0x4D2);
        assert_eq!((&request[..], &reply[..]), (&b"W08000004D2\r"[..], &b"w 08 000004D2 !\r\n"[..]));
    }
}
