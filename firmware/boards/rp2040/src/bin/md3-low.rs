//! An MD3 of 1.8 A on the Pico.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::md3::{MEMORY, Md3};
use drivetwin_firmware::shell::ONE_ANSWER;
use drivetwin_rp2040::{run, wires};

#[entry]
fn main() -> ! {
    run::<_, MEMORY, ONE_ANSWER, _>(Md3::low, &wires::MD3)
}
