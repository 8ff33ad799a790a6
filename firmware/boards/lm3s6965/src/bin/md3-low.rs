//! An MD3 of the low current version on the LM3S6965 board.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use standin_firmware::md3::{MEMORY, Md3};
use standin_lm3s6965::gpio::{A, B, C, D, F, G, Gpio};
use standin_lm3s6965::{Saved, run};

const WIRES: [(&str, Gpio); 13] = [
    ("J2.2", D.pin(4)),
    ("J2.3", D.pin(5)),
    ("J2.4", D.pin(6)),
    ("J2.5", D.pin(7)),
    ("J2.9", C.pin(4)),
    ("J2.10", C.pin(5)),
    ("J2.12", C.pin(6)),
    ("J3.7", B.pin(1)),
    ("J3.8", B.pin(2)),
    ("D5", B.pin(0)),
    ("D6", F.pin(0)),
    ("over_temperature", A.pin(7)),
    ("over_current", G.pin(0)),
];

#[unsafe(export_name = "SAVED")]
#[unsafe(link_section = ".uninit.SAVED")]
static SAVED: Saved<MEMORY> = Saved::new();

#[entry]
fn main() -> ! {
    run(Md3::low, &SAVED, &WIRES)
}
