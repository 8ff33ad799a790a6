//! Drives on the Raspberry Pi Pico and the Pico 2.
//!
//! Each binary of `drivetwin-rp2040` and of `drivetwin-rp2350` is one kind of drive. It names the drive's constructor and the
//! wires of the board, and calls [`run`]. Code that is common to all boards is in `drivetwin_board`; code that is common to
//! all drives and to both boards is here. The RP2350 of the Pico 2 has the UART, the timer, the pins and the USB controller
//! of the RP2040; `chip` is the module of one of them.
//!
//! README.md of `rp2040` shows the wiring. Sections cited beside the code are those of the *RP2040 Datasheet*, in `rp2350`
//! those of the *RP2350 Datasheet*; the sections of the flash chip are in *W25Q16JV*.
//!
//! | module | what it holds |
//! |---|---|
//! | [`wires`] | assignment of the pins |
//! | `Pico` | the board, as the loop needs it |
//! | `chip`: `rp2040` or `rp2350` | addresses and interrupts; the way from the reset to a program in RAM, clocks, functions of the boot ROM |
//! | `vectors` | the table of interrupts |
//! | `timer` | time, alarms, sleep |
//! | `bus` | UART0, and the direction of RS-485 |
//! | `pins` | levels and edges |
//! | `steps` | STEP and DIR |
//! | `flash` | the flash for images, the chosen kind and saved registers |
//! | `kinds` | the kinds of drive that the board can be |
//! | `selector` | the start of the chosen kind |
//! | `usb`, `usb_bus` | the USB cable, and the controller |
//! | `watchdog` | the watchdog |
//! | `log` | the log through a debug probe |
//! | `pll`, `registers` | a PLL; registers of the hardware |
#![no_std]

mod bus;
mod flash;
mod kinds;
mod log;
mod pins;
mod pll;
mod registers;
#[cfg(not(rp2350))]
mod rp2040;
#[cfg(rp2350)]
mod rp2350;
mod selector;
mod steps;
mod timer;
mod usb;
mod usb_bus;
mod vectors;
mod watchdog;
pub mod wires;

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use cortex_m::{Peripherals, asm};
use cortex_m_rt::{exception, interrupt};
use drivetwin_board::{Axis, Board, End, Leave, Output, Queue, Saved, Tap, made};
use drivetwin_control::Refused;
use drivetwin_firmware::device::{Boot, Device, Instant, Spec};
use drivetwin_firmware::shell::{BoardEvent, NoNetwork};

#[cfg(not(rp2350))]
use self::rp2040 as chip;
#[cfg(rp2350)]
use self::rp2350 as chip;

pub use self::pins::Wire;
pub use self::selector::select;

use self::bus::Uart0;
use self::chip::Interrupt as interrupt;
use self::chip::{Interrupt, clock};
use self::flash::{Flash, MOST_SECTORS};
use self::pins::Pins;
use self::steps::Steps;
use self::timer::{TICKS, WAKE};
use self::usb::Usb;

/// Maximum number of events that wait, of 24 bytes each. It suffices for a request of the longest kind, and
/// for everything that a line at 57,600 baud receives in the 45 ms in which a sector is erased.
const ROOM: usize = 256;

/// Events from the interrupts to the loop.
static QUEUE: Queue<(Instant, BoardEvent), ROOM> = Queue::new();

/// Characters that the bus sends, for the cable.
pub(crate) const TAP: Option<&Tap> = {
    static TAP: Tap = Tap::new();
    Some(&TAP)
};

/// Number of events that were lost because the queue was full; it wraps.
static LOST: AtomicU32 = AtomicU32::new(0);

