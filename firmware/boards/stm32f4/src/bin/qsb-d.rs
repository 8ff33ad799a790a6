//! A QSB-D, for a differential encoder, on the STM32F411.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::qsb::{MEMORY, Qsb};
use drivetwin_firmware::shell::ANSWERS;
use drivetwin_stm32f4::{run, wires};

#[entry]
fn main() -> ! {
    run::<_, MEMORY, ANSWERS, _>(Qsb::d, &wires::QSB)
}
