//! TCP framing: a header with the length precedes each PDU (application 4.1; FB 3.2.1 of the MDrive manual).

use core::fmt;

use super::pdu::{PDU_BYTES, READ_HOLDING_REGISTERS};

/// The MBAP header: transaction, protocol and length of two bytes each, and one byte for the unit.
pub const HEADER_BYTES: usize = 7;

/// The longest ADU (application 4.1): 260 bytes.
pub const ADU_BYTES: usize = HEADER_BYTES + PDU_BYTES;

/// A request or a reply with its header, as sent on a connection.
pub type Adu = heapless::Vec<u8, ADU_BYTES>;

/// Bytes up to the end of the length field. The length counts only the bytes after them.
const LENGTH_END: usize = 6;

/// The header fields that a server copies into its reply.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Header {
    /// Number of the request. Its reply has the same number.
    pub transaction: u16,
    /// Address of the slave behind a gateway.
    pub unit: u8,
}

/// The header and the PDU of a whole ADU; `None` if `adu` is not exactly one ADU.
#[must_use]
pub fn parse(adu: &[u8]) -> Option<(Header, &[u8])> {
    if adu_length(adu) != Ok(adu.len()) {
        return None;
    }
    let (&[a, b, _, _, _, _, unit], pdu) = adu.split_first_chunk::<HEADER_BYTES>()?;
    Some((Header { transaction: u16::from_be_bytes([a, b]), unit }, pdu))
}

/// Replaces the contents of `adu` by a header with length 0. The caller then appends a PDU and calls
/// [`set_length`].
pub fn begin(adu: &mut Adu, header: Header) {
    adu.clear();
    let [a, b] = header.transaction.to_be_bytes();
    let _ = adu.extend_from_slice(&[a, b, 0, 0, 0, 0, header.unit]);
}

/// Writes the number of the bytes after the length field into this field.
pub fn set_length(adu: &mut Adu) {
    let length = (adu.len().saturating_sub(LENGTH_END) & 0xFFFF) as u16;
    if let Some(field) = adu.get_mut(LENGTH_END - 2..LENGTH_END) {
        field.copy_from_slice(&length.to_be_bytes());
    }
}

/// The ADU of a header and a PDU of at most 253 bytes. A longer PDU is truncated.
#[must_use]
pub fn frame(header: Header, pdu: &[u8]) -> Adu {
    let mut adu = Adu::new();
    begin(&mut adu, header);
    let _ = adu.extend_from_slice(pdu.get(..PDU_BYTES).unwrap_or(pdu));
    set_length(&mut adu);
    adu
}

/// A client's request to read `count` holding registers from `first`.
#[must_use]
pub fn read(header: Header, first: u16, count: u16) -> Adu {
    let ([a, b], [c, d]) = (first.to_be_bytes(), count.to_be_bytes());
    frame(header, &[READ_HOLDING_REGISTERS, a, b, c, d])
}

/// Reason why a connection cannot be read any further: the start of the next ADU is unknown.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Broken {
    /// A protocol identifier other than 0.
    Protocol,
    /// A length that no ADU has: fewer than 2 bytes or more than 254.
    Length,
}

impl fmt::Display for Broken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Protocol => "a header with a protocol identifier other than 0, which is no Modbus",
            Self::Length => "a header whose length is not from 2 to 254",
        })
    }
}

impl core::error::Error for Broken {}

/// Length of the whole ADU in bytes. If `front` ends before the length field is complete, the length up to
/// the end of that field.
fn adu_length(front: &[u8]) -> Result<usize, Broken> {
    if front.iter().skip(2).take(2).any(|&byte| byte != 0) {
        return Err(Broken::Protocol);
    }
    match (front.get(4), front.get(5)) {
        (None | Some(0), None) => Ok(LENGTH_END),
        (Some(0), Some(&length @ 2..=254)) => Ok(LENGTH_END + usize::from(length)),
        _ => Err(Broken::Length),
    }
}