/// Counts a lost event. Called in interrupts of one priority, or in a critical section.
fn lose() {
    LOST.store(LOST.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

/// Reserves memory for `$bytes` bytes of saved registers, into which they are read from flash.
#[macro_export]
macro_rules! memory {
    ($bytes:expr) => {
        &mut [0xFF; $bytes]
    };
}

/// Makes a drive and runs it, with its pins and faults wired as in `wires`. `memory` has as many bytes as the
/// drive's spec saves; `CHARACTERS` is the number of characters that may wait to be sent.
// Inlined, because a stack frame of its own would take stack for as long as the drive runs.
#[inline(always)]
pub fn run<D: Device, const MEMORY: usize, const CHARACTERS: usize, const WIRES: usize>(
    make: fn() -> D,
    memory: &mut [u8; MEMORY],
    wires: &[Wire; WIRES],
) -> ! {
    drivetwin_board::run::<Pico, _, _, _, CHARACTERS, _>(
        &mut made(make),
        wires,
        |spec| Saved::<_, MOST_SECTORS>::new(Flash::new(), flash::place(MEMORY), spec.kind, memory),
        |_| None::<NoNetwork>,
    )
}

/// The board.
enum Pico {}

impl Board for Pico {
    type Wire = Wire;
    type Pin = Output<Pins>;
    type Uart = Uart0;
    type Timer = Steps;
    type Cable = Usb;

    const NAME: &'static str = chip::BOARD;

    fn axis() -> &'static Axis<Steps> {
        &steps::AXIS
    }

    fn start() -> Boot {
        clock::start();
        timer::start();
        watchdog::start();
        Boot { fast: pins::is_tied(wires::FAST), ..Boot::default() }
    }

    fn wire<const N: usize>(spec: &Spec, wires: &[Wire; N]) -> [(Option<End>, Output<Pins>); N] {
        kinds::this_is(spec.kind);
        if wires.iter().all(|(_, pins)| pins & wires::LIGHT == 0) {
            pins::drive_low(wires::LIGHT);
            pins::write(wires::LIGHT, true);
        }
        pins::start(spec, wires)
    }

    /// Enables interrupts. Only critical sections delay a step. All interrupts that timestamp or send have
    /// the same priority, so that timestamps ascend. The alarm of the loop and USB have the lowest one, because
    /// they only end the sleep.
    fn unmask() {
        let priorities = [
            (Interrupt::TIMER_IRQ_0, 0x00),
            (Interrupt::UART0_IRQ, 0x40),
            (Interrupt::IO_IRQ_BANK0, 0x40),
            (Interrupt::TIMER_IRQ_2, 0x40),
            (Interrupt::TIMER_IRQ_1, 0xC0),
            (Interrupt::USBCTRL_IRQ, 0xC0),
        ];
        let Some(mut core) = Peripherals::take() else { return };
        for (interrupt, priority) in priorities {
            // SAFETY: no critical section relies on priorities.
            unsafe { core.NVIC.set_priority(interrupt, priority) };
            // SAFETY: no critical section relies on the interrupt's mask.
            unsafe { NVIC::unmask(interrupt) };
        }
    }

    fn log(kind: &str, boot: Boot) {
        log::power(kind, boot);
    }

    fn past() -> Instant {
        timer::past()
    }

    fn next_event(until: Instant) -> Option<(Instant, BoardEvent)> {
        QUEUE.pop_if(|(at, _)| *at <= until)
    }

    fn lost_inputs() -> u32 {
        LOST.load(Ordering::Relaxed)
    }

    fn is_quiet() -> bool {
        QUEUE.is_empty()
    }

    fn tell_missed() {
        pins::tell_missed();
    }

    fn feed() {
        watchdog::feed();
    }

    fn cable() -> Usb {
        Usb::start()
    }

    fn kind(number: u8) -> Option<&'static str> {
        kinds::kind(number)
    }

    fn choose(kind: &str) -> Result<Leave, Refused> {
        kinds::choose(kind)
    }

    fn boot_loader() -> Result<Leave, Refused> {
        Ok(kinds::start_boot_loader)
    }

    #[inline(never)]
    fn sleep_until(deadline: Instant) {
        let set = |at: Instant| WAKE.set(at.ticks() / TICKS + 1);
        drivetwin_board::sleep_until::<Self>(deadline, set, asm::wfe);
    }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    watchdog::reset()
}

#[exception(trampoline = false)]
unsafe fn HardFault() -> ! {
    watchdog::reset()
}
