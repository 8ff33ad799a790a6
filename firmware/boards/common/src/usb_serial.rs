//! A serial port of a USB device. Sections cited are those of *USB Class Definitions for Communications Devices* (CDC) and
//! of its *Subclass for PSTN Devices* (PSTN), both 1.2.

use core::mem;
use core::ops::Range;

use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;
use usb_device::UsbDirection;
use usb_device::class_prelude::*;
use usb_device::control::{Recipient, Request, RequestType};
use usb_device::device::DEFAULT_ALTERNATE_SETTING;

/// Size of a packet.
const PACKET: usize = 64;
/// Most bytes in a packet to the computer. A shorter packet than the greatest ends a transfer, so no empty packet is
/// needed behind it.
const MOST: usize = PACKET - 1;

/// Class codes (CDC 4.2, 4.3, 4.5): a communications interface with the abstract control model, and its data interface.
const COMMUNICATIONS: u8 = 0x02;
const ABSTRACT_CONTROL: u8 = 0x02;
const DATA: u8 = 0x0A;
const NONE: u8 = 0x00;
/// Type of a functional descriptor (CDC 5.2.3).
const FUNCTIONAL: u8 = 0x24;

/// Requests (PSTN 6.3).
const SET_LINE_CODING: u8 = 0x20;
const GET_LINE_CODING: u8 = 0x21;
const SET_CONTROL_LINE_STATE: u8 = 0x22;

/// Settings of the line (PSTN 6.3.11): 9600 8N1, until the computer sets others.
const CODING: [u8; 7] = [0x80, 0x25, 0, 0, 0, 0, 8];

/// Endpoints of a serial port.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Endpoints {
    /// Address of the endpoint for notifications. None is ever sent, but a computer wants to see an endpoint. It may be one
    /// of packets from the computer (BOARD-20).
    pub notifications: u8,
    /// Number of the two endpoints for data.
    pub data: u8,
}

/// The endpoint for notifications.
enum Notifications<'a, B: UsbBus> {
    ToComputer(EndpointIn<'a, B>),
    FromComputer(EndpointOut<'a, B>),
}

/// A serial port of a USB device, with a name. Without handshake, breaks and modem signals other than DTR.
pub struct UsbSerial<'a, B: UsbBus> {
    control: InterfaceNumber,
    data: InterfaceNumber,
    label: StringIndex,
    name: &'static str,
    notifications: Notifications<'a, B>,
    input: EndpointOut<'a, B>,
    output: EndpointIn<'a, B>,
    coding: Option<[u8; 7]>,
    dtr: bool,
    was_closed: bool,
    /// Last packet from the computer, and the part of it that is not read.
    packet: [u8; PACKET],
    unread: Range<usize>,
}

impl<'a, B: UsbBus> UsbSerial<'a, B> {
    /// The next serial port of a device: two interfaces, and three endpoints. Returns `None` if the controller does not have
    /// these endpoints.
    pub fn new(
        allocator: &'a UsbBusAllocator<B>,
        name: &'static str,
        Endpoints { notifications, data }: Endpoints,
    ) -> Option<Self> {
        let notifications = EndpointAddress::from(notifications);
        let (kind, at) = (EndpointType::Interrupt, Some(notifications));
        let notifications = if notifications.is_in() {
            Notifications::ToComputer(allocator.alloc(at, kind, 8, 255).ok()?)
        } else {
            Notifications::FromComputer(allocator.alloc(at, kind, 8, 255).ok()?)
        };
        let at = |direction| Some(EndpointAddress::from_parts(data.into(), direction));
        Some(Self {
            control: allocator.interface(),
            data: allocator.interface(),
            label: allocator.string(),
            name,
            notifications,
            input: allocator.alloc(at(UsbDirection::Out), EndpointType::Bulk, PACKET as u16, 0).ok()?,
            output: allocator.alloc(at(UsbDirection::In), EndpointType::Bulk, PACKET as u16, 0).ok()?,
            coding: None,
            dtr: false,
            was_closed: false,
            packet: [0; PACKET],
            unread: 0..0,
        })
    }

    /// Takes bytes that the computer has sent. Returns their number. The computer cannot send the next packet until all of
    /// this one is taken.
    pub fn read(&mut self, bytes: &mut [u8]) -> usize {
        if self.unread.is_empty() {
            self.unread = 0..self.input.read(&mut self.packet).unwrap_or(0);
        }
        let waiting = self.packet.get(self.unread.clone()).unwrap_or_default();
        for (place, byte) in bytes.iter_mut().zip(waiting) {
            *place = *byte;
        }
        let count = waiting.len().min(bytes.len());
        self.unread.start += count;
        count
    }

