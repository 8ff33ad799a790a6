//! The USB controller as a device (4.1.2; RP2350: 12.7).
//!
//! Everything is called in the loop and needs no critical section: an interrupt never touches the controller.

use core::sync::atomic::{AtomicBool, AtomicU16, Ordering};

use cortex_m::asm;
use usb_device::bus::PollResult;
use usb_device::endpoint::{EndpointAddress, EndpointType};
use usb_device::{Result, UsbDirection, UsbError};

use crate::chip::{can_abort, clock};
use crate::registers::Register;

/// Memory that the processor shares with the controller (4.1.2.5).
const MEMORY: usize = 0x5010_0000;
/// Offset of the control words of buffers: for each endpoint one for packets to the computer, and one for those from it.
const CONTROLS: usize = 0x80;
/// Offset of the buffer of endpoint 0, which both directions share, and of the buffers of the other endpoints.
const BUFFER_0: usize = 0x100;
const BUFFERS: usize = 0x180;

/// Registers of the controller (4.1.4).
const USB: usize = 0x5011_0000;
const ADDRESS: Register = Register::at(USB, 0x00);
const MAIN_CTRL: Register = Register::at(USB, 0x40);
const SIE_CTRL: Register = Register::at(USB, 0x4C);
const SIE_STATUS: Register = Register::at(USB, 0x50);
const BUFF_STATUS: Register = Register::at(USB, 0x58);
const EP_ABORT: Register = Register::at(USB, 0x60);
const EP_ABORT_DONE: Register = Register::at(USB, 0x64);
const EP_STALL_ARM: Register = Register::at(USB, 0x68);
const USB_MUXING: Register = Register::at(USB, 0x74);
const USB_PWR: Register = Register::at(USB, 0x78);
const INTE: Register = Register::at(USB, 0x90);

/// Bits of SIE_STATUS; writing one clears it.
const BUS_RESET: u32 = 1 << 19;
const SETUP_REC: u32 = 1 << 17;
const RESUME: u32 = 1 << 11;
const SUSPENDED: u32 = 1 << 4;

/// Bits of a buffer's control word (4.1.2.5.4). FULL: it holds a packet. AVAILABLE: it belongs to the controller.
const FULL: u32 = 1 << 15;
const DATA1: u32 = 1 << 13;
const STALL: u32 = 1 << 11;
const AVAILABLE: u32 = 1 << 10;
const LENGTH: u32 = 0x3FF;

/// Greatest size of a packet.
const PACKET: usize = 64;
/// Number of endpoints, in each direction: endpoint 0, and two for each of two serial ports.
const ENDPOINTS: usize = 5;

/// Cycles of the processor until the controller, at 48 MHz, has seen a control word (4.1.2.5.1).
const SEEN: u32 = 20;

/// The controller. It keeps nearly all of its state in its own memory.
pub(crate) struct Controller {
    /// Types of the endpoints to the computer and from it, as in their control registers; `None` if an endpoint is not used.
    kinds: [[Option<u32>; ENDPOINTS]; 2],
    /// True if the next read of endpoint 0 is that of a setup packet.
    is_setup: AtomicBool,
    /// Bytes that the computer will still send in the control transfer.
    expected: AtomicU16,
}

/// A buffer of the controller, and its control word.
#[derive(Clone, Copy)]
struct Buffer {
    control: Register,
    bytes: Register,
}

impl Buffer {
    /// The buffer of an endpoint.
    fn of(address: EndpointAddress) -> Self {
        let (index, out) = (address.index(), usize::from(address.is_out()));
        let bytes = match index.checked_sub(1) {
            None => BUFFER_0,
            Some(place) => BUFFERS + PACKET * (2 * place + out),
        };
        Self {
            control: Register::at(MEMORY, CONTROLS + 8 * index + 4 * out),
            bytes: Register::at(MEMORY, bytes),
        }
    }

