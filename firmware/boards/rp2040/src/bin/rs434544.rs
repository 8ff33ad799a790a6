//! An RS 434544 of 20 A on the Pico.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::rs434::{MEMORY, rs434544};
use drivetwin_firmware::shell::ONE_ANSWER;
use drivetwin_rp2040::{run, wires};

#[entry]
fn main() -> ! {
    run::<_, MEMORY, ONE_ANSWER, _>(rs434544, &wires::RS434)
}