    /// Gives bytes to the computer. Returns the number of bytes that there was room for. A port that is not open drops them
    /// all.
    pub fn write(&mut self, bytes: &[u8]) -> usize {
        if !self.dtr {
            return bytes.len();
        }
        let first = bytes.get(..MOST).unwrap_or(bytes);
        if first.is_empty() { 0 } else { self.output.write(first).unwrap_or(0) }
    }

    /// Returns `true` while a program on the computer has the port open: while it asserts DTR.
    pub fn is_open(&self) -> bool {
        self.dtr
    }

    /// Returns `true` if the port was closed since the last call. A packet may still wait at its
    /// [`output`](Self::output) for the computer to take it.
    pub fn was_closed(&mut self) -> bool {
        mem::take(&mut self.was_closed)
    }

    /// Endpoint of the packets to the computer.
    pub fn output(&self) -> EndpointAddress {
        self.output.address()
    }

    /// Settings of the line that the computer has set; `None` if it has not, or if they are none of a [`Line`].
    pub fn line(&self) -> Option<Line> {
        self.coding.and_then(line_of)
    }

    /// Returns `true` if a request is one to this port.
    fn is_asked(&self, request: &Request) -> bool {
        request.request_type == RequestType::Class
            && request.recipient == Recipient::Interface
            && request.index == u16::from(u8::from(self.control))
    }
}

/// The line with settings in the form of PSTN 6.3.11; `None` if they are none of a [`Line`]: no baud rate, fewer than 7 or
/// more than 8 data bits, 1.5 stop bits, or a parity of mark or space.
#[must_use]
pub fn line_of([b0, b1, b2, b3, stop, parity, data]: [u8; 7]) -> Option<Line> {
    let baud = u32::from_le_bytes([b0, b1, b2, b3]);
    let stop = match stop {
        0 => 1,
        2 => 2,
        _ => return None,
    };
    let parity = match parity {
        0 => Parity::None,
        1 => Parity::Odd,
        2 => Parity::Even,
        _ => return None,
    };
    (baud > 0 && matches!(data, 7 | 8)).then(|| Line::new(baud, data, parity, stop))
}

impl<B: UsbBus> UsbClass<B> for UsbSerial<'_, B> {
    fn get_configuration_descriptors(&self, writer: &mut DescriptorWriter<'_>) -> usb_device::Result<()> {
        let (control, data) = (u8::from(self.control), u8::from(self.data));
        let label = Some(self.label);
        writer.iad(self.control, 2, COMMUNICATIONS, ABSTRACT_CONTROL, NONE, label)?;
        writer.interface_alt(
            self.control,
            DEFAULT_ALTERNATE_SETTING,
            COMMUNICATIONS,
            ABSTRACT_CONTROL,
            NONE,
            label,
        )?;
        // CDC 5.2.3.1: the header, with the version of the standard.
        writer.write(FUNCTIONAL, &[0x00, 0x20, 0x01])?;
        // PSTN 5.3.1: no management of calls.
        writer.write(FUNCTIONAL, &[0x01, 0x00, data])?;
        // PSTN 5.3.2: the requests for the line and for DTR.
        writer.write(FUNCTIONAL, &[0x02, 0x02])?;
        // CDC 5.2.3.2: the two interfaces belong together.
        writer.write(FUNCTIONAL, &[0x06, control, data])?;
        match &self.notifications {
            Notifications::ToComputer(endpoint) => writer.endpoint(endpoint)?,
            Notifications::FromComputer(endpoint) => writer.endpoint(endpoint)?,
        }
        writer.interface(self.data, DATA, NONE, NONE)?;
        writer.endpoint(&self.output)?;
        writer.endpoint(&self.input)
    }

    fn get_string(&self, index: StringIndex, _language: LangID) -> Option<&str> {
        (index == self.label).then_some(self.name)
    }

    /// Forgets what was before the reset.
    fn reset(&mut self) {
        self.coding = None;
        self.dtr = false;
        self.was_closed = false;
        self.unread = 0..0;
    }

    fn control_in(&mut self, transfer: ControlIn<'_, '_, '_, B>) {
        if self.is_asked(transfer.request()) && transfer.request().request == GET_LINE_CODING {
            // Fails if the computer has asked something else meanwhile.
            let _ = transfer.accept_with(&self.coding.unwrap_or(CODING));
        }
    }

    fn control_out(&mut self, transfer: ControlOut<'_, '_, '_, B>) {
        let request = *transfer.request();
        if !self.is_asked(&request) {
            return;
        }
        match request.request {
            SET_LINE_CODING => {
                let Ok(coding) = transfer.data().try_into() else { return };
                self.coding = Some(coding);
            }
            SET_CONTROL_LINE_STATE => {
                let dtr = request.value & 1 != 0;
                self.was_closed |= self.dtr && !dtr;
                self.dtr = dtr;
            }
            _ => return,
        }
        // As above.
        let _ = transfer.accept();
    }
}
