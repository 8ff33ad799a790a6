//! The statements of 7.11 to 7.14 as tests, then random events compared with a slow and plain model.

use std::format;
use std::string::String;
use std::vec::Vec;

use proptest::prelude::*;

use super::Channel::{A, B, Index};
use super::{Channel, Encoder, Instant};

/// The fields in the columns of section 7.11, typed here again from the manual.
const ENABLE_INDEX: u16 = 0x001;
const X2_INDEX: u16 = 0b00 << 1;
const X2_MAX: u16 = 0b01 << 1;
const X4_INDEX: u16 = 0b10 << 1;
const X4_MAX: u16 = 0b11 << 1;
const MODES: [u16; 4] = [X2_INDEX, X2_MAX, X4_INDEX, X4_MAX];
const SWPAB: u16 = 0x008;
const FILTER: u16 = 0x200;

/// Levels of A and B.
type State = (bool, bool);

/// The states of A and B in successive quarter cycles while A leads B.
const UP: [State; 4] = [(false, false), (true, false), (true, true), (false, true)];

fn tick(ticks: u64) -> Instant {
    Instant::from_ticks(ticks)
}

/// An encoder that is turned by a shaft, with one tick between two edges.
#[derive(Clone)]
struct Shaft {
    encoder: Encoder,
    now: u64,
    /// Quarter cycles since the start, signed.
    quarter: i32,
}

impl Shaft {
    fn new(configuration: u16, max_count: u16) -> Self {
        let mut encoder = Encoder::new();
        encoder.configure(tick(0), configuration, max_count, true);
        Self { encoder, now: 0, quarter: 0 }
    }

    /// A shaft at one of the four states of A and B, reached while counting up.
    fn at_state(configuration: u16, max_count: u16, a: bool, b: bool) -> Self {
        let mut shaft = Self::new(configuration, max_count);
        shaft.turn(4 + UP.iter().position(|state| *state == (a, b)).unwrap() as i32);
        shaft
    }

    fn edge(&mut self, channel: Channel, high: bool) {
        self.now += 1;
        self.encoder.edge(tick(self.now), channel, high);
    }

    fn turn(&mut self, quarters: i32) -> u16 {
        for _ in 0..quarters.unsigned_abs() {
            let (a, _) = self.levels();
            self.quarter += quarters.signum();
            let (next_a, next_b) = self.levels();
            if a == next_a { self.edge(B, next_b) } else { self.edge(A, next_a) }
        }
        self.encoder.count()
    }

    fn levels(&self) -> State {
        UP[self.quarter.rem_euclid(4) as usize]
    }

    fn index_pulse(&mut self) {
        self.edge(Index, true);
        self.edge(Index, false);
    }

    fn counts(&self) -> (u16, i32) {
        (self.encoder.count(), self.encoder.index_count())
    }
}

#[test]
fn x4_counts_every_edge_up_while_a_leads_b() {
    let mut shaft = Shaft::new(X4_INDEX, 0);
    shaft.edge(A, true);
    assert_eq!(shaft.encoder.count(), 1);
    shaft.edge(B, true);
    assert_eq!(shaft.encoder.count(), 2);
    shaft.edge(A, false);
    assert_eq!(shaft.encoder.count(), 3);
    shaft.edge(B, false);
    assert_eq!(shaft.encoder.count(), 4);
    shaft.edge(B, true);
    assert_eq!(shaft.encoder.count(), 3);
    shaft.edge(A, true);
    assert_eq!(shaft.encoder.count(), 2);
    shaft.edge(B, false);
    assert_eq!(shaft.encoder.count(), 1);
    shaft.edge(A, false);
    assert_eq!(shaft.encoder.count(), 0);
}

#[test]
fn x2_counts_the_edges_of_a_in_the_direction_b_tells() {
    let mut shaft = Shaft::new(X2_INDEX, 0);
    let up: Vec<u16> = (0..8).map(|_| shaft.turn(1)).collect();
    assert_eq!(up, [1, 1, 2, 2, 3, 3, 4, 4]);
    let down: Vec<u16> = (0..8).map(|_| shaft.turn(-1)).collect();
    assert_eq!(down, [4, 3, 3, 2, 2, 1, 1, 0]);
    // Only A changes, twice, while B is high.
    shaft.turn(2);
    shaft.edge(A, false);
    assert_eq!(shaft.encoder.count(), 2);
    shaft.edge(A, true);
    assert_eq!(shaft.encoder.count(), 1);
}