/// Receiver of a connection: takes segments and returns whole ADUs, wherever TCP split them.
///
/// ```
/// use drivetwin_protocol::modbus::tcp::{self, Broken, Header, Splitter};
///
/// // Transaction 0x1234, unit 5: read 2 holding registers from 0x008B.
/// let request = tcp::read(Header { transaction: 0x1234, unit: 5 }, 0x008B, 2);
/// assert_eq!(request, [0x12, 0x34, 0, 0, 0, 6, 5, 3, 0x00, 0x8B, 0x00, 0x02]);
///
/// let mut splitter = Splitter::new();
/// // TCP delivers the first 5 bytes, then the rest and another request in one segment.
/// let mut segment = &request[..5];
/// assert_eq!(splitter.next(&mut segment), Ok(None));
/// let rest = [&request[5..], &request].concat();
/// let mut segment = &rest[..];
/// assert_eq!(splitter.next(&mut segment), Ok(Some(&request[..])));
/// assert_eq!(splitter.next(&mut segment), Ok(Some(&request[..])));
/// assert_eq!(splitter.next(&mut segment), Ok(None));
///
/// // A protocol identifier other than 0 is not Modbus: close the connection.
/// let mut segment = &[0, 1, 0, 7, 0, 6][..];
/// assert_eq!(splitter.next(&mut segment), Err(Broken::Protocol));
/// ```
#[derive(Clone, Debug, Default)]
pub struct Splitter {
    /// The first part of an ADU, or a whole ADU that was already returned. An invalid header stays here.
    buffer: Adu,
}

impl Splitter {
    /// The splitter of a new connection.
    #[must_use]
    pub const fn new() -> Self {
        Self { buffer: Adu::new() }
    }

    /// The invalid header after which the connection cannot be read any further, as far as it was read; `None`
    /// until then.
    #[must_use]
    pub fn broken(&self) -> Option<&[u8]> {
        adu_length(&self.buffer).is_err().then_some(&self.buffer)
    }

    /// The first part of an ADU whose rest is missing; empty if there is none.
    #[must_use]
    pub fn partial(&self) -> &[u8] {
        if adu_length(&self.buffer) == Ok(self.buffer.len()) { &[] } else { &self.buffer }
    }

