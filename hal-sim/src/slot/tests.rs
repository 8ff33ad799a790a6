//! Pulses on pins that also serve other purposes.

use drivetwin_firmware::device::{AxisSpec, Context, Input, Output, PinSpec, Plan, Role};
use drivetwin_firmware::motion::Limits;
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::Span;
use fixed::types::I24F8;
use proptest::prelude::*;

use super::*;
use crate::bench::{Bench, DriveId, PowerAction, Settings};
use crate::export::vcd;
use crate::record::trace::{Event, Retention};
use crate::signals::pulses::Pulse;

drivetwin_protocol::registers! {
    /// Registers of a lender, a device that lends its pins.
    enum Reg: HighFirst {
        /// 0 to 2: STEP low, high, floating. 3 to 5: the same for DIR. 6: a plan without motion. 7 and 8: a
        /// plan of two steps, forward and backward. 9 and 10: a wave on STEP, on DIR. 11: 200,000 steps/s at
        /// once. Reads as the number of edges received.
        Do = rw(0, "1"),
    }
}

const STEP: Pin = Pin(0);
const DIR: Pin = Pin(1);
const MOTOR: Axis = Axis(0);

static SPEC: Spec = Spec {
    kind: "lender",
    product: "an axis that lends its pins",
    manual: "this file",
    pins: &[PinSpec::new("STEP", Role::Both, Level::High), PinSpec::new("DIR", Role::Both, Level::High)],
    axes: &[AxisSpec { name: "motor", step_dir: Some((STEP, DIR)) }],
    registers: Reg::TABLE,
    ..Spec::EMPTY
};

#[derive(Default)]
struct Lender {
    edges: i64,
}

impl Device for Lender {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }

    fn power_on(&mut self, _at: Instant, _boot: Boot, _out: &mut dyn Context) {
        self.edges = 0;
    }

    fn input(&mut self, _at: Instant, input: Input<'_>, _out: &mut dyn Context) {
        self.edges += i64::from(matches!(input, Input::Edge { .. }));
    }

    fn deadline(&self) -> Instant {
        Instant::NEVER
    }

    fn timeout(&mut self, _at: Instant, _out: &mut dyn Context) {}

    fn peek(&self, _at: Instant, _row: usize) -> i64 {
        self.edges
    }

    fn poke(
        &mut self,
        at: Instant,
        _row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let pin = if matches!(value, 3..=5 | 10) { DIR } else { STEP };
        let steps = match value {
            7 => 2,
            8 => -2,
            _ => 0,
        };
        // The first step comes after sqrt(2/200) s, the second and last one after the same time again.
        let plan = match value {
            11 => {
                let ramp = Plan::at_rest(at - 1.millis(), 0);
                ramp.ramp_to(at - 1.millis(), I24F8::from_num(200_000), i32::MAX as u32).continued_from(at, 0)
            }
            _ => Plan::profile(at, 0, steps, Limits::even(1_000_u16.into(), 200)),
        };
        out.put(
            at,
            match value {
                0 | 3 => Output::Level { pin, level: Level::Low },
                1 | 4 => Output::Level { pin, level: Level::High },
                2 | 5 => Output::Level { pin, level: Level::Float },
                9 | 10 => Output::Wave { pin, period: 10.millis(), high: 4.millis() },
                _ => Output::Plan { axis: MOTOR, plan: &plan },
            },
        );
        Ok(())
    }
}

/// A bench with a lender that is powered on, and a second lender `ear` that receives its signals.
struct Fixture {
    bench: Bench,
    lender: DriveId,
    ear: DriveId,
}

impl Fixture {
    fn new(wired: bool) -> Self {
        let mut bench = Bench::with(Settings { trace: Retention::All, ..Settings::default() });
        let (lender, ear) = (bench.add::<Lender>("lender"), bench.add::<Lender>("ear"));
        bench.run_until(1.millis());
        let mut fixture = Self { bench, lender, ear };
        if wired {
            fixture.wire();
        }
        fixture
    }

    fn wire(&mut self) {
        for pin in [STEP, DIR] {
            self.bench.wire((self.lender, pin), (self.ear, pin));
        }
    }

    /// Gives the lender an order at a time in ms.
    fn poke(&mut self, ms: u64, what: u8) {
        self.bench.run_until(ms.millis());
        self.bench.poke(self.lender, 0, what.into()).unwrap();
    }

    fn levels(&self, drive: DriveId) -> [Level; 2] {
        [STEP, DIR].map(|pin| self.bench.level(drive, pin))
    }