#[test]
fn swapped_inputs_count_the_other_way() {
    assert_eq!(Shaft::new(X4_INDEX | SWPAB, 0).turn(-5), 5);
    assert_eq!(Shaft::new(X4_INDEX | SWPAB, 0).turn(5), 0xFFFB);
    // With x2, the edges of pin 12 are counted.
    let mut shaft = Shaft::new(X2_INDEX | SWPAB, 0);
    let counts: Vec<u16> = (0..5).map(|_| shaft.turn(-1)).collect();
    assert_eq!(counts, [1, 1, 2, 2, 3]);
}

#[test]
fn a_level_told_again_is_no_edge() {
    let mut shaft = Shaft::new(X4_INDEX | ENABLE_INDEX, 0);
    shaft.edge(A, false);
    shaft.edge(B, false);
    assert_eq!(shaft.counts(), (0, 0));
    shaft.edge(A, true);
    shaft.edge(A, true);
    assert_eq!(shaft.counts(), (1, 0));
    shaft.edge(A, false);
    shaft.edge(Index, true);
    shaft.edge(Index, true);
    assert_eq!(shaft.encoder.index_count(), -1);
}

/// Section 7.12, for an encoder of 500 cycles per revolution.
#[test]
fn max_count_is_one_less_than_a_revolution() {
    let mut x4 = Shaft::new(X4_MAX, 4 * 500 - 1);
    assert_eq!((x4.turn(1_999), x4.turn(1)), (1_999, 0));
    assert_eq!((x4.turn(-1), x4.turn(-1_998), x4.turn(-1)), (1_999, 1, 0));
    let mut x2 = Shaft::new(X2_MAX, 2 * 500 - 1);
    assert_eq!((x2.turn(1_998), x2.turn(1), x2.turn(1)), (999, 0, 0));
    assert_eq!((x2.turn(-1), x2.turn(-1), x2.turn(-1_997), x2.turn(-1)), (0, 999, 1, 0));
}

#[test]
fn with_reset_by_index_it_counts_through_16_bits() {
    for mode in [X2_INDEX, X4_INDEX] {
        let mut shaft = Shaft::new(mode, 1_999);
        assert_eq!(shaft.turn(-1), if mode == X4_INDEX { 0xFFFF } else { 0 });
        assert_eq!(shaft.turn(-1), if mode == X4_INDEX { 0xFFFE } else { 0xFFFF });
        assert_eq!(shaft.turn(2), 0);
    }
}

#[test]
fn a_count_above_max_count_goes_on_until_it_wraps_or_meets_it() {
    let mut shaft = Shaft::new(X4_MAX, 9);
    shaft.encoder.set_count(0xFFFE);
    assert_eq!(shaft.turn(1), 0xFFFF);
    assert_eq!(shaft.turn(1), 0);
    assert_eq!(shaft.turn(9), 9);
    assert_eq!(shaft.turn(1), 0);
    shaft.encoder.set_count(11);
    assert_eq!(shaft.turn(-2), 9);
    assert_eq!(shaft.turn(-9), 0);
    assert_eq!(shaft.turn(-1), 9);
}

#[test]
fn max_count_0_holds_the_count() {
    let mut shaft = Shaft::new(X4_MAX, 0);
    assert_eq!((shaft.turn(3), shaft.turn(-7)), (0, 0));
}

