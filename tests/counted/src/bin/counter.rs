//! Counts the instructions that the LS7366R takes for an edge, and for 1,000 steps in one call.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use counted::{count, done, group, opaque};
use drivetwin_firmware::counter::Channel::{self, A, B};
use drivetwin_firmware::counter::Ls7366r;
use drivetwin_firmware::device::{Duration, Instant};

/// Time between two edges: the shortest that passes the filter.
const GAP: Duration = Duration::from_ticks(2);

/// MDR0: x4 and modulo-n, x4 and free-running, non-quadrature.
const X4_MODULO_N: u8 = 0x0F;
const X4: u8 = 0x03;
const NON_QUADRATURE: u8 = 0x00;

#[entry]
fn main() -> ! {
    let quadrature = [(A, true), (B, true), (A, false), (B, false)];
    group(c"counter: edge in x4");
    edges(counter(X4), quadrature);
    group(c"counter: edge in x4 and modulo-n");
    edges(counter(X4_MODULO_N), quadrature);
    group(c"counter: edge without quadrature");
    edges(counter(NON_QUADRATURE), [(B, true), (A, true), (B, false), (A, false)]);
    group(c"counter: 1,000 steps at once in x4");
    thousand_steps(counter(X4));
    group(c"counter: 1,000 steps at once in x4 and modulo-n");
    thousand_steps(counter(X4_MODULO_N));
    done()
}

fn counter(mdr0: u8) -> Ls7366r {
    let mut counter = Ls7366r::new(false, false, true);
    counter.set_mdr0(opaque(mdr0));
    counter.set_dtr(opaque(99));
    opaque(counter)
}

fn edges(mut counter: Ls7366r, cycle: [(Channel, bool); 4]) {
    let mut at = Instant::ZERO;
    for _ in 0..250 {
        for (channel, high) in opaque(cycle) {
            at += GAP;
            count(|| edge(&mut counter, at, channel, high));
        }
    }
    opaque(&counter);
}

fn thousand_steps(mut counter: Ls7366r) {
    count(|| steps(&mut counter, opaque(1_000)));
    opaque(&counter);
}

/// Not inlined, because a drive calls the counter through a function, too.
#[inline(never)]
fn edge(counter: &mut Ls7366r, at: Instant, channel: Channel, high: bool) {
    counter.edge(at, channel, high);
}

#[inline(never)]
fn steps(counter: &mut Ls7366r, steps: i32) {
    counter.take_steps(steps, false, false);
}
