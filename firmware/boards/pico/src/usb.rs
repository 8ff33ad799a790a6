//! The USB cable: a device with two serial ports.

use core::str;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::NVIC;
use cortex_m::singleton;
use drivetwin_board::{Cable, CablePort, Endpoints, UsbCable, hex};
use drivetwin_firmware::device::Line;
use usb_device::bus::UsbBusAllocator;

use crate::chip::{Interrupt, rom};
use crate::interrupt;
use crate::usb_bus::Controller;

/// Endpoints of the bus and of control.
const ENDPOINTS: [Endpoints; 2] =
    [Endpoints { notifications: 0x81, data: 2 }, Endpoints { notifications: 0x83, data: 4 }];

/// True if the controller has work for the loop.
static PENDING: AtomicBool = AtomicBool::new(false);

/// Ends the sleep of the loop. The loop does the work, and unmasks the interrupt.
#[interrupt]
fn USBCTRL_IRQ() {
    NVIC::mask(Interrupt::USBCTRL_IRQ);
    PENDING.store(true, Ordering::Relaxed);
}

/// The cable; `None` if there is no second one.
pub(crate) struct Usb(Option<&'static mut UsbCable<Controller>>);

impl Usb {
    /// Starts the controller, and connects the board to the computer.
    pub(crate) fn start() -> Self {
        Self(connect())
    }
}

/// Makes the device. The stack that this needs is free again when it returns.
#[inline(never)]
fn connect() -> Option<&'static mut UsbCable<Controller>> {
    let serial = singleton!(: [u8; 16] = hex(&rom::unique_id()))?;
    let allocator = singleton!(: UsbBusAllocator<Controller> = UsbBusAllocator::new(Controller::new()))?;
    let cable = UsbCable::connect(allocator, str::from_utf8(serial).ok()?, ENDPOINTS)?;
    singleton!(: UsbCable<Controller> = cable)
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
        let Some(cable) = self.0.as_deref_mut() else { return };
        PENDING.store(false, Ordering::Relaxed);
        cable.poll(Controller::take_back);
        NVIC::unpend(Interrupt::USBCTRL_IRQ);
        // SAFETY: no critical section relies on the interrupt's mask.
        unsafe { NVIC::unmask(Interrupt::USBCTRL_IRQ) };
    }

    fn read(&mut self, port: CablePort, bytes: &mut [u8]) -> usize {
        self.0.as_deref_mut().map_or(0, |cable| cable.read(port, bytes))
    }

    fn write(&mut self, port: CablePort, bytes: &[u8]) -> usize {
        self.0.as_deref_mut().map_or(bytes.len(), |cable| cable.write(port, bytes))
    }

    fn is_open(&self, port: CablePort) -> bool {
        self.0.as_deref().is_some_and(|cable| cable.is_open(port))
    }

    fn line(&self) -> Option<Line> {
        self.0.as_deref().and_then(UsbCable::line)
    }
}
