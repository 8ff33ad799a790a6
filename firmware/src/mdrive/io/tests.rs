//! Scripts with times: the behaviour of I/O points that MC specifies, and its time.

use std::vec;
use std::vec::Vec;

use fixed::types::U24F8;
use proptest::prelude::*;

use super::super::ANALOG;
use super::*;
use crate::device::{Level, Output};
use crate::motion::{Limits, StepIterator};
use crate::testing::{Recorder, Treatment};

/// Recorder of levels. The I/O may make no other output.
fn recorder() -> Recorder {
    Recorder::default().ruled(|output| match output {
        Output::Level { .. } => Treatment::Keep,
        _ => Treatment::Refuse,
    })
}

/// The I/O with its present time.
struct Dut {
    io: Io,
    filters: Filters,
    out: Recorder,
    now: Instant,
}

fn at_ms(ms: u64) -> Instant {
    Instant::from(Duration::millis(ms))
}

fn at_us(us: u64) -> Instant {
    Instant::from(Duration::micros(us))
}

fn tick(ticks: u64) -> Instant {
    Instant::from_ticks(ticks)
}

impl Dut {
    fn new() -> Self {
        let filters = Filters { clock: 2, pulse: 10, ..Filters::NONE };
        let mut dut = Self { io: Io::OPEN, filters, out: recorder(), now: Instant::ZERO };
        dut.io.power_on(dut.now, true, &mut dut.out);
        dut.io.ready();
        dut.filter(|_| {});
        dut
    }

    /// Handles all deadlines before `at`, and at `at` if `inclusive`.
    fn wake(&mut self, at: Instant, inclusive: bool) {
        loop {
            let due = self.io.deadline();
            if due > at || due == at && !inclusive {
                break;
            }
            assert!(due >= self.now, "a deadline is not over when it is told");
            self.now = due;
            self.io.timeout(due, &mut self.out);
            assert!(self.io.deadline() > due || self.io.events.len() < EVENTS, "it makes no progress");
        }
        self.now = at;
    }

    /// Runs up to `at`, including the deadlines at that instant.
    fn at(&mut self, at: Instant) -> &mut Self {
        self.wake(at, true);
        self
    }

    fn edge(&mut self, at: Instant, pin: Pin, high: bool) {
        self.wake(at, false);
        self.io.edge(at, pin, high, &mut self.out);
    }

    fn open(&mut self, at: Instant, pin: Pin) {
        self.wake(at, false);
        self.io.opened(at, pin, &mut self.out);
    }

    fn set_up(&mut self, n: u8, values: [u16; 3]) -> Result<(), Error> {
        self.io.set_up(self.now, n, values, &mut self.out)
    }

    fn filter(&mut self, change: impl Fn(&mut Filters)) {
        change(&mut self.filters);
        self.io.set_filters(self.now, self.filters, &mut self.out);
    }

    fn write(&mut self, n: u8, active: bool) -> Result<(), Error> {
        self.io.write(self.now, n, active, &mut self.out)
    }

    fn show(&mut self, shown: StateFlags) {
        self.io.update_outputs(self.now, shown, &mut self.out);
    }

    fn follow(&mut self, plan: &Plan) {
        self.io.plan(self.now, plan, &mut self.out);
    }

    fn events(&mut self) -> Vec<Event> {
        core::iter::from_fn(|| self.io.next_event()).collect()
    }

    /// Levels that the I/O has put out since the last call.
    fn put(&mut self) -> Vec<(Instant, Pin, Level)> {
        core::mem::take(&mut self.out.levels)
    }

    fn active(&self) -> [bool; 4] {
        [1, 2, 3, 4].map(|n| self.io.is_active(n))
    }
}

#[test]
fn inputs_are_active_low_or_high_sinking_or_sourcing_driven_or_open() {
    // MC 5-63, 7.2.2: active low is active when grounded, active high at a voltage. An open sinking input is
    // pulled up, an open sourcing input is pulled down.
    for (active_high, sources, outside, level, active) in [
        (0, 0, Some(false), false, true),
        (0, 0, Some(true), true, false),
        (0, 0, None, true, false),
        (1, 0, Some(false), false, false),
        (1, 0, Some(true), true, true),
        (1, 0, None, true, true),
        (0, 1, Some(false), false, true),
        (0, 1, Some(true), true, false),
        (0, 1, None, false, true),
        (1, 1, Some(false), false, false),
        (1, 1, Some(true), true, true),
        (1, 1, None, false, false),
    ] {
        for (n, pin) in (1..=4).zip(PINS) {
            let mut dut = Dut::new();
            dut.set_up(n, [0, active_high, sources]).unwrap();
            // First the opposite level, so that the level has to change.
            dut.edge(at_us(1), pin, !level);
            assert_eq!(dut.io.is_active(n), !active);
            match outside {
                Some(high) => dut.edge(at_us(2), pin, high),
                None => dut.open(at_us(2), pin),
            }
            assert_eq!(dut.io.is_active(n), active, "{active_high} {sources} {outside:?}");
            // The other inputs are open and sink, so they are high. Levels do not depend on the active state
            // (MC 5-36, 5-37).
            let levels = if level { 0b1111 } else { 0b1111 ^ 1 << (n - 1) };
            assert_eq!(dut.io.levels(), levels);
            assert_eq!(dut.io.raw_levels(), levels);
            assert_eq!(dut.put(), [], "an input puts nothing out");
        }
    }
}