/// The two tables of section 7.11: the states (A, B) at which a short index pulse counts.
#[test]
fn index_gating() {
    const LL: State = (false, false);
    const HL: State = (true, false);
    const LH: State = (false, true);
    const HH: State = (true, true);
    #[rustfmt::skip]
    let rows: [(bool, u16, &[State]); 8] = [
        (true, 0, &[LL]),        // B=0, A=0
        (true, 1, &[HL]),        // B=0, A=1
        (true, 2, &[LH]),        // B=1, A=0
        (true, 3, &[HH]),        // B=1, A=1
        (false, 0, &[LL, LH]),   // A=0
        (false, 1, &[HL, HH]),   // A=1
        (false, 2, &[LL, HL]),   // B=0
        (false, 3, &[LH, HH]),   // B=1
    ];
    for (x4, gating, valid) in rows {
        for mode in if x4 { [X4_INDEX, X4_MAX] } else { [X2_INDEX, X2_MAX] } {
            for (a, b) in UP {
                let configuration = mode | gating << 4;
                let mut shaft = Shaft::at_state(configuration, 1_999, a, b);
                shaft.index_pulse();
                let expected = if valid.contains(&(a, b)) { 1 } else { 0 };
                assert_eq!(shaft.encoder.index_count(), expected, "{configuration:#x} {a} {b}");
                // With swapped inputs the gate's A is pin 12, and the direction is reversed.
                let mut shaft = Shaft::at_state(configuration | SWPAB, 1_999, a, b);
                shaft.index_pulse();
                let expected = if valid.contains(&(b, a)) { -1 } else { 0 };
                assert_eq!(shaft.encoder.index_count(), expected, "{configuration:#x} swapped {a} {b}");
            }
        }
    }
}

#[test]
fn an_index_event_loads_0_going_up_and_max_count_going_down() {
    for mode in [X2_INDEX, X4_INDEX] {
        let mut shaft = Shaft::new(mode | ENABLE_INDEX, 1_999);
        shaft.turn(8);
        shaft.index_pulse();
        assert_eq!(shaft.counts(), (0, 1));
        shaft.turn(9);
        shaft.turn(-1);
        shaft.index_pulse();
        assert_eq!(shaft.counts(), (1_999, 0));
    }
}

#[test]
fn without_enable_index_or_with_reset_by_max_count_an_index_event_only_counts() {
    for configuration in [X2_INDEX, X4_INDEX, X2_MAX | ENABLE_INDEX, X4_MAX | ENABLE_INDEX] {
        let mut shaft = Shaft::new(configuration, 1_999);
        shaft.encoder.set_count(500);
        shaft.turn(4);
        let position = shaft.encoder.count();
        shaft.index_pulse();
        assert_eq!(shaft.counts(), (position, 1), "{configuration:#x}");
        shaft.turn(-4);
        shaft.index_pulse();
        assert_eq!(shaft.counts(), (500, 0), "{configuration:#x}");
    }
}

#[test]
fn outside_the_gate_an_index_pulse_neither_clears_nor_counts() {
    let mut shaft = Shaft::new(X4_INDEX | ENABLE_INDEX, 1_999);
    shaft.turn(5);
    shaft.index_pulse();
    assert_eq!(shaft.counts(), (5, 0));
    shaft.turn(3);
    assert_eq!(shaft.counts(), (8, 0));
}

#[test]
fn a_wide_index_pulse_clears_once_when_a_and_b_get_there() {
    let mut shaft = Shaft::new(X4_INDEX | ENABLE_INDEX | 3 << 4, 1_999);
    shaft.turn(101);
    shaft.edge(Index, true);
    assert_eq!(shaft.counts(), (101, 0));
    // The edge that leads into the gated state is counted first, then the count is cleared.
    shaft.turn(1);
    assert_eq!(shaft.counts(), (0, 1));
    shaft.turn(4);
    assert_eq!(shaft.counts(), (4, 1));
    shaft.edge(Index, false);
    shaft.edge(Index, true);
    assert_eq!(shaft.counts(), (0, 2));
    shaft.edge(Index, false);
    shaft.turn(3);
    shaft.edge(Index, true);
    shaft.turn(-3);
    assert_eq!(shaft.counts(), (1_999, 1));
}

/// Section 7.13: "5 CW rotations will increase the count by 5 and 3 CCW rotations will decrease the count by
/// 3".
#[test]
fn the_index_count_follows_rotations_both_ways() {
    let mut shaft = Shaft::new(X4_INDEX | ENABLE_INDEX, 1_999);
    for revolution in 1..=5 {
        shaft.turn(1_000);
        shaft.index_pulse();
        assert_eq!(shaft.counts(), (0, revolution));
        shaft.turn(1_000);
    }
    for revolution in 1..=3 {
        shaft.turn(-1_000);
        shaft.index_pulse();
        assert_eq!(shaft.counts(), (1_999, 5 - revolution));
        shaft.turn(-1_000);
    }
}

