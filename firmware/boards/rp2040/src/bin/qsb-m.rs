//! A QSB-M, with the motor drive, on the Pico.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::qsb::{MEMORY, Qsb};
use drivetwin_firmware::shell::ANSWERS;
use drivetwin_rp2040::{run, wires};

#[entry]
fn main() -> ! {
    run::<_, MEMORY, ANSWERS, _>(Qsb::m, &wires::QSB)
}
