//! The USB cable: a device with two serial ports.

use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::NVIC;
use cortex_m::singleton;
use drivetwin_board::{Cable, CablePort, UsbSerial};
use drivetwin_firmware::device::Line;
use usb_device::bus::UsbBusAllocator;
use usb_device::device::{StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbDeviceState, UsbVidPid};

use crate::chip::{Interrupt, rom};
use crate::interrupt;
use crate::usb_bus::Controller;

/// Vendor and product: those for tests, until the project has its own.
const IDS: UsbVidPid = UsbVidPid(0x1209, 0x0001);

/// True if the controller has work for the loop.
static PENDING: AtomicBool = AtomicBool::new(false);

/// Ends the sleep of the loop. The loop does the work, and unmasks the interrupt.
#[interrupt]
fn USBCTRL_IRQ() {
    NVIC::mask(Interrupt::USBCTRL_IRQ);
    PENDING.store(true, Ordering::Relaxed);
}

/// The cable; `None` if there is no second one.
pub(crate) struct Usb(Option<&'static mut Device>);

/// The device.
struct Device {
    device: UsbDevice<'static, Controller>,
    bus: UsbSerial<'static, Controller>,
    control: UsbSerial<'static, Controller>,
}

impl Usb {
    /// Starts the controller, and connects the board to the computer.
    pub(crate) fn start() -> Self {
        Self(connect())
    }

    fn port(&mut self, port: CablePort) -> Option<&mut UsbSerial<'static, Controller>> {
        let Device { bus, control, .. } = self.0.as_deref_mut()?;
        Some(match port {
            CablePort::Bus => bus,
            CablePort::Control => control,
        })
    }
}

/// Makes the device. The stack that this needs is free again when it returns.
#[inline(never)]
fn connect() -> Option<&'static mut Device> {
    let serial = singleton!(: [u8; 16] = hex(rom::unique_id()))?;
    let allocator = singleton!(: UsbBusAllocator<Controller> = UsbBusAllocator::new(Controller::new()))?;
    let bus = UsbSerial::new(allocator, "drivetwin bus");
    let control = UsbSerial::new(allocator, "drivetwin control");
    let strings = StringDescriptors::default()
        .manufacturer("drivetwin")
        .product("drivetwin")
        .serial_number(str::from_utf8(serial).ok()?);
    let device = UsbDeviceBuilder::new(allocator, IDS)
        .composite_with_iads()
        .max_packet_size_0(64)
        .ok()?
        .strings(&[strings])
        .ok()?
        .build();
    singleton!(: Device = Device {
        device,
        bus,
        control,
    })
}

/// Hexadecimal digits of bytes.
fn hex(bytes: [u8; 8]) -> [u8; 16] {
    const DIGITS: &[u8; 16] = b"0123456789ABCDEF";
    let mut digits = [0; 16];
    for (pair, byte) in digits.chunks_exact_mut(2).zip(bytes) {
        for (place, digit) in pair.iter_mut().zip([byte >> 4, byte & 0xF]) {
            *place = DIGITS.get(usize::from(digit)).copied().unwrap_or_default();
        }
    }
    digits
}

impl Cable for Usb {
    fn is_pending() -> bool {
        PENDING.load(Ordering::Relaxed)
    }

    #[inline(never)]
    fn poll(&mut self) {
        if !Self::is_pending() {
            return;
        }
        let Some(Device { device, bus, control, .. }) = self.0.as_deref_mut() else { return };
        PENDING.store(false, Ordering::Relaxed);
        device.poll(&mut [bus, control]);
        for port in [bus, control] {
            if port.was_closed() {
                device.bus().take_back(port.output());
            }
        }
        NVIC::unpend(Interrupt::USBCTRL_IRQ);
        // SAFETY: no critical section relies on the interrupt's mask.
        unsafe { NVIC::unmask(Interrupt::USBCTRL_IRQ) };
    }

    fn read(&mut self, port: CablePort, bytes: &mut [u8]) -> usize {
        self.port(port).map_or(0, |port| port.read(bytes))
    }

    fn write(&mut self, port: CablePort, bytes: &[u8]) -> usize {
        if !self.is_open(port) {
            return bytes.len();
        }
        self.port(port).map_or(0, |port| port.write(bytes))
    }

    fn is_open(&self, port: CablePort) -> bool {
        let Some(Device { device, bus, control, .. }) = self.0.as_deref() else { return false };
        let port = match port {
            CablePort::Bus => bus,
            CablePort::Control => control,
        };
        // A computer that sleeps, or is no longer there, has no port open.
        device.state() == UsbDeviceState::Configured && port.is_open()
    }

    fn line(&self) -> Option<Line> {
        self.0.as_deref().and_then(|device| device.bus.line())
    }
}
