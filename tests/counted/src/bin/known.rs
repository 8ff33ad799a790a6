//! Interrupt handlers whose numbers of instructions are known. The plugin must count exactly these.
//!
//! PendSV has the lowest priority and takes 16 instructions, including the function that it calls. In the
//! middle SVCall interrupts it and takes 4. Each handler runs twice.
#![no_std]
#![no_main]

use core::arch::{asm, global_asm};

use cortex_m::Peripherals;
use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m_rt::entry;
use counted::done;

global_asm!(
    ".syntax unified",
    ".global PendSV",
    ".thumb_func",
    "PendSV:",
    "    push {{r4, lr}}", // 1
    "    movs r4, #2",     // 2
    "2:  bl 3f",           // 3, 8
    "    subs r4, #1",     // 6, 11
    "    bne 2b",          // 7, 12
    "    svc 0",           // 13
    "    nop",             // 14
    "    nop",             // 15
    "    pop {{r4, pc}}",  // 16
    ".thumb_func",
    "3:  nop",   // 4, 9
    "    bx lr", // 5, 10
    ".global SVCall",
    ".thumb_func",
    "SVCall:",
    "    push {{lr}}", // 1
    "    nop",         // 2
    "    nop",         // 3
    "    pop {{pc}}",  // 4
);

#[entry]
fn main() -> ! {
    if let Some(mut core) = Peripherals::take() {
        // SAFETY: no critical section of this program relies on priorities.
        unsafe { core.SCB.set_priority(SystemHandler::PendSV, 0xFF) };
    }
    for _ in 0..2 {
        SCB::set_pendsv();
        // SAFETY: the instructions only wait until the interrupt has been handled.
        unsafe { asm!("dsb", "isb") };
    }
    done()
}