    /// Gives the buffer to the controller, which may look at the control word at any time: AVAILABLE comes last.
    fn hand_over(self, word: u32) {
        self.control.write(word);
        asm::delay(SEEN);
        self.control.write(word | AVAILABLE);
    }

    /// Lets the computer send a packet with this number, 0 or [`DATA1`].
    fn await_packet(self, data: u32) {
        self.hand_over(data | PACKET as u32);
    }

    fn put(self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<4>();
        let mut place = self.bytes;
        for word in words {
            place.write(u32::from_le_bytes(*word));
            place = place.plus(4);
        }
        if !rest.is_empty() {
            let mut word = [0; 4];
            for (place, byte) in word.iter_mut().zip(rest) {
                *place = *byte;
            }
            place.write(u32::from_le_bytes(word));
        }
    }

    fn get(self, bytes: &mut [u8]) {
        let (words, rest) = bytes.as_chunks_mut::<4>();
        let mut place = self.bytes;
        for word in words {
            *word = place.read().to_le_bytes();
            place = place.plus(4);
        }
        for (byte, value) in rest.iter_mut().zip(place.read().to_le_bytes()) {
            *byte = value;
        }
    }
}

/// Endpoint 0, to the computer and from it.
fn endpoint_0() -> (Buffer, Buffer) {
    (Buffer::of(EndpointAddress::from(0x80)), Buffer::of(EndpointAddress::from(0x00)))
}

impl Controller {
    /// The controller, without endpoints.
    pub(crate) fn new() -> Self {
        Self { kinds: [[None; ENDPOINTS]; 2], is_setup: AtomicBool::new(false), expected: AtomicU16::new(0) }
    }

    /// Takes back a packet to the computer that the computer has not taken.
    pub(crate) fn take_back(&self, address: EndpointAddress) {
        let Some(Buffer { control, .. }) = self.buffer(address) else { return };
        let bit = 1 << (2 * address.index());
        // A chip that cannot do this may have begun to send the packet.
        let can_abort = can_abort();
        if can_abort {
            EP_ABORT.set(bit);
            // As long as a packet takes, at most.
            for _ in 0..1_000 {
                if EP_ABORT_DONE.read() & bit != 0 {
                    break;
                }
            }
        }
        let word = control.read();
        if word & AVAILABLE != 0 {
            // The next packet has the number of this one.
            control.write(word & DATA1 ^ DATA1);
        }
        if can_abort {
            EP_ABORT_DONE.write(bit);
            EP_ABORT.clear(bit);
        }
    }

    /// The buffer of an endpoint that is used.
    fn buffer(&self, address: EndpointAddress) -> Option<Buffer> {
        let [to, from] = &self.kinds;
        let kinds = if address.is_in() { to } else { from };
        kinds.get(address.index()).is_some_and(Option::is_some).then(|| Buffer::of(address))
    }

    /// Reads a setup packet, and prepares endpoint 0 for what follows it: packets of both directions begin with DATA1.
    fn read_setup(&self, bytes: &mut [u8]) -> Result<usize> {
        // Before the packet is read, so that the next one is noticed.
        SIE_STATUS.write(SETUP_REC);
        let packet = [Register::at(MEMORY, 0).read(), Register::at(MEMORY, 4).read()];
        let place = bytes.first_chunk_mut::<8>().ok_or(UsbError::BufferOverflow)?;
        for (place, word) in place.chunks_exact_mut(4).zip(packet) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        let [kind, .., low, high] = *place;
        let (is_in, length) = (kind & 0x80 != 0, u16::from_le_bytes([low, high]));
        let (to, from) = endpoint_0();
        to.control.write(0);
        self.expected.store(if is_in { 0 } else { length }, Ordering::Relaxed);
        // With no data in between, the status is a packet to the computer.
        if length > 0 {
            from.await_packet(DATA1);
        } else {
            from.control.write(0);
        }
        Ok(place.len())
    }
}

