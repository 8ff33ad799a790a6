//! A USB device with the two serial ports of a [`Cable`](crate::Cable).

use drivetwin_firmware::device::Line;
use usb_device::bus::{UsbBus, UsbBusAllocator};
use usb_device::device::{StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbDeviceState, UsbVidPid};
use usb_device::endpoint::EndpointAddress;

use crate::cable::CablePort;
use crate::usb_serial::{Endpoints, UsbSerial};

/// Vendor and product: those for tests, until the project has its own.
const IDS: UsbVidPid = UsbVidPid(0x1209, 0x0001);

/// The USB device of a board. Its functions are called in the loop.
pub struct UsbCable<B: UsbBus + 'static> {
    device: UsbDevice<'static, B>,
    bus: UsbSerial<'static, B>,
    control: UsbSerial<'static, B>,
}

impl<B: UsbBus> UsbCable<B> {
    /// The device, connected to the computer, with the endpoints of the bus and of control.
    pub fn connect(
        allocator: &'static UsbBusAllocator<B>,
        serial: &'static str,
        [bus, control]: [Endpoints; 2],
    ) -> Option<Self> {
        let bus = UsbSerial::new(allocator, "drivetwin bus", bus)?;
        let control = UsbSerial::new(allocator, "drivetwin control", control)?;
        let strings =
            StringDescriptors::default().manufacturer("drivetwin").product("drivetwin").serial_number(serial);
        let device = UsbDeviceBuilder::new(allocator, IDS)
            .composite_with_iads()
            .max_packet_size_0(64)
            .ok()?
            .strings(&[strings])
            .ok()?
            .build();
        Some(Self { device, bus, control })
    }

    /// Does the work that is due. `take_back` takes a packet back that waits at an endpoint, because its port was closed.
    pub fn poll(&mut self, take_back: impl Fn(&B, EndpointAddress)) {
        let Self { device, bus, control } = self;
        device.poll(&mut [bus, control]);
        for port in [bus, control] {
            if port.was_closed() {
                take_back(device.bus(), port.output());
            }
        }
    }

    /// The controller.
    pub fn controller(&self) -> &B {
        self.device.bus()
    }

    /// Takes bytes that the computer has sent to a port, as [`Cable::read`](crate::Cable::read) does.
    pub fn read(&mut self, port: CablePort, bytes: &mut [u8]) -> usize {
        self.port(port).read(bytes)
    }

    /// Gives bytes to the computer, as [`Cable::write`](crate::Cable::write) does. A port that is not open drops them all.
    pub fn write(&mut self, port: CablePort, bytes: &[u8]) -> usize {
        if self.is_open(port) { self.port(port).write(bytes) } else { bytes.len() }
    }

    /// Returns `true` while a program on the computer has the port open. A computer that sleeps, or is no longer there, has
    /// no port open.
    pub fn is_open(&self, port: CablePort) -> bool {
        let port = match port {
            CablePort::Bus => &self.bus,
            CablePort::Control => &self.control,
        };
        self.device.state() == UsbDeviceState::Configured && port.is_open()
    }

    /// Settings that the computer has given to the port of the bus.
    pub fn line(&self) -> Option<Line> {
        self.bus.line()
    }

    fn port(&mut self, port: CablePort) -> &mut UsbSerial<'static, B> {
        match port {
            CablePort::Bus => &mut self.bus,
            CablePort::Control => &mut self.control,
        }
    }
}

/// Hexadecimal digits of bytes, for a serial number: two for each byte, as many as there is room for.
#[must_use]
pub fn hex<const DIGITS: usize>(bytes: &[u8]) -> [u8; DIGITS] {
    const ALL: &[u8; 16] = b"0123456789ABCDEF";
    let mut digits = [0; DIGITS];
    for (pair, byte) in digits.chunks_exact_mut(2).zip(bytes) {
        for (place, digit) in pair.iter_mut().zip([byte >> 4, byte & 0xF]) {
            *place = ALL.get(usize::from(digit)).copied().unwrap_or_default();
        }
    }
    digits
}
