//! A QSB-S, for a single-ended encoder, on the STM32F411.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use standin_firmware::qsb::{MEMORY, Qsb};
use standin_firmware::shell::ANSWERS;
use standin_stm32f4::{run, wires};

#[entry]
fn main() -> ! {
    let mut drive = Qsb::s();
    run::<_, ANSWERS, _>(&mut drive, &mut [0xFF; MEMORY], &wires::QSB)
}
