//! The Ethernet controller (16.6), and the drive's network over it.

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::singleton;
use critical_section::Mutex;
use drivetwin_board::network::{BYTES, FRAME_BYTES, Frames, LINKS, Network, PIECES, PLACES, Piece, Places};
use drivetwin_firmware::device::{Instant, Spec};
use drivetwin_protocol::modbus::tcp::Splitter;
use lm3s6965::interrupt;
use smoltcp::iface::SocketStorage;
use smoltcp::phy::{Device, DeviceCapabilities, RxToken, TxToken};
use smoltcp::time;

use crate::registers::Register;
use crate::{clock, gpio};

const ETHERNET: usize = 0x4004_8000;
/// Events. A write acknowledges them.
const RIS: Register = Register::at(ETHERNET, 0x000);
const IM: Register = Register::at(ETHERNET, 0x004);
const RCTL: Register = Register::at(ETHERNET, 0x008);
const TCTL: Register = Register::at(ETHERNET, 0x00C);
const DATA: Register = Register::at(ETHERNET, 0x010);
const IA0: Register = Register::at(ETHERNET, 0x014);
const IA1: Register = Register::at(ETHERNET, 0x018);
const MDV: Register = Register::at(ETHERNET, 0x024);
/// Number of received frames that wait.
const NP: Register = Register::at(ETHERNET, 0x034);
const TR: Register = Register::at(ETHERNET, 0x038);

/// Size of the controller's FIFO for received frames (16.1).
const FIFO: usize = 2_048;
/// Bytes in the FIFO in addition to a received frame: its length before it, and its check sequence after it.
const AROUND: usize = 2 + 4;
/// Bytes of a frame that are not included in its length when it is sent: two addresses and a type.
const HEADER: usize = 14;
/// A frame was received.
const RECEIVED: u32 = 1 << 0;
/// RCTL: receive frames, reject those with a wrong check sequence, flush the receive FIFO.
const ENABLE: u32 = 1 << 0;
const REFUSE_SPOILED: u32 = 1 << 3;
const FLUSH: u32 = 1 << 4;
/// A frame is being sent, or is to be sent.
const NEW_TX: u32 = 1 << 0;

/// True if a frame was received since the last [`take_frames`].
static FRAMES: AtomicBool = AtomicBool::new(false);
/// Time at which the last frame was received.
static CAME: Mutex<Cell<Instant>> = Mutex::new(Cell::new(Instant::ZERO));

