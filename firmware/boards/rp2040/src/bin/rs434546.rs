//! An RS 434546 of 40 A on the Pico.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::rs434::{MEMORY, rs434546};
use drivetwin_firmware::shell::ONE_ANSWER;
use drivetwin_rp2040::{run, wires};

#[entry]
fn main() -> ! {
    run::<_, MEMORY, ONE_ANSWER, _>(rs434546, &wires::RS434)
}