#[test]
fn before_any_movement_an_index_pulse_counts_up() {
    let mut shaft = Shaft::new(X4_INDEX | ENABLE_INDEX, 1_999);
    shaft.index_pulse();
    assert_eq!(shaft.counts(), (0, 1));
}

#[test]
fn an_edge_that_x2_does_not_count_tells_the_direction_too() {
    let mut shaft = Shaft::new(X2_INDEX | 1 << 4, 1_999);
    shaft.turn(2);
    shaft.turn(-1);
    shaft.index_pulse();
    assert_eq!(shaft.counts(), (1, -1));
}

#[test]
fn both_counts_can_be_written() {
    let mut shaft = Shaft::new(X4_INDEX, 1_999);
    shaft.encoder.set_count(0x1234);
    shaft.encoder.set_index_count(i32::MAX);
    assert_eq!(shaft.counts(), (0x1234, i32::MAX));
    shaft.turn(4);
    shaft.index_pulse();
    assert_eq!(shaft.counts(), (0x1238, i32::MIN));
    shaft.turn(-4);
    shaft.index_pulse();
    assert_eq!(shaft.counts(), (0x1234, i32::MAX));
}

#[test]
fn a_new_configuration_shows_with_the_next_edge() {
    let mut shaft = Shaft::new(X4_INDEX, 1_999);
    shaft.turn(1);
    shaft.edge(Index, true);
    shaft.encoder.configure(tick(shaft.now), X4_INDEX | ENABLE_INDEX | 1 << 4, 5, true);
    assert_eq!(shaft.counts(), (1, 0));
    // The next edge leaves the new gated state, and the edge after that enters this state again.
    shaft.turn(1);
    assert_eq!(shaft.counts(), (2, 0));
    shaft.turn(-1);
    assert_eq!(shaft.counts(), (5, -1));
}

/// Section 7.8, bit 12 makes the pins outputs.
#[test]
fn disabled_it_follows_levels_and_counts_nothing() {
    let mut shaft = Shaft::new(X4_INDEX, 1_999);
    shaft.turn(1);
    shaft.encoder.configure(tick(shaft.now), X4_INDEX | ENABLE_INDEX, 1_999, false);
    shaft.turn(6);
    shaft.index_pulse();
    shaft.turn(1);
    shaft.index_pulse();
    assert_eq!(shaft.counts(), (1, 0));
    shaft.encoder.configure(tick(shaft.now), X4_INDEX, 1_999, true);
    assert_eq!(shaft.counts(), (1, 0));
    shaft.turn(1);
    assert_eq!(shaft.counts(), (2, 0));
}

/// Section 7.11: "ignore pulses less than 3 clock periods in duration", in ticks of 62.5 ns.
#[test]
fn the_filter_ignores_pulses_shorter_than_three_periods() {
    #[rustfmt::skip]
    let rows: [(u16, u64); 8] = [
        (0, 2),     // 40 MHz: 75 ns
        (1, 3),     // 20 MHz: 150 ns
        (2, 5),     // 10 MHz: 300 ns
        (3, 20),    // 2.5 MHz: 1.2 µs
        (4, 39),    // 1.25 MHz: 2.4 µs
        (5, 77),    // 625 kHz: 4.8 µs
        (6, 154),   // 312.5 kHz: 9.6 µs
        (7, 308),   // 156.25 kHz: 19.2 µs
    ];
    for (frequency, ticks) in rows {
        let mut encoder = Encoder::new();
        encoder.configure(tick(0), X4_INDEX | FILTER | frequency << 6, 0, true);
        assert_eq!(encoder.deadline(), Instant::NEVER);
        // This pulse is too short by one tick.
        encoder.edge(tick(1_000), A, true);
        assert_eq!(encoder.deadline(), tick(1_000 + ticks));
        encoder.timeout(tick(1_000 + ticks - 1));
        encoder.edge(tick(1_000 + ticks - 1), A, false);
        assert_eq!(encoder.deadline(), Instant::NEVER);
        encoder.timeout(tick(1_000 + ticks));
        assert_eq!(encoder.count(), 0, "{frequency}");
        // This level takes effect after it has lasted long enough.
        encoder.edge(tick(2_000), A, true);
        encoder.timeout(tick(2_000 + ticks - 1));
        assert_eq!(encoder.count(), 0, "{frequency}");
        encoder.timeout(tick(2_000 + ticks));
        assert_eq!((encoder.count(), encoder.deadline()), (1, Instant::NEVER), "{frequency}");
        // This pulse lasts just long enough; its end is passed to the encoder before the timeout.
        encoder.edge(tick(3_000), B, true);
        encoder.edge(tick(3_000 + ticks), B, false);
        assert_eq!((encoder.count(), encoder.deadline()), (2, tick(3_000 + 2 * ticks)), "{frequency}");
        encoder.timeout(tick(3_000 + 2 * ticks));
        assert_eq!(encoder.count(), 1, "{frequency}");
    }
}

