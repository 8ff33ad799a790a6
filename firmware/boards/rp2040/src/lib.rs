//! Drives on the Raspberry Pi Pico.
//!
//! Each binary is one kind of drive: it says which pin of the board is which of the drive, and has
//! [`run`] make it. What all have in common is here.
//!
//! README.md shows how it is wired. Sections beside the code are those of the *RP2040 Datasheet*; those of
//! the flash chip are in *W25Q16JV*.
//!
//! | module | what it holds |
//! |---|---|
//! | [`wires`] | which pins are what |
//! | `boot` | from the reset to a program in RAM |
//! | [`run`] | the loop |
//! | `clock` | the system clock |
//! | `timer` | time, alarms, sleep |
//! | `caught` | what interrupts have for the loop |
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
mod caught;
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

use cortex_m::Peripherals;
use cortex_m::peripheral::NVIC;
use cortex_m_rt::exception;
use drivetwin_board::{AxisPins, Hands, Saved, is_full_duplex, made};
use drivetwin_firmware::device::{Boot, Device, Instant};
use drivetwin_firmware::motion::Follower;
use drivetwin_firmware::shell::Shell;
use rp2040_pac::Interrupt;

pub use self::pins::Wire;

use self::bus::Sender;
use self::caught::Ears;
use self::flash::{Flash, MOST_SECTORS};
use self::pins::Pin;
use self::steps::Steps;

/// The saved registers of a drive on this board.
type Memory<'a> = Saved<'a, Flash, MOST_SECTORS>;

/// A drive on this board.
type Board<'a, D, const CHARACTERS: usize, const WIRES: usize> =
    Shell<&'a mut D, Ears, Hands<Sender, Pin, Memory<'a>, Steps, WIRES>, CHARACTERS>;

/// Makes a drive and runs it; its pins and faults are wired like that. `MEMORY` is how many bytes its spec says that it
/// saves, `CHARACTERS` how many characters may wait to be sent.
pub fn run<D: Device, const MEMORY: usize, const CHARACTERS: usize, const WIRES: usize>(
    make: fn() -> D,
    wires: &[Wire; WIRES],
) -> ! {
    start::<_, CHARACTERS, _>(&mut made(make), &mut [0xFF; MEMORY], wires)
}

/// Runs the drive, which was made before there is all that this needs of the stack.
#[inline(never)]
fn start<D: Device, const CHARACTERS: usize, const WIRES: usize>(
    drive: &mut D,
    memory: &mut [u8],
    wires: &[Wire; WIRES],
) -> ! {
    clock::start();
    timer::start();
    watchdog::start();
    let boot = Boot { fast: pins::is_tied(wires::FAST), ..Boot::default() };
    let saved = Saved::new(Flash, flash::place(memory.len()), drive.spec().kind, memory);
    let mut shell: Board<'_, D, CHARACTERS, WIRES> = assemble(drive, saved, wires);
    shell.power_on(Instant::ZERO, boot);
    log::power(shell.device().spec().kind, boot);
    if let Some(mut core) = Peripherals::take() {
        unmask(&mut core.NVIC);
    }
    loop {
        watchdog::feed();
        caught::look_at_bus();
        if shell.turn().is_err() {
            timer::sleep_until(shell.deadline());
        }
    }
}

/// Puts the drive on the board. What that needs of the stack is free again when it returns.
#[inline(never)]
fn assemble<'a, D: Device, const CHARACTERS: usize, const WIRES: usize>(
    drive: &'a mut D,
    memory: Memory<'a>,
    wires: &[Wire; WIRES],
) -> Board<'a, D, CHARACTERS, WIRES> {
    let spec = drive.spec();
    bus::start(is_full_duplex(spec));
    let pins = pins::start(spec, wires);
    let axis_pins = AxisPins::of(spec, pins.iter().map(|(end, _)| *end));
    if axis_pins == AxisPins::Own {
        steps::start();
    }
    let axis = &steps::AXIS;
    let hands = Hands { bus: Sender, pins, memory, axis, axis_pins, follower: Follower::new(), links: None };
    Shell::new(drive, Ears, hands)
}

/// Lets interrupts come. Nothing delays a step but a critical section. What stamps or sends has one
/// priority, so that stamps ascend. The alarm of the loop only has to end its sleep.
fn unmask(nvic: &mut NVIC) {
    let priorities = [
        (Interrupt::TIMER_IRQ_0, 0x00),
        (Interrupt::UART0_IRQ, 0x40),
        (Interrupt::IO_IRQ_BANK0, 0x40),
        (Interrupt::TIMER_IRQ_2, 0x40),
        (Interrupt::TIMER_IRQ_1, 0xC0),
    ];
    for (interrupt, priority) in priorities {
        // SAFETY: no critical section of this crate relies on priorities.
        unsafe { nvic.set_priority(interrupt, priority) };
        // SAFETY: none relies on the interrupt's mask.
        unsafe { NVIC::unmask(interrupt) };
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
