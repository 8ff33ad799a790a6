//! Plans and the step iterator: the plan that a drive passes to a board, and the steps that a timer interrupt
//! makes of it.
#![no_std]
#![no_main]

use drivetwin_firmware::device::{Instant, Plan};
use drivetwin_firmware::motion::{Limits, StepIterator};
use panic_free::{opaque, perhaps_panic};

/// Entry point for the linker.
#[unsafe(no_mangle)]
extern "C" fn start() -> ! {
    loop {
        let at: Instant = opaque(Instant::ZERO);
        let [start, speed] = opaque([Default::default(); 2]);
        let rates =
            Limits { start_speed: start, max_speed: speed, acceleration: opaque(0), deceleration: opaque(0) };
        let plan = opaque(Plan::profile(at, opaque(0), opaque(0), rates));
        let plan = opaque(plan.ramp_to(at, opaque(Default::default()), opaque(0)));
        let plan = opaque(plan.continued_from(at, opaque(0)));
        opaque((plan.start(), plan.end(), plan.segments(), plan.position_at(at), plan.speed_at(at)));
        let mut walker = opaque(StepIterator::new(&plan, at));
        while let Some(step) = walker.next() {
            opaque((step, &mut walker));
        }
        opaque((plan.halt(at), Plan::at_rest(at, opaque(0))));
        perhaps_panic(opaque(&[]), opaque(0));
    }
}
