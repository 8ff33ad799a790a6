//! The USB cable: a device with two serial ports, at the controller OTG_FS (22).
//!
//! The driver of the controller is the crate `synopsys-usb-otg`. It is called only in the loop.

use core::ptr;
use core::str;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::NVIC;
use cortex_m::singleton;
use drivetwin_board::{Cable, CablePort, Endpoints, UsbCable, hex};
use drivetwin_firmware::device::Line;
use synopsys_usb_otg::{UsbBus, UsbPeripheral};
use usb_device::bus::UsbBusAllocator;
use usb_device::endpoint::EndpointAddress;

use crate::clock::{self, MHZ};
use crate::registers::Register;
use crate::vectors::{Interrupt, interrupt};
use crate::wires::{DM, DP};

/// Endpoints of the bus and of control. The controller has three to the computer: two are for data, and the third one for
/// the notifications of both ports, so that of control is declared as one from the computer (BOARD-20).
const ENDPOINTS: [Endpoints; 2] =
    [Endpoints { notifications: 0x81, data: 2 }, Endpoints { notifications: 0x01, data: 3 }];

/// Number of the alternate function of PA11 and PA12 (datasheet, table 9).
const FUNCTION: u32 = 10;

/// Registers of the controller (22.16).
const OTG: usize = 0x5000_0000;
const RESETS: Register = Register::at(OTG, 0x010);
/// Control and events of the endpoints to the computer: those of the next endpoint are 0x20 further.
const CONTROL: usize = OTG + 0x900;
const EVENTS: usize = OTG + 0x908;

/// The number that every chip has of its own, 96 bits (24.1).
const UNIQUE: Register = Register::at(0x1FFF_7A10, 0);

/// Words of memory for packets from the computer, which the driver needs: 64 bytes for each of the endpoints 0, 2 and 3, and
/// 8 bytes for endpoint 1.
const WORDS: usize = 3 * 16 + 2;

/// True if the controller has work for the loop.
static PENDING: AtomicBool = AtomicBool::new(false);
/// True while the loop is in the driver.
static IN_DRIVER: AtomicBool = AtomicBool::new(false);

/// Ends the sleep of the loop. The loop does the work, and unmasks the interrupt.
#[interrupt]
fn OTG_FS() {
    NVIC::mask(Interrupt::OTG_FS);
    PENDING.store(true, Ordering::Relaxed);
}

/// Returns `true` while the loop is in the driver, whose critical sections need to mask nothing: no interrupt touches what
/// the driver has.
#[inline]
pub(crate) fn is_in_driver() -> bool {
    IN_DRIVER.load(Ordering::Relaxed)
}

/// Calls the driver.
fn driver<T>(act: impl FnOnce() -> T) -> T {
    IN_DRIVER.store(true, Ordering::Relaxed);
    let result = act();
    IN_DRIVER.store(false, Ordering::Relaxed);
    result
}

/// The controller.
struct Otg;

// SAFETY: the registers are those of the controller of this chip, and nothing else uses them while the driver does.
unsafe impl UsbPeripheral for Otg {
    const REGISTERS: *const () = ptr::without_provenance(OTG);
    const HIGH_SPEED: bool = false;
    const FIFO_DEPTH_WORDS: usize = 320;
    const ENDPOINT_COUNT: usize = 4;

    fn enable() {
        clock::start_usb();
        for pin in [DM, DP] {
            pin.give_fast(FUNCTION);
        }
    }

    fn ahb_frequency_hz(&self) -> u32 {
        MHZ * 1_000_000
    }
}

/// The cable; `None` if there is no second one.
pub(crate) struct Usb(Option<&'static mut UsbCable<UsbBus<Otg>>>);

impl Usb {
    /// Starts the controller, and connects the board to the computer.
    pub(crate) fn start() -> Self {
        Self(driver(connect))
    }
}

/// Makes the device. The stack that this needs is free again when it returns.
#[inline(never)]
fn connect() -> Option<&'static mut UsbCable<UsbBus<Otg>>> {
    let serial = singleton!(: [u8; 24] = hex(&unique_id()))?;
    let memory = singleton!(: [u32; WORDS] = [0; WORDS])?;
    let allocator = singleton!(: UsbBusAllocator<UsbBus<Otg>> = UsbBus::new(Otg, memory))?;
    let cable = UsbCable::connect(allocator, str::from_utf8(serial).ok()?, ENDPOINTS)?;
    singleton!(: UsbCable<UsbBus<Otg>> = cable)
}

/// The number of the chip.
fn unique_id() -> [u8; 12] {
    let mut id = [0; 12];
    for (place, word) in id.chunks_exact_mut(4).zip([0, 4, 8]) {
        place.copy_from_slice(&UNIQUE.plus(word).read().to_be_bytes());
    }
    id
}

/// Takes back a packet to the computer that the computer has not taken (22.17.6).
fn take_back(_: &UsbBus<Otg>, endpoint: EndpointAddress) {
    const ENABLED: u32 = 1 << 31;
    const DISABLE: u32 = 1 << 30;
    const REFUSE: u32 = 1 << 27;
    const REFUSES: u32 = 1 << 6;
    const DISABLED: u32 = 1 << 1;
    const FLUSH: u32 = 1 << 5;
    let number = endpoint.index();
    let [control, events] = [CONTROL, EVENTS].map(|base| Register::at(base, 0x20 * number));
    // As long as a packet takes, at most.
    let wait = |register: Register, bits: u32, set: bool| {
        for _ in 0..1_000 {
            if (register.read() & bits != 0) == set {
                break;
            }
        }
    };
    if control.read() & ENABLED == 0 {
        return;
    }
    control.set(REFUSE);
    wait(events, REFUSES, true);
    control.set(DISABLE | REFUSE);
    wait(events, DISABLED, true);
    events.write(DISABLED | REFUSES);
    RESETS.write(FLUSH | (number as u32) << 6);
    wait(RESETS, FLUSH, false);
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
        driver(|| cable.poll(take_back));
        NVIC::unpend(Interrupt::OTG_FS);
        // SAFETY: no critical section relies on the interrupt's mask.
        unsafe { NVIC::unmask(Interrupt::OTG_FS) };
    }

    fn read(&mut self, port: CablePort, bytes: &mut [u8]) -> usize {
        self.0.as_deref_mut().map_or(0, |cable| driver(|| cable.read(port, bytes)))
    }

    fn write(&mut self, port: CablePort, bytes: &[u8]) -> usize {
        self.0.as_deref_mut().map_or(bytes.len(), |cable| driver(|| cable.write(port, bytes)))
    }

    fn is_open(&self, port: CablePort) -> bool {
        self.0.as_deref().is_some_and(|cable| cable.is_open(port))
    }

    fn line(&self) -> Option<Line> {
        self.0.as_deref().and_then(UsbCable::line)
    }
}