impl usb_device::bus::UsbBus for Controller {
    fn alloc_ep(
        &mut self,
        direction: UsbDirection,
        address: Option<EndpointAddress>,
        kind: EndpointType,
        size: u16,
        _interval: u8,
    ) -> Result<EndpointAddress> {
        let [to, from] = &mut self.kinds;
        let kinds = if direction == UsbDirection::In { to } else { from };
        let index = match address {
            Some(address) => address.index(),
            None => kinds.iter().skip(1).position(Option::is_none).map_or(ENDPOINTS, |place| 1 + place),
        };
        let place = kinds.get_mut(index).ok_or(UsbError::EndpointOverflow)?;
        if place.is_some() || usize::from(size) > PACKET {
            return Err(UsbError::InvalidEndpoint);
        }
        *place = Some(u32::from(kind.to_bm_attributes() & 0b11));
        Ok(EndpointAddress::from_parts(index, direction))
    }

    fn enable(&mut self) {
        const TO_PHY: u32 = 1 << 0;
        const SOFTCON: u32 = 1 << 3;
        const VBUS_DETECT: u32 = 0b11 << 2;
        const CONTROLLER_EN: u32 = 1 << 0;
        const EP0_INT_1BUF: u32 = 1 << 29;
        const PULLUP_EN: u32 = 1 << 16;
        /// Interrupts: BUFF_STATUS, BUS_RESET, DEV_SUSPEND, DEV_RESUME_FROM_HOST, SETUP_REQ.
        const INTERRUPTS: u32 = 1 << 4 | 1 << 12 | 1 << 14 | 1 << 15 | 1 << 16;

        clock::start_usb();
        for offset in (0..BUFFER_0).step_by(4) {
            Register::at(MEMORY, offset).write(0);
        }
        USB_MUXING.write(TO_PHY | SOFTCON);
        // The Pico has power whether a cable is there or not.
        USB_PWR.write(VBUS_DETECT);
        // This also connects the transceiver of an RP2350, which its reset has isolated.
        MAIN_CTRL.write(CONTROLLER_EN);
        INTE.write(INTERRUPTS);
        SIE_CTRL.write(EP0_INT_1BUF | PULLUP_EN);
    }

    fn reset(&self) {
        const ENABLE: u32 = 1 << 31;
        const INTERRUPT_PER_BUFFER: u32 = 1 << 29;

        ADDRESS.write(0);
        BUFF_STATUS.write(u32::MAX);
        let (to, from) = endpoint_0();
        to.control.write(0);
        from.control.write(0);
        for (kinds, direction) in self.kinds.iter().zip([UsbDirection::In, UsbDirection::Out]) {
            for (index, kind) in kinds.iter().enumerate().skip(1) {
                let Some(kind) = kind else { continue };
                let address = EndpointAddress::from_parts(index, direction);
                let buffer = Buffer::of(address);
                let begin = buffer.bytes.address() - MEMORY;
                let control = Register::at(MEMORY, 8 * index + 4 * usize::from(address.is_out()));
                control.write(ENABLE | INTERRUPT_PER_BUFFER | kind << 26 | begin as u32);
                if address.is_in() {
                    // The packet before the first one, which is DATA0.
                    buffer.control.write(DATA1);
                } else {
                    buffer.await_packet(0);
                }
            }
        }
    }

    fn set_device_address(&self, address: u8) {
        ADDRESS.write(u32::from(address));
    }

    fn write(&self, address: EndpointAddress, bytes: &[u8]) -> Result<usize> {
        let buffer = self.buffer(address).ok_or(UsbError::InvalidEndpoint)?;
        if bytes.len() > PACKET {
            return Err(UsbError::BufferOverflow);
        }
        let word = buffer.control.read();
        if word & (AVAILABLE | STALL) != 0 {
            return Err(UsbError::WouldBlock);
        }
        buffer.put(bytes);
        buffer.hand_over(FULL | word & DATA1 ^ DATA1 | bytes.len() as u32);
        Ok(bytes.len())
    }