    /// Inputs that `ear` has received by a time in ms: pin, level and time in µs, without the tick of delay
    /// of a wire.
    fn received(&mut self, ms: u64) -> Vec<String> {
        self.bench.run_until(ms.millis());
        let ear = self.ear.0 as usize;
        let edges = self.bench.trace().events().filter(|entry| entry.drive == ear);
        edges
            .filter_map(|entry| match entry.event {
                Event::Input(InputRecord::Edge { pin, high }) => {
                    let name = if pin == STEP { 'S' } else { 'D' };
                    let micros = (entry.at.ticks() - 1) as f64 / 16.0;
                    Some(format!("{name}{} {micros}", if high { '+' } else { '-' }))
                }
                _ => None,
            })
            .collect()
    }
}

/// Rise and fall of each pulse in µs, and true if it is forward.
fn pulses(fixture: &Fixture) -> Vec<(f64, f64, bool)> {
    let micros = |at: Instant| at.ticks() as f64 / 16.0;
    let pulses = fixture.bench.pulses(fixture.lender.step());
    pulses.map(|Pulse { rise, fall, forward }| (micros(rise), micros(fall), forward)).collect()
}

#[test]
fn a_plan_takes_pins_that_were_let_go() {
    let mut fixture = Fixture::new(true);
    assert_eq!(fixture.levels(fixture.lender), [Level::High; 2]);
    fixture.poke(10, 7);
    assert_eq!(fixture.levels(fixture.lender), [Level::Low; 2]);
    let received = ["S- 10000", "D- 10000", "D+ 109995", "S+ 110000", "S- 110002", "S+ 210000", "S- 210002"];
    assert_eq!(fixture.received(500), received);
    assert_eq!(pulses(&fixture), [(110_000.0, 110_002.0, true), (210_000.0, 210_002.0, true)]);
}

#[test]
fn a_level_takes_its_pin_until_the_next_plan() {
    let mut fixture = Fixture::new(true);
    fixture.poke(10, 7);
    fixture.poke(150, 1);
    assert_eq!(fixture.levels(fixture.lender), [Level::High; 2]);
    // The second step does not appear at the pin. The axis kept DIR, which has been high since the first
    // step.
    let before = fixture.received(299).len();
    assert_eq!(fixture.received(299)[before - 1], "S+ 150000");
    fixture.poke(300, 8);
    fixture.poke(600, 5);
    fixture.poke(700, 2);
    let received = [
        "S- 300000",
        "D- 399995",
        "S+ 400000",
        "S- 400002",
        "S+ 500000",
        "S- 500002",
        "D+ 600000",
        "S+ 700000",
    ];
    assert_eq!(fixture.received(900)[before..], received);
    let expected =
        [(110_000.0, 110_002.0, true), (400_000.0, 400_002.0, false), (500_000.0, 500_002.0, false)];
    assert_eq!(pulses(&fixture), expected);
}

#[test]
fn the_direction_is_low_when_a_plan_takes_it() {
    for (wired, late) in [(true, false), (false, true), (false, false)] {
        let mut fixture = Fixture::new(wired);
        fixture.poke(10, 7);
        fixture.poke(300, 4);
        if late {
            fixture.wire();
        }
        // The last step was forward, but DIR is low now, so the next plan must raise it again.
        fixture.poke(400, 7);
        fixture.bench.run_until(499.millis());
        assert_eq!(fixture.levels(fixture.lender), [Level::Low; 2]);
        fixture.bench.run_until(550.millis());
        assert_eq!(fixture.levels(fixture.lender), [Level::Low, Level::High]);
    }
}

#[test]
fn a_plan_that_turns_the_direction_at_once_is_heard() {
    let mut fixture = Fixture::new(true);
    for what in [0, 3] {
        fixture.poke(5, what);
    }
    fixture.poke(10, 11);
    fixture.bench.run_until(10_003.micros());
    // In the 1 ms before, of which 93 µs were a ramp, the plan made 190.687 steps; so the next step is 1.57
    // µs away.
    assert_eq!(fixture.received(10)[2..], ["D+ 10000", "S+ 10001.5625"]);
    assert_eq!(fixture.levels(fixture.ear), fixture.levels(fixture.lender));
}

