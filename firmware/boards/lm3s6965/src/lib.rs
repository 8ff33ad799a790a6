//! Drives on the Stellaris LM3S6965 evaluation board (`lm3s6965evb` in QEMU).
//!
//! Each binary is one kind of drive: it says which pin of the board is which of the drive, and has
//! [`run`] make it, or [`run_on_network`] where the drive has TCP ports. What all have in common is here: UART0 is the bus,
//! UART1 says one line when the drive has power, a timer makes STEP and DIR. `README.md` has the pins.
//!
//! Interrupts have two priorities: that of the step timer and of SysTick, and below it all the others.
//!
//! Datasheet: *Stellaris LM3S6965 Microcontroller*, DS-LM3S6965; its sections stand beside the code.
//! Built optimised only: there the linker proves that nothing can panic, but in images with a network.
#![no_std]

mod bus;
mod caught;
mod clock;
mod ethernet;
pub mod gpio;
mod inputs;
mod log;
mod registers;
mod saved;
mod steps;
mod timer;
mod uart;
mod watchdog;
pub mod wires;

use core::panic::PanicInfo;

use cortex_m::peripheral::{NVIC, SCB};
use cortex_m::{Peripherals, asm};
use cortex_m_rt::{ExceptionFrame, exception};
use drivetwin_board::{AxisPins, End, Hands, is_full_duplex, made};
use drivetwin_firmware::device::{Boot, Device, Instant, Spec};
use drivetwin_firmware::motion::Follower;
use drivetwin_firmware::shell::{Links, NoLinks, Shell};
use lm3s6965::Interrupt;

use self::bus::Sender;
use self::caught::Ears;
use self::gpio::{Gpio, Output};
use self::saved::Memory;
pub use self::saved::Saved;
use self::steps::Steps;
use self::wires::Wire;

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

/// A drive on this board.
type Board<'a, D, const MEMORY: usize, const CHARACTERS: usize, const WIRES: usize, L> =
    Shell<&'a mut D, Ears, Hands<Sender, Output, Memory<MEMORY>, Steps, WIRES, L>, CHARACTERS>;

/// Makes a drive and runs it with these saved registers; its pins and faults, by their names, are wired to these pins of
/// the board. `CHARACTERS` is how many characters may wait to be sent.
pub fn run<D: Device, const MEMORY: usize, const CHARACTERS: usize, const WIRES: usize>(
    make: fn() -> D,
    saved: &'static Saved<MEMORY>,
    wires: &[Wire; WIRES],
) -> ! {
    start::<_, _, CHARACTERS, _, _>(&mut made(make), saved, wires, |_| None::<NoLinks>)
}

/// Runs a drive as [`run`] does, one whose ports are TCP ports: 502 is Modbus, 503 is MCode, at 192.168.33.1.
pub fn run_on_network<D: Device, const MEMORY: usize, const WIRES: usize>(
    make: fn() -> D,
    saved: &'static Saved<MEMORY>,
    wires: &[Wire; WIRES],
) -> ! {
    start::<_, _, 0, _, _>(&mut made(make), saved, wires, ethernet::start)
}

/// Runs the drive, which was made before there is all that this needs of the stack.
#[inline(never)]
fn start<D: Device, const MEMORY: usize, const CHARACTERS: usize, const WIRES: usize, L: Links>(
    drive: &mut D,
    saved: &'static Saved<MEMORY>,
    wires: &[Wire; WIRES],
    network: impl FnOnce(&Spec) -> Option<L>,
) -> ! {
    let mut core = Peripherals::take();
    if let Some(core) = &mut core {
        clock::start(&mut core.SYST);
    }
    watchdog::start();
    let links = network(drive.spec());
    let mut shell: Board<'_, D, MEMORY, CHARACTERS, WIRES, L> = assemble(drive, saved.begin(), wires, links);
    FAST.pulled(true);
    // Time for the pull-ups: 20 µs.
    asm::delay(1_000);
    let boot = Boot { fast: !FAST.is_high(), ..Boot::default() };
    inputs::begin();
    // Not before: the stack is nowhere as deep as while the drive is put on the board, and what the inputs are goes
    // before all that interrupts catch.
    if let Some(core) = &mut core {
        unmask(&mut core.NVIC);
    }
    shell.power_on(Instant::ZERO, boot);
    log::power(shell.device().spec().kind);
    loop {
        watchdog::feed();
        if shell.turn().is_err() {
            clock::sleep_until(shell.deadline().min(clock::now() + watchdog::NAP));
        }
    }
}

/// Puts the drive on the board. What that needs of the stack is free again when it returns.
#[inline(never)]
fn assemble<'a, D: Device, const MEMORY: usize, const CHARACTERS: usize, const WIRES: usize, L: Links>(
    drive: &'a mut D,
    memory: Memory<MEMORY>,
    wires: &[Wire; WIRES],
    links: Option<L>,
) -> Board<'a, D, MEMORY, CHARACTERS, WIRES, L> {
    let spec = drive.spec();
    bus::start(is_full_duplex(spec));
    let pins = wires.map(|(name, gpio)| wire(spec, name, gpio));
    let axis_pins = AxisPins::of(spec, pins.iter().map(|(end, _)| *end));
    if axis_pins == AxisPins::Own {
        steps::start();
    }
    let axis = &steps::AXIS;
    let hands = Hands { bus: Sender, pins, memory, axis, axis_pins, follower: Follower::new(), links };
    Shell::new(drive, Ears, hands)
}

/// Lets interrupts come.
fn unmask(nvic: &mut NVIC) {
    /// The hardware has the upper three bits.
    const BELOW: u8 = 1 << 5;
    for interrupt in LESS_URGENT {
        // SAFETY: critical sections are made by PRIMASK, whatever the priorities.
        unsafe { nvic.set_priority(interrupt, BELOW) };
        // SAFETY: no critical section relies on an interrupt's mask.
        unsafe { NVIC::unmask(interrupt) };
    }
    // SAFETY: as above.
    unsafe { NVIC::unmask(Interrupt::TIMER_1A) };
}

/// Makes a pin of the board what the drive calls `name`.
fn wire(spec: &Spec, name: &str, gpio: Gpio) -> (Option<End>, Output) {
    let end = End::of(spec, name);
    let input = end.filter(|end| end.is_input(spec));
    let rests_high = input.map(|end| end.rests_high(spec));
    if let Some(end) = end {
        if let Some(rests_high) = rests_high {
            gpio.resting(rests_high);
            inputs::add(gpio, end, rests_high);
        } else if end.is_open_drain(spec) {
            gpio.open_drain();
        } else {
            gpio.push_pull();
        }
    }
    (end, Output::new(gpio, rests_high))
}

/// Nothing can be right after that: the board starts again.
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