#[test]
fn the_filter_looks_at_each_pin_by_itself() {
    let mut encoder = Encoder::new();
    encoder.configure(tick(0), X4_INDEX | ENABLE_INDEX | 3 << 4 | FILTER | 3 << 6, 1_999, true);
    encoder.edge(tick(100), A, true);
    encoder.edge(tick(105), Index, true);
    encoder.edge(tick(110), B, true);
    encoder.edge(tick(112), B, false);
    encoder.edge(tick(113), B, true);
    // Setting the same level again does not restart its time.
    encoder.edge(tick(119), A, true);
    assert_eq!(encoder.deadline(), tick(120));
    encoder.timeout(tick(120));
    assert_eq!((encoder.count(), encoder.deadline()), (1, tick(125)));
    encoder.timeout(tick(125));
    assert_eq!((encoder.count(), encoder.deadline()), (1, tick(133)));
    encoder.timeout(tick(133));
    assert_eq!((encoder.count(), encoder.index_count()), (0, 1));
}

#[test]
fn levels_due_at_one_instant_come_in_the_order_a_b_index() {
    // If B came before A, the count would go down. If the index came before B, the index would be valid at
    // gate 0 or 1.
    for (gating, index_count) in [(0, 0), (1, 0), (2, 0), (3, 1)] {
        let mut encoder = Encoder::new();
        encoder.configure(tick(0), X4_INDEX | gating << 4 | FILTER | 3 << 6, 1_999, true);
        for channel in [Index, B, A] {
            encoder.edge(tick(100), channel, true);
        }
        encoder.timeout(tick(120));
        assert_eq!((encoder.count(), encoder.index_count()), (2, index_count), "{gating}");
    }
}

#[test]
fn behind_the_filter_an_index_falls_before_a_and_b_change() {
    // The index is high while A and B are low: of the four gates only the first responds (7.11).
    for (gating, index_count) in [(0, 1), (1, 0), (2, 0), (3, 0)] {
        let mut encoder = Encoder::new();
        encoder.configure(tick(0), X4_INDEX | gating << 4 | FILTER | 3 << 6, 1_999, true);
        let turn = [(A, true), (B, true), (A, false), (B, false), (A, true), (B, true)];
        for (n, (channel, high)) in (1..).zip(turn) {
            encoder.edge(tick(100 * n), channel, high);
            match (channel, high, n) {
                (B, false, _) => encoder.edge(tick(100 * n), Index, true),
                (A, true, 2..) => encoder.edge(tick(100 * n), Index, false),
                _ => {}
            }
            encoder.timeout(tick(100 * n + 50));
        }
        assert_eq!(encoder.index_count(), index_count, "{gating}");
    }
}

#[test]
fn levels_that_are_due_come_in_time_however_late_it_is_told() {
    let mut encoder = Encoder::new();
    encoder.configure(tick(0), X4_INDEX | FILTER | 3 << 6, 1_999, true);
    encoder.edge(tick(100), B, true);
    encoder.edge(tick(101), A, true);
    encoder.timeout(tick(1_000));
    assert_eq!(encoder.count(), 0xFFFE);
}

