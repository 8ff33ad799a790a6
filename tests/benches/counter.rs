//! Edges per second that an LS7366R counts through its public `edge`, in every mode.
//!
//! The time is the shortest of many runs. valgrind counts the instructions.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;

use std::hint::black_box;

use drivetwin_firmware::counter::Channel::{A, B};
use drivetwin_firmware::counter::Ls7366r;
use drivetwin_firmware::device::{Duration, Instant};

use support::{line, took};

/// Value of DTR, at which the counts of range-limit and modulo-n end.
const DTR: u32 = 999;
/// Time between two edges: the shortest that passes the slower of the two filters.
const GAP: Duration = Duration::from_ticks(3);
/// Number of edges in a run: whole cycles, enough to reach DTR, but so few that other load on the machine
/// disturbs only some of the runs.
const EDGES: u64 = 20_000;

/// A mode, and its number of counts for 1,000 edges.
struct Mode {
    name: &'static str,
    mdr0: u8,
    counts: u64,
}

const MODES: [Mode; 9] = [
    Mode { name: "x1", mdr0: 0x01, counts: 250 },
    Mode { name: "x2", mdr0: 0x02, counts: 500 },
    Mode { name: "x4", mdr0: 0x03, counts: 1_000 },
    Mode { name: "x4, slow filter", mdr0: 0x83, counts: 1_000 },
    Mode { name: "x4, single-cycle", mdr0: 0x07, counts: 1_000 },
    Mode { name: "x4, range-limit", mdr0: 0x0B, counts: 0 },
    Mode { name: "x4, modulo-n", mdr0: 0x0F, counts: 0 },
    Mode { name: "x4, index held low", mdr0: 0x43, counts: 1_000 },
    Mode { name: "non-quadrature", mdr0: 0x00, counts: 500 },
];

/// Counts `edges` edges upwards.
fn run(mode: &Mode, edges: u64) {
    // INDEX/ is low, but acts only in modes in which it is synchronous.
    let mut counter = Ls7366r::new(false, true, mode.mdr0 & 0x40 == 0);
    let quadrature = mode.mdr0 & 3 != 0;
    counter.set_mdr0(mode.mdr0);
    counter.set_dtr(DTR);
    let cycle = if quadrature {
        [(B, false), (A, true), (B, true), (A, false)]
    } else {
        [(A, true), (A, false), (A, true), (A, false)]
    };
    let cycle = black_box(cycle);
    let mut at = black_box(Instant::ZERO);
    for _ in 0..edges / 4 {
        for (channel, high) in cycle {
            at += GAP;
            counter.edge(at, channel, high);
        }
    }
    counter.timeout(at + GAP);
    let expected = match mode.mdr0 & 0x0C {
        // A thousand counts lead from 0 back to 0.
        0x0C => 0,
        0x08 => u64::from(DTR),
        _ => mode.counts * edges / 1_000,
    };
    assert_eq!(u64::from(black_box(counter).cntr()), expected, "{}", mode.name);
}

fn main() {
    if let Some((name, edges)) = count::wanted() {
        let mode = MODES.iter().find(|mode| mode.name == name).expect("a mode of this benchmark");
        run(mode, edges);
        return;
    }
    println!("one edge");
    let mut all_counted = true;
    for mode in &MODES {
        let least = (0..2_000).map(|_| took(|| run(mode, EDGES))).min().unwrap_or_default();
        let ns = least.as_nanos() as f64 / EDGES as f64;
        let instructions = count::instructions(mode.name, 4_000, 104_000);
        all_counted &= instructions.is_some();
        let million = 1_000.0 / ns;
        line(mode.name, &format!("{million:.0} million/s, {ns:.1} ns, {}", count::counted(instructions)));
    }
    count::warn_unless(all_counted);
}
