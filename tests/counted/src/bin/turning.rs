//! Counts the instructions of one millisecond of a drive on a board while its motor turns: the control ticks
//! of the servo and the model of the motor.
#![no_std]
#![no_main]

use core::ffi::CStr;

use cortex_m_rt::entry;
use counted::{count, done, group};
use drivetwin_firmware::device::{Axis, Boot, Context, Device, Duration, Instant, Output, advance};
use drivetwin_firmware::mdrobot::{Mdrobot, Pid};
use drivetwin_firmware::rs434::{Reg, Rs434};

/// Time that the motor turns before the measurement, and time of the measurement, in ms.
const SPEEDS_UP: u32 = 1_000;
const LOOKED_AT: u32 = 100;

#[entry]
fn main() -> ! {
    // The drive turns at its factory setting, 1,000 rpm.
    turn(c"rs434544: ms of turning", Rs434::rs434544(), &[(Reg::START_bit as usize, 1)]);
    let orders = [(Pid::UI_COM as usize, 1), (Pid::START_STOP as usize, 1), (Pid::VEL_CMD as usize, 1_000)];
    turn(c"mdrobot: ms of turning", Mdrobot::md400(), &orders);
    done()
}

/// Writes `orders` to the drive's registers and counts while the motor turns. Not inlined, because RAM has
/// room for one drive.
#[inline(never)]
fn turn(name: &CStr, mut drive: impl Device, orders: &[(usize, i64)]) {
    let out = &mut Hands;
    let mut now = Instant::ZERO;
    drive.power_on(now, Boot { seed: 1, fast: true, ..Boot::default() }, out);
    pass(&mut drive, &mut now, out);
    for &(row, value) in orders {
        assert!(drive.poke(now, row, value, out).is_ok());
    }
    for _ in 0..SPEEDS_UP {
        pass(&mut drive, &mut now, out);
    }
    group(name);
    for _ in 0..LOOKED_AT {
        count(|| pass(&mut drive, &mut now, out));
    }
    assert!(drive.shaft(now, Axis(0)).is_some_and(|shaft| shaft.speed > 100), "it turns");
}

/// Advances the drive by 1 ms.
#[inline(never)]
fn pass(drive: &mut impl Device, now: &mut Instant, out: &mut Hands) {
    *now += Duration::millis(1);
    advance(drive, *now, core::iter::empty(), out);
}

/// A board that ignores all outputs.
struct Hands;

impl Context for Hands {
    fn put(&mut self, _at: Instant, _output: Output<'_>) {}

    fn memory(&self) -> &[u8] {
        static NEW: [u8; 8 << 10] = [0xFF; _];
        &NEW
    }
}
