//! The blocks of a pcapng file (draft-ietf-opsawg-pcapng), and in its packets Wireshark's tags.
//!
//! Written here because the crates that write it do not fit: of `pcap-file` the kept version (2.0) says
//! microseconds and writes nanoseconds, and the one that mends it is not out.

use std::io::{self, Write};

use drivetwin_firmware::device::Instant;
use drivetwin_protocol::modbus::{ascii, rtu};
use drivetwin_protocol::time::TICKS_PER_SECOND;

/// Types of blocks (4.1, 4.2, 4.3).
const SECTION_HEADER: u32 = 0x0A0D_0D0A;
const INTERFACE_DESCRIPTION: u32 = 1;
const ENHANCED_PACKET: u32 = 6;

/// In the section header, so that a reader sees in which order bytes are written.
const BYTE_ORDER: u32 = 0x1A2B_3C4D;

/// Options (3.5, 4.1 to 4.3).
const USER_APPLICATION: u16 = 4;
const INTERFACE_NAME: u16 = 2;
const TIME_RESOLUTION: u16 = 9;
const PACKET_FLAGS: u16 = 2;
const DROP_COUNT: u16 = 4;

/// Stamps count units of 10⁻⁹ s.
const NANOSECONDS: u8 = 9;

/// Flags of a packet (4.3): its direction, and a wrong checksum, also for collisions.
const INBOUND: u32 = 1;
const OUTBOUND: u32 = 2;
const CHECK_SUM_ERROR: u32 = 1 << 24;

/// Link type of packets that name their dissector.
const EXPORTED_PDU: u16 = 252;

/// Their tags (Wireshark's `exported_pdu_tlvs.h`).
const DISSECTOR: u16 = 12;
const PORT_TYPE: u16 = 24;
const SOURCE_PORT: u16 = 25;
const DESTINATION_PORT: u16 = 26;
const PROTOCOL_COLUMN: u16 = 33;

/// The type of ports that Modbus has.
const TCP: u32 = 2;

/// Port number of drives, that of Modbus/TCP: Wireshark distinguishes queries from responses by it.
const DRIVE_PORT: u32 = 502;

/// Port number of clients on the first line; one more for each further line, so that Wireshark finds the query of a
/// response on the same line.
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
    NullContext,
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
    /// True if others corrupted it on the line, so that no receiver could read it.
    pub collided: bool,
    /// Packets before it that were lost.
    pub lost: u64,
}

impl Packet<'_> {
    /// Returns whether the bytes are a frame of their protocol.
    fn is_whole(&self) -> bool {
        match self.protocol {
            _ if self.collided => false,
            Protocol::Rtu => rtu::verify_crc(self.bytes).is_some(),
            Protocol::Ascii => ascii::decode(self.bytes).is_some(),
            Protocol::Tcp | Protocol::Text | Protocol::Noise => true,
        }
    }

    /// Names of Wireshark's dissector and, if that names none, of the protocol. The dissector takes any bytes for
    /// Modbus, so invalid frames are shown as data; it does not support Modbus ASCII.
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
            Way::NullContext => 0,
        };
        if self.is_whole() { way } else { way | CHECK_SUM_ERROR }
    }

    /// Source and destination.
    fn ports(&self) -> Option<(u32, u32)> {
        let client = FIRST_CLIENT_PORT + self.line;
        match self.way {
            Way::In => Some((client, DRIVE_PORT)),
            Way::Out => Some((DRIVE_PORT, client)),
            Way::NullContext => None,
        }
    }
}

/// The blocks of a file, written one by one.
#[derive(Debug)]
pub struct Blocks<W> {
    out: W,
    /// Lines so far.
    lines: u32,
    /// The block that is being made.
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
            // Version 1.0, of any length.
            block.extend(1_u16.to_le_bytes());
            block.extend(0_u16.to_le_bytes());
            block.extend((-1_i64).to_le_bytes());
            option(block, USER_APPLICATION, b"drivetwin");
            end_options(block);
        })?;
        Ok(blocks)
    }

    /// Adds a line of that name. Returns its number for packets.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn line(&mut self, name: &str) -> io::Result<u32> {
        self.write(INTERFACE_DESCRIPTION, |block| {
            block.extend(EXPORTED_PDU.to_le_bytes());
            // Reserved, and no limit of length.
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
            // As much is here as there was.
            block.extend(length);
            block.extend(length);
            block.extend(&data);
            pad(block);
            option(block, PACKET_FLAGS, &packet.flags().to_le_bytes());
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

    /// Writes a block, which has its length before and behind it (3.1).
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

/// Input of Wireshark's dissector of exported PDUs: tags, in network order, and the bytes.
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

/// All parts are aligned to 32 bits.
fn pad(bytes: &mut Vec<u8>) {
    bytes.resize(bytes.len().next_multiple_of(4), 0);
}
