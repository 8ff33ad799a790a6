//! Drives on the Stellaris LM3S6965 evaluation board (`lm3s6965evb` in QEMU).
//!
//! Each binary is one kind of drive: it names what makes it and the wires of the board, and has [`run`] run it, or
//! [`run_on_network`] where the drive has TCP ports. What it has in common with other boards is in `drivetwin_board`,
//! what all drives have in common here: UART0 is the bus, UART1 prints one line when the drive has power, a timer
//! makes STEP and DIR. `README.md` has the pins.
//!
//! Interrupts have two priorities: that of the step timer and of SysTick, and below it all the others.
//!
//! Datasheet: *Stellaris LM3S6965 Microcontroller*, DS-LM3S6965; its sections are cited beside the code.
//! Built optimised only: there the linker proves that nothing can panic, but in images with a network.
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
use drivetwin_board::{Axis, Board, End, Output, Queue, made};
use drivetwin_firmware::device::{Boot, Device, Instant, Spec};
use drivetwin_firmware::shell::{BoardEvent, NoNetwork};
use lm3s6965::Interrupt;

use self::bus::Uart0;
use self::gpio::{Gpio, Wired};
pub use self::saved::Saved;
use self::steps::Steps;
use self::wires::Wire;

/// The number of events that may be caught before the drive takes the first one. A request has 8 characters.
const ROOM: usize = 80;

/// The events that interrupts have for the loop.
static QUEUE: Queue<(Instant, BoardEvent), ROOM> = Queue::new();

/// A jumper to ground: no start-up delay.
const FAST: Gpio = gpio::B.pin(6);

/// Interrupts below the step timer's.
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

/// The place of an image's saved registers, that many bytes. A debugger finds it by this name.
#[macro_export]
macro_rules! memory {
    ($bytes:expr) => {{
        #[unsafe(export_name = "SAVED")]
        #[unsafe(link_section = ".uninit.SAVED")]
        static SAVED: $crate::Saved<{ $bytes }> = $crate::Saved::new();
        &SAVED
    }};
}

/// Makes a drive and runs it with these saved registers; its pins and faults, by their names, are wired to these pins of
/// the board. `CHARACTERS` is how many characters may wait to be sent.
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

/// Runs a drive as [`run`] does, one whose ports are TCP ports: 502 is Modbus, 503 is MCode, at 192.168.33.1.
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
        // Time for the pull-ups: 20 µs.
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

    fn sleep_until(deadline: Instant) {
        clock::sleep_until(deadline);
    }
}

/// Puts interrupts below the step timer's.
fn prioritise(nvic: &mut NVIC) {
    /// The hardware has the upper three bits.
    const BELOW: u8 = 1 << 5;
    for interrupt in LESS_URGENT {
        // SAFETY: critical sections are made by PRIMASK, with any priorities.
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
    /// Never defined but in images with a network, where it is [`HardFault`]: another one that can panic does not link.
    safe fn a_panic_can_happen() -> !;
}

#[cfg(not(feature = "defmt"))]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    a_panic_can_happen()
}

/// `defmt` itself may panic.
#[cfg(feature = "defmt")]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    SCB::sys_reset()
}
