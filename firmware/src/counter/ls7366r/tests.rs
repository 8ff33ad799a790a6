//! Tests of the figures and tables of the data sheet.

mod model;

use std::format;
use std::vec::Vec;

use proptest::prelude::*;

use super::super::Channel::{self, A, B, Index};
use super::status::{BW, CEN, CMP, CY, IDX, PLS, S, UP};
use super::{Instant, Ls7366r};

/// Fields of MDR0, typed here again from its table.
const NON_QUADRATURE: u8 = 0b00;
const X1: u8 = 0b01;
const X2: u8 = 0b10;
const X4: u8 = 0b11;
const SINGLE_CYCLE: u8 = 0b01 << 2;
const RANGE_LIMIT: u8 = 0b10 << 2;
const MODULO_N: u8 = 0b11 << 2;
const LOAD_CNTR: u8 = 0b01 << 4;
const RESET_CNTR: u8 = 0b10 << 4;
const LOAD_OTR: u8 = 0b11 << 4;
const SYNCHRONOUS: u8 = 1 << 6;
const HALF_CLOCK: u8 = 1 << 7;

/// Fields of MDR1.
const BYTES_3: u8 = 0b01;
const BYTES_2: u8 = 0b10;
const BYTES_1: u8 = 0b11;
const DISABLE: u8 = 1 << 2;

/// Levels of A and B in successive quarter cycles while A leads B.
const CYCLE: [(bool, bool); 4] = [(false, false), (true, false), (true, true), (false, true)];

fn tick(ticks: u64) -> Instant {
    Instant::from_ticks(ticks)
}

/// A counter that is turned by a shaft. The time between two edges is long enough for every filter.
#[derive(Clone)]
struct Shaft {
    counter: Ls7366r,
    now: u64,
    /// Quarter cycles since the start, signed.
    quarter: i32,
}

impl Shaft {
    /// A shaft with A and B low and INDEX/ high.
    fn new(mdr0: u8, mdr1: u8, dtr: u32) -> Self {
        let mut counter = Ls7366r::new(false, false, true);
        counter.set_mdr0(mdr0);
        counter.set_mdr1(mdr1);
        counter.set_dtr(dtr);
        counter.clear_status();
        Self { counter, now: 0, quarter: 0 }
    }

    fn at(mut self, count: u32) -> Self {
        let dtr = self.counter.dtr();
        self.counter.set_dtr(count);
        self.counter.load_cntr();
        self.counter.set_dtr(dtr);
        self
    }

    fn edge(&mut self, channel: Channel, high: bool) {
        self.now += 4;
        self.counter.edge(tick(self.now), channel, high);
        self.now += 4;
        self.counter.timeout(tick(self.now));
    }

    fn turn(&mut self, quarters: i32) {
        for _ in 0..quarters.unsigned_abs() {
            let (a, _) = self.levels();
            self.quarter += quarters.signum();
            let (next_a, next_b) = self.levels();
            if a == next_a { self.edge(B, next_b) } else { self.edge(A, next_a) }
        }
    }

    fn levels(&self) -> (bool, bool) {
        CYCLE[self.quarter.rem_euclid(4) as usize]
    }

    /// Makes a rising and a falling edge of A, with B at the level `up`.
    fn clock(&mut self, up: bool) {
        self.edge(B, up);
        self.edge(A, true);
        self.edge(A, false);
    }

    fn index_pulse(&mut self) {
        self.edge(Index, false);
        self.edge(Index, true);
    }

    fn seen(&mut self) -> (u32, u8) {
        (self.counter.cntr(), self.counter.take_events())
    }

    /// CNTR and the events after each of `quarters` quarter cycles.
    fn turns(&mut self, quarters: i32) -> Vec<(u32, u8)> {
        let turn = |_| {
            self.turn(quarters.signum());
            self.seen()
        };
        (0..quarters.unsigned_abs()).map(turn).collect()
    }