#[test]
fn an_output_drives_what_the_table_of_output_conditions_says() {
    use Level::{Float, High, Low};
    // MC 5-64: each row has the level for O = 1, then the level for O = 0.
    for (values, on, off) in [
        ([16, 1, 0], Float, Low),
        ([16, 0, 0], Low, Float),
        ([16, 1, 1], High, Float),
        ([16, 0, 1], Float, High),
    ] {
        let mut dut = Dut::new();
        dut.set_up(2, values).unwrap();
        let level = |dut: &mut Dut, before| {
            dut.put().last().map_or(before, |&(_, pin, level)| {
                assert_eq!(pin, IO2);
                level
            })
        };
        assert_eq!(level(&mut dut, Float), off);
        assert!(!dut.io.is_active(2));
        dut.write(2, true).unwrap();
        assert_eq!(level(&mut dut, off), on);
        assert!(dut.io.is_active(2));
        dut.write(2, true).unwrap();
        assert_eq!(dut.put(), [], "it is so already");
        dut.write(2, false).unwrap();
        assert_eq!(level(&mut dut, on), off);
        assert!(!dut.io.is_active(2));
    }
}

#[test]
fn the_level_of_an_output_is_what_it_drives_or_what_it_leaves_to_others() {
    let mut dut = Dut::new();
    // Active low, sinking: on is low.
    dut.set_up(1, [16, 0, 0]).unwrap();
    assert_eq!(dut.io.raw_levels(), 0b1111);
    dut.edge(at_us(1), IO1, false);
    assert_eq!(dut.io.raw_levels(), 0b1110);
    dut.edge(at_us(2), IO1, true);
    dut.write(1, true).unwrap();
    assert_eq!(dut.io.raw_levels(), 0b1110, "it sinks whatever somebody else does");
    assert_eq!(dut.io.levels(), 0b1110);
    // Active high, sourcing: off is pulled down.
    dut.set_up(4, [16, 1, 1]).unwrap();
    assert_eq!(dut.io.raw_levels(), 0b0110);
    dut.write(4, true).unwrap();
    assert_eq!(dut.io.raw_levels(), 0b1110);
}

#[test]
fn an_output_that_stays_one_stays_active() {
    let mut dut = Dut::new();
    dut.set_up(1, [16, 0, 0]).unwrap();
    dut.write(1, true).unwrap();
    dut.set_up(1, [16, 1, 1]).unwrap();
    assert!(dut.io.is_active(1));
    assert_eq!(dut.put(), [(Instant::ZERO, IO1, Level::Low), (Instant::ZERO, IO1, Level::High)]);
    // As an input it drives nothing, and as an output again it is inactive.
    dut.set_up(1, [0, 1, 1]).unwrap();
    dut.set_up(1, [16, 1, 1]).unwrap();
    assert!(!dut.io.is_active(1));
    assert_eq!(dut.put(), [(Instant::ZERO, IO1, Level::Float)]);
}

#[test]
fn what_cannot_be_set_up_is_refused_and_changes_nothing() {
    let mut dut = Dut::new();
    dut.set_up(1, [1, 1, 0]).unwrap();
    assert_eq!(dut.events(), [Event::Contact(Contact::Home, true), Event::Active(1)]);
    for kind in (9..=10).chain(12..=15).chain([22]).chain(26..=70).chain([255, u16::MAX]) {
        assert_eq!(dut.set_up(1, [kind, 0, 0]), Err(Error::IllegalType), "{kind}");
    }
    assert_eq!(dut.set_up(1, [0, 2, 0]), Err(Error::IllegalValue));
    assert_eq!(dut.set_up(1, [0, 0, 2]), Err(Error::IllegalValue));
    assert_eq!(dut.set_up(1, [9, 2, 2]), Err(Error::IllegalType), "the type is looked at first");
    assert_eq!(dut.io.contact(Contact::Home), Some(true));
    for n in [0, 5, 255] {
        assert_eq!(dut.set_up(n, [0, 0, 0]), Err(Error::IllegalIo));
        assert_eq!(dut.write(n, true), Err(Error::IllegalIo));
    }
    assert_eq!(dut.events(), []);
}

#[test]
fn a_type_is_given_once_but_the_general_ones() {
    // MC 9.1, error 6.
    for kind in [1, 2, 3, 4, 5, 6, 7, 8, 11, 17, 18, 19, 20, 21, 23, 24, 25] {
        let mut dut = Dut::new();
        dut.set_up(3, [kind, 0, 0]).unwrap();
        assert_eq!(dut.set_up(1, [kind, 0, 0]), Err(Error::TypeTaken), "{kind}");
        assert_eq!(dut.set_up(1, [kind, 2, 0]), Err(Error::IllegalValue), "values are looked at first");
        dut.set_up(3, [kind, 1, 1]).unwrap();
        dut.set_up(3, [0, 0, 0]).unwrap();
        dut.set_up(1, [kind, 0, 0]).unwrap();
    }
    let mut dut = Dut::new();
    for kind in [0, 16] {
        for n in 1..=4 {
            dut.set_up(n, [kind, 0, 0]).unwrap();
        }
    }
}

#[test]
fn only_a_general_purpose_output_can_be_written() {
    // MC 9.1, error 9.
    let mut dut = Dut::new();
    for kind in [0, 1, 2, 3, 4, 5, 6, 7, 8, 11, 17, 18, 19, 20, 21, 23, 24, 25] {
        dut.set_up(1, [kind, 0, 0]).unwrap();
        dut.put();
        assert_eq!(dut.write(1, true), Err(Error::NoOutput), "{kind}");
        assert_eq!(dut.put(), []);
    }
}