#[test]
fn a_level_held_back_comes_when_due_though_the_filter_changes() {
    let mut encoder = Encoder::new();
    encoder.configure(tick(0), X4_INDEX | FILTER | 7 << 6, 1_999, true);
    encoder.edge(tick(100), A, true);
    encoder.configure(tick(200), X4_INDEX, 1_999, true);
    assert_eq!((encoder.count(), encoder.deadline()), (0, tick(408)));
    encoder.edge(tick(407), B, true);
    assert_eq!(encoder.count(), 0xFFFF);
    encoder.timeout(tick(408));
    assert_eq!(encoder.count(), 0xFFFE);
    // A level that is due before the change uses the old configuration.
    encoder.configure(tick(500), X4_INDEX | FILTER, 1_999, true);
    encoder.edge(tick(600), A, false);
    encoder.configure(tick(602), X4_INDEX, 1_999, false);
    assert_eq!((encoder.count(), encoder.deadline()), (0xFFFF, Instant::NEVER));
}

#[test]
fn a_count_forgets_levels_of_a_and_b_that_were_held_back() {
    let mut encoder = Encoder::new();
    encoder.configure(tick(0), X4_INDEX | FILTER | 3 << 6, 1_999, true);
    encoder.edge(tick(100), A, true);
    encoder.edge(tick(101), Index, true);
    encoder.add_counts(5, true, false);
    assert_eq!((encoder.count(), encoder.deadline()), (5, tick(121)));
}

#[test]
fn a_count_takes_levels_over_to_which_its_steps_do_not_lead() {
    let mut encoder = Encoder::new();
    encoder.configure(tick(0), X4_INDEX, 1_999, true);
    encoder.add_counts(0, true, true);
    assert_eq!(encoder.count(), 0);
    encoder.edge(tick(1), A, false);
    assert_eq!(encoder.count(), 1);
}

/// Text of all state that an edge can change.
fn state(shaft: &Shaft) -> String {
    format!("{:?}", shaft.encoder)
}

/// Checks that one count of `quarters` has the same effect as that many edges.
fn check_count(shaft: &Shaft, quarters: i32) -> Result<(), TestCaseError> {
    let (mut by_edges, mut at_once) = (shaft.clone(), shaft.clone());
    by_edges.turn(quarters);
    let (a, b) = by_edges.levels();
    at_once.encoder.add_counts(quarters, a, b);
    prop_assert_eq!(state(&at_once), state(&by_edges), "{} from {:?}", quarters, shaft.encoder);
    Ok(())
}

#[test]
fn a_count_is_so_many_edges() {
    for mode in MODES {
        for rest in 0..16 {
            let configuration = mode | (rest & 1) | (rest >> 1 & 1) << 3 | (rest >> 2) << 4;
            for phase in 0..4 {
                for index in [false, true] {
                    for position in [0, 1, 3, 4, 0xFFFE] {
                        let mut shaft = Shaft::new(configuration, 3);
                        shaft.turn(phase);
                        shaft.edge(Index, index);
                        shaft.encoder.set_count(position);
                        for quarters in -9..=9 {
                            check_count(&shaft, quarters).unwrap();
                        }
                    }
                }
            }
        }
    }
}

/// An event for an encoder and its model.
#[derive(Clone, Copy, Debug)]
enum Event {
    Configure { configuration: u16, max_count: u16, enabled: bool },
    Edge { channel: Channel, high: bool },
    Position(u16),
    IndexCount(i32),
}

/// A pin of the model.
#[derive(Clone, Copy)]
struct Input {
    level: bool,
    since: u64,
    /// Ticks that the level must last.
    lasting: u64,
    /// The level after the filter.
    seen: bool,
}

/// Levels after the filter, stored after each edge.
#[derive(Clone, Copy)]
struct Moment {
    a: bool,
    b: bool,
    index: bool,
    swapped: bool,
}

impl Moment {
    fn a_b(self, swapped: bool) -> State {
        if swapped { (self.b, self.a) } else { (self.a, self.b) }
    }

    fn quarter(self, swapped: bool) -> usize {
        UP.iter().position(|state| *state == self.a_b(swapped)).unwrap()
    }
}

/// Both counts after each event. The model computes them tick by tick from the whole history.
struct Model {
    configuration: u16,
    max_count: i64,
    enabled: bool,
    inputs: [Input; 3],
    history: Vec<Moment>,
    /// Index in `history` of the last moment before the index pulse that was counted last.
    counted: Option<usize>,
    position: i64,
    index_count: i64,
}