    /// CNTR and the events after each of `clocks` clocks in non-quadrature mode.
    fn clocks(&mut self, clocks: u32, up: bool) -> Vec<(u32, u8)> {
        let clock = |_| {
            self.clock(up);
            self.seen()
        };
        (0..clocks).map(clock).collect()
    }

    fn has(&self, status: u8) -> bool {
        self.counter.status() & status == status
    }
}

fn counts(seen: &[(u32, u8)]) -> Vec<u32> {
    seen.iter().map(|(count, _)| *count).collect()
}

#[test]
fn power_up() {
    let counter = Ls7366r::new(false, false, true);
    assert_eq!([counter.mdr0(), counter.mdr1()], [0, 0]);
    assert_eq!([counter.dtr(), counter.cntr(), counter.otr(), counter.at_index()], [0; 4]);
    assert_eq!(counter.status(), PLS | CEN);
    assert!(!counter.lflag());
    // B is the direction input in the non-quadrature mode of MDR0 = 0.
    assert_eq!(Ls7366r::new(true, true, true).status(), PLS | CEN | UP);
}

#[test]
fn figure_7_quadrature_clocks() {
    let mut x4 = Shaft::new(X4, 0, 99);
    assert_eq!(counts(&x4.turns(8)), [1, 2, 3, 4, 5, 6, 7, 8]);
    assert!(x4.has(UP));
    assert_eq!(counts(&x4.turns(-8)), [7, 6, 5, 4, 3, 2, 1, 0]);
    assert!(!x4.has(UP));
    let mut x2 = Shaft::new(X2, 0, 99);
    assert_eq!(counts(&x2.turns(8)), [1, 1, 2, 2, 3, 3, 4, 4]);
    assert_eq!(counts(&x2.turns(-8)), [4, 3, 3, 2, 2, 1, 1, 0]);
    let mut x1 = Shaft::new(X1, 0, 99);
    assert_eq!(counts(&x1.turns(8)), [1, 1, 1, 1, 2, 2, 2, 2]);
    assert_eq!(counts(&x1.turns(-8)), [2, 2, 2, 1, 1, 1, 1, 0]);
}

#[test]
fn to_and_fro_at_one_edge_no_mode_gains_a_count() {
    for mode in [X1, X2, X4] {
        for start in 0..4 {
            for to_and_fro in [1, -1] {
                let mut shaft = Shaft::new(mode, 0, 99).at(50);
                shaft.turn(start);
                let before = shaft.counter.cntr();
                shaft.turn(to_and_fro);
                shaft.turn(-to_and_fro);
                assert_eq!(shaft.counter.cntr(), before, "{mode} {start} {to_and_fro}");
            }
        }
    }
}

#[test]
fn an_edge_that_does_not_count_tells_the_direction() {
    let mut shaft = Shaft::new(X1, DISABLE, 0);
    for (quarters, up) in [(1, true), (1, true), (-1, false), (1, true), (1, true), (1, true), (-1, false)] {
        shaft.turn(quarters);
        assert_eq!((shaft.has(UP), shaft.counter.cntr()), (up, 0));
    }
}

#[test]
fn figure_6_count_and_direction() {
    let mut shaft = Shaft::new(NON_QUADRATURE, 0, 99).at(50);
    let mut seen = |channel, high| {
        shaft.edge(channel, high);
        (shaft.counter.cntr(), shaft.has(UP))
    };
    assert_eq!(seen(A, true), (49, false));
    assert_eq!(seen(A, false), (49, false));
    assert_eq!(seen(A, true), (48, false));
    assert_eq!(seen(B, true), (48, true));
    assert_eq!(seen(A, false), (48, true));
    assert_eq!(seen(A, true), (49, true));
    assert_eq!(seen(B, false), (49, false));
    assert_eq!(seen(A, false), (49, false));
    shaft.counter.set_enabled(false);
    assert!(!shaft.has(CEN));
    shaft.clock(true);
    assert_eq!(shaft.counter.cntr(), 49);
    shaft.counter.set_enabled(true);
    assert!(shaft.has(CEN));
    shaft.clock(true);
    assert_eq!(shaft.counter.cntr(), 50);
}