#[test]
fn an_input_counts_once_it_was_stable_for_its_time() {
    // MC 5-16: "must be stable for time amount of milliseconds before a change in state is detected".
    let mut dut = Dut::new();
    dut.filter(|filters| filters.debounce_ms = [0, 150, 0, 255]);
    dut.edge(at_ms(10), IO2, false);
    assert_eq!((dut.io.levels(), dut.io.raw_levels()), (0b1111, 0b1101), "IN is not debounced (MC 5-37)");
    dut.at(tick(at_ms(160).ticks() - 1));
    assert_eq!((dut.events(), dut.active()), (vec![], [false; 4]));
    dut.at(at_ms(160));
    assert_eq!(dut.events(), [Event::Active(2)]);
    assert_eq!((dut.active(), dut.io.levels()), ([false, true, false, false], 0b1101));
    // The input bounces, which restarts the debounce time.
    dut.edge(at_ms(200), IO2, true);
    dut.edge(at_ms(300), IO2, false);
    dut.edge(at_ms(301), IO2, true);
    dut.at(tick(at_ms(451).ticks() - 1));
    assert!(dut.io.is_active(2));
    dut.at(at_ms(451));
    assert!(!dut.io.is_active(2));
    assert_eq!(dut.events(), []);
    // A pulse of exactly the debounce time counts. A pulse one tick shorter does not.
    dut.edge(at_ms(1_000), IO4, false);
    dut.edge(at_ms(1_255), IO4, true);
    assert_eq!(dut.events(), [Event::Active(4)]);
    dut.at(at_ms(2_000));
    dut.edge(at_ms(2_000), IO4, false);
    dut.edge(tick(at_ms(2_255).ticks() - 1), IO4, true);
    dut.at(at_ms(3_000));
    assert_eq!(dut.events(), []);
    // Without a debounce time everything counts at once.
    dut.edge(at_ms(3_000), IO1, false);
    dut.edge(at_ms(3_000), IO1, true);
    assert_eq!(dut.events(), [Event::Active(1)]);
}

#[test]
fn contacts_tell_when_they_become_active_and_when_not() {
    for (kind, contact) in [
        (1, Contact::Home),
        (2, Contact::PlusLimit),
        (3, Contact::MinusLimit),
        (7, Contact::JogPlus),
        (8, Contact::JogMinus),
    ] {
        let mut dut = Dut::new();
        assert_eq!(dut.io.contact(contact), None);
        dut.set_up(3, [kind, 0, 0]).unwrap();
        assert_eq!(dut.io.contact(contact), Some(false));
        dut.edge(at_ms(1), IO3, false);
        assert_eq!(dut.io.contact(contact), Some(true));
        assert_eq!(dut.events(), [Event::Contact(contact, true), Event::Active(3)]);
        dut.open(at_ms(2), IO3);
        assert_eq!(dut.events(), [Event::Contact(contact, false)]);
        // A point that no longer has the type of the contact is not active as that contact.
        dut.edge(at_ms(3), IO3, false);
        dut.events();
        dut.set_up(3, [0, 0, 0]).unwrap();
        assert_eq!(dut.io.contact(contact), None);
        assert_eq!(dut.events(), [Event::Contact(contact, false), Event::Active(3)]);
    }
}

#[test]
fn what_an_input_asks_for_is_told_once_each_time_it_becomes_active() {
    for (kind, event) in [(4, Event::Go), (5, Event::SoftStop), (6, Event::Pause), (11, Event::Reset)] {
        let mut dut = Dut::new();
        dut.edge(at_ms(1), IO1, false);
        dut.events();
        dut.set_up(1, [kind, 1, 1]).unwrap();
        assert_eq!(dut.events(), []);
        for ms in [10, 20] {
            dut.edge(at_ms(ms), IO1, true);
            assert_eq!(dut.events(), [event, Event::Active(1)]);
            dut.edge(at_ms(ms + 1), IO1, false);
            assert_eq!(dut.events(), []);
        }
    }
}

/// MC 5-63: "If setting the input to sourcing, active true, ground the input first or a reset will occur." An
/// open pin is pulled up until it is set up so.
#[test]
fn a_reset_that_sources_resets_unless_it_is_grounded() {
    let reset = [Event::Reset, Event::Active(1)];
    let mut dut = Dut::new();
    dut.set_up(1, [11, 1, 1]).unwrap();
    assert_eq!(dut.events(), reset);
    let mut dut = Dut::new();
    dut.edge(at_ms(1), IO1, false);
    dut.events();
    dut.set_up(1, [11, 1, 1]).unwrap();
    assert_eq!(dut.events(), [], "grounded");
    // A pin that was pulled down before the set-up is low.
    let mut dut = Dut::new();
    dut.set_up(1, [0, 1, 1]).unwrap();
    dut.set_up(1, [11, 1, 1]).unwrap();
    assert_eq!(dut.events(), []);
    // Another type does nothing when the level falls. A reset input that is active low and sinks does
    // nothing, either.
    for set_up in [[5, 1, 1], [11, 0, 0]] {
        let mut dut = Dut::new();
        dut.set_up(1, set_up).unwrap();
        assert_eq!(dut.events(), [], "{set_up:?}");
    }
}

