//! Drives on the Raspberry Pi Pico 2.
//!
//! Each binary is one kind of drive. It names the drive's constructor and the wires of the board, and calls
//! [`run`]. Code that is common to all boards is in `drivetwin_board`; code that is common to all drives is
//! here.
//!
//! No image has run on a Pico 2 yet. The RP2350 has the UART, the timer and the pins of the RP2040 at other addresses, so
//! modules of the crate of the Pico are used here, too; `chip` has the addresses. The sections that these modules cite are
//! those of the *RP2040 Datasheet*; the others are those of the *RP2350 Datasheet*.
//!
//! | module | what it holds |
//! |---|---|
//! | [`wires`] | assignment of the pins |
//! | `boot` | from the reset to a program in RAM |
//! | `Pico2` | the board, as the loop needs it |
//! | `chip` | addresses and interrupts |
//! | `clock` | the system clock |
//! | `timer` | time, alarms, sleep |
//! | `bus` | UART0, and the direction of RS-485 |
//! | `pins` | levels and edges |
//! | `steps` | STEP and DIR |
//! | `flash` | the flash for saved registers |
//! | `watchdog` | the watchdog |
//! | `log` | the log through a debug probe |
//! | `registers` | registers of the hardware |
#![no_std]

mod boot;
#[path = "../../rp2040/src/bus.rs"]
mod bus;
mod chip;
mod clock;
mod flash;
#[path = "../../rp2040/src/log.rs"]
mod log;
#[path = "../../rp2040/src/pins.rs"]
mod pins;
mod registers;
#[path = "../../rp2040/src/steps.rs"]
mod steps;
#[path = "../../rp2040/src/timer.rs"]
mod timer;
mod watchdog;
#[path = "../../rp2040/src/wires.rs"]
pub mod wires;

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use cortex_m::{Peripherals, asm};
use cortex_m_rt::exception;
use drivetwin_board::{Axis, Board, End, NoCable, Output, Queue, Saved, Tap, made};
use drivetwin_firmware::device::{Boot, Device, Instant, Spec};
use drivetwin_firmware::shell::{BoardEvent, NoNetwork};

pub use self::pins::Wire;

use self::bus::Uart0;
use self::chip::Interrupt;
use self::flash::{Flash, MOST_SECTORS};
use self::pins::Pins;
use self::steps::Steps;
use self::timer::{TICKS, WAKE};

/// Maximum number of events that wait, of 24 bytes each. It suffices for a request of the longest kind, and
/// for everything that a line at 57,600 baud receives in the 45 ms in which a sector is erased.
const ROOM: usize = 256;

/// Events from the interrupts to the loop.
static QUEUE: Queue<(Instant, BoardEvent), ROOM> = Queue::new();

/// The bus sends nothing for a cable.
pub(crate) const TAP: Option<&Tap> = None;

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
    drivetwin_board::run::<Pico2, _, _, _, CHARACTERS, _>(
        &mut made(make),
        wires,
        |spec| Saved::<_, MOST_SECTORS>::new(Flash::new(), flash::place(MEMORY), spec.kind, memory),
        |_| None::<NoNetwork>,
    )
}

/// The board.
enum Pico2 {}

impl Board for Pico2 {
    type Wire = Wire;
    type Pin = Output<Pins>;
    type Uart = Uart0;
    type Timer = Steps;
    type Cable = NoCable;

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
        if wires.iter().all(|(_, pins)| pins & wires::LIGHT == 0) {
            pins::drive_low(wires::LIGHT);
            pins::write(wires::LIGHT, true);
        }
        pins::start(spec, wires)
    }

    /// Enables interrupts. Only critical sections delay a step. All interrupts that timestamp or send have
    /// the same priority, so that timestamps ascend. The alarm of the loop has the lowest one, because it
    /// only ends the sleep.
    fn unmask() {
        let priorities = [
            (Interrupt::TIMER_IRQ_0, 0x00),
            (Interrupt::UART0_IRQ, 0x40),
            (Interrupt::IO_IRQ_BANK0, 0x40),
            (Interrupt::TIMER_IRQ_2, 0x40),
            (Interrupt::TIMER_IRQ_1, 0xC0),
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

    fn is_quiet() -> bool {
        QUEUE.is_empty()
    }

    fn tell_missed() {
        pins::tell_missed();
    }

    fn lost_inputs() -> u32 {
        LOST.load(Ordering::Relaxed)
    }

    fn feed() {
        watchdog::feed();
    }

    fn cable() -> NoCable {
        NoCable
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