#[test]
fn figure_8_free_running_in_3_bytes() {
    let mut shaft = Shaft::new(X4, BYTES_3, 1).at(0xFF_FFFC);
    let up = [(0xFF_FFFD, 0), (0xFF_FFFE, 0), (0xFF_FFFF, CY), (0, CY), (1, CMP), (2, 0)];
    assert_eq!(shaft.turns(6), up);
    assert!(shaft.has(CY | CMP | UP) && !shaft.has(S));
    let down = [(1, 0), (0, BW), (0xFF_FFFF, BW), (0xFF_FFFE, 0), (0xFF_FFFD, 0)];
    assert_eq!(shaft.turns(-5), down);
    assert!(shaft.has(CY | CMP | BW | S));
}

#[test]
fn figure_9_single_cycle_stops_until_it_is_loaded() {
    let mut shaft = Shaft::new(SINGLE_CYCLE | LOAD_CNTR, 0, 2).at(0xFFFF_FFFC);
    let up = [(0xFFFF_FFFD, 0), (0xFFFF_FFFE, 0), (0xFFFF_FFFF, CY), (0, CY), (0, 0), (0, 0)];
    assert_eq!(shaft.clocks(6, true), up);
    assert!(!shaft.has(CEN));
    shaft.counter.clear_status();
    shaft.counter.set_mdr0(SINGLE_CYCLE | LOAD_CNTR);
    assert_eq!(shaft.clocks(1, true), [(0, 0)]);
    shaft.index_pulse();
    assert_eq!(shaft.seen(), (2, IDX));
    assert!(shaft.has(CEN));
    let down = [(1, 0), (0, BW), (0xFFFF_FFFF, BW), (0xFFFF_FFFF, 0), (0xFFFF_FFFF, 0)];
    assert_eq!(shaft.clocks(5, false), down);
    assert!(!shaft.has(CEN));
}

#[test]
fn a_stopped_single_cycle_goes_on_by_reset_load_and_another_mode() {
    let stopped = Shaft::new(X4 | SINGLE_CYCLE, 0, 7);
    let again: [fn(&mut Ls7366r); 3] = [Ls7366r::clear_cntr, Ls7366r::load_cntr, |counter| {
        counter.set_mdr0(X4);
        counter.set_mdr0(X4 | SINGLE_CYCLE);
    }];
    for again in again {
        let mut shaft = stopped.clone();
        shaft.turn(-5);
        assert_eq!((shaft.counter.cntr(), shaft.has(CEN)), (u32::MAX, false));
        again(&mut shaft.counter);
        let before = shaft.counter.cntr();
        assert!(shaft.has(CEN));
        shaft.turn(-1);
        assert_eq!(shaft.counter.cntr(), before.wrapping_sub(1));
    }
    // Clearing the flags does not start the counter again.
    let mut shaft = stopped;
    shaft.turn(-5);
    shaft.counter.clear_status();
    shaft.turn(-5);
    assert_eq!((shaft.counter.cntr(), shaft.has(CEN)), (u32::MAX, false));
}

#[test]
fn figure_10_modulo_n_in_1_byte() {
    let mut shaft = Shaft::new(MODULO_N, BYTES_1, 3);
    let up = [(1, 0), (2, 0), (3, CMP), (0, 0), (1, 0), (2, 0)];
    assert_eq!(shaft.clocks(6, true), up);
    let down = [(1, 0), (0, BW), (3, BW), (2, 0), (1, 0)];
    assert_eq!(shaft.clocks(5, false), down);
}

#[test]
fn figure_11_range_limit_flags_refused_clocks() {
    let mut shaft = Shaft::new(RANGE_LIMIT, BYTES_1, 3);
    let up = [(1, 0), (2, 0), (3, CMP), (3, CMP), (3, CMP)];
    assert_eq!(shaft.clocks(5, true), up);
    assert!(shaft.has(CEN));
    let down = [(2, 0), (1, 0), (0, BW), (0, BW), (0, BW)];
    assert_eq!(shaft.clocks(5, false), down);
    assert_eq!(shaft.clocks(1, true), [(1, 0)]);
}

