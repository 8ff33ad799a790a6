//! Drives on an STM32F411, as on the Black Pill.
//!
//! Each binary is one kind of drive: it names what makes it and the wires of the board, and has [`run`] run it. What it
//! has in common with other boards is in `drivetwin_board`, what all drives have in common here.
//!
//! README.md shows how it is wired. Sections beside the code are those of the reference manual, RM0383; the
//! datasheet is DS10314.
//!
//! | module | what it holds |
//! |---|---|
//! | [`wires`] | which pins are what |
//! | `boot` | from the reset to a program in RAM |
//! | `vectors` | the interrupts that are taken |
//! | `BlackPill` | the board, as the loop needs it |
//! | `clock` | the clocks |
//! | `timer` | time, alarms, sleep |
//! | `bus` | USART1, and the direction of RS-485 |
//! | [`gpio`], `inputs` | levels and edges |
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
pub mod gpio;
mod inputs;
mod log;
mod registers;
mod steps;
mod timer;
mod vectors;
mod watchdog;
pub mod wires;

use core::panic::PanicInfo;

use cortex_m::peripheral::{NVIC, SCB};
use cortex_m::{Peripherals, asm};
use cortex_m_rt::exception;
use drivetwin_board::{Axis, Board, End, Output, Queue, Saved, made};
use drivetwin_firmware::device::{Boot, Device, Duration, Instant, Spec};
use drivetwin_firmware::shell::{BoardEvent, NoNetwork};

use self::bus::Usart1;
use self::flash::{Flash, SECTORS};
use self::gpio::Gpio;
use self::steps::Steps;
use self::timer::WAKE;
use self::vectors::Interrupt;
use self::wires::{FAST, Wire};

/// The number of events that may wait, of 16 bytes each: a request of the longest kind, or all that a line of 9,600 baud brings in
/// the half second that erasing a sector may take.
const ROOM: usize = 512;

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

    /// Enables interrupts. A step is delayed by critical sections alone. All that stamps or sends has one priority,
    /// so that stamps ascend.
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
        inputs::tell_missed();
    }

    fn feed() {
        watchdog::feed();
    }

    #[inline(never)]
    fn sleep_until(deadline: Instant) {
        drivetwin_board::sleep_until::<Self>(deadline, |at| {
            if WAKE.set(at + Duration::from_ticks(1)) {
                asm::wfi();
            }
        });
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