#[test]
fn an_input_that_is_active_when_it_is_set_up_becomes_so_once_it_has_settled() {
    // MC 5-63: "If setting the input to sourcing, active true, ground the input first or a reset will occur."
    let mut dut = Dut::new();
    dut.edge(at_ms(1), IO1, true);
    dut.set_up(1, [11, 1, 1]).unwrap();
    assert_eq!(dut.events(), [Event::Reset, Event::Active(1)]);
    dut.set_up(1, [11, 1, 1]).unwrap();
    assert_eq!(dut.events(), [], "that is no other set-up");
    // MC 5-64, note 2: "Once set wait debounce time before using an input."
    dut.edge(at_ms(2), IO1, false);
    dut.filter(|filters| filters.debounce_ms = [20, 0, 0, 0]);
    dut.set_up(1, [4, 0, 0]).unwrap();
    dut.at(tick(at_ms(22).ticks() - 1));
    assert_eq!((dut.events(), dut.io.is_active(1)), (vec![], false));
    dut.at(at_ms(22));
    assert_eq!((dut.events(), dut.io.is_active(1)), (vec![Event::Go, Event::Active(1)], true));
}

#[test]
fn another_active_state_makes_the_release_of_a_switch_an_activation() {
    // MC 8.7 measures the length of a switch in this way.
    let mut dut = Dut::new();
    dut.edge(at_ms(1), IO1, false);
    assert_eq!(dut.events(), [Event::Active(1)]);
    dut.set_up(1, [0, 1, 0]).unwrap();
    assert_eq!((dut.events(), dut.io.is_active(1)), (vec![], false));
    dut.edge(at_ms(2), IO1, true);
    assert_eq!((dut.events(), dut.io.is_active(1)), (vec![Event::Active(1)], true));
}

#[test]
fn what_is_held_when_set_ups_are_loaded_was_so_before() {
    let mut dut = Dut::new();
    dut.filter(|filters| filters.debounce_ms = [255; 4]);
    dut.edge(at_ms(1), IO1, false);
    dut.edge(at_ms(1), IO2, false);
    dut.io.begin_load();
    dut.set_up(1, [11, 0, 0]).unwrap();
    dut.set_up(2, [2, 0, 0]).unwrap();
    dut.set_up(3, [16, 0, 1]).unwrap();
    let now = dut.now;
    dut.io.end_load(now, &mut dut.out);
    assert_eq!(dut.events(), [Event::Contact(Contact::PlusLimit, true)]);
    assert_eq!(dut.active(), [true, true, false, false]);
    assert_eq!(dut.put(), [(at_ms(1), IO3, Level::High)]);
    dut.at(at_ms(1_000));
    assert_eq!(dut.events(), []);
}

#[test]
fn types_can_change_places_when_they_are_loaded() {
    let mut dut = Dut::new();
    dut.set_up(1, [1, 0, 0]).unwrap();
    dut.set_up(2, [17, 0, 0]).unwrap();
    dut.io.begin_load();
    dut.set_up(1, [17, 0, 0]).unwrap();
    dut.set_up(2, [1, 0, 0]).unwrap();
    assert_eq!(dut.set_up(3, [1, 0, 0]), Err(Error::TypeTaken));
    let now = dut.now;
    dut.io.end_load(now, &mut dut.out);
    assert_eq!(dut.io.contact(Contact::Home), Some(false));
}

#[test]
fn a_restart_lets_go_of_outputs_and_knows_the_levels() {
    let mut dut = Dut::new();
    dut.edge(at_ms(1), IO2, false);
    dut.edge(at_ms(1), CAPTURE, false);
    dut.edge(at_ms(1), IO7, false);
    dut.at(at_ms(2));
    dut.set_up(1, [16, 0, 0]).unwrap();
    dut.write(1, true).unwrap();
    dut.io.set_up_capture(dut.now, [61, 0], &mut dut.out).unwrap();
    dut.set_up(2, [2, 0, 0]).unwrap();
    dut.put();
    dut.events();
    dut.io.power_on(dut.now, false, &mut dut.out);
    assert_eq!(dut.put(), [(at_ms(2), CAPTURE, Level::Float), (at_ms(2), IO1, Level::Float)]);
    assert_eq!(dut.events(), []);
    assert_eq!((dut.io.raw_levels(), dut.active()), (0b1101, [false, true, false, false]));
    // The active limit is reported again, because the motion has forgotten it after the restart.
    dut.set_up(2, [2, 0, 0]).unwrap();
    assert_eq!(dut.events(), [Event::Contact(Contact::PlusLimit, true), Event::Active(2)]);
    // At power-on the I/O forgets all levels.
    dut.io.power_on(dut.now, true, &mut dut.out);
    assert_eq!((dut.io.raw_levels(), dut.active()), (0b1111, [false; 4]));
}

#[test]
fn outputs_with_a_type_show_what_is_so() {
    type Field = fn(&mut StateFlags) -> &mut bool;
    let fields: [(u16, Field); 8] = [
        (17, |shown| &mut shown.moving),
        (18, |shown| &mut shown.fault),
        (19, |shown| &mut shown.stall),
        (20, |shown| &mut shown.changing),
        (21, |shown| &mut shown.locked_rotor),
        (23, |shown| &mut shown.positioning),
        (24, |shown| &mut shown.hybrid),
        (25, |shown| &mut shown.is_making_up),
    ];
    for (kind, field) in fields {
        let mut dut = Dut::new();
        dut.set_up(4, [kind, 0, 0]).unwrap();
        for (other, field) in fields {
            let mut shown = StateFlags::default();
            *field(&mut shown) = true;
            dut.show(shown);
            assert_eq!(dut.io.is_active(4), kind == other);
            assert_eq!(dut.put().is_empty(), kind != other);
            dut.show(StateFlags::default());
            assert!(!dut.io.is_active(4));
            dut.put();
        }
        // Active low, sinking: the output drives low.
        let mut shown = StateFlags::default();
        *field(&mut shown) = true;
        dut.show(shown);
        assert_eq!(dut.put(), [(Instant::ZERO, IO4, Level::Low)]);
    }
}