#[test]
fn a_count_beyond_dtr_goes_on_to_the_end_of_the_counter() {
    for mode in [RANGE_LIMIT, MODULO_N] {
        let mut shaft = Shaft::new(X4 | mode, BYTES_2, 2).at(0xFFFE);
        assert_eq!(shaft.turns(4), [(0xFFFF, 0), (0, 0), (1, 0), (2, CMP)]);
        let mut shaft = Shaft::new(X4 | mode, BYTES_2, 2).at(4);
        assert_eq!(shaft.turns(-4), [(3, 0), (2, 0), (1, 0), (0, BW)]);
    }
}

#[test]
fn with_dtr_0_modulo_n_and_range_limit_stand_still_and_flag() {
    for mode in [RANGE_LIMIT, MODULO_N] {
        let mut shaft = Shaft::new(X4 | mode, 0, 0);
        assert_eq!(shaft.turns(2), [(0, CMP); 2]);
        assert_eq!(shaft.turns(-2), [(0, BW); 2]);
    }
}

#[test]
fn loading_clearing_and_writing_dtr_set_no_flag() {
    let mut shaft = Shaft::new(X4, 0, 0).at(5);
    shaft.counter.set_dtr(5);
    shaft.counter.clear_cntr();
    shaft.counter.load_cntr();
    shaft.counter.load_otr();
    assert_eq!((shaft.seen(), shaft.counter.otr()), ((5, 0), 5));
    assert_eq!(shaft.counter.status(), CEN);
}

#[test]
fn the_sign_goes_with_borrow_and_carry() {
    let mut shaft = Shaft::new(X4, 0, 99);
    shaft.turn(-1);
    assert!(shaft.has(S | BW));
    shaft.counter.clear_cntr();
    shaft.counter.load_cntr();
    shaft.turn(3);
    assert!(shaft.has(S));
    let mut shaft = shaft.at(0xFFFF_FFFE);
    shaft.turn(1);
    assert!(shaft.has(CY | BW) && !shaft.has(S));
    shaft.turn(-8);
    assert!(!shaft.has(S));
    let mut shaft = shaft.at(1);
    shaft.turn(-1);
    assert!(shaft.has(S));
    shaft.counter.clear_status();
    assert_eq!(shaft.counter.status(), CEN);
}

#[test]
fn a_counter_has_as_many_bytes_as_mdr1_says() {
    for (mdr1, top) in [(0, 0xFFFF_FFFF), (BYTES_3, 0xFF_FFFF), (BYTES_2, 0xFFFF), (BYTES_1, 0xFF)] {
        let mut shaft = Shaft::new(X4, mdr1, 0xFFFF_FFFF);
        assert_eq!(shaft.counter.dtr(), top);
        shaft.turn(-1);
        assert_eq!(shaft.counter.cntr(), top);
        shaft.turn(1);
        assert_eq!(shaft.counter.cntr(), 0);
        shaft.turn(-1);
        shaft.counter.load_otr();
        shaft.counter.set_mdr1(BYTES_1);
        shaft.counter.set_mdr1(0);
        assert_eq!([shaft.counter.cntr(), shaft.counter.dtr(), shaft.counter.otr()], [0xFF; 3]);
    }
}

#[test]
fn counting_can_be_disabled() {
    let mut shaft = Shaft::new(X4, DISABLE, 99);
    assert!(!shaft.has(CEN));
    shaft.turn(5);
    assert_eq!((shaft.seen(), shaft.counter.mdr1()), ((0, 0), DISABLE));
    shaft.counter.set_mdr1(0);
    assert!(shaft.has(CEN));
    shaft.turn(5);
    assert_eq!(shaft.counter.cntr(), 5);
}

