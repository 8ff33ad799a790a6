//! Random events compared with a slow and plain model, and steps at once compared with edges.

use std::vec::Vec;

use proptest::prelude::*;

use super::*;

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

/// An event for a counter and its model.
#[derive(Clone, Copy, Debug)]
enum Event {
    Edge(Channel, bool),
    Mdr0(u8),
    Mdr1(u8),
    Dtr(u32),
    LoadCntr,
    LoadOtr,
    ClearCntr,
    ClearStatus,
    Reversed(bool),
    Enabled(bool),
}

/// CNTR, OTR, CNTR at the index, STR and the events, after each event. The model computes them tick by tick.
struct Model {
    mdr0: u8,
    mdr1: u8,
    dtr: i64,
    cntr: i64,
    otr: i64,
    at_index: i64,
    inputs: [Input; 3],
    reversed: bool,
    enabled: bool,
    stopped: bool,
    up: bool,
    latched: u8,
    events: u8,
}

impl Model {
    fn run(events: &[(u64, Event)]) -> Vec<[u32; 5]> {
        let pin = |level| Input { level, since: 0, lasting: 0, seen: level };
        let mut model = Self {
            mdr0: 0,
            mdr1: 0,
            dtr: 0,
            cntr: 0,
            otr: 0,
            at_index: 0,
            inputs: [pin(false), pin(false), pin(true)],
            reversed: false,
            enabled: true,
            stopped: false,
            up: false,
            latched: PLS,
            events: 0,
        };
        let mut now = 0;
        let after = |(at, event): &(u64, Event)| {
            (now..=*at).for_each(|tick| model.look(tick));
            now = *at;
            model.happen(now, *event);
            model.look(now);
            let happened = std::mem::take(&mut model.events);
            let [cntr, otr, at_index] = [model.cntr, model.otr, model.at_index].map(|n| n as u32);
            [cntr, otr, at_index, model.status().into(), happened.into()]
        };
        events.iter().map(after).collect()
    }

    fn happen(&mut self, now: u64, event: Event) {
        match event {
            Event::Edge(channel, high) => {
                let lasting = match (self.mdr0 & 3, self.mdr0 & HALF_CLOCK) {
                    (NON_QUADRATURE, _) => u64::from(channel == Index),
                    (_, 0) => 2,
                    _ => 3,
                };
                let input = &mut self.inputs[channel as usize];
                if input.level != high {
                    *input = Input { level: high, since: now, lasting, ..*input };
                }
            }
            Event::Mdr0(value) => {
                self.mdr0 = value;
                self.stopped &= value & MODULO_N == SINGLE_CYCLE;
                if value & 3 == NON_QUADRATURE {
                    let [_, b, _] = self.inputs.map(|input| input.seen);
                    self.up = b;
                }
            }
            Event::Mdr1(value) => {
                self.mdr1 = value;
                for register in [&mut self.cntr, &mut self.otr, &mut self.dtr] {
                    *register %= [1 << 32, 1 << 24, 1 << 16, 1 << 8][usize::from(value & 3)];
                }
            }
            Event::Dtr(value) => self.dtr = i64::from(value) % self.values(),
            Event::LoadCntr => self.load(self.dtr),
            Event::LoadOtr => self.otr = self.cntr,
            Event::ClearCntr => self.load(0),
            Event::ClearStatus => self.latched = 0,
            Event::Reversed(reversed) => self.reversed = reversed,
            Event::Enabled(enabled) => self.enabled = enabled,
        }
    }

    fn values(&self) -> i64 {
        [1 << 32, 1 << 24, 1 << 16, 1 << 8][usize::from(self.mdr1 & 3)]
    }

    fn load(&mut self, value: i64) {
        self.cntr = value;
        self.stopped = false;
    }

    fn counting(&self) -> bool {
        self.enabled && !self.stopped && self.mdr1 & DISABLE == 0
    }

    fn status(&self) -> u8 {
        self.latched | if self.up { UP } else { 0 } | if self.counting() { CEN } else { 0 }
    }

    /// Applies the levels that have lasted long enough.
    fn look(&mut self, now: u64) {
        for place in 0..3 {
            let input = self.inputs[place];
            if input.level != input.seen && now - input.since >= input.lasting {
                let was_active = self.index_is_active();
                let before = self.quarter();
                self.inputs[place].seen = input.level;
                if place < 2 {
                    self.turn((self.quarter() - before).rem_euclid(4) == 1, place == 0);
                }
                if self.index_is_active() && !was_active {
                    self.index();
                }
            }
        }
    }

    fn quarter(&self) -> i32 {
        let [a, b, _] = self.inputs.map(|input| input.seen);
        CYCLE.iter().position(|levels| *levels == (a, b)).unwrap() as i32
    }

    fn turn(&mut self, forward: bool, is_a: bool) {
        let [a, b, _] = self.inputs.map(|input| input.seen);
        let counts = match self.mdr0 & 3 {
            NON_QUADRATURE => is_a && a,
            X1 => is_a && !b,
            X2 => is_a,
            _ => true,
        };
        self.up = if self.mdr0 & 3 == NON_QUADRATURE { b } else { forward != self.reversed };
        if counts && self.counting() {
            self.clock();
        }
    }

