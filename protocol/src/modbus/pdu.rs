//! Requests and exceptions, the same in every framing (application, chapters 4 to 7).

use core::fmt;

/// Read coils.
pub const READ_COILS: u8 = 1;
/// Read discrete inputs.
pub const READ_DISCRETE_INPUTS: u8 = 2;
/// Read holding registers.
pub const READ_HOLDING_REGISTERS: u8 = 3;
/// Read input registers.
pub const READ_INPUT_REGISTERS: u8 = 4;
/// Write single coil.
pub const WRITE_SINGLE_COIL: u8 = 5;
/// Write single register.
pub const WRITE_SINGLE_REGISTER: u8 = 6;
/// Write multiple coils.
pub const WRITE_MULTIPLE_COILS: u8 = 15;
/// Write multiple registers.
pub const WRITE_MULTIPLE_REGISTERS: u8 = 16;
/// Encapsulated interface transport: the next byte selects the interface.
pub const ENCAPSULATED_INTERFACE: u8 = 43;

/// The longest PDU, the same in every framing (application 4.1).
pub const PDU_BYTES: usize = 253;

/// The bit of a reply's function code that marks an exception.
pub const EXCEPTION_BIT: u8 = 0x80;

/// Exception code of a slave that refuses a request (application, chapter 7).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Exception {
    /// The slave does not know the function.
    IllegalFunction = 1,
    /// The slave has no such address.
    IllegalDataAddress = 2,
    /// A value in the request is not allowed.
    IllegalDataValue = 3,
    /// An error occurred while the slave executed the request.
    ServerDeviceFailure = 4,
}

impl Exception {
    /// The code on the wire.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }
}

/// The name in the specification (application protocol, section 7).
impl fmt::Display for Exception {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::IllegalFunction => "illegal function",
            Self::IllegalDataAddress => "illegal data address",
            Self::IllegalDataValue => "illegal data value",
            Self::ServerDeviceFailure => "server device failure",
        })
    }
}

impl core::error::Error for Exception {}

/// A parsed request. Its addresses and values are not checked yet.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Request<'a> {
    /// Functions 1 to 4: `count` addresses from `first`.
    Read {
        /// Function code, 1 to 4.
        function: u8,
        /// The lowest address.
        first: u16,
        /// Number of registers or bits.
        count: u16,
    },
    /// Functions 5 and 6: one coil (value `0xFF00` or `0x0000`) or one register.
    WriteSingle {
        /// Function code, 5 or 6.
        function: u8,
        /// Address of the register or coil.
        address: u16,
        /// The word to write.
        value: u16,
    },
    /// Functions 15 and 16: `count` coils, packed into bytes, or `count` registers, high byte first.
    WriteMultiple {
        /// Function code, 15 or 16.
        function: u8,
        /// The lowest address.
        first: u16,
        /// Number of registers or bits.
        count: u16,
        /// Bytes after the byte count.
        values: &'a [u8],
        /// Byte count that the request states.
        bytes: u8,
    },
    /// Any other function.
    Other {
        /// Function code.
        function: u8,
        /// Bytes after the function code.
        data: &'a [u8],
    },
}

impl<'a> Request<'a> {
    /// Parses a request; `None` if it does not have the length that its function requires.
    #[must_use]
    #[inline]
    pub fn parse(pdu: &'a [u8]) -> Option<Self> {
        let (&function, data) = pdu.split_first()?;
        let words = |data: &[u8]| match *data {
            [a, b, c, d] => Some((u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]))),
            _ => None,
        };
        Some(match function {
            READ_COILS..=READ_INPUT_REGISTERS => {
                let (first, count) = words(data)?;
                Self::Read { function, first, count }
            }
            WRITE_SINGLE_COIL | WRITE_SINGLE_REGISTER => {
                let (address, value) = words(data)?;
                Self::WriteSingle { function, address, value }
            }
            WRITE_MULTIPLE_COILS | WRITE_MULTIPLE_REGISTERS => {
                let (head, rest) = data.split_first_chunk::<4>()?;
                let (first, count) = words(head)?;
                let (&bytes, values) = rest.split_first()?;
                Self::WriteMultiple { function, first, count, values, bytes }
            }
            _ => Self::Other { function, data },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_of_the_wrong_length_is_none() {
        assert_eq!(Request::parse(&[]), None);
        assert_eq!(Request::parse(&[3, 0, 0, 0]), None);
        assert_eq!(Request::parse(&[3, 0, 0, 0, 1, 0]), None);
        assert_eq!(Request::parse(&[16, 0, 1, 0, 1]), None);
    }

    #[test]
    fn requests_of_the_specification() {
        // Application 6.3, 6.6 and 6.12.
        assert_eq!(
            Request::parse(&[0x03, 0x00, 0x6B, 0x00, 0x03]),
            Some(Request::Read { function: 3, first: 0x6B, count: 3 })
        );
        assert_eq!(
            Request::parse(&[0x06, 0x00, 0x01, 0x00, 0x03]),
            Some(Request::WriteSingle { function: 6, address: 1, value: 3 })
        );
        assert_eq!(
            Request::parse(&[0x10, 0x00, 0x01, 0x00, 0x02, 0x04, 0x00, 0x0A, 0x01, 0x02]),
            Some(Request::WriteMultiple {
                function: 16,
                first: 1,
                count: 2,
                values: &[0x00, 0x0A, 0x01, 0x02],
                bytes: 4
            })
        );
    }
}