#[test]
fn a_flag_that_mdr1_selects_pulls_lflag_until_str_is_cleared() {
    for flag in [CY, BW, CMP, IDX] {
        let mut shaft = Shaft::new(X4, flag, 3);
        assert!(!shaft.counter.lflag());
        shaft.turn(-1);
        assert_eq!(shaft.counter.lflag(), flag == BW);
        shaft.turn(1);
        shaft.turn(3);
        shaft.index_pulse();
        assert!(shaft.counter.lflag());
        shaft.counter.set_mdr1(0);
        assert!(!shaft.counter.lflag());
        shaft.counter.set_mdr1(flag);
        assert!(shaft.counter.lflag());
        shaft.counter.clear_status();
        assert!(!shaft.counter.lflag());
    }
}

#[test]
fn index_functions() {
    for gating in [0, SYNCHRONOUS] {
        for (function, cntr, otr) in [(0, 52, 0), (LOAD_CNTR, 7, 0), (RESET_CNTR, 0, 0), (LOAD_OTR, 52, 52)] {
            let mut shaft = Shaft::new(X4 | function | gating, 0, 7).at(50);
            shaft.turn(2);
            shaft.edge(Index, false);
            assert_eq!(shaft.seen(), (cntr, IDX));
            assert_eq!((shaft.counter.otr(), shaft.counter.at_index()), (otr, 52));
            assert!(shaft.has(IDX));
            shaft.counter.clear_status();
            shaft.edge(Index, true);
            assert_eq!((shaft.seen(), shaft.counter.status()), ((cntr, 0), CEN | UP));
        }
    }
}

#[test]
fn an_asynchronous_index_acts_once_in_any_phase() {
    for mode in [NON_QUADRATURE, NON_QUADRATURE | SYNCHRONOUS, X1, X2, X4] {
        for phase in 0..4 {
            let mut shaft = Shaft::new(mode | LOAD_CNTR, 0, 70);
            shaft.turn(phase);
            shaft.counter.take_events();
            shaft.edge(Index, false);
            assert_eq!(shaft.seen(), (70, IDX), "{mode} {phase}");
            shaft.turn(8);
            assert_ne!(shaft.counter.cntr(), 70, "{mode} {phase}");
            assert_eq!(shaft.counter.take_events() & IDX, 0, "{mode} {phase}");
        }
    }
}

/// Notes 1 and 2 of figure 5.
#[test]
fn a_synchronous_index_meets_a_and_b_both_high_or_both_low() {
    for phase in 0..4 {
        let mut shaft = Shaft::new(X4 | LOAD_CNTR | SYNCHRONOUS, 0, 70);
        shaft.turn(phase);
        shaft.index_pulse();
        let expected = if phase % 2 == 0 { (70, IDX) } else { (phase as u32, 0) };
        assert_eq!(shaft.seen(), expected);
    }
    // The edge that makes A and B equal is counted first. INDEX/ acts again after A and B have differed.
    let mut shaft = Shaft::new(X4 | RESET_CNTR | SYNCHRONOUS, 0, 70).at(50);
    shaft.turn(1);
    shaft.edge(Index, false);
    assert_eq!(shaft.turns(4), [(0, IDX), (1, 0), (0, IDX), (1, 0)]);
    assert_eq!(shaft.counter.at_index(), 2);
}

#[test]
fn only_edges_act() {
    let mut shaft = Shaft::new(X4 | RESET_CNTR | SYNCHRONOUS, 0, 0).at(50);
    shaft.turn(1);
    shaft.edge(Index, false);
    shaft.counter.set_mdr0(X4 | RESET_CNTR);
    assert_eq!(shaft.seen(), (51, 0));
    shaft.turn(1);
    assert_eq!(shaft.seen(), (52, 0));
}

#[test]
fn a_and_b_count_before_an_index_of_the_same_instant() {
    for (mode, counted) in [(X4, 52), (NON_QUADRATURE, 51)] {
        let mut counter = Shaft::new(mode | RESET_CNTR, 0, 0).at(50).counter;
        counter.edge(tick(100), Index, false);
        counter.edge(tick(100), B, true);
        counter.edge(tick(100), A, true);
        // Both are high now: A before B in a quadrature mode.
        counter.timeout(tick(101));
        counter.timeout(tick(102));
        assert_eq!((counter.cntr(), counter.at_index()), (0, counted));
    }
}

