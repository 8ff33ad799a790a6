//! The blocks of a pcapng file (draft-ietf-opsawg-pcapng), and Wireshark's tags in its packets.
//!
//! This module exists because no crate fits: `pcap-file` 2.0 declares microseconds but writes nanoseconds,
//! and the version that corrects this is not released.

use std::io::{self, Write};

use drivetwin_firmware::device::Instant;
use drivetwin_protocol::modbus::{ascii, rtu};
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// Types of blocks (4.1, 4.2, 4.3).
const SECTION_HEADER: u32 = 0x0A0D_0D0A;
const INTERFACE_DESCRIPTION: u32 = 1;
const ENHANCED_PACKET: u32 = 6;

/// Number in the section header from which a reader detects the byte order.
const BYTE_ORDER: u32 = 0x1A2B_3C4D;

/// Codes of options (3.5, 4.1 to 4.3).
const COMMENT: u16 = 1;
const USER_APPLICATION: u16 = 4;
const INTERFACE_NAME: u16 = 2;
const TIME_RESOLUTION: u16 = 9;
const PACKET_FLAGS: u16 = 2;
const DROP_COUNT: u16 = 4;

/// Unit of timestamps: 10⁻⁹ s.
const NANOSECONDS: u8 = 9;

/// Flags of a packet (4.3): its direction, and a wrong checksum, which also marks collisions.
const INBOUND: u32 = 1;
const OUTBOUND: u32 = 2;
const CHECK_SUM_ERROR: u32 = 1 << 24;

/// Link type of packets that name their own dissector.
const EXPORTED_PDU: u16 = 252;

/// Tags of such packets (Wireshark's `exported_pdu_tlvs.h`).
const DISSECTOR: u16 = 12;
const PORT_TYPE: u16 = 24;
const SOURCE_PORT: u16 = 25;
const DESTINATION_PORT: u16 = 26;
const PROTOCOL_COLUMN: u16 = 33;

/// Port type TCP, which Modbus uses.
const TCP: u32 = 2;

/// Port number of drives, that of Modbus/TCP: Wireshark uses it to distinguish queries from responses.
const DRIVE_PORT: u32 = 502;

/// Port number of clients on the first line. Each further line has the next number, so that Wireshark matches
/// a response with the query on the same line.
const FIRST_CLIENT_PORT: u32 = 1024;

/// Protocol of a packet.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Protocol {
    /// A frame of Modbus RTU with its CRC.
    Rtu,
    /// A message of Modbus ASCII from its colon to its line feed.
    Ascii,
    /// A frame of Modbus/TCP with its header.
    Tcp,
    /// A line of text.
    Text,
    /// Noise.
    Noise,
}

/// Direction of a packet.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Way {
    /// To drives.
    In,
    /// From a drive.
    Out,
    /// Noise, without a sender.
    Noise,
}

/// A packet.
#[derive(Clone, Copy, Debug)]
pub struct Packet<'a> {
    /// Line, as returned by [`Blocks::line`].
    pub line: u32,
    /// Start of the packet.
    pub at: Instant,
    /// Direction.
    pub way: Way,
    /// Protocol of its bytes.
    pub protocol: Protocol,
    /// The bytes.
    pub bytes: &'a [u8],
    /// True if other characters corrupted the packet on the line, so that no receiver could read it.
    pub collided: bool,
    /// The packet as text in the manual's names; empty if there is no text.
    pub comment: &'a str,
    /// Number of packets that were lost before this one.
    pub lost: u64,
}

impl Packet<'_> {
    /// Returns true if the bytes are a valid frame of their protocol.
    fn is_whole(&self) -> bool {
        match self.protocol {
            _ if self.collided => false,
            Protocol::Rtu => rtu::verify_crc(self.bytes).is_some(),
            Protocol::Ascii => ascii::decode(self.bytes).is_some(),
            Protocol::Tcp | Protocol::Text | Protocol::Noise => true,
        }
    }

    /// Name of Wireshark's dissector, and of the protocol if the dissector does not show it. The Modbus
    /// dissector takes any bytes for Modbus, so invalid frames are shown as data. Wireshark does not support
    /// Modbus ASCII.
    fn names(&self) -> (&'static str, Option<&'static str>) {
        match self.protocol {
            Protocol::Rtu if self.is_whole() => ("mbrtu", None),
            Protocol::Rtu => ("data", Some("Modbus RTU")),
            Protocol::Ascii if self.collided => ("data", Some("Modbus ASCII")),
            Protocol::Ascii => ("data-text-lines", Some("Modbus ASCII")),
            Protocol::Tcp => ("mbtcp", None),
            Protocol::Text => ("data-text-lines", Some("Text")),
            Protocol::Noise => ("data", Some("Noise")),
        }
    }

    fn flags(&self) -> u32 {
        let way = match self.way {
            Way::In => INBOUND,
            Way::Out => OUTBOUND,
            Way::Noise => 0,
        };
        if self.is_whole() { way } else { way | CHECK_SUM_ERROR }
    }

    /// Source and destination port; `None` for noise.
    fn ports(&self) -> Option<(u32, u32)> {
        let client = FIRST_CLIENT_PORT + self.line;
        match self.way {
            Way::In => Some((client, DRIVE_PORT)),
            Way::Out => Some((DRIVE_PORT, client)),
            Way::Noise => None,
        }
    }
}