/// Value of the variable I5 with this set-up and voltage.
fn reads(values: [u16; 2], mv: i32) -> u16 {
    let mut dut = Dut::new();
    dut.io.set_up_analogue(dut.now, values).unwrap();
    dut.io.voltage(dut.now, mv);
    dut.io.analogue(dut.now)
}

#[test]
fn the_analogue_input_reads_1023_at_full_scale() {
    // MC 5-34, 5-65: ranges in volts.
    for (mv, expected) in
        [(0, 0), (-1_000, 0), (2_500, 512), (5_000, 1_023), (5, 1), (2, 0), (900_000, 1_023)]
    {
        assert_eq!(reads([9, 0], mv), expected, "{mv} mV");
        assert_eq!(reads([9, 1], mv * 2), expected, "{mv} mV");
    }
    // Ranges in milliamperes, across 250 Ω; "512 would represent 10 mA".
    for (ma, expected) in [(0, 0), (4, 205), (10, 512), (20, 1_023), (25, 1_023)] {
        assert_eq!(reads([10, 0], ma * 250), expected, "{ma} mA");
        // "For 4 to 20 mA current mode, the range for I5 is 205 to 1023."
        assert_eq!(reads([10, 1], ma * 250), expected.max(205), "{ma} mA");
    }
    let mut dut = Dut::new();
    for kind in [0, 8, 11, 60] {
        assert_eq!(dut.io.set_up_analogue(dut.now, [kind, 0]), Err(Error::IllegalType));
    }
    assert_eq!(dut.io.set_up_analogue(dut.now, [9, 2]), Err(Error::IllegalValue));
}

#[test]
fn d5_averages_readings_of_every_millisecond() {
    // MC 5-17: with X = 10 each reading moves the average, which begins at 0, by 1/10 of the difference.
    for over in [2_u8, 10, 100, 255] {
        let mut dut = Dut::new();
        dut.filter(|filters| filters.average = over);
        dut.io.voltage(at_us(500), 5_000);
        let mut average = 0.0_f64;
        for ms in 0..3_000 {
            assert_eq!(dut.io.analogue(tick(at_ms(ms + 1).ticks() - 1)), average.round() as u16);
            average += (1_023.0 - average) / f64::from(over);
            let read = dut.io.analogue(at_ms(ms + 1));
            // If the average is near half a count, rounding errors decide the last digit.
            let near = (average.fract() - 0.5).abs() < 0.01;
            assert!(read == average.round() as u16 || near, "{over} {ms}: {read}, {average}");
            if near {
                dut.io.voltage(at_us(ms * 1_000 + 1_500), 5_000);
                break;
            }
        }
        // The average reaches the voltage, however long it is not read.
        assert_eq!(dut.io.analogue(at_ms(1_000_000_000)), 1_023);
    }
}

#[test]
fn an_average_goes_on_from_what_it_is() {
    let mut dut = Dut::new();
    dut.io.voltage(Instant::ZERO, 5_000);
    dut.at(at_ms(10));
    dut.filter(|filters| filters.average = 2);
    assert_eq!(dut.io.analogue(at_ms(10)), 1_023, "it begins with what is there");
    dut.io.voltage(tick(at_ms(20).ticks() + 1), 0);
    assert_eq!(dut.io.analogue(at_ms(20)), 1_023);
    assert_eq!(dut.io.analogue(at_ms(21)), 512, "511.5");
    assert_eq!(dut.io.analogue(at_ms(22)), 256, "255.75");
    // A voltage that changes at the instant of a reading is included in it.
    dut.io.voltage(at_ms(23), 5_000);
    assert_eq!(dut.io.analogue(at_ms(23)), 639, "(255.75 + 1023) / 2 = 639.375");
    dut.filter(|filters| filters.average = 0);
    assert_eq!(dut.io.analogue(at_ms(23)), 1_023);
}

#[test]
fn an_analogue_voltage_is_no_level() {
    let mut dut = Dut::new();
    dut.edge(at_ms(1), ANALOG, false);
    assert_eq!((dut.io.raw_levels(), dut.events()), (0b1111, vec![]));
}

/// A drive whose motor follows I/O 7 and 8, which are inputs of the type `code`.
fn follower(code: u16, active: [u16; 2], ratio: u16) -> Dut {
    let mut dut = Dut::new();
    dut.filter(|filters| (filters.clock, filters.ratio) = (0, ratio));
    dut.io.set_up_clock(dut.now, 7, [code, active[0]], &mut dut.out).unwrap();
    dut.io.set_up_clock(dut.now, 8, [code, active[1]], &mut dut.out).unwrap();
    dut.filter(|filters| filters.clocked = true);
    dut
}

impl Dut {
    /// Applies levels to I/O 7 and 8, at least a µs apart. Returns the steps after each.
    fn clock(&mut self, levels: &[(u8, u8)]) -> Vec<i32> {
        let mut steps = Vec::new();
        for &(seven, eight) in levels {
            let at = self.now + Duration::micros(1);
            self.edge(at, IO8, eight != 0);
            self.edge(at, IO7, seven != 0);
            self.at(at + Duration::micros(1));
            steps.push(
                self.events()
                    .iter()
                    .map(|event| match event {
                        Event::Clock(steps) => *steps,
                        other => panic!("{other:?}"),
                    })
                    .sum(),
            );
        }
        steps
    }
}

