//! An MDrive Hybrid on the LM3S6965 board.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::mdrive::{MEMORY, Mdrive};
use drivetwin_lm3s6965::{Saved, run_on_network, wires};

#[unsafe(export_name = "SAVED")]
#[unsafe(link_section = ".uninit.SAVED")]
static SAVED: Saved<MEMORY> = Saved::new();

#[entry]
fn main() -> ! {
    run_on_network(Mdrive::hybrid, &SAVED, &wires::MDRIVE)
}
