//! An RS 434544 of 20 A on the LM3S6965 board.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::rs434::{MEMORY, rs434544};
use drivetwin_firmware::shell::ONE_ANSWER;
use drivetwin_lm3s6965::{Saved, run, wires};

#[unsafe(export_name = "SAVED")]
#[unsafe(link_section = ".uninit.SAVED")]
static SAVED: Saved<MEMORY> = Saved::new();

#[entry]
fn main() -> ! {
    run::<_, _, ONE_ANSWER, _>(rs434544, &SAVED, &wires::RS434)
}
