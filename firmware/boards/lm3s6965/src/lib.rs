//! Drives on the Stellaris LM3S6965 evaluation board (`lm3s6965evb` in QEMU).
//!
//! Each binary is one kind of drive. It names the drive's constructor and the wires of the board, and calls
//! [`run`], or [`run_on_network`] if the drive has TCP ports. Code that is common to all boards is in
//! `drivetwin_board`; code that is common to all drives is here: UART0 is the bus, UART1 prints one text line
//! when the drive has power, a timer makes STEP and DIR. `README.md` lists the pins.
//!
//! Interrupts have two priorities. The step timer and SysTick have the higher one, all others the lower one.
//!
//! Datasheet: *Stellaris LM3S6965 Microcontroller*, DS-LM3S6965; its sections are cited beside the code.
//! Images must be built with optimisation: then the linker proves that nothing can panic, except in images
//! with a network.
#![no_std]

mod bus;
mod clock;
mod ethernet;
pub mod gpio;
mod inputs;
mod log;
mod registers;
mod saved;
mod steps;
mod timer;
mod watchdog;
pub mod wires;

use core::panic::PanicInfo;

use cortex_m::peripheral::{NVIC, SCB};
use cortex_m::{Peripherals, asm};
use cortex_m_rt::{ExceptionFrame, exception};
use drivetwin_board::{Axis, Board, End, NoCable, Output, Queue, made};
use drivetwin_firmware::device::{Boot, Device, Instant, Spec};
use drivetwin_firmware::shell::{BoardEvent, NoNetwork};
use lm3s6965::Interrupt;

use self::bus::Uart0;
use self::gpio::{Gpio, Wired};
pub use self::saved::Saved;
use self::steps::Steps;
use self::wires::Wire;

/// Maximum number of events that wait until the drive takes the first one. A request has 8 characters.
const ROOM: usize = 80;

/// Events from the interrupts to the loop.
static QUEUE: Queue<(Instant, BoardEvent), ROOM> = Queue::new();

/// Input for a jumper to ground, which skips the start-up delay.
const FAST: Gpio = gpio::B.pin(6);

/// Interrupts with a lower priority than the step timer.
const LESS_URGENT: [Interrupt; 11] = [
    Interrupt::UART0,
    Interrupt::TIMER_0A,
    Interrupt::TIMER_2A,
    Interrupt::GPIOA,
    Interrupt::GPIOB,
    Interrupt::GPIOC,
    Interrupt::GPIOD,
    Interrupt::GPIOE,
    Interrupt::GPIOF,
    Interrupt::GPIOG,
    Interrupt::ETHERNET,
];

/// Reserves an image's memory for `$bytes` bytes of saved registers. A debugger finds it by its exported
/// name.
#[macro_export]
macro_rules! memory {
    ($bytes:expr) => {{
        #[unsafe(export_name = "SAVED")]
        #[unsafe(link_section = ".uninit.SAVED")]
        static SAVED: $crate::Saved<{ $bytes }> = $crate::Saved::new();
        &SAVED
    }};
}

/// Makes a drive and runs it with these saved registers. `wires` connects names of the drive's pins and
/// faults to pins of the board. `CHARACTERS` is the number of characters that may wait to be sent.
pub fn run<D: Device, const MEMORY: usize, const CHARACTERS: usize, const WIRES: usize>(
    make: fn() -> D,
    saved: &'static Saved<MEMORY>,
    wires: &[Wire; WIRES],
) -> ! {
    let drive = &mut made(make);
    drivetwin_board::run::<Evaluation, _, _, _, CHARACTERS, _>(
        drive,
        wires,
        |_| saved.begin(),
        |_| None::<NoNetwork>,
    )
}

/// Runs a drive like [`run`], but with TCP ports: 502 for Modbus and 503 for MCode, at 192.168.33.1.
pub fn run_on_network<D: Device, const MEMORY: usize, const WIRES: usize>(
    make: fn() -> D,
    saved: &'static Saved<MEMORY>,
    wires: &[Wire; WIRES],
) -> ! {
    let drive = &mut made(make);
    drivetwin_board::run::<Evaluation, _, _, _, 0, _>(drive, wires, |_| saved.begin(), ethernet::start)
}

/// The evaluation board.
enum Evaluation {}

impl Board for Evaluation {
    type Wire = Wire;
    type Pin = Output<Wired>;
    type Uart = Uart0;
    type Timer = Steps;
    type Cable = NoCable;

    const NAME: &'static str = "lm3s6965";

    fn axis() -> &'static Axis<Steps> {
        &steps::AXIS
    }

    fn start() -> Boot {
        if let Some(mut core) = Peripherals::take() {
            clock::start(&mut core.SYST);
            prioritise(&mut core.NVIC);
        }
        watchdog::start();
        FAST.pulled(true);
        // Waits 20 µs for the pull-ups.
        asm::delay(1_000);
        Boot { fast: !FAST.is_high(), ..Boot::default() }
    }

    fn wire<const N: usize>(spec: &Spec, wires: &[Wire; N]) -> [(Option<End>, Output<Wired>); N] {
        inputs::start(spec, wires)
    }

    fn unmask() {
        for interrupt in LESS_URGENT.into_iter().chain([Interrupt::TIMER_1A]) {
            // SAFETY: no critical section relies on an interrupt's mask.
            unsafe { NVIC::unmask(interrupt) };
        }
    }

    fn log(kind: &str, _: Boot) {
        log::power(kind);
    }

    fn past() -> Instant {
        clock::now()
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

    fn cable() -> NoCable {
        NoCable
    }

    fn sleep_until(deadline: Instant) {
        clock::sleep_until(deadline);
    }
}

/// Gives interrupts a lower priority than the step timer's.
fn prioritise(nvic: &mut NVIC) {
    /// Second highest priority. The hardware uses the upper three bits.
    const BELOW: u8 = 1 << 5;
    for interrupt in LESS_URGENT {
        // SAFETY: critical sections use PRIMASK, which does not depend on priorities.
        unsafe { nvic.set_priority(interrupt, BELOW) };
    }
}

/// Starts the board again, because no state can be trusted after a fault.
#[exception]
unsafe fn HardFault(_: &ExceptionFrame) -> ! {
    SCB::sys_reset()
}

#[cfg(not(feature = "defmt"))]
unsafe extern "C" {
    /// Never defined, so that an image that can panic does not link. Only images with a network define it, as
    /// [`HardFault`].
    safe fn a_panic_can_happen() -> !;
}

#[cfg(not(feature = "defmt"))]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    a_panic_can_happen()
}

/// Panic handler for images with `defmt`, which itself may panic.
#[cfg(feature = "defmt")]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    SCB::sys_reset()
}