    fn read(&self, address: EndpointAddress, bytes: &mut [u8]) -> Result<usize> {
        let buffer = self.buffer(address).ok_or(UsbError::InvalidEndpoint)?;
        let is_control = address.index() == 0;
        if is_control && self.is_setup.load(Ordering::Relaxed) {
            self.is_setup.store(false, Ordering::Relaxed);
            return self.read_setup(bytes);
        }
        let word = buffer.control.read();
        if word & FULL == 0 || word & (AVAILABLE | STALL) != 0 {
            return Err(UsbError::WouldBlock);
        }
        let count = word & LENGTH;
        // A control transfer drops a packet that it does not expect by reading nothing of it.
        if !(is_control && bytes.is_empty()) {
            buffer.get(bytes.get_mut(..count as usize).ok_or(UsbError::BufferOverflow)?);
        }
        let next = word & DATA1 ^ DATA1;
        if !is_control {
            buffer.await_packet(next);
            return Ok(count as usize);
        }
        // Endpoint 0 takes no packet more than the transfer has: the next transfer begins with DATA1 again.
        let left = u32::from(self.expected.load(Ordering::Relaxed)).saturating_sub(count);
        self.expected.store(left as u16, Ordering::Relaxed);
        if left > 0 {
            buffer.await_packet(next);
        } else {
            buffer.control.write(0);
        }
        Ok(count as usize)
    }

    fn set_stalled(&self, address: EndpointAddress, stalled: bool) {
        let Some(buffer) = self.buffer(address) else { return };
        let word = buffer.control.read();
        let held = word & !(AVAILABLE | STALL);
        if stalled && address.index() == 0 {
            EP_STALL_ARM.set(1 << usize::from(address.is_out()));
            // Not AVAILABLE: what follows the next setup packet must wait until the setup packet is read.
            buffer.control.write(STALL);
        } else if stalled && address.is_out() && word & FULL == 0 {
            // Packets from the computer are refused where they could be taken (4.1.2.6.3).
            buffer.hand_over(held | STALL);
        } else if stalled {
            buffer.control.write(held | STALL);
        } else if address.index() == 0 {
            // A setup packet has ended the stall, and what follows it may be in the buffer.
            if word & STALL != 0 {
                buffer.control.write(held);
            }
        } else if address.is_out() && word & FULL == 0 {
            // The numbers of packets begin again with DATA0.
            buffer.await_packet(0);
        } else if address.is_in() && word & AVAILABLE != 0 {
            buffer.hand_over(held & !DATA1);
        } else {
            buffer.control.write(held | DATA1);
        }
    }

    fn is_stalled(&self, address: EndpointAddress) -> bool {
        self.buffer(address).is_some_and(|buffer| buffer.control.read() & STALL != 0)
    }

    fn suspend(&self) {}

    fn resume(&self) {}

    fn poll(&self) -> PollResult {
        let status = SIE_STATUS.read();
        if status & BUS_RESET != 0 {
            // A setup packet stays, because it may have come after the reset.
            SIE_STATUS.write(BUS_RESET | RESUME | SUSPENDED);
            return PollResult::Reset;
        }
        if status & RESUME != 0 {
            SIE_STATUS.write(RESUME | SUSPENDED);
            return PollResult::Resume;
        }
        if status & SUSPENDED != 0 {
            SIE_STATUS.write(SUSPENDED);
            return PollResult::Suspend;
        }
        let done = BUFF_STATUS.read();
        BUFF_STATUS.write(done);
        let is_setup = status & SETUP_REC != 0;
        if is_setup {
            self.is_setup.store(true, Ordering::Relaxed);
        }
        if done == 0 && !is_setup {
            return PollResult::None;
        }
        let (mut ep_in_complete, mut ep_out) = (0, 0);
        for index in 0..ENDPOINTS {
            ep_in_complete |= (done >> (2 * index) & 1) << index;
            ep_out |= (done >> (2 * index + 1) & 1) << index;
        }
        PollResult::Data {
            ep_out: ep_out as u16,
            ep_in_complete: ep_in_complete as u16,
            ep_setup: u16::from(is_setup),
        }
    }
}