/// Writer of the blocks of a file, one by one.
#[derive(Debug)]
pub struct Blocks<W> {
    out: W,
    /// Number of lines so far.
    lines: u32,
    /// The present block, until it is complete.
    block: Vec<u8>,
}

impl<W: Write> Blocks<W> {
    /// Begins the file.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn new(out: W) -> io::Result<Self> {
        let mut blocks = Self { out, lines: 0, block: Vec::new() };
        blocks.write(SECTION_HEADER, |block| {
            block.extend(BYTE_ORDER.to_le_bytes());
            // Version 1.0; the length of the section is not specified.
            block.extend(1_u16.to_le_bytes());
            block.extend(0_u16.to_le_bytes());
            block.extend((-1_i64).to_le_bytes());
            option(block, USER_APPLICATION, b"drivetwin");
            end_options(block);
        })?;
        Ok(blocks)
    }

    /// Adds a line with that name. Returns the number of the line for packets.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn line(&mut self, name: &str) -> io::Result<u32> {
        self.write(INTERFACE_DESCRIPTION, |block| {
            block.extend(EXPORTED_PDU.to_le_bytes());
            // Reserved bytes, and no limit of length.
            block.extend([0; 6]);
            option(block, INTERFACE_NAME, name.as_bytes());
            option(block, TIME_RESOLUTION, &[NANOSECONDS]);
            end_options(block);
        })?;
        self.lines += 1;
        Ok(self.lines - 1)
    }

    /// Adds a packet.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn packet(&mut self, packet: &Packet) -> io::Result<()> {
        let data = exported(packet);
        let length = (data.len() as u32).to_le_bytes();
        let nanos = u128::from(packet.at.ticks()) * 1_000_000_000 / u128::from(TICKS_PER_SECOND);
        self.write(ENHANCED_PACKET, |block| {
            block.extend(packet.line.to_le_bytes());
            block.extend(((nanos >> 32) as u32).to_le_bytes());
            block.extend((nanos as u32).to_le_bytes());
            // Captured length and original length, which are the same.
            block.extend(length);
            block.extend(length);
            block.extend(&data);
            pad(block);
            option(block, PACKET_FLAGS, &packet.flags().to_le_bytes());
            if !packet.comment.is_empty() {
                option(block, COMMENT, packet.comment.as_bytes());
            }
            if packet.lost > 0 {
                option(block, DROP_COUNT, &packet.lost.to_le_bytes());
            }
            end_options(block);
        })
    }

    /// Flushes the writer.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Writes a block, with its length at the beginning and at the end (3.1).
    fn write(&mut self, kind: u32, body: impl FnOnce(&mut Vec<u8>)) -> io::Result<()> {
        let block = &mut self.block;
        block.clear();
        block.extend(kind.to_le_bytes());
        block.extend([0; 4]);
        body(block);
        let length = (block.len() as u32 + 4).to_le_bytes();
        block[4..8].copy_from_slice(&length);
        block.extend(length);
        self.out.write_all(block)
    }
}

/// Data for Wireshark's dissector of exported PDUs: tags in network byte order, then the bytes of the packet.
fn exported(packet: &Packet) -> Vec<u8> {
    let mut data = Vec::new();
    let mut tag = |kind: u16, value: &[u8]| {
        data.extend(kind.to_be_bytes());
        data.extend((value.len().next_multiple_of(4) as u16).to_be_bytes());
        data.extend(value);
        pad(&mut data);
    };
    let (dissector, protocol) = packet.names();
    tag(DISSECTOR, dissector.as_bytes());
    if let Some(protocol) = protocol {
        tag(PROTOCOL_COLUMN, protocol.as_bytes());
    }
    if let Some((source, destination)) = packet.ports() {
        tag(PORT_TYPE, &TCP.to_be_bytes());
        tag(SOURCE_PORT, &source.to_be_bytes());
        tag(DESTINATION_PORT, &destination.to_be_bytes());
    }
    tag(0, &[]);
    data.extend(packet.bytes);
    data
}

fn option(block: &mut Vec<u8>, code: u16, value: &[u8]) {
    block.extend(code.to_le_bytes());
    block.extend((value.len() as u16).to_le_bytes());
    block.extend(value);
    pad(block);
}

fn end_options(block: &mut Vec<u8>) {
    option(block, 0, &[]);
}

/// Pads with zeros to a multiple of 32 bits, to which all parts are aligned.
fn pad(bytes: &mut Vec<u8>) {
    bytes.resize(bytes.len().next_multiple_of(4), 0);
}
