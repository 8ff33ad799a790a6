//! The LS7366R without a drive: each of its methods, and its SPI.
#![no_std]
#![no_main]

use drivetwin_firmware::counter::{Channel, Ls7366r, Transmission};
use drivetwin_firmware::device::Instant;
use panic_free::{opaque, perhaps_panic};

/// Entry point for the linker.
#[unsafe(no_mangle)]
extern "C" fn start() -> ! {
    let mut counter = Ls7366r::new(opaque(false), opaque(false), opaque(false));
    loop {
        let counter = opaque(&mut counter);
        let at: Instant = opaque(Instant::ZERO);
        counter.edge(at, opaque(Channel::A), opaque(false));
        counter.take_steps(opaque(0), opaque(false), opaque(false));
        counter.timeout(at);
        counter.set_mdr0(opaque(0));
        counter.set_mdr1(opaque(0));
        counter.set_dtr(opaque(0));
        counter.set_reversed(opaque(false));
        counter.set_enabled(opaque(false));
        counter.load_cntr();
        counter.load_otr();
        counter.clear_cntr();
        counter.clear_status();
        opaque((counter.deadline(), counter.take_events(), counter.at_index(), counter.lflag()));
        opaque((counter.mdr0(), counter.mdr1(), counter.dtr(), counter.cntr()));
        opaque((counter.otr(), counter.status()));
        let mut transmission = opaque(Transmission::new(counter));
        opaque(transmission.exchange(opaque(0)));
        opaque(transmission.exchange(opaque(0)));
        perhaps_panic(opaque(&[]), opaque(0));
    }
}
