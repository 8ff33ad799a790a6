//! A QSB-D, for a differential encoder, on the LM3S6965 board.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::qsb::{MEMORY, Qsb};
use drivetwin_firmware::shell::ANSWERS;
use drivetwin_lm3s6965::{Saved, run, wires};

#[unsafe(export_name = "SAVED")]
#[unsafe(link_section = ".uninit.SAVED")]
static SAVED: Saved<MEMORY> = Saved::new();

#[entry]
fn main() -> ! {
    run::<_, _, ANSWERS, _>(Qsb::d, &SAVED, &wires::QSB)
}