impl Model {
    fn run(events: &[(u64, Event)]) -> Vec<(u16, i32)> {
        let low = Input { level: false, since: 0, lasting: 0, seen: false };
        let mut model = Self {
            configuration: 0,
            max_count: 0,
            enabled: false,
            inputs: [low; 3],
            history: std::vec![Moment { a: false, b: false, index: false, swapped: false }],
            counted: None,
            position: 0,
            index_count: 0,
        };
        let mut now = 0;
        let after = |(at, event): &(u64, Event)| {
            (now..=*at).for_each(|tick| model.look(tick));
            now = *at;
            model.happen(now, *event);
            model.look(now);
            (model.position as u16, model.index_count as i32)
        };
        events.iter().map(after).collect()
    }

    fn happen(&mut self, now: u64, event: Event) {
        match event {
            Event::Configure { configuration, max_count, enabled } => {
                (self.configuration, self.max_count, self.enabled) =
                    (configuration, max_count.into(), enabled);
            }
            Event::Edge { channel, high } => {
                let frequency = usize::from(self.configuration >> 6 & 7);
                let filtered = self.configuration & FILTER != 0;
                let lasting = if filtered { [2, 3, 5, 20, 39, 77, 154, 308][frequency] } else { 0 };
                let input = &mut self.inputs[channel as usize];
                if input.level != high {
                    *input = Input { level: high, since: now, lasting, ..*input };
                }
            }
            Event::Position(count) => self.position = count.into(),
            Event::IndexCount(count) => self.index_count = count.into(),
        }
    }

    /// Applies the levels that have lasted long enough.
    fn look(&mut self, now: u64) {
        // A falling index is applied before A and B.
        let order = if self.inputs[2].seen { [2, 0, 1] } else { [0, 1, 2] };
        for place in order {
            let input = &mut self.inputs[place];
            if input.level != input.seen && now - input.since >= input.lasting {
                input.seen = input.level;
                let [a, b, index] = self.inputs.map(|input| input.seen);
                self.history.push(Moment { a, b, index, swapped: self.configuration & SWPAB != 0 });
                if self.enabled {
                    self.count_edge();
                    self.count_index();
                }
            }
        }
    }

    /// Returns true if the last edge of A or B counted up, with the swapping that applied at that edge.
    fn up(&self) -> bool {
        let turns = self.history.windows(2).rev().map(|pair| {
            let swapped = pair[1].swapped;
            (pair[1].quarter(swapped) + 4 - pair[0].quarter(swapped)) % 4
        });
        turns.into_iter().find(|turn| *turn != 0).is_none_or(|turn| turn == 1)
    }

    fn x4(&self) -> bool {
        [X4_INDEX, X4_MAX].contains(&(self.configuration & 6))
    }

    fn by_max_count(&self) -> bool {
        [X2_MAX, X4_MAX].contains(&(self.configuration & 6))
    }

    fn count_edge(&mut self) {
        let [.., before, now] = self.history[..] else { panic!("an edge has two sides") };
        let (a_before, b_before) = before.a_b(now.swapped);
        let (a, b) = now.a_b(now.swapped);
        let last = if self.by_max_count() { self.max_count } else { 0xFFFF };
        if a != a_before || (b != b_before && self.x4()) {
            self.position = match self.up() {
                true if self.position == last || self.position == 0xFFFF => 0,
                true => self.position + 1,
                false if self.position == 0 => last,
                false => self.position - 1,
            };
        }
    }

    fn count_index(&mut self) {
        let now = *self.history.last().unwrap();
        let (a, b) = now.a_b(now.swapped);
        let row = usize::from(self.configuration >> 4 & 3);
        let x4_rows = [(false, false), (true, false), (false, true), (true, true)];
        let x2_rows = [(a, false), (a, true), (b, false), (b, true)];
        let valid = if self.x4() { (a, b) == x4_rows[row] } else { x2_rows[row].0 == x2_rows[row].1 };
        let began = self.history.iter().rposition(|moment| !moment.index);
        if now.index && valid && self.counted != began {
            self.counted = began;
            self.index_count += if self.up() { 1 } else { -1 };
            if self.configuration & ENABLE_INDEX != 0 && !self.by_max_count() {
                self.position = if self.up() { 0 } else { self.max_count };
            }
        }
    }
}