    /// Removes the next whole ADU from the front of `segment` and returns it; `None` when the segment is used
    /// up. An ADU that is completely in the segment is not copied.
    ///
    /// # Errors
    /// A header is invalid. All later calls fail, too: close the connection.
    pub fn next<'a, 'b: 'a>(&'a mut self, segment: &mut &'b [u8]) -> Result<Option<&'a [u8]>, Broken> {
        if adu_length(&self.buffer) == Ok(self.buffer.len()) {
            self.buffer.clear();
        }
        if self.buffer.is_empty()
            && let Ok(length) = adu_length(segment)
            && let Some((adu, rest)) = segment.split_at_checked(length)
        {
            *segment = rest;
            return Ok(Some(adu));
        }
        loop {
            let missing = adu_length(&self.buffer)?.saturating_sub(self.buffer.len());
            if missing == 0 {
                return Ok(Some(&self.buffer));
            }
            if segment.is_empty() {
                return Ok(None);
            }
            let (more, rest) = segment.split_at_checked(missing).unwrap_or((segment, &[]));
            let _ = self.buffer.extend_from_slice(more);
            *segment = rest;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Reads the maximum velocity of an MDrive (FB 4.2.4): transaction 1234h, unit 5. 6 bytes follow the
    /// length.
    const REQUEST: &[u8] = &[0x12, 0x34, 0, 0, 0, 6, 5, 3, 0x00, 0x8B, 0x00, 0x02];
    const HEADER: Header = Header { transaction: 0x1234, unit: 5 };

    /// Passes segments to the splitter. Returns the ADUs, and the error if there was one.
    fn split<'a>(
        splitter: &mut Splitter,
        segments: impl IntoIterator<Item = &'a [u8]>,
    ) -> (Vec<Vec<u8>>, Option<Broken>) {
        let mut adus = Vec::new();
        for mut segment in segments {
            loop {
                match splitter.next(&mut segment) {
                    Ok(Some(adu)) => adus.push(adu.to_vec()),
                    Ok(None) => break,
                    Err(broken) => return (adus, Some(broken)),
                }
            }
            assert!(segment.is_empty(), "a segment is used up");
        }
        (adus, None)
    }

    #[test]
    fn a_header_and_its_pdu() {
        assert_eq!(parse(REQUEST), Some((HEADER, &REQUEST[7..])));
        assert_eq!(frame(HEADER, &REQUEST[7..])[..], *REQUEST);
        assert_eq!(read(HEADER, 0x8B, 2)[..], *REQUEST);
        for cut in 0..REQUEST.len() {
            assert_eq!(parse(&REQUEST[..cut]), None, "{cut} bytes");
        }
        assert_eq!(parse(&[REQUEST, &[0]].concat()), None, "more than its length");
        assert_eq!(parse(&[0, 1, 0, 1, 0, 2, 1, 3]), None, "another protocol");
    }

    #[test]
    fn the_longest_adu_has_260_bytes() {
        let longest = frame(HEADER, &[0x5A; 253]);
        // 254 = FEh bytes follow the length: the unit and 253 bytes of PDU.
        assert_eq!((longest.len(), &longest[..7]), (260, &[0x12, 0x34, 0, 0, 0, 0xFE, 5][..]));
        assert_eq!(frame(HEADER, &[0x5A; 300]), longest);
        assert_eq!(parse(&longest), Some((HEADER, &[0x5A; 253][..])));
        for cut in 0..=260 {
            let (front, rest) = longest.split_at(cut);
            let mut splitter = Splitter::new();
            let in_two = split(&mut splitter, [front, rest]);
            assert_eq!(in_two, (Vec::from([longest.to_vec()]), None), "cut at {cut}");
            assert_eq!(splitter.partial(), [], "cut at {cut}");
            let mut splitter = Splitter::new();
            let _ = split(&mut splitter, [front]);
            assert_eq!(splitter.partial(), if cut < 260 { front } else { &[] }, "cut at {cut}");
        }
    }

    #[test]
    fn an_adu_that_lies_in_a_segment_is_not_copied() {
        let mut splitter = Splitter::new();
        let two = [REQUEST, REQUEST, &REQUEST[..3]].concat();
        let mut segment = &two[..];
        for start in [0, 12] {
            let adu = splitter.next(&mut segment).unwrap().unwrap();
            assert!(core::ptr::eq(adu, &raw const two[start..start + 12]));
        }
        assert_eq!(splitter.next(&mut segment), Ok(None));
        assert!(segment.is_empty());
        assert_eq!(splitter.next(&mut &REQUEST[3..]), Ok(Some(REQUEST)));
    }

    #[test]
    fn a_header_is_judged_with_the_byte_that_tells() {
        for (bytes, broken) in [
            (&[0, 1, 1][..], Broken::Protocol),
            (&[0, 1, 0, 1], Broken::Protocol),
            (&[0, 1, 0, 0, 1], Broken::Length),
            (&[0, 1, 0, 0, 0, 0], Broken::Length),
            (&[0, 1, 0, 0, 0, 1], Broken::Length),
            (&[0, 1, 0, 0, 0, 255], Broken::Length),
        ] {
            let (front, last) = bytes.split_at(bytes.len() - 1);
            let mut splitter = Splitter::new();
            assert_eq!(split(&mut splitter, [front]), (Vec::new(), None), "{front:?}");
            assert_eq!(split(&mut splitter, [last]), (Vec::new(), Some(broken)), "{bytes:?}");
            assert_eq!(split(&mut splitter, [REQUEST]), (Vec::new(), Some(broken)), "for good");
            assert_eq!(splitter.next(&mut &[][..]), Err(broken), "for good");
            assert!(bytes.starts_with(splitter.broken().unwrap()), "{bytes:?}");
            // The invalid header comes after a valid ADU in the same segment.
            let together = [REQUEST, bytes, REQUEST].concat();
            let mut splitter = Splitter::new();
            assert_eq!(split(&mut splitter, [&together[..]]), (Vec::from([REQUEST.to_vec()]), Some(broken)));
            assert_eq!(split(&mut splitter, [REQUEST]), (Vec::new(), Some(broken)), "for good");
        }
    }

    #[test]
    fn the_log_says_why_a_connection_is_closed() {
        let said = [Broken::Protocol, Broken::Length].map(|broken| std::format!("{broken}"));
        assert_eq!(said[0], "a header with a protocol identifier other than 0, which is no Modbus");
        assert_eq!(said[1], "a header whose length is not from 2 to 254");
    }

    #[test]
    fn the_shortest_adu_has_a_function_and_nothing_else() {
        let shortest = [0, 1, 0, 0, 0, 2, 0xFF, 7];
        assert_eq!(parse(&shortest), Some((Header { transaction: 1, unit: 255 }, &[7][..])));
        let split = split(&mut Splitter::new(), [&shortest[..]]);
        assert_eq!(split, (Vec::from([shortest.to_vec()]), None));
    }

    #[test]
    fn a_connection_takes_at_most_300_bytes() {
        assert!(size_of::<Splitter>() <= 300);
    }

    /// Divides a stream into segments whose lengths repeat `lengths`.
    fn segments<'a>(mut stream: &'a [u8], lengths: &[usize]) -> Vec<&'a [u8]> {
        let mut segments = Vec::new();
        for &length in lengths.iter().cycle() {
            let (segment, rest) = stream.split_at(length.min(stream.len()));
            segments.push(segment);
            stream = rest;
            if stream.is_empty() {
                break;
            }
        }
        segments
    }

    fn cuts() -> impl Strategy<Value = Vec<usize>> {
        prop::collection::vec(prop_oneof![1_usize..12, 1_usize..600], 1..8)
    }

    proptest! {
        #[test]
        fn cutting_a_stream_anywhere_changes_nothing(
            adus in prop::collection::vec(
                (any::<u16>(), any::<u8>(), prop::collection::vec(any::<u8>(), 1..=253)), 0..8,
            ),
            cuts in cuts(),
        ) {
            let adus: Vec<Vec<u8>> = adus
                .iter()
                .map(|(transaction, unit, pdu)| {
                    let length = (pdu.len() as u16 + 1).to_be_bytes();
                    [&transaction.to_be_bytes()[..], &[0, 0], &length, &[*unit], pdu].concat()
                })
                .collect();
            let stream = adus.concat();
            let parts = split(&mut Splitter::new(), segments(&stream, &cuts));
            prop_assert_eq!(parts, (adus, None));
        }

        #[test]
        fn any_bytes_are_split_or_refused_however_they_are_cut(
            stream in prop::collection::vec(prop_oneof![5 => Just(0), 2 => 0_u8..20, 1 => any::<u8>()], 0..900),
            cuts in cuts(),
        ) {
            let whole = split(&mut Splitter::new(), [&stream[..]]);
            let parts = split(&mut Splitter::new(), segments(&stream, &cuts));
            prop_assert_eq!(&whole, &parts);
            prop_assert!(whole.0.iter().all(|adu| parse(adu).is_some()));
            let taken: usize = whole.0.iter().map(Vec::len).sum();
            let rest = &stream[taken..];
            prop_assert_eq!(&whole.0.concat()[..], &stream[..taken]);
            prop_assert_eq!(whole.1.is_some(), refused(rest));
        }
    }

    /// Returns true if no ADU can begin with `front`. Checks byte by byte.
    fn refused(front: &[u8]) -> bool {
        (0..front.len()).any(|place| match place {
            2..=4 => front[place] != 0,
            5 => front[place] < 2 || front[place] > 254,
            _ => false,
        })
    }
}