/// The TCP ports of a drive, on the network; `None` if this was called before. The stack that this needs is
/// free again when it returns.
#[inline(never)]
pub(crate) fn start(spec: &Spec) -> Option<&'static mut Network<'static, Ethernet>> {
    let address = clock::give_ethernet_its_clock();
    // The pins of the jack's lights.
    gpio::F.give(0b1100);
    begin(address);
    let ethernet = Ethernet {
        received: singleton!(: [u8; FRAME_BYTES] = [0; FRAME_BYTES])?,
        leaving: singleton!(: [u8; FRAME_BYTES] = [0; FRAME_BYTES])?,
    };
    let places = Places {
        sockets: singleton!(: [SocketStorage<'static>; PLACES] = [SocketStorage::EMPTY; PLACES])?,
        splitters: singleton!(: [Splitter; LINKS] = [const { Splitter::new() }; LINKS])?,
        bytes: singleton!(: [u8; BYTES] = [0; BYTES])?,
        long: singleton!(: [Piece; PIECES] = [const { Piece::EMPTY }; PIECES])?,
    };
    // The unique address and the time that the start took, because there is no better source of randomness.
    let [a, b, c, d, e, f] = address;
    let seed = u64::from_le_bytes([a, b, c, d, e, f, 0, 0]) ^ clock::now().ticks().rotate_right(16);
    singleton!(: Network<'static, Ethernet> = Network::new(spec, ethernet, address, seed, places))
}

/// Enables the controller, with this Ethernet address (16.4.1).
fn begin([a, b, c, d, e, f]: [u8; 6]) {
    const PAD: u32 = 1 << 1;
    const CHECK_SEQUENCE: u32 = 1 << 2;
    const FULL_DUPLEX: u32 = 1 << 4;
    /// Divisor of the management clock, for 2.5 MHz.
    const DIVISOR: u32 = clock::HZ / 2 / 2_500_000 - 1;
    MDV.write(DIVISOR);
    IA0.write(u32::from_le_bytes([a, b, c, d]));
    IA1.write(u32::from_le_bytes([e, f, 0, 0]));
    TCTL.write(FULL_DUPLEX | CHECK_SEQUENCE | PAD | ENABLE);
    flush();
    IM.write(RECEIVED);
}

/// Enables reception and drops earlier frames: the controller flushes them while reception is off.
fn flush() {
    RCTL.write(REFUSE_SPOILED | FLUSH);
    RCTL.write(REFUSE_SPOILED | ENABLE);
}

/// Returns whether a frame was received since the last call.
pub(crate) fn take_frames() -> bool {
    FRAMES.swap(false, Ordering::Relaxed)
}

#[interrupt]
fn ETHERNET() {
    let at = clock::now();
    RIS.write(RIS.read());
    critical_section::with(|cs| CAME.borrow(cs).set(at));
    FRAMES.store(true, Ordering::Relaxed);
}

/// The controller, with buffers for the last received frame and the frame to send.
pub(crate) struct Ethernet {
    received: &'static mut [u8; FRAME_BYTES],
    leaving: &'static mut [u8; FRAME_BYTES],
}

/// Takes the next frame from the FIFO. A frame that is too long for `into` is dropped.
fn take(into: &mut [u8; FRAME_BYTES]) -> Option<&[u8]> {
    if !has_frame() {
        return None;
    }
    // The first word has the length and the first two bytes of the frame.
    let [low, high, a, b] = DATA.read().to_le_bytes();
    let inside = usize::from(u16::from_le_bytes([low, high]));
    if !(AROUND..=FIFO).contains(&inside) {
        // This cannot be a length, so the start of the next frame is unknown.
        flush();
        return None;
    }
    let mut places = into.iter_mut();
    let mut put = |bytes: &[u8]| {
        // `bytes` comes first in the zip: when it ends, no place is consumed.
        for (byte, place) in bytes.iter().zip(places.by_ref()) {
            *place = *byte;
        }
    };
    put(&[a, b]);
    for _ in 1..inside.div_ceil(4) {
        put(&DATA.read().to_le_bytes());
    }
    into.get(..inside - AROUND)
}

fn has_frame() -> bool {
    NP.read() & 0x3F != 0
}

/// Returns whether the last frame has been sent.
fn has_sent() -> bool {
    TR.read() & NEW_TX == 0
}

impl Frames for Ethernet {
    fn has_frame(&self) -> bool {
        has_frame()
    }

    fn came(&self) -> Instant {
        critical_section::with(|cs| CAME.borrow(cs).get())
    }
}

impl Device for Ethernet {
    type RxToken<'a> = Received<'a>;
    type TxToken<'a> = Leaving<'a>;

    fn receive(&mut self, _now: time::Instant) -> Option<(Received<'_>, Leaving<'_>)> {
        if !has_sent() {
            return None;
        }
        Some((Received(take(self.received)?), Leaving(self.leaving)))
    }

    fn transmit(&mut self, _now: time::Instant) -> Option<Leaving<'_>> {
        has_sent().then_some(Leaving(self.leaving))
    }

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.max_transmission_unit = FRAME_BYTES;
        capabilities
    }
}

/// A received frame.
pub(crate) struct Received<'a>(&'a [u8]);

impl RxToken for Received<'_> {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, f: F) -> R {
        f(self.0)
    }
}

/// Buffer for a frame to send.
pub(crate) struct Leaving<'a>(&'a mut [u8; FRAME_BYTES]);

impl TxToken for Leaving<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, f: F) -> R {
        let frame = self.0.get_mut(..length).unwrap_or_default();
        let result = f(frame);
        let [low, high, ..] = frame.len().saturating_sub(HEADER).to_le_bytes();
        let (first, rest) = frame.split_at_checked(2).unwrap_or_default();
        let mut word = [low, high, 0, 0];
        for (place, byte) in word.iter_mut().skip(2).zip(first) {
            *place = *byte;
        }
        DATA.write(u32::from_le_bytes(word));
        for bytes in rest.chunks(4) {
            let mut word = [0; 4];
            for (place, byte) in word.iter_mut().zip(bytes) {
                *place = *byte;
            }
            DATA.write(u32::from_le_bytes(word));
        }
        TR.write(NEW_TX);
        result
    }
}
