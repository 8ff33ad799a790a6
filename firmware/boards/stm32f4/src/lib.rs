//! Drives on an STM32F411, as on the Black Pill.
//!
//! Each binary is one kind of drive. It names the drive's constructor and the wires of the board, and calls
//! [`run`]. Code that is common to all boards is in `drivetwin_board`; code that is common to all drives is
//! here.
//!
//! README.md shows the wiring. Sections cited beside the code are those of the reference manual, RM0383; the
//! datasheet is DS10314.
//!
//! | module | what it holds |
//! |---|---|
//! | [`wires`] | assignment of the pins |
//! | `boot` | from the reset to a program in RAM |
//! | `vectors` | the interrupts with handlers |
//! | `BlackPill` | the board, as the loop needs it |
//! | `clock` | the clocks |
//! | `timer` | time, alarms, sleep |
//! | `bus` | USART1, and the direction of RS-485 |
//! | [`gpio`], `inputs` | levels and edges |
//! | `steps` | STEP and DIR |
//! | `usb` | the USB cable |
//! | `critical` | critical sections |
//! | `flash` | the flash for saved registers |
//! | `watchdog` | the watchdog |
//! | `log` | the log through a debug probe |
//! | `registers` | registers of the hardware |
#![no_std]

mod boot;
mod bus;
mod clock;
mod critical;
mod flash;
pub mod gpio;
mod inputs;
mod log;
mod registers;
mod steps;
mod timer;
mod usb;
mod vectors;
mod watchdog;
pub mod wires;

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::{NVIC, SCB};
use cortex_m::{Peripherals, asm};
use cortex_m_rt::exception;
use drivetwin_board::{Axis, Board, End, Output, Queue, Saved, Tap, made};
use drivetwin_firmware::device::{Boot, Device, Duration, Instant, Spec};
use drivetwin_firmware::shell::{BoardEvent, NoNetwork};

use self::bus::Usart1;
use self::flash::{Flash, SECTORS};
use self::gpio::Gpio;
use self::steps::Steps;
use self::timer::WAKE;
use self::usb::Usb;
use self::vectors::Interrupt;
use self::wires::{FAST, Wire};

/// Maximum number of events that wait, of 16 bytes each. It suffices for a request of the longest kind, and
/// for everything that a line at 9,600 baud receives in the half second that erasing a sector may take.
const ROOM: usize = 512;

/// Events from the interrupts to the loop.
static QUEUE: Queue<(Instant, BoardEvent), ROOM> = Queue::new();

/// Characters that the bus sends, for the cable.
static TAP: Tap = Tap::new();

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
    drivetwin_board::run::<BlackPill, _, _, _, CHARACTERS, _>(
        &mut made(make),
        wires,
        |spec| Saved::<_, SECTORS>::new(Flash::new(), flash::SAVED, spec.kind, memory),
        |_| None::<NoNetwork>,
    )
}

/// The board.
enum BlackPill {}

impl Board for BlackPill {
    type Wire = Wire;
    type Pin = Output<Gpio>;
    type Uart = Usart1;
    type Timer = Steps;
    type Cable = Usb;

    const NAME: &'static str = "black-pill";

    fn axis() -> &'static Axis<Steps> {
        &steps::AXIS
    }

    fn start() -> Boot {
        clock::start();
        timer::start();
        watchdog::start();
        FAST.pulled(true);
        inputs::settle();
        Boot { fast: !FAST.is_high(), ..Boot::default() }
    }

    fn wire<const N: usize>(spec: &Spec, wires: &[Wire; N]) -> [(Option<End>, Output<Gpio>); N] {
        inputs::start(spec, wires)
    }

    /// Enables interrupts. Only critical sections delay a step. All interrupts that timestamp or send have
    /// the same priority, so that timestamps ascend. USB has the lowest one, because it only ends the sleep.
    fn unmask() {
        let priorities = [
            (Interrupt::TIM2, 0x00),
            (Interrupt::USART1, 0x40),
            (Interrupt::EXTI0, 0x40),
            (Interrupt::EXTI1, 0x40),
            (Interrupt::EXTI2, 0x40),
            (Interrupt::EXTI3, 0x40),
            (Interrupt::EXTI4, 0x40),
            (Interrupt::EXTI9_5, 0x40),
            (Interrupt::EXTI15_10, 0x40),
            (Interrupt::OTG_FS, 0xC0),
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
        inputs::tell_missed();
    }

    fn feed() {
        watchdog::feed();
    }

    fn cable() -> Usb {
        Usb::start()
    }

    #[inline(never)]
    fn sleep_until(deadline: Instant) {
        let set = |at| WAKE.set(at + Duration::from_ticks(1));
        drivetwin_board::sleep_until::<Self>(deadline, set, asm::wfe);
    }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    SCB::sys_reset()
}

#[exception(trampoline = false)]
unsafe fn HardFault() -> ! {
    SCB::sys_reset()
}
