//! Drives on the Raspberry Pi Pico.
//!
//! Each binary is one kind of drive: it names what makes it and the wires of the board, and has [`run`] run it. What it
//! has in common with other boards is in `drivetwin_board`, what all drives have in common here.
//!
//! README.md shows how it is wired. Sections beside the code are those of the *RP2040 Datasheet*; those of
//! the flash chip are in *W25Q16JV*.
//!
//! | module | what it holds |
//! |---|---|
//! | [`wires`] | which pins are what |
//! | `boot` | from the reset to a program in RAM |
//! | `Pico` | the board, as the loop needs it |
//! | `clock` | the system clock |
//! | `timer` | time, alarms, sleep |
//! | `bus` | UART0, and the direction of RS-485 |
//! | `pins` | levels and edges |
//! | `steps` | STEP and DIR |
//! | `flash` | where saved registers are |
//! | `watchdog` | the watchdog |
//! | `log` | what shows over a debug probe |
//! | `registers` | registers of the hardware |
#![no_std]

mod boot;
mod bus;
mod clock;
mod flash;
mod log;
mod pins;
mod registers;
mod steps;
mod timer;
mod watchdog;
pub mod wires;

use core::panic::PanicInfo;

use cortex_m::peripheral::NVIC;
use cortex_m::{Peripherals, asm};
use cortex_m_rt::exception;
use drivetwin_board::{Axis, Board, End, Output, Queue, Saved, made};
use drivetwin_firmware::device::{Boot, Device, Instant, Spec};
use drivetwin_firmware::shell::{BoardEvent, NoNetwork};
use rp2040_pac::Interrupt;

pub use self::pins::Wire;

use self::bus::Uart0;
use self::flash::{Flash, MOST_SECTORS};
use self::pins::Pins;
use self::steps::Steps;
use self::timer::{TICKS, WAKE};

/// The number of events that may wait, of 24 bytes each: a request of the longest kind, or all that a line of 57,600 baud
/// brings in the 45 ms in which a sector is erased.
const ROOM: usize = 256;

/// The events that interrupts have for the loop.
static QUEUE: Queue<(Instant, BoardEvent), ROOM> = Queue::new();

/// A place for that many bytes of saved registers, until they are found in flash.
#[macro_export]
macro_rules! memory {
    ($bytes:expr) => {
        &mut [0xFF; $bytes]
    };
}

/// Makes a drive and runs it; its pins and faults are wired as given. `memory` has as many bytes as its spec saves,
/// `CHARACTERS` is how many characters may wait to be sent.
// A frame of its own would cost stack for as long as the drive runs.
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
        pins::start(spec, wires)
    }

    /// Enables interrupts. A step is delayed by critical sections alone. All that stamps or sends has one priority,
    /// so that stamps ascend. The alarm of the loop only has to end its sleep.
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
            // SAFETY: none relies on the interrupt's mask.
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

    fn feed() {
        watchdog::feed();
    }

    #[inline(never)]
    fn sleep_until(deadline: Instant) {
        drivetwin_board::sleep_until::<Self>(deadline, |at| {
            if WAKE.set(at.ticks() / TICKS + 1) {
                asm::wfi();
            }
        });
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