#[test]
fn reversed_the_same_edges_count_the_other_way() {
    for mode in [X1, X2, X4] {
        let mut shaft = Shaft::new(mode, 0, 99).at(50);
        let mut reversed = shaft.clone();
        reversed.counter.set_reversed(true);
        for quarters in [1, 1, 1, 1, 1, -1, -1, 1, -1, -1, -1, -1, -1, -1] {
            shaft.turn(quarters);
            reversed.turn(quarters);
            assert_eq!(100 - shaft.counter.cntr(), reversed.counter.cntr());
            assert_ne!(shaft.has(UP), reversed.has(UP));
        }
    }
    let mut shaft = Shaft::new(NON_QUADRATURE, 0, 99).at(50);
    shaft.counter.set_reversed(true);
    shaft.clock(true);
    assert_eq!((shaft.counter.cntr(), shaft.has(UP)), (51, true));
}

/// t5 is two clocks of the filter: 83.3 ns, or 166.7 ns with MDR0 B7, in ticks of 62.5 ns.
#[test]
fn the_filter_drops_pulses_shorter_than_two_clocks() {
    for (mdr0, least) in [(X4, 2), (X4 | HALF_CLOCK, 3)] {
        for width in 0..6 {
            // A pulse of A counts from 0 to 1 and back, a pulse of B down and back, a pulse of INDEX/ acts.
            for (channel, event) in [(A, CMP | BW), (B, BW | CY), (Index, IDX)] {
                let mut counter = Shaft::new(mdr0, 0, 1).counter;
                let rest = channel == Index;
                counter.edge(tick(100), channel, !rest);
                assert_eq!(counter.deadline(), tick(100 + least));
                counter.edge(tick(100 + width), channel, rest);
                counter.timeout(tick(200));
                let expected = if width >= least { event } else { 0 };
                assert_eq!(counter.take_events(), expected, "{width} {channel:?}");
                assert_eq!((counter.cntr(), counter.deadline()), (0, Instant::NEVER));
            }
        }
    }
}

#[test]
fn without_quadrature_a_and_b_are_not_filtered() {
    let mut counter = Shaft::new(NON_QUADRATURE | HALF_CLOCK, 0, 99).counter;
    counter.edge(tick(100), B, true);
    for at in 100..110 {
        counter.edge(tick(at), A, true);
        counter.edge(tick(at), A, false);
    }
    assert_eq!((counter.cntr(), counter.deadline()), (10, Instant::NEVER));
    counter.edge(tick(110), Index, false);
    assert_eq!((counter.take_events(), counter.deadline()), (0, tick(111)));
    counter.timeout(tick(111));
    assert_eq!(counter.take_events(), IDX);
}

/// A pulse of A or B lasts two clocks of the filter; edges of A and B alternate at half of that time.
#[test]
fn no_edge_is_lost_at_the_speed_that_the_filter_takes() {
    for (mdr0, pulse) in [(X4, 2), (X4 | HALF_CLOCK, 4)] {
        let mut counter = Shaft::new(mdr0, 0, 99).counter;
        for quarter in 1..=1_000_usize {
            let (a, b) = CYCLE[quarter % 4];
            let (channel, high) = if quarter % 2 == 1 { (A, a) } else { (B, b) };
            counter.edge(tick(quarter as u64 * pulse / 2), channel, high);
        }
        counter.timeout(tick(10_000));
        assert_eq!(counter.cntr(), 1_000);
    }
}

#[test]
fn a_level_held_back_comes_when_due_though_the_filter_changes() {
    let mut counter = Shaft::new(X4 | HALF_CLOCK, 0, 99).counter;
    counter.edge(tick(100), A, true);
    counter.set_mdr0(X4);
    assert_eq!(counter.deadline(), tick(103));
    counter.edge(tick(100), B, true);
    counter.timeout(tick(1_000));
    // The edge of B took effect first.
    assert_eq!(counter.cntr(), u32::MAX - 1);
}

