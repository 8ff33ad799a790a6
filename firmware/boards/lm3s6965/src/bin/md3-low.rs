//! An MD3 of the low current version on the LM3S6965 board.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::md3::{MEMORY, Md3};
use drivetwin_firmware::shell::ONE_ANSWER;
use drivetwin_lm3s6965::{Saved, run, wires};

#[unsafe(export_name = "SAVED")]
#[unsafe(link_section = ".uninit.SAVED")]
static SAVED: Saved<MEMORY> = Saved::new();

#[entry]
fn main() -> ! {
    run::<_, _, ONE_ANSWER, _>(Md3::low, &SAVED, &wires::MD3)
}
