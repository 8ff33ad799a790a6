//! The device at the cable of a board, as a computer learns about it: its endpoints fit into the controller, and Linux finds
//! in them what its driver for serial ports wants.
#![allow(missing_docs, reason = "a test")]

use std::sync::Mutex;

use drivetwin_board::{Endpoints, UsbCable, hex};
use usb_device::bus::{PollResult, UsbBus, UsbBusAllocator};
use usb_device::endpoint::{EndpointAddress, EndpointType};
use usb_device::{Result, UsbDirection, UsbError};

/// State of the controller, and bytes that it has sent.
#[derive(Default)]
struct Wire {
    taken: Vec<EndpointAddress>,
    was_reset: bool,
    setup: Option<[u8; 8]>,
    is_setup: bool,
    has_sent: bool,
    sent: Vec<u8>,
}

/// A controller with so many endpoints in each direction, endpoint 0 among them.
struct Controller {
    endpoints: usize,
    wire: Mutex<Wire>,
}

impl UsbBus for Controller {
    fn alloc_ep(
        &mut self,
        direction: UsbDirection,
        address: Option<EndpointAddress>,
        _kind: EndpointType,
        _size: u16,
        _interval: u8,
    ) -> Result<EndpointAddress> {
        let wire = self.wire.get_mut().unwrap();
        let address = address.unwrap_or(EndpointAddress::from_parts(0, direction));
        if address.index() >= self.endpoints || wire.taken.contains(&address) {
            return Err(UsbError::InvalidEndpoint);
        }
        wire.taken.push(address);
        Ok(address)
    }

    fn enable(&mut self) {}

    fn reset(&self) {}

    fn set_device_address(&self, _address: u8) {}

    fn write(&self, address: EndpointAddress, bytes: &[u8]) -> Result<usize> {
        assert_eq!(address.index(), 0);
        let mut wire = self.wire.lock().unwrap();
        wire.sent.extend(bytes);
        wire.has_sent = true;
        Ok(bytes.len())
    }

    fn read(&self, _address: EndpointAddress, bytes: &mut [u8]) -> Result<usize> {
        let setup = self.wire.lock().unwrap().setup.take().ok_or(UsbError::WouldBlock)?;
        bytes[..8].copy_from_slice(&setup);
        Ok(8)
    }

    fn set_stalled(&self, _address: EndpointAddress, stalled: bool) {
        assert!(!stalled, "a request is refused");
    }

    fn is_stalled(&self, _address: EndpointAddress) -> bool {
        false
    }

    fn suspend(&self) {}

    fn resume(&self) {}

    fn poll(&self) -> PollResult {
        let mut wire = self.wire.lock().unwrap();
        if !std::mem::replace(&mut wire.was_reset, true) {
            return PollResult::Reset;
        }
        let ep_setup = u16::from(std::mem::take(&mut wire.is_setup));
        let ep_in_complete = u16::from(std::mem::take(&mut wire.has_sent));
        PollResult::Data { ep_out: 0, ep_in_complete, ep_setup }
    }
}

/// Endpoints of each interface, as in the configuration descriptor of a device: address, and attributes (USB 2.0, 9.6.6).
fn interfaces(endpoints: usize, ports: [Endpoints; 2]) -> Option<Vec<Vec<(u8, u8)>>> {
    let controller = Controller { endpoints, wire: Mutex::default() };
    let allocator = Box::leak(Box::new(UsbBusAllocator::new(controller)));
    let mut cable = UsbCable::connect(allocator, "0123", ports)?;
    let mut configuration = Vec::new();
    // The device is reset; then it is asked for its configuration (9.4.3), which it sends in several packets.
    for turn in 0..10 {
        cable.poll(|_, _| ());
        let bus = cable.controller();
        let mut wire = bus.wire.lock().unwrap();
        if turn == 0 {
            wire.setup = Some([0x80, 6, 0, 2, 0, 0, 0, 2]);
            wire.is_setup = true;
        }
        configuration.append(&mut wire.sent);
    }
    let mut interfaces: Vec<Vec<(u8, u8)>> = Vec::new();
    let mut rest = configuration.as_slice();
    assert_eq!(rest.len(), usize::from(u16::from_le_bytes([rest[2], rest[3]])), "{rest:02x?}");
    while let [length, kind, ..] = *rest {
        match kind {
            4 => interfaces.push(Vec::new()),
            5 => interfaces.last_mut().unwrap().push((rest[2], rest[3])),
            _ => {}
        }
        rest = &rest[usize::from(length)..];
    }
    Some(interfaces)
}

/// Attributes of endpoints.
const BULK: u8 = 2;
const INTERRUPT: u8 = 3;

/// Endpoints as in firmware/boards/pico/src/usb.rs and firmware/boards/stm32f4/src/usb.rs, typed again.
fn ports([bus, control]: [(u8, u8); 2]) -> [Endpoints; 2] {
    [bus, control].map(|(notifications, data)| Endpoints { notifications, data })
}

#[test]
fn the_ports_of_a_pico_have_six_endpoints() {
    let found = interfaces(5, ports([(0x81, 2), (0x83, 4)])).unwrap();
    assert_eq!(
        found,
        [
            vec![(0x81, INTERRUPT)],
            vec![(0x82, BULK), (0x02, BULK)],
            vec![(0x83, INTERRUPT)],
            vec![(0x84, BULK), (0x04, BULK)],
        ]
    );
}

#[test]
fn the_ports_of_a_black_pill_fit_into_its_controller() {
    let found = interfaces(4, ports([(0x81, 2), (0x01, 3)])).unwrap();
    assert_eq!(
        found,
        [
            vec![(0x81, INTERRUPT)],
            vec![(0x82, BULK), (0x02, BULK)],
            vec![(0x01, INTERRUPT)],
            vec![(0x83, BULK), (0x03, BULK)],
        ]
    );
    // Linux wants an endpoint in each interface of control, and asks the one to the computer with its number; it skips an
    // endpoint that an interface before has declared (BOARD-20).
    let mut all: Vec<u8> = found.concat().into_iter().map(|(address, _)| address).collect();
    for notifications in [&found[0], &found[2]] {
        assert!(all.contains(&(0x80 | notifications[0].0)));
    }
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), 6, "no endpoint is declared twice");
}

#[test]
fn ports_that_do_not_fit_are_none() {
    assert!(interfaces(4, ports([(0x81, 2), (0x83, 4)])).is_none());
    assert!(interfaces(5, ports([(0x81, 2), (0x82, 4)])).is_none());
}

#[test]
fn a_serial_number_has_two_digits_for_each_byte() {
    assert_eq!(hex(&[0x00, 0x1F, 0xA5, 0xFF]), *b"001FA5FF");
    assert_eq!(hex(&[0xE6, 0x61, 0xA4]), *b"E661");
}