#[test]
fn steps_forget_levels_of_a_and_b_that_were_held_back() {
    let mut counter = Shaft::new(X4, 0, 99).counter;
    counter.edge(tick(100), A, true);
    counter.edge(tick(101), Index, false);
    counter.take_steps(5, true, false);
    assert_eq!((counter.cntr(), counter.deadline()), (5, tick(103)));
}

#[test]
fn steps_take_levels_over_to_which_they_do_not_lead() {
    let mut counter = Shaft::new(X4, 0, 99).counter;
    counter.take_steps(0, true, true);
    assert_eq!(counter.cntr(), 0);
    counter.take_steps(1, false, true);
    assert_eq!(counter.cntr(), 1);
}

/// Checks that steps at once have the same effect on all state as the same turn by edges.
fn check_steps(shaft: &Shaft, quarters: i32) -> Result<(), TestCaseError> {
    let (mut by_edges, mut at_once) = (shaft.clone(), shaft.clone());
    by_edges.turn(quarters);
    let (a, b) = by_edges.levels();
    at_once.counter.take_steps(quarters, a, b);
    let [at_once, by_edges] = [at_once, by_edges].map(|shaft| format!("{:?}", shaft.counter));
    prop_assert_eq!(at_once, by_edges, "{} from {:?}", quarters, shaft.counter);
    Ok(())
}

/// Every MDR0 except for the filter bit, at the limits of every count mode.
#[test]
fn steps_at_once_are_so_many_edges() {
    for mdr0 in 0..HALF_CLOCK {
        for (phase, low, reversed) in (0..16).map(|n| (n & 3, n & 4 != 0, n & 8 != 0)) {
            for (dtr, count) in [(3, 0), (3, 3), (3, 0xFE), (0, 0), (0xFF, 0xFD)] {
                let mut shaft = Shaft::new(mdr0, BYTES_1, dtr);
                shaft.counter.set_reversed(reversed);
                shaft.turn(phase);
                shaft.edge(Index, !low);
                shaft = shaft.at(count);
                for quarters in [-21, -13, -12, -5, -1, 0, 2, 11, 14, 20, 23] {
                    check_steps(&shaft, quarters).unwrap();
                }
            }
        }
    }
}

/// Checked by arithmetic: 2,000 · 1,073,741 is 1,647 short of 2³¹ − 1.
#[test]
fn any_number_of_steps_takes_no_time() {
    let mut shaft = Shaft::new(X4 | MODULO_N, 0, 1_999);
    let mut steps = |mdr0, dtr, steps| {
        shaft.counter.set_mdr0(mdr0);
        shaft.counter.set_dtr(dtr);
        shaft.counter.take_steps(steps, false, true);
        shaft.seen()
    };
    assert_eq!(steps(X4 | MODULO_N, 1_999, i32::MAX), (1_647, CMP));
    assert_eq!(steps(X4 | MODULO_N, 1_999, i32::MIN), (1_999, BW));
    // A DTR of all ones makes the counter free-running: 1,999 − 2³¹.
    assert_eq!(steps(X4 | MODULO_N, u32::MAX, i32::MIN), (0x8000_07CF, BW));
    assert_eq!(steps(X4 | RANGE_LIMIT, 1_999, i32::MIN), (0x7CF, 0));
    assert_eq!(steps(X4 | RANGE_LIMIT, 2_999, i32::MAX), (2_999, CMP));
    assert_eq!(steps(X4 | RANGE_LIMIT, 2_999, i32::MIN), (0, BW));
    assert_eq!(steps(X1 | SINGLE_CYCLE, 0, i32::MAX), (0x1FFF_FFFF + 1, 0));
    assert_eq!(steps(X4 | SINGLE_CYCLE, 0, i32::MIN), (u32::MAX, BW));
}