#[test]
fn the_motor_follows_step_and_direction() {
    // MC 5-66: I/O 7 makes a step when it becomes active, I/O 8 is the direction.
    let mut low = follower(33, [0, 0], 1_000);
    assert!(low.io.follows_clock());
    assert_eq!(low.clock(&[(1, 1), (0, 1), (1, 1), (0, 0), (1, 0), (0, 1)]), [0, 1, 0, -1, 0, 1]);
    let mut high = follower(33, [1, 1], 1_000);
    assert_eq!(high.clock(&[(1, 1), (0, 1), (1, 1), (0, 0), (1, 0), (0, 1)]), [0, 0, -1, 0, 1, 0]);
}

#[test]
fn the_motor_follows_a_quadrature() {
    // If I/O 7 leads, each edge is a step forward.
    let forward = [(1, 1), (0, 1), (0, 0), (1, 0), (1, 1), (0, 1)];
    assert_eq!(follower(34, [0, 0], 1_000).clock(&forward), [0, 1, 1, 1, 1, 1]);
    assert_eq!(follower(34, [1, 1], 1_000).clock(&forward), [0, 1, 1, 1, 1, 1]);
    let back = [(1, 1), (1, 0), (0, 0), (0, 1), (1, 1), (1, 0)];
    assert_eq!(follower(34, [0, 0], 1_000).clock(&back), [0, -1, -1, -1, -1, -1]);
    assert_eq!(follower(34, [1, 0], 1_000).clock(&back), [0, 1, 1, 1, 1, 1]);
}

#[test]
fn the_motor_follows_clocks_up_and_down() {
    let levels = [(1, 1), (0, 1), (1, 1), (1, 0), (1, 1), (1, 0)];
    assert_eq!(follower(35, [0, 0], 1_000).clock(&levels), [0, 1, 0, -1, 0, -1]);
    assert_eq!(follower(35, [1, 1], 1_000).clock(&levels), [0, 0, 1, 0, -1, 0]);
}

#[test]
fn the_clock_ratio_scales_what_comes_and_loses_nothing() {
    // MC 5-14: tests a ratio of one half, of one and a half, and of two.
    let pulses: Vec<(u8, u8)> = [(0, 1), (1, 1)].repeat(4);
    assert_eq!(follower(33, [0, 0], 500).clock(&pulses), [0, 0, 1, 0, 0, 0, 1, 0]);
    assert_eq!(follower(33, [0, 0], 1_500).clock(&pulses), [1, 0, 2, 0, 1, 0, 2, 0]);
    assert_eq!(follower(33, [0, 0], 2_000).clock(&pulses), [2, 0, 2, 0, 2, 0, 2, 0]);
    let mut thousandth = follower(33, [0, 0], 1);
    let there: i32 = thousandth.clock(&[(0, 1), (1, 1)].repeat(2_999)).iter().sum();
    assert_eq!(there, 2);
    let back: i32 = thousandth.clock(&[(0, 0), (1, 0)].repeat(2_999)).iter().sum();
    assert_eq!(back, -2);
}

#[test]
fn clock_inputs_do_nothing_without_cm() {
    let pulses: Vec<(u8, u8)> = [(0, 1), (1, 1)].repeat(4);
    let mut dut = follower(33, [0, 0], 1_000);
    dut.filter(|filters| filters.clocked = false);
    assert!(!dut.io.follows_clock());
    assert_eq!(dut.clock(&pulses), [0; 8]);
    dut.filter(|filters| filters.clocked = true);
    assert!(dut.io.follows_clock());
    for kind in [0, 32, 36, 48, 52, 60] {
        let refused = dut.io.set_up_clock(dut.now, 7, [kind, 0], &mut dut.out);
        assert_eq!(refused, Err(Error::IllegalClockType));
    }
    let refused = dut.io.set_up_clock(dut.now, 7, [33, 2], &mut dut.out);
    assert_eq!(refused, Err(Error::IllegalValue));
}

/// MC 5-66: "I/O 7 and I/O 8 are setup in pairs"; each point has its own active state.
#[test]
fn one_of_a_pair_sets_up_both() {
    let mut dut = follower(33, [0, 1], 1_000);
    dut.io.set_up_clock(dut.now, 8, [35, 0], &mut dut.out).unwrap();
    assert_eq!(dut.clock(&[(0, 1), (1, 1), (1, 0)]), [1, 0, -1], "up and down");
    dut.io.set_up_clock(dut.now, 7, [49, 0], &mut dut.out).unwrap();
    assert!(!dut.io.follows_clock(), "outputs");
}

#[test]
fn fm_and_fc_let_pass_what_is_at_least_as_long_as_their_pulse() {
    // MC 5-25, 5-26, in ticks of 62.5 ns, rounded up.
    let ticks = [1, 3, 4, 5, 8, 15, 28, 53, 104, 207];
    for (filter, least) in (0..=9).zip(ticks) {
        for (length, passes) in [(least, true), (least - 1, false)] {
            if length == 0 {
                continue;
            }
            let mut dut = follower(33, [0, 0], 1_000);
            dut.filter(|filters| (filters.clock, filters.capture) = (filter, filter));
            dut.edge(tick(1_000), IO7, false);
            dut.edge(tick(1_000 + length), IO7, true);
            dut.at(tick(2_000));
            assert_eq!(dut.events(), if passes { vec![Event::Clock(1)] } else { vec![] }, "FM {filter}");
            dut.edge(tick(3_000), CAPTURE, false);
            dut.edge(tick(3_000 + length), CAPTURE, true);
            let captured = vec![Event::Capture];
            assert_eq!(dut.events(), if passes { captured } else { vec![] }, "FC {filter}");
            dut.at(tick(4_000));
            assert_eq!(dut.events(), []);
        }
    }
}

