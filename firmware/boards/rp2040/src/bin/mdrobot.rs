//! An MD400 of MDROBOT on the Pico.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::mdrobot::{MEMORY, mdrobot};
use drivetwin_firmware::shell::ONE_ANSWER;
use drivetwin_rp2040::{run, wires};

#[entry]
fn main() -> ! {
    run::<_, MEMORY, ONE_ANSWER, _>(mdrobot, &wires::MDROBOT)
}
