//! A plugin of QEMU that counts the instructions of a Cortex-M: exactly, and the same in every run.
//!
//! ```text
//! qemu-system-arm … -d plugin -plugin libinsncount.so,handler=UART0:0x1c5,stack=0x20000000:0x20000c00
//! ```
//!
//! | argument | counts |
//! |---|---|
//! | `handler=name:entry` | calls of an interrupt's handler, and the most instructions from its first to its return. A handler that interrupts another is not part of it |
//! | `stack=bottom:top` | how deep the stack was written |
//!
//! A program can mark the code to count, by instructions that do nothing otherwise:
//! `mov r9, r9` begins a group; what runs between `mov r10, r10` and `mov r11, r11` is a part of it.
//!
//! When QEMU ends, every result is a line in its log:
//!
//! ```text
//! group parts 1000 instructions 76700 most 196
//! handler UART0 calls 8 most 142
//! stack 812
//! ```
//!
//! These are instructions, not cycles. One that its condition skips counts, because it takes its cycle.

mod counter;
pub mod qemu;
mod thumb;

use std::sync::{Mutex, MutexGuard, PoisonError};

use counter::Counter;
use qemu::Block;
use thumb::Instruction;

/// QEMU's callbacks come with a number each, so what they are about is here.
static PLUGIN: Mutex<Plugin> = Mutex::new(Plugin { counter: Counter::new(), seen: Vec::new() });

struct Plugin {
    counter: Counter,
    /// Every instruction that QEMU has translated.
    seen: Vec<Instruction>,
}

fn plugin() -> MutexGuard<'static, Plugin> {
    PLUGIN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Takes an argument of the command line.
fn configure(argument: &str) -> Result<(), String> {
    let wrong = || format!("`{argument}` is neither handler=name:entry nor stack=bottom:top");
    let (key, value) = argument.split_once('=').ok_or_else(wrong)?;
    let (first, second) = value.split_once(':').ok_or_else(wrong)?;
    let second = number(second).ok_or_else(wrong)?;
    match key {
        // Bit 0 of a function's address marks Thumb code.
        "handler" => plugin().counter.add_handler(first, second & !1),
        "stack" => plugin().counter.watch_stack(number(first).ok_or_else(wrong)?..second),
        _ => return Err(wrong()),
    }
    Ok(())
}

/// A hexadecimal number.
fn number(text: &str) -> Option<u32> {
    u32::from_str_radix(text.strip_prefix("0x")?, 16).ok()
}

/// QEMU has translated a block of instructions.
fn translated(block: &Block) {
    let mut plugin = plugin();
    for instruction in block.instructions() {
        let place = plugin.seen.len();
        plugin.seen.push(instruction.decode());
        instruction.tell_executed(place);
        instruction.tell_stored();
    }
}

/// The instruction at this place is about to be executed.
fn executed(place: usize) {
    let Plugin { counter, seen } = &mut *plugin();
    if let Some(instruction) = seen.get(place) {
        counter.executed(instruction);
    }
}

/// An instruction writes to this address.
fn stored(address: u32) {
    plugin().counter.stored(address);
}

/// Report when QEMU ends.
fn report() -> String {
    plugin().counter.to_string()
}
