//! A QEMU plugin that counts the instructions of a Cortex-M. Its counts are exact, and the same in every run.
//!
//! ```text
//! qemu-system-arm … -d plugin -plugin libinsncount.so,handler=UART0:0x1c5,stack=0x20000000:0x20000c00
//! ```
//!
//! | argument | counts |
//! |---|---|
//! | `handler=name:entry` | calls of an interrupt handler, and the most instructions from its first one to its return, without those of handlers that interrupt it |
//! | `stack=bottom:top` | how deep the stack was written |
//!
//! A program can mark the code to count, with instructions that have no other effect: `mov r9, r9` begins a
//! group, and the code between `mov r10, r10` and `mov r11, r11` is one part of the group.
//!
//! When QEMU ends, the plugin writes each result as a text line to QEMU's log:
//!
//! ```text
//! group parts 1000 instructions 76700 most 196
//! handler UART0 calls 8 most 142
//! stack 812
//! ```
//!
//! The counts are instructions, not cycles. An instruction that its condition skips counts, because it takes
//! a cycle.

mod counter;
pub mod qemu;
mod thumb;

use std::sync::{Mutex, MutexGuard, PoisonError};

use counter::Counter;
use qemu::Block;
use thumb::Instruction;

/// State of the plugin. It is global, because a callback of QEMU carries only a number.
static PLUGIN: Mutex<Plugin> = Mutex::new(Plugin { counter: Counter::new(), seen: Vec::new() });

struct Plugin {
    counter: Counter,
    /// Every instruction that QEMU has translated.
    seen: Vec<Instruction>,
}

fn plugin() -> MutexGuard<'static, Plugin> {
    PLUGIN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Handles an argument of the command line.
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

/// Handles a block of instructions that QEMU has translated.
fn translated(block: &Block) {
    let mut plugin = plugin();
    for instruction in block.instructions() {
        let place = plugin.seen.len();
        plugin.seen.push(instruction.decode());
        instruction.tell_executed(place);
        instruction.tell_stored();
    }
}

/// Handles the execution of an instruction. `place` is its index in `seen`.
fn executed(place: usize) {
    let Plugin { counter, seen } = &mut *plugin();
    if let Some(instruction) = seen.get(place) {
        counter.executed(instruction);
    }
}

/// Handles a write to `address`.
fn stored(address: u32) {
    plugin().counter.stored(address);
}

/// The report for QEMU's log.
fn report() -> String {
    plugin().counter.to_string()
}
