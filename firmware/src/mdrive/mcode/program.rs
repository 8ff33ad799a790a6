//! Lines of the program, stored by address in the non-volatile memory (MC 5-55).
//!
//! Each line has an address. The memory is a log: a new line is stored after the last one, and the last line
//! with an address is the valid one.
//!
//! | bytes | content |
//! |---|---|
//! | 2 | address, high byte first, with [`VOID`] if the line was cleared; `0xFF` after the last line |
//! | 1 | characters |
//! | … | the line |
//! | 2 | CRC-16 of these bytes, without [`VOID`] |
//!
//! The first byte is stored last, on its own: if power fails before, the log is unchanged. When the log has
//! no room left, lines that have been replaced are removed. Until that is complete, the log fails its test.

use drivetwin_protocol::modbus::rtu::crc;
use heapless::Vec;

use super::super::error::Error;
use super::super::registers::Reg;
use super::super::saved;
use super::super::variables::Registers;
use super::Mcode;
use super::names::Meaning;
use super::operand::Place;
use super::parse::{parse, without_comment};
use super::statement::Statement;
use crate::device::{Context, Instant, Output};

/// Bytes of the log.
pub(in crate::mdrive) const BYTES: usize = 12 * 1024;
/// Addresses are below this; the first one is 1. MC 4.4 ends with 767, but programs of real machines use
/// higher ones. There are as many as the log has room for lines of one character (MDRIVE-12).
pub(in crate::mdrive) const ADDRESSES: usize = BYTES / (FRAME + 1);
/// Maximum length of a line (MC 3.3.1).
pub(in crate::mdrive) const LINE_BYTES: usize = 64;

/// Bit in the first byte of a line that was cleared.
const VOID: u8 = 0x80;
/// The first byte after the last line.
const END: u8 = 0xFF;
/// First byte of a log in which lines are being moved. No address has it.
const MOVING: u8 = VOID - 1;
/// Bytes before the characters.
const HEAD: usize = 3;
/// Bytes of a line in addition to its characters.
const FRAME: usize = HEAD + 2;
/// Value in the list of positions that marks an address at which no line begins.
const NOWHERE: u16 = u16::MAX;

/// A line in the log.
struct Record<'a> {
    address: u16,
    void: bool,
    line: &'a [u8],
}

impl<'a> Record<'a> {
    /// Reads and checks the line at a position of the log; `None` after the last line.
    ///
    /// # Errors
    /// Error 70: there is no valid line.
    fn checked(memory: &'a [u8], place: usize) -> Result<Option<Self>, Error> {
        let Some((record, sum)) = Self::at(memory, place)? else { return Ok(None) };
        let good = is_address(record.address)
            && record.line.len() <= LINE_BYTES
            && sum == sum_of(record.address, record.line);
        if good { Ok(Some(record)) } else { Err(Error::Flash) }
    }

    /// Reads the line at a position of the log, and its CRC; `None` after the last line.
    ///
    /// # Errors
    /// Error 70: there is no complete line.
    fn at(memory: &'a [u8], place: usize) -> Result<Option<(Self, u16)>, Error> {
        let log = memory.get(saved::PROGRAM..).and_then(|log| log.get(..BYTES)).unwrap_or_default();
        let rest = log.get(place..).unwrap_or_default();
        let &[first, low, length, ref behind @ ..] = rest else { return Err(Error::Flash) };
        if first == END {
            return Ok(None);
        }
        let high = first & !VOID;
        let address = u16::from_be_bytes([high, low]);
        let (line, sum) = behind.split_at_checked(length.into()).ok_or(Error::Flash)?;
        let sum = sum.first_chunk().copied().map(u16::from_be_bytes).ok_or(Error::Flash)?;
        Ok(Some((Self { address, void: first != high, line }, sum)))
    }

    /// Bytes that the line takes in the log.
    fn len(&self) -> usize {
        FRAME + self.line.len()
    }
}

/// A line in the form that the log stores.
type Stored = Vec<u8, { FRAME + LINE_BYTES }>;

/// Encodes a line for the log, without [`VOID`].
fn record(address: u16, line: &[u8]) -> Stored {
    let [high, low] = address.to_be_bytes();
    let mut record = Vec::new();
    // The record has room for the longest line.
    let _ = record.extend_from_slice(&[high, low, line.len() as u8]);
    let _ = record.extend_from_slice(line);
    let sum = crc(&record).to_be_bytes();
    let _ = record.extend_from_slice(&sum);
    record
}

/// Returns true if a line can have this address.
fn is_address(address: u16) -> bool {
    (1..ADDRESSES).contains(&usize::from(address))
}

fn sum_of(address: u16, line: &[u8]) -> u16 {
    let record = record(address, line);
    record.last_chunk().copied().map_or(0, u16::from_be_bytes)
}

