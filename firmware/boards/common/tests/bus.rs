//! A bus with a change of direction, and flash that is programmed page by page.
#![allow(missing_docs, reason = "a test")]

use std::cell::RefCell;
use std::ops::Range;

use drivetwin_board::{Bus, Flash, Sectors, Sender, SerialBus, Uart};
use drivetwin_firmware::device::{Duration, Line};
use drivetwin_protocol::line::Parity;
use embedded_io::{Write, WriteReady};
use embedded_storage_async::nor_flash::{NorFlash, NorFlashErrorKind, ReadNorFlash};

const LINE: Line = Line::new(9_600, 8, Parity::None, 1);
const OTHER: Line = Line::new(19_200, 8, Parity::Even, 1);

/// Actions of a bus on its UART.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum OutputRecord {
    Configure(Line),
    Write(u8),
    Pend,
    Turn(bool),
    End,
}

thread_local! {
    static DID: RefCell<Vec<OutputRecord>> = const { RefCell::new(Vec::new()) };
    /// Number of characters for which the UART has room.
    static ROOM: RefCell<usize> = const { RefCell::new(0) };
}

fn did(thing: OutputRecord) {
    DID.with_borrow_mut(|did| did.push(thing));
}

/// Actions since the last call.
fn done() -> Vec<OutputRecord> {
    DID.take()
}

/// A UART that accepts as many characters as a test allows.
struct Simulated;

impl Uart for Simulated {
    fn bus() -> &'static SerialBus<Self> {
        thread_local! {
            static BUS: &'static SerialBus<Simulated> = Box::leak(Box::new(SerialBus::new()));
        }
        BUS.with(|bus| *bus)
    }

    fn start() {}

    fn configure(line: Line) {
        did(OutputRecord::Configure(line));
    }

    fn has_room() -> bool {
        ROOM.with_borrow(|room| *room > 0)
    }

    fn write(byte: u8) {
        ROOM.with_borrow_mut(|room| *room -= 1);
        did(OutputRecord::Write(byte));
    }

    fn pend() {
        did(OutputRecord::Pend);
    }

    fn turn(sends: bool) {
        did(OutputRecord::Turn(sends));
    }

    fn end() {
        if Self::bus().begin_end() {
            did(OutputRecord::End);
        }
    }
}

/// Calls the UART's interrupt, with room for `room` characters. Returns the actions.
fn interrupt(bus: &SerialBus<Simulated>, room: usize) -> Vec<OutputRecord> {
    ROOM.set(room);
    bus.send();
    done()
}

fn bus(full_duplex: bool) -> (&'static SerialBus<Simulated>, Sender<Simulated>) {
    let (bus, mut sender) = (Simulated::bus(), Sender::new());
    bus.start(full_duplex);
    sender.set_line(LINE);
    assert_eq!(done(), [OutputRecord::Configure(LINE)]);
    assert_eq!(bus.character(), LINE.character());
    (bus, sender)
}

#[test]
fn a_transceiver_sends_from_before_the_first_character_until_the_last_has_left() {
    let (bus, mut sender) = bus(false);
    assert!(bus.hears());
    assert_eq!(sender.write(b"ab"), Ok(2));
    assert_eq!(done(), [OutputRecord::Pend], "only the interrupt sends");
    assert_eq!(interrupt(bus, 1), [OutputRecord::Turn(true), OutputRecord::Write(b'a')]);
    assert!(!bus.hears() && !bus.ends());
    assert_eq!(interrupt(bus, 1), [OutputRecord::Turn(true), OutputRecord::Write(b'b')]);
    assert_eq!(interrupt(bus, 1), [OutputRecord::End], "nothing waits any more");
    assert_eq!(interrupt(bus, 1), [], "its end is looked for once");
    assert!(!bus.hears() && bus.ends());
    bus.sent();
    assert_eq!(done(), [OutputRecord::Turn(false)]);
    assert!(bus.hears() && !bus.ends());
    assert_eq!(interrupt(bus, 1), [], "a character that has come ends nothing");
}

#[test]
fn what_is_sent_before_the_end_puts_it_off() {
    let (bus, mut sender) = bus(false);
    assert_eq!(sender.write(b"a"), Ok(1));
    assert_eq!(
        interrupt(bus, 2),
        [OutputRecord::Pend, OutputRecord::Turn(true), OutputRecord::Write(b'a'), OutputRecord::End]
    );
    assert_eq!(sender.write(b"b"), Ok(1));
    assert_eq!(interrupt(bus, 1), [OutputRecord::Pend, OutputRecord::Turn(true), OutputRecord::Write(b'b')]);
    assert!(!bus.ends(), "the alarm of before finds that more was sent");
    assert_eq!(interrupt(bus, 1), [OutputRecord::End]);
}

