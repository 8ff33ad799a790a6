//! An MD3 of 1.8 A on the Pico.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use standin_firmware::md3::Md3;
use standin_rp2040::{md3, run};

#[entry]
fn main() -> ! {
    run::<_, { md3::MEMORY }, _>(Md3::low(), md3::WIRES)
}