/// The lines of the program in the content of a drive's memory, in the order of their addresses; none if the memory is
/// bad.
pub fn lines(memory: &[u8]) -> impl Iterator<Item = (u16, &[u8])> {
    let mut program = Program::new();
    program.load(memory);
    (1..ADDRESSES as u16).filter_map(move |address| Some((address, program.line(memory, address)?)))
}

/// Positions of the lines in the log.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Program {
    /// Position of each address's line.
    index: [u16; ADDRESSES],
    /// End of the log.
    end: u16,
}

impl Program {
    // Inlined to build the value in its final place: a copy would need room on a board's stack.
    #[inline(always)]
    pub(in crate::mdrive) const fn new() -> Self {
        Self { index: [NOWHERE; ADDRESSES], end: 0 }
    }

    /// Finds all lines in the drive's memory. Returns true if the log is good. If it is bad, there are no
    /// lines.
    fn load(&mut self, memory: &[u8]) -> bool {
        *self = Self::new();
        loop {
            match Record::checked(memory, self.end.into()) {
                Ok(Some(record)) => {
                    self.put(record.address, if record.void { NOWHERE } else { self.end });
                    self.end += record.len() as u16;
                }
                Ok(None) => return true,
                Err(_) => {
                    *self = Self::new();
                    return false;
                }
            }
        }
    }

    /// Line at an address of the drive's memory. It passed its test at power-on, or was stored since.
    pub(in crate::mdrive) fn line<'a>(&self, memory: &'a [u8], address: u16) -> Option<&'a [u8]> {
        let place = *self.index.get(usize::from(address)).filter(|place| **place != NOWHERE)?;
        let (record, _) = Record::at(memory, place.into()).ok().flatten()?;
        Some(record.line)
    }

    /// Copy of the line at an address of the drive's memory.
    pub(in crate::mdrive) fn copy(&self, memory: &[u8], address: u16) -> Option<Vec<u8, LINE_BYTES>> {
        Vec::from_slice(self.line(memory, address)?).ok()
    }

    /// First address from `address` on that has a line.
    pub(in crate::mdrive) fn next(&self, address: u16) -> Option<u16> {
        let places = self.index.get(usize::from(address)..)?;
        let further = places.iter().position(|place| *place != NOWHERE)?;
        Some(address + further as u16)
    }

    /// Stores a line.
    ///
    /// # Errors
    /// Error 45: there is no such address, or no room.
    fn store(&mut self, at: Instant, address: u16, line: &[u8], out: &mut dyn Context) -> Result<(), Error> {
        let record = record(address, line);
        let has_room = |taken: usize| taken + record.len() < BYTES;
        // Valid lines never take more than the log. They are counted only if there is no room at its end.
        let fits = has_room(self.end.into());
        if !is_address(address) || !fits && !has_room(self.bytes_beside(address, out.memory())) {
            return Err(Error::ProgramFull);
        }
        if fits {
            self.append(at, address, &record, out);
        } else {
            self.put(address, NOWHERE);
            let first = self.compact(at, out);
            self.append(at, address, &record, out);
            if let Some(first) = first {
                self.store_record(at, 0, &first, out);
            }
        }
        Ok(())
    }

    /// Stores a line after the last one.
    fn append(&mut self, at: Instant, address: u16, record: &[u8], out: &mut dyn Context) {
        let end = self.end + record.len() as u16;
        self.store_bytes(at, end, &[END], out);
        self.store_record(at, self.end, record, out);
        self.put(address, self.end);
        self.end = end;
    }

    /// Number of bytes of all valid lines, except the line at one address.
    fn bytes_beside(&self, address: u16, memory: &[u8]) -> usize {
        let others = (1..ADDRESSES as u16).filter(|&other| other != address);
        others.filter_map(|other| self.line(memory, other)).map(|line| FRAME + line.len()).sum()
    }

    /// Moves the valid lines together. Returns the first of them, if any. The log fails its test until the
    /// caller has stored that line.
    fn compact(&mut self, at: Instant, out: &mut dyn Context) -> Option<Stored> {
        let (mut place, mut end, mut first) = (0, 0, None);
        while let Ok(Some((found, _))) = Record::at(out.memory(), place.into()) {
            let (address, length) = (found.address, found.len() as u16);
            let moved = record(address, found.line);
            if place == 0 {
                self.store_bytes(at, 0, &[MOVING], out);
            }
            if self.index.get(usize::from(address)) == Some(&place) {
                if first.is_some() {
                    self.store_bytes(at, end, &moved, out);
                } else {
                    first = Some(moved);
                }
                self.put(address, end);
                end += length;
            }
            place += length;
        }
        self.end = end;
        first
    }

    /// Stores a line so that after a power failure it is complete or missing.
    fn store_record(&self, at: Instant, place: u16, record: &[u8], out: &mut dyn Context) {
        if let Some((first, rest)) = record.split_first() {
            self.store_bytes(at, place + 1, rest, out);
            self.store_bytes(at, place, &[*first], out);
        }
    }

    /// Clears all lines from `from` on.
    pub(in crate::mdrive) fn clear(&mut self, at: Instant, from: u16, out: &mut dyn Context) {
        let keeps = self.next(0).is_some_and(|first| first < from);
        let (mut place, mut kept) = (0, 0);
        // Older lines of an address come first, so that none of them becomes valid again if power fails
        // meanwhile.
        while keeps && let Ok(Some((record, _))) = Record::at(out.memory(), place.into()) {
            let (address, void, length) = (record.address, record.void, record.len() as u16);
            if address >= from && !void {
                let [high, _] = address.to_be_bytes();
                self.store_bytes(at, place, &[high | VOID], out);
            }
            place += length;
            if address < from && !void {
                kept = place;
            }
        }
        self.store_bytes(at, kept, &[END], out);
        self.end = kept;
        if let Some(places) = self.index.get_mut(usize::from(from)..) {
            places.fill(NOWHERE);
        }
    }

    fn put(&mut self, address: u16, place: u16) {
        if let Some(held) = self.index.get_mut(usize::from(address)) {
            *held = place;
        }
    }

    fn store_bytes(&self, at: Instant, place: u16, bytes: &[u8], out: &mut dyn Context) {
        out.put(at, Output::Store { offset: saved::PROGRAM as u16 + place, bytes });
    }
}