#[test]
fn a_full_duplex_bus_receives_while_it_sends() {
    let (bus, mut sender) = bus(true);
    assert_eq!(sender.write(b"a"), Ok(1));
    assert_eq!(interrupt(bus, 1), [OutputRecord::Pend, OutputRecord::Write(b'a')]);
    assert!(bus.hears());
}

#[test]
fn a_line_changes_when_all_has_left() {
    let (bus, mut sender) = bus(false);
    assert_eq!(sender.write(b"a"), Ok(1));
    sender.set_line(OTHER);
    assert_eq!(interrupt(bus, 1), [OutputRecord::Pend, OutputRecord::Turn(true), OutputRecord::Write(b'a')]);
    assert_eq!(sender.write_ready(), Ok(false), "what comes behind the change waits for it");
    assert_eq!(bus.character(), LINE.character());
    bus.sent();
    assert_eq!(done(), [OutputRecord::Turn(false), OutputRecord::Configure(OTHER)]);
    assert_eq!(bus.character(), OTHER.character());
    assert_eq!(sender.write_ready(), Ok(true));
    assert!(bus.character() < Duration::millis(1));
}

#[test]
fn more_than_a_frame_does_not_fit() {
    let (bus, mut sender) = bus(false);
    assert_eq!(sender.write(&[0; 300]), Ok(256));
    assert_eq!(sender.write_ready(), Ok(false));
    assert_eq!(interrupt(bus, 1).len(), 3);
    assert_eq!(sender.write_ready(), Ok(true));
}

thread_local! {
    /// The words that were programmed, with their offsets. An erased sector has none.
    static PROGRAMMED: RefCell<Vec<(u32, Vec<u8>)>> = const { RefCell::new(Vec::new()) };
}

/// Two sectors of 64 bytes, from offset 64 on, with words of 4 bytes and pages of 16 bytes.
#[derive(Clone, Copy, Debug)]
enum Small {}

impl Sectors for Small {
    const OURS: Range<u32> = 64..192;
    const CAPACITY: usize = 256;
    const SECTOR: usize = 64;
    const WORD: usize = 4;
    const PAGE: usize = 16;

    fn read(offset: u32) -> u8 {
        offset as u8
    }

    fn erase(offset: u32) -> Result<(), NorFlashErrorKind> {
        PROGRAMMED.with_borrow_mut(|programmed| programmed.push((offset, Vec::new())));
        Ok(())
    }

    fn program(offset: u32, words: &[u8]) -> Result<(), NorFlashErrorKind> {
        PROGRAMMED.with_borrow_mut(|programmed| programmed.push((offset, words.to_vec())));
        Ok(())
    }
}

/// Result of a future that never waits.
fn ready<T>(future: impl Future<Output = T>) -> T {
    let mut context = std::task::Context::from_waker(std::task::Waker::noop());
    match std::pin::pin!(future).poll(&mut context) {
        std::task::Poll::Ready(value) => value,
        std::task::Poll::Pending => panic!("flash returns when it is done"),
    }
}

#[test]
fn flash_is_programmed_page_by_page() {
    let mut flash = Flash::<Small>::new();
    let bytes: Vec<u8> = (0..28).collect();
    ready(flash.write(72, &bytes)).expect("it is ours");
    let expected = [(72, &bytes[..8]), (80, &bytes[8..24]), (96, &bytes[24..])];
    assert_eq!(PROGRAMMED.take(), expected.map(|(at, words)| (at, words.to_vec())));
    ready(flash.erase(64, 192)).expect("it is ours");
    assert_eq!(PROGRAMMED.take(), [(64, vec![]), (128, vec![])]);
    let mut read = [0; 3];
    ready(flash.read(65, &mut read)).expect("it is ours");
    assert_eq!(read, [65, 66, 67]);
}

#[test]
fn flash_of_others_is_left_alone() {
    let mut flash = Flash::<Small>::new();
    assert_eq!(ready(flash.write(60, &[0; 8])), Err(NorFlashErrorKind::OutOfBounds));
    assert_eq!(ready(flash.write(188, &[0; 8])), Err(NorFlashErrorKind::OutOfBounds));
    assert_eq!(ready(flash.read(191, &mut [0; 2])), Err(NorFlashErrorKind::OutOfBounds));
    assert_eq!(ready(flash.erase(0, 128)), Err(NorFlashErrorKind::OutOfBounds));
    assert_eq!(ready(flash.write(66, &[0; 4])), Err(NorFlashErrorKind::NotAligned));
    assert_eq!(ready(flash.write(64, &[0; 3])), Err(NorFlashErrorKind::NotAligned));
    assert_eq!(ready(flash.erase(64, 100)), Err(NorFlashErrorKind::NotAligned));
    assert_eq!(PROGRAMMED.take(), []);
}