/// Counts near the values at which the counter wraps or clears.
fn some_count() -> impl Strategy<Value = u16> {
    prop_oneof![3 => 0..6_u16, 1 => 0xFFFC..=0xFFFF_u16, 1 => any::<u16>()]
}

fn some_configuration() -> impl Strategy<Value = u16> {
    prop_oneof![2 => 0..FILTER, 1 => FILTER..2 * FILTER, 1 => any::<u16>()]
}

fn some_event() -> impl Strategy<Value = Event> {
    let channel = prop_oneof![3 => Just(A), 3 => Just(B), 2 => Just(Index)];
    prop_oneof![
        30 => (channel, any::<bool>()).prop_map(|(channel, high)| Event::Edge { channel, high }),
        2 => (some_configuration(), some_count(), prop::bool::weighted(0.9)).prop_map(
            |(configuration, max_count, enabled)| Event::Configure { configuration, max_count, enabled }
        ),
        1 => some_count().prop_map(Event::Position),
        1 => (-2..=2_i32).prop_map(Event::IndexCount),
    ]
}

/// Ticks since the previous event.
fn some_gap() -> impl Strategy<Value = u64> {
    prop_oneof![4 => 0..4_u64, 2 => 0..50_u64, 1 => 0..400_u64]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    /// The encoder counts like the model, even if its timeouts are called late.
    #[test]
    fn it_counts_what_the_model_counts(
        first in (some_configuration(), some_count()),
        rest in prop::collection::vec((some_gap(), some_event(), any::<bool>()), 1..80),
    ) {
        let (configuration, max_count) = first;
        let mut events = std::vec![(0, Event::Configure { configuration, max_count, enabled: true })];
        let mut now = 0;
        for (gap, event, _) in &rest {
            now += gap;
            events.push((now, *event));
        }
        let expected = Model::run(&events);
        let late = std::iter::once(false).chain(rest.iter().map(|(_, _, late)| *late));
        let mut encoder = Encoder::new();
        for (((at, event), expected), late) in events.iter().zip(expected).zip(late) {
            let at = tick(*at);
            if matches!(event, Event::Position(_) | Event::IndexCount(_)) {
                // A write has no time argument, so the timeout comes first.
                encoder.timeout(at);
            }
            // Each of the three pins may have one pending level.
            for _ in 0..3 {
                if !late && encoder.deadline() < at {
                    encoder.timeout(encoder.deadline());
                }
            }
            match *event {
                Event::Configure { configuration, max_count, enabled } => {
                    encoder.configure(at, configuration, max_count, enabled);
                }
                Event::Edge { channel, high } => encoder.edge(at, channel, high),
                Event::Position(count) => encoder.set_count(count),
                Event::IndexCount(count) => encoder.set_index_count(count),
            }
            prop_assert_eq!((encoder.count(), encoder.index_count()), expected, "{:?}", (at, event));
        }
    }

    #[test]
    fn a_count_of_many_revolutions_is_so_many_edges(
        configuration in 0..0x40_u16,
        max_count in some_count(),
        enabled in prop::bool::weighted(0.9),
        phase in 0..4_i32,
        index in any::<bool>(),
        position in some_count(),
        quarters in prop_oneof![-70_000..70_000_i32, -300..300_i32],
    ) {
        let mut shaft = Shaft::new(configuration, max_count);
        shaft.encoder.configure(tick(0), configuration, max_count, enabled);
        shaft.turn(phase);
        shaft.edge(Index, index);
        shaft.encoder.set_count(position);
        check_count(&shaft, quarters)?;
    }
}

/// The largest counts, checked by arithmetic: 2³¹ is 0 modulo 4 and modulo 2¹⁶, and 1,648 modulo 2,000 (2,000
/// · 1,073,741 + 1,648).
#[test]
fn a_count_of_any_size_takes_no_time() {
    let mut encoder = Encoder::new();
    encoder.configure(tick(0), X4_MAX, 1_999, true);
    encoder.add_counts(i32::MAX, false, true);
    assert_eq!(encoder.count(), 1_647);
    encoder.add_counts(i32::MIN, false, true);
    assert_eq!(encoder.count(), 1_999);
    encoder.configure(tick(0), X2_INDEX, 0, true);
    encoder.set_count(0);
    encoder.add_counts(i32::MIN, false, true);
    assert_eq!(encoder.count(), 0);
}