#[test]
fn a_capture_comes_of_the_edge_to_its_active_level() {
    let mut dut = Dut::new();
    dut.edge(at_us(10), CAPTURE, false);
    dut.at(tick(160));
    assert_eq!(dut.events(), []);
    dut.at(tick(161));
    assert_eq!(dut.events(), [Event::Capture]);
    dut.io.set_up_capture(dut.now, [60, 1], &mut dut.out).unwrap();
    assert_eq!(dut.events(), []);
    dut.edge(at_us(30), CAPTURE, true);
    dut.at(tick(480));
    assert_eq!(dut.events(), []);
    dut.at(tick(481));
    assert_eq!(dut.events(), [Event::Capture]);
    dut.edge(at_us(40), CAPTURE, false);
    dut.at(at_us(50));
    assert_eq!(dut.events(), []);
    assert_eq!(dut.put(), []);
    for kind in [0, 59, 62] {
        let refused = dut.io.set_up_capture(dut.now, [kind, 0], &mut dut.out);
        assert_eq!(refused, Err(Error::IllegalType));
    }
    let refused = dut.io.set_up_capture(dut.now, [60, 2], &mut dut.out);
    assert_eq!(refused, Err(Error::IllegalValue));
}

#[test]
fn a_trip_output_is_active_for_the_clock_width() {
    // MC 5-15: CW x 50 ns; 100 are 5 µs.
    for (active, idle, pulse) in [(0, Level::High, Level::Low), (1, Level::Low, Level::High)] {
        for (width, ticks) in [(100, 80), (10, 8), (1, 1), (0, 1), (255, 204)] {
            let mut dut = Dut::new();
            dut.filter(|filters| filters.pulse = width);
            dut.io.set_up_capture(dut.now, [61, active], &mut dut.out).unwrap();
            assert_eq!(dut.put(), [(Instant::ZERO, CAPTURE, idle)]);
            dut.at(at_us(10));
            dut.io.pulse(dut.now, &mut dut.out);
            dut.at(at_us(100));
            assert_eq!(dut.put(), [(tick(160), CAPTURE, pulse), (tick(160 + ticks), CAPTURE, idle)]);
        }
    }
    // A capture input makes no pulses, and a trip output captures nothing.
    let mut dut = Dut::new();
    dut.io.pulse(dut.now, &mut dut.out);
    assert_eq!(dut.put(), []);
    dut.io.set_up_capture(dut.now, [61, 0], &mut dut.out).unwrap();
    dut.edge(at_us(1), CAPTURE, false);
    dut.at(at_us(2));
    assert_eq!(dut.events(), []);
}

/// I/O 7 and 8 as outputs of a code, with the plan of a motor at rest.
fn teller(code: u16, active: [u16; 2]) -> Dut {
    let mut dut = follower(code, active, 1_000);
    assert!(!dut.io.follows_clock());
    assert!(dut.io.wants_plan());
    dut.follow(&Plan::at_rest(Instant::ZERO, 0));
    assert!(!dut.io.wants_plan());
    dut
}

/// Moves by `steps` and back at 1,000 steps/s; the first move begins at 1 ms.
fn there_and_back(dut: &mut Dut, steps: i32) {
    let rates = Limits::even(U24F8::from_num(1_000), 1_000_000);
    for (ms, from, by) in [(1, 0, steps), (101, steps, -steps)] {
        dut.at(at_ms(ms));
        let plan = Plan::profile(dut.now, from, by, rates);
        dut.follow(&plan);
    }
    dut.at(at_ms(200));
}

#[test]
fn step_and_direction_are_told_with_the_clock_width() {
    let mut dut = teller(49, [0, 1]);
    // At rest I/O 7 is inactive (high), and I/O 8 shows forward (low).
    assert_eq!(dut.put(), [(Instant::ZERO, IO8, Level::Low), (Instant::ZERO, IO7, Level::High)]);
    there_and_back(&mut dut, 2);
    let rates = Limits::even(U24F8::from_num(1_000), 1_000_000);
    let mut expected = Vec::new();
    for (ms, from, by) in [(1, 0, 2), (101, 2, -2)] {
        let mut walker = StepIterator::new(&Plan::profile(at_ms(ms), from, by, rates), at_ms(ms));
        let steps: Vec<Instant> = walker.by_ref().map(|step| step.at).collect();
        assert_eq!(steps.len(), 2);
        if by < 0 {
            // The direction changes 5 µs before the first step.
            expected.push((tick(steps[0].ticks() - 80), IO8, Level::High));
        }
        for step in steps {
            expected.push((step, IO7, Level::Low));
            expected.push((tick(step.ticks() + 8), IO7, Level::High));
        }
    }
    assert_eq!(dut.put(), expected);
}

#[test]
fn clocks_up_and_down_are_told_at_their_own_point() {
    let mut dut = teller(51, [1, 1]);
    dut.put();
    there_and_back(&mut dut, 3);
    let rises: Vec<Pin> =
        dut.put().iter().filter(|(_, _, level)| *level == Level::High).map(|&(_, pin, _)| pin).collect();
    assert_eq!(rises, [IO7, IO7, IO7, IO8, IO8, IO8]);
}

#[test]
fn a_quadrature_is_told_with_an_edge_for_each_step() {
    use Level::{High, Low};
    let mut dut = teller(50, [1, 1]);
    assert_eq!(dut.put().len(), 2);
    there_and_back(&mut dut, 5);
    let edges: Vec<(Pin, Level)> = dut.put().iter().map(|&(_, pin, level)| (pin, level)).collect();
    let there = [(IO7, High), (IO8, High), (IO7, Low), (IO8, Low), (IO7, High)];
    let back = [(IO7, Low), (IO8, High), (IO7, High), (IO8, Low), (IO7, Low)];
    assert_eq!(edges, [there, back].concat());
}

