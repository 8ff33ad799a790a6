//! A QSB-S, for a single-ended encoder, on the LM3S6965 board.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use standin_firmware::qsb::{MEMORY, Qsb};
use standin_firmware::shell::ANSWERS;
use standin_lm3s6965::{Saved, run, wires};

#[unsafe(export_name = "SAVED")]
#[unsafe(link_section = ".uninit.SAVED")]
static SAVED: Saved<MEMORY> = Saved::new();

#[entry]
fn main() -> ! {
    run::<_, _, ANSWERS, _>(Qsb::s, &SAVED, &wires::QSB)
}