#[test]
fn a_level_cuts_a_pulse_off() {
    let mut fixture = Fixture::new(true);
    fixture.poke(10, 7);
    fixture.bench.run_until(110_001.micros());
    fixture.bench.poke(fixture.lender, 0, 0).unwrap();
    assert_eq!(fixture.received(400)[3..], ["S+ 110000", "S- 110001"]);
    assert_eq!(pulses(&fixture), [(110_000.0, 110_001.0, true)]);
    // A plan does not restore the rest of the pulse.
    let mut fixture = Fixture::new(true);
    fixture.poke(10, 7);
    fixture.bench.run_until(110_001.micros());
    for what in [1, 6] {
        fixture.bench.poke(fixture.lender, 0, what).unwrap();
    }
    assert_eq!(fixture.levels(fixture.lender), [Level::Low, Level::High]);
}

#[test]
fn a_pin_that_is_let_go_is_an_input() {
    let mut fixture = Fixture::new(false);
    fixture.bench.wire((fixture.ear, STEP), (fixture.lender, STEP));
    fixture.poke(10, 6);
    fixture.poke(20, 2);
    let edges = fixture.bench.peek(fixture.lender, 0);
    fixture.bench.run_until(30.millis());
    // The other drive pulls the pin low, and then releases it.
    for (ms, what, level) in [(40, 0, Level::Low), (50, 2, Level::High)] {
        fixture.bench.run_until(ms.millis());
        fixture.bench.poke(fixture.ear, 0, what).unwrap();
        fixture.bench.run_until((ms + 1).millis());
        assert_eq!(fixture.bench.level(fixture.lender, STEP), level);
    }
    assert_eq!(fixture.bench.peek(fixture.lender, 0), edges + 2);
}

#[test]
fn without_power_the_pins_are_let_go() {
    let mut fixture = Fixture::new(true);
    fixture.poke(10, 7);
    fixture.bench.run_until(150.millis());
    fixture.bench.power(fixture.lender, PowerAction::Off);
    fixture.bench.run_until(151.millis());
    assert_eq!(fixture.levels(fixture.lender), [Level::High; 2]);
    fixture.bench.power(fixture.lender, PowerAction::On);
    fixture.bench.run_until(300.millis());
    assert_eq!(fixture.levels(fixture.lender), [Level::High; 2]);
    // DIR was high already. STEP rises when it is released.
    assert_eq!(fixture.received(500).last().unwrap(), "S+ 150000");
    assert_eq!(pulses(&fixture).len(), 1);
}

/// The level of the lender's STEP or DIR at `at` in a file of waveforms.
fn shown(file: &str, pin: Pin, at: Instant) -> Level {
    let code = if pin == STEP { '!' } else { '"' };
    let (mut stamp, mut level) = (0, None);
    for line in file.lines() {
        if let Some(units) = line.strip_prefix('#') {
            stamp = units.parse::<u64>().unwrap();
        } else if stamp <= at.ticks() * 125 / 2 && line.len() == 2 && line.ends_with(code) {
            level = line.chars().next();
        }
    }
    match level {
        Some('0') => Level::Low,
        Some('1') => Level::High,
        other => panic!("{other:?} at {at:?}"),
    }
}

proptest! {
    #[test]
    fn wires_levels_and_waveforms_agree(
        orders in proptest::collection::vec((1_u64..150, 0_u8..11, 0_u64..100), 1..20),
    ) {
        let (mut fixture, mut except) = (Fixture::new(true), Fixture::new(false));
        let mut samples = Vec::new();
        let mut ms = 1;
        for (wait, what, sample) in orders {
            ms += wait;
            for fixture in [&mut fixture, &mut except] {
                // Orders are given 0.3 ms after whole milliseconds; steps come whole milliseconds after the
                // start of a plan.
                fixture.bench.run_until((1_000 * ms + 300).micros());
                fixture.bench.poke(fixture.lender, 0, what.into()).unwrap();
            }
            let at = Instant::from((1_000 * ms + 300).micros()) + (sample * sample * 15).micros();
            let levels = [&mut fixture, &mut except].map(|fixture| {
                fixture.bench.run_until(at);
                fixture.levels(fixture.lender)
            });
            prop_assert_eq!(levels[0], levels[1], "{:?}", at);
            fixture.bench.run_until(at + Duration::TICK);
            prop_assert_eq!(fixture.levels(fixture.ear), levels[0], "{:?}", at);
            samples.push((at, levels[0]));
            ms += sample * sample * 15 / 1_000 + 1;
        }
        fixture.bench.run_until(ms.millis());
        let mut file = Vec::new();
        vcd::write(fixture.bench.trace(), &mut file).unwrap();
        let file = String::from_utf8(file).unwrap();
        for (at, levels) in samples {
            prop_assert_eq!([STEP, DIR].map(|pin| shown(&file, pin, at)), levels, "{:?}", at);
        }
    }
}