#[test]
fn fast_pulses_last_half_of_their_period() {
    // 5,000,000 steps/s: 3.2 ticks each. The width of CW = 10 would be 8 ticks.
    let mut dut = teller(49, [1, 1]);
    dut.put();
    let rates = Limits {
        start_speed: U24F8::from_num(5_000_000),
        ..Limits::even(U24F8::from_num(5_000_000), 1_000_000)
    };
    dut.follow(&Plan::profile(dut.now, 0, 1_000, rates));
    dut.at(at_ms(10));
    let put = dut.put();
    assert_eq!(put.len(), 2_000);
    for (pulse, next) in put.chunks(2).zip(put.chunks(2).skip(1)) {
        let [(rise, _, Level::High), (fall, _, Level::Low)] = *pulse else { panic!("{pulse:?}") };
        let half = next[0].0.since(rise).ticks() / 2;
        assert_eq!(fall.since(rise).ticks(), half.max(1));
    }
}

#[test]
fn without_cm_clock_outputs_are_let_go() {
    let mut dut = teller(49, [0, 0]);
    dut.put();
    dut.filter(|filters| filters.clocked = false);
    assert_eq!(dut.put(), [(Instant::ZERO, IO7, Level::Float), (Instant::ZERO, IO8, Level::Float)]);
    there_and_back(&mut dut, 5);
    assert_eq!(dut.put(), []);
    // Switched on in the middle of a motion, the outputs show the remaining steps.
    let plan = Plan::profile(dut.now, 0, 10, Limits::even(U24F8::from_num(1_000), 1_000_000));
    dut.at(at_ms(200) + Duration::micros(5_500));
    dut.filter(|filters| filters.clocked = true);
    assert!(dut.io.wants_plan());
    let left = 10 - plan.position_at(dut.now);
    dut.follow(&plan);
    dut.put();
    dut.at(at_ms(300));
    assert_eq!(dut.put().len(), 2 * left as usize);
}

/// Actions of the random test.
#[derive(Clone, Debug)]
enum Act {
    Edge(u8, bool),
    Open(u8),
    SetUp(u8, [u16; 3]),
    Write(u8, bool),
    Debounce([u8; 4]),
    Load,
    Restart,
    Show(bool),
    Pulse,
}

fn acts() -> impl Strategy<Value = Act> {
    let kind = prop_oneof![Just(0_u16), Just(16), 0..30_u16];
    prop_oneof![
        6 => (0..11_u8, any::<bool>()).prop_map(|(pin, high)| Act::Edge(pin, high)),
        2 => (0..11_u8).prop_map(Act::Open),
        3 => (0..6_u8, kind, 0..3_u16, 0..2_u16).prop_map(|(n, a, b, c)| Act::SetUp(n, [a, b, c])),
        2 => (0..6_u8, any::<bool>()).prop_map(|(n, on)| Act::Write(n, on)),
        1 => any::<[u8; 4]>().prop_map(|ms| Act::Debounce(ms.map(|ms| ms & 3))),
        1 => Just(Act::Load),
        1 => Just(Act::Restart),
        1 => any::<bool>().prop_map(Act::Show),
        1 => Just(Act::Pulse),
    ]
}

proptest! {
    #[test]
    fn whatever_happens_contacts_are_as_they_were_told_and_every_deadline_comes(
        script in prop::collection::vec((0..100_000_u64, acts()), 0..60)
    ) {
        let mut dut = Dut::new();
        let mut told = [false; 5];
        for (later, act) in script {
            dut.at(dut.now + Duration::from_ticks(later));
            let now = dut.now;
            let Dut { io, out, filters, .. } = &mut dut;
            match act {
                Act::Edge(pin, high) => io.edge(now, Pin(pin), high, out),
                Act::Open(pin) => io.opened(now, Pin(pin), out),
                Act::SetUp(n, values) => drop(io.set_up(now, n, values, out)),
                Act::Write(n, on) => drop(io.write(now, n, on, out)),
                Act::Debounce(ms) => {
                    filters.debounce_ms = ms;
                    io.set_filters(now, *filters, out);
                }
                Act::Load => {
                    io.begin_load();
                    io.end_load(now, out);
                }
                Act::Restart => {
                    io.power_on(now, false, out);
                    io.ready();
                    told = [false; 5];
                }
                Act::Show(on) => io.update_outputs(now, StateFlags { moving: on, fault: !on, ..StateFlags::default() }, out),
                Act::Pulse => io.pulse(now, out),
            }
            prop_assert!(io.deadline() > now);
            prop_assert!(io.events.len() < EVENTS);
            for event in dut.events() {
                if let Event::Contact(contact, active) = event {
                    let place = CONTACTS.iter().position(|&known| known == contact).unwrap();
                    prop_assert!(told[place] != active, "it is told once");
                    told[place] = active;
                }
            }
            for (place, contact) in CONTACTS.into_iter().enumerate() {
                prop_assert_eq!(dut.io.contact(contact) == Some(true), told[place]);
            }
        }
        // After the longest debounce time, debounced levels equal the levels at the pins.
        dut.at(dut.now + Duration::millis(256));
        prop_assert_eq!(dut.io.levels(), dut.io.raw_levels());
        prop_assert_eq!(dut.io.deadline(), Instant::NEVER);
    }
}