    fn clock(&mut self) {
        let (mode, highest) = (self.mdr0 & MODULO_N, self.values() - 1);
        let from = self.cntr;
        self.cntr = match (mode, self.up) {
            (RANGE_LIMIT, true) if from == self.dtr => from,
            (RANGE_LIMIT, false) if from == 0 => from,
            (MODULO_N, true) if from == self.dtr => 0,
            (MODULO_N, false) if from == 0 => self.dtr,
            (_, true) => from + 1,
            (_, false) => from - 1,
        };
        let wrapped = self.cntr < 0 || self.cntr > highest;
        self.cntr = self.cntr.rem_euclid(self.values());
        self.stopped = wrapped && mode == SINGLE_CYCLE;
        let mut flags = 0;
        if self.up && self.cntr == self.dtr {
            flags |= CMP;
        }
        if self.up && [from, self.cntr].contains(&highest) && mode != RANGE_LIMIT && mode != MODULO_N {
            flags |= CY;
            self.latched &= !S;
        }
        if !self.up && [from, self.cntr].contains(&0) {
            flags |= BW;
            self.latched |= S;
        }
        self.latched |= flags;
        self.events |= flags;
    }

    fn index_is_active(&self) -> bool {
        let [a, b, index] = self.inputs.map(|input| input.seen);
        !index && (self.mdr0 & SYNCHRONOUS == 0 || self.mdr0 & 3 == NON_QUADRATURE || a == b)
    }

    fn index(&mut self) {
        self.at_index = self.cntr;
        match self.mdr0 & LOAD_OTR {
            0 => {}
            LOAD_CNTR => self.load(self.dtr),
            RESET_CNTR => self.load(0),
            _ => self.otr = self.cntr,
        }
        self.latched |= IDX;
        self.events |= IDX;
    }
}

/// Counts near the values at which the counter wraps or matches.
fn some_count() -> impl Strategy<Value = u32> {
    prop_oneof![
        3 => 0..6_u32,
        1 => (0..32_u32, 0..6_u32).prop_map(|(bits, less)| (u32::MAX >> bits).wrapping_sub(less)),
        1 => any::<u32>(),
    ]
}

fn some_event() -> impl Strategy<Value = Event> {
    let channel = prop_oneof![4 => Just(A), 4 => Just(B), 1 => Just(Index)];
    prop_oneof![
        40 => (channel, any::<bool>()).prop_map(|(channel, high)| Event::Edge(channel, high)),
        2 => any::<u8>().prop_map(Event::Mdr0),
        1 => any::<u8>().prop_map(Event::Mdr1),
        1 => some_count().prop_map(Event::Dtr),
        1 => Just(Event::LoadCntr),
        1 => Just(Event::LoadOtr),
        1 => Just(Event::ClearCntr),
        1 => Just(Event::ClearStatus),
        1 => any::<bool>().prop_map(Event::Reversed),
        1 => prop::bool::weighted(0.8).prop_map(Event::Enabled),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    /// The counter counts like the model, even if its timeouts are called late.
    #[test]
    fn it_counts_what_the_model_counts(
        first in (any::<u8>(), any::<u8>(), some_count(), some_count()),
        rest in prop::collection::vec((0..5_u64, some_event(), any::<bool>()), 1..120),
    ) {
        let (mdr0, mdr1, dtr, count) = first;
        let mdr1 = mdr1 & !DISABLE;
        let first = [
            Event::Mdr1(mdr1), Event::Mdr0(mdr0), Event::Dtr(count), Event::LoadCntr, Event::Dtr(dtr),
        ];
        let mut events: Vec<_> = first.map(|event| (0, event, true)).to_vec();
        let mut now = 0;
        events.extend(rest.iter().map(|(gap, event, late)| {
            now += gap;
            (now, *event, *late)
        }));
        let expected = Model::run(&events.iter().map(|(at, event, _)| (*at, *event)).collect::<Vec<_>>());
        let mut counter = Ls7366r::new(false, false, true);
        for ((at, event, late), expected) in events.into_iter().zip(expected) {
            let due = counter.deadline();
            if !late && due < tick(at) {
                counter.timeout(due);
            }
            counter.timeout(tick(at));
            match event {
                Event::Edge(channel, high) => counter.edge(tick(at), channel, high),
                Event::Mdr0(value) => counter.set_mdr0(value),
                Event::Mdr1(value) => counter.set_mdr1(value),
                Event::Dtr(value) => counter.set_dtr(value),
                Event::LoadCntr => counter.load_cntr(),
                Event::LoadOtr => counter.load_otr(),
                Event::ClearCntr => counter.clear_cntr(),
                Event::ClearStatus => counter.clear_status(),
                Event::Reversed(reversed) => counter.set_reversed(reversed),
                Event::Enabled(enabled) => counter.set_enabled(enabled),
            }
            let (status, happened) = (counter.status().into(), counter.take_events().into());
            let seen = [counter.cntr(), counter.otr(), counter.at_index(), status, happened];
            prop_assert_eq!(seen, expected, "{:?}", (at, event));
        }
    }

    #[test]
    fn many_steps_at_once_are_so_many_edges(
        mdr0 in 0..HALF_CLOCK,
        mdr1 in 0..DISABLE,
        dtr in some_count(),
        from_dtr in -3_000..3_000_i32,
        near in any::<bool>(),
        setting in (any::<bool>(), any::<bool>(), prop::bool::weighted(0.95), any::<bool>()),
        phase in 0..4_i32,
        quarters in prop_oneof![-5_000..5_000_i32, -60..60_i32],
    ) {
        let (low, reversed, enabled, borrowed) = setting;
        let mut shaft = Shaft::new(mdr0, mdr1, dtr);
        shaft.counter.set_reversed(reversed);
        shaft.turn(phase);
        if borrowed {
            shaft.turn(-4);
        }
        shaft.counter.take_events();
        shaft.edge(Index, !low);
        shaft.counter.set_enabled(enabled);
        let count = if near { dtr.wrapping_add_signed(from_dtr) } else { from_dtr as u32 };
        shaft = shaft.at(count);
        check_steps(&shaft, quarters)?;
    }
}