impl Mcode {
    /// Finds the stored lines and their labels at power-on. Returns true if the log is good (error 70 if
    /// not).
    pub(in crate::mdrive) fn load_program(&mut self, variants: u8, out: &dyn Context) -> bool {
        let good = self.program.load(out.memory());
        let mut address = 1;
        while let Some(next) = self.program.next(address) {
            let line = self.program.line(out.memory(), next).unwrap_or_default();
            if let Ok(Statement::Label(name)) = parse(line, variants, &self.names) {
                // The name exists already if a global variable with that name was saved later.
                let _ = self.names.add(name, Meaning::Label(next));
            }
            address = next + 1;
        }
        good
    }

    /// Address of a place in the program.
    ///
    /// # Errors
    /// Error 30 for a name that is not a label, 42 for an address that no line can have.
    pub(in crate::mdrive) fn address(&self, place: Place) -> Result<u16, Error> {
        match place {
            Place::Address(address) => u16::try_from(address)
                .ok()
                .filter(|address| is_address(*address))
                .ok_or(Error::IllegalAddress),
            Place::Label(name) => match self.names.find(name) {
                Some(Meaning::Label(address)) => Ok(address),
                _ => Err(Error::UnknownLabel),
            },
        }
    }

    /// Address of a line that exists.
    ///
    /// # Errors
    /// Error 30 for a name that is not a label, 42 if there is no line.
    pub(in crate::mdrive) fn find_line(&self, place: Place) -> Result<u16, Error> {
        let address = self.address(place)?;
        let found = self.program.next(address) == Some(address);
        if found { Ok(address) } else { Err(Error::IllegalAddress) }
    }

    /// Stores a line that was typed in program mode.
    ///
    /// # Errors
    /// The errors of the line; 28 for a label that exists already, 31 and 45 if there is no room. Nothing is
    /// stored then, and the address stays.
    pub(in crate::mdrive) fn store_line(
        &mut self,
        at: Instant,
        address: u16,
        line: &[u8],
        statement: &Statement<'_>,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let here = Meaning::Label(address);
        if let Statement::Label(name) = *statement {
            self.names.has_room_for(name)?;
        }
        self.program.store(at, address, &compact(line), out)?;
        self.names.retain(|_, meaning| meaning != here);
        match *statement {
            Statement::Label(name) => self.names.add(name, here),
            _ => Ok(()),
        }
    }

    /// Clears all lines from an address on, and their labels.
    pub(in crate::mdrive) fn clear_program(&mut self, at: Instant, from: u16, out: &mut dyn Context) {
        self.program.clear(at, from, out);
        self.names.retain(|_, meaning| !matches!(meaning, Meaning::Label(address) if address >= from));
    }
}

impl Registers {
    /// Checks that the program may be listed and changed.
    ///
    /// # Errors
    /// Error 44: LK is 1 (MC 5-42).
    pub(in crate::mdrive) fn needs_unlocked(&self) -> Result<(), Error> {
        if self.word(Reg::LK) == 0 { Ok(()) } else { Err(Error::Locked) }
    }
}

/// A line in the form that is stored: in capitals outside of quotation marks, one blank between words, no
/// comment.
pub(super) fn compact(line: &[u8]) -> Vec<u8, LINE_BYTES> {
    let mut text = Vec::new();
    let (mut quoted, mut blank) = (false, false);
    for character in without_comment(line) {
        let apart = !quoted && character.is_ascii_whitespace();
        if apart && blank {
            continue;
        }
        blank = apart;
        quoted ^= *character == b'"';
        let kept = match *character {
            _ if apart => b' ',
            other if quoted => other,
            other => other.to_ascii_uppercase(),
        };
        if text.push(kept).is_err() {
            break;
        }
    }
    text
}
