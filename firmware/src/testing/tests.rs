use std::vec;
use std::vec::Vec;

use drivetwin_protocol::line::{Line, Parity};
use drivetwin_protocol::registers::Register;

use super::{Fixture, Recorder, Transcript, Treatment};
use crate::device::{
    Axis, Boot, Context, Device, DropReason, Duration, Encoder, Input, Instant, Level, Link, LogEvent,
    Output, Pin, Plan, Port, PresetError, Spec,
};

const AT: Instant = Instant::from_ticks(5);
const LATER: Instant = Instant::from_ticks(7);
const LINE: Line = Line::new(9_600, 8, Parity::Even, 1);
const NOTE: LogEvent = LogEvent::Dropped { port: Port(1), why: DropReason::Crc };

/// Puts one output of each kind.
fn put_all(out: &mut dyn Context) {
    let (axis, pin, port, link) = (Axis(0), Pin(3), Port(1), Link(2));
    let plan = Plan::at_rest(AT, 40);
    for output in [
        Output::Bytes { port, bytes: &[1, 2] },
        Output::Message { port, link, bytes: &[3] },
        Output::Close { port, link },
        Output::Line { port, line: LINE },
        Output::Level { pin, level: Level::High },
        Output::Wave { pin, period: Duration::millis(2), high: Duration::millis(1) },
        Output::Plan { axis, plan: &plan },
        Output::Step { axis, steps: -4 },
        Output::CurrentLimit { axis, ma: 500 },
        Output::Duty { axis, duty: -600 },
        Output::Store { offset: 1, bytes: &[8, 9] },
        Output::Log(NOTE),
    ] {
        out.put(AT, output);
    }
}

#[test]
fn a_recorder_keeps_each_kind() {
    let mut out = Recorder::new(4);
    put_all(&mut out);
    let (axis, pin, port, link) = (Axis(0), Pin(3), Port(1), Link(2));
    assert_eq!(out.bytes, [(AT, port, vec![1, 2])]);
    assert_eq!(out.sent(port), [(AT, vec![1, 2])]);
    assert_eq!(out.sent(Port(0)), []);
    assert_eq!(out.messages, [(AT, port, link, vec![3])]);
    assert_eq!(out.closed, [(AT, port, link)]);
    assert_eq!(out.lines, [(AT, port, LINE)]);
    assert_eq!(out.levels, [(AT, pin, Level::High)]);
    assert_eq!((out.level(pin), out.level(Pin(0))), (Some(Level::High), None));
    assert_eq!(out.waves, [(AT, pin, Duration::millis(2), Duration::millis(1))]);
    assert_eq!(out.plans, [(AT, axis, Plan::at_rest(AT, 40))]);
    assert_eq!((out.plan(), out.steps_since_plan()), (Plan::at_rest(AT, 40), -4));
    assert_eq!(out.steps, [(AT, axis, -4)]);
    assert_eq!(out.currents, [(AT, axis, 500)]);
    assert_eq!(out.duties, [(AT, axis, -600)]);
    assert_eq!(out.stores, [(AT, 1, vec![8, 9])]);
    assert_eq!(out.stored(), [(AT, 1, 2)]);
    assert_eq!((&out.notes[..], &out.noted()[..]), (&[(AT, NOTE)][..], &[NOTE][..]));
    assert_eq!(out.memory(), [0xFF, 8, 9, 0xFF]);
}

#[test]
fn steps_count_from_the_last_plan() {
    let mut out = Recorder::default();
    let axis = Axis(0);
    for (steps, since) in [(3, 3), (-1, 2)] {
        out.put(AT, Output::Step { axis, steps });
        assert_eq!(out.steps_since_plan(), since);
    }
    out.put(AT, Output::Plan { axis, plan: &Plan::at_rest(AT, 0) });
    assert_eq!((out.steps_since_plan(), out.steps.len()), (0, 2));
}

#[test]
fn a_clear_leaves_memory_rule_and_limit() {
    let mut out = Recorder::new(4).ruled(|output| match output {
        Output::Level { .. } => Treatment::Ignore,
        _ => Treatment::Keep,
    });
    out.bytes_left = 1;
    put_all(&mut out);
    out.clear();
    assert_eq!((out.bytes.len(), out.notes.len(), out.steps_since_plan()), (0, 0, 0));
    assert_eq!((out.memory(), out.bytes_left), (&[0xFF, 8, 0xFF, 0xFF][..], 0));
    put_all(&mut out);
    assert_eq!((out.levels.len(), out.bytes.len()), (0, 1));
}

#[test]
fn a_recorder_of_its_memory_alone_keeps_nothing_else() {
    let mut out = Recorder::new(4).memory_only();
    put_all(&mut out);
    assert_eq!(out.memory, [0xFF, 8, 9, 0xFF]);
    assert!(out.stores.is_empty() && out.bytes.is_empty() && out.notes.is_empty());
}

#[test]
#[should_panic(expected = "must not put Level")]
fn an_output_that_is_refused_fails_the_test() {
    put_all(&mut Recorder::new(4).ruled(|output| match output {
        Output::Level { .. } => Treatment::Refuse,
        _ => Treatment::Ignore,
    }));
}

#[test]
fn power_can_be_lost_at_any_byte_of_a_store() {
    for left in 0..=5 {
        let mut out = Recorder::new(6);
        out.bytes_left = left;
        out.put(AT, Output::Store { offset: 1, bytes: &[1, 2, 3] });
        out.put(LATER, Output::Store { offset: 4, bytes: &[4, 5] });
        let expected: Vec<u8> =
            [0xFF].into_iter().chain((1..=5).take(left)).chain([0xFF; 5]).take(6).collect();
        assert_eq!((out.memory(), out.bytes_left), (&expected[..], 0), "{left} bytes");
        assert_eq!(out.stores, [(AT, 1, vec![1, 2, 3]), (LATER, 4, vec![4, 5])]);
    }
}

#[test]
#[should_panic(expected = "out of range")]
fn a_store_behind_the_memory_fails_even_without_power() {
    let mut out = Recorder::new(4);
    out.bytes_left = 0;
    out.put(AT, Output::Store { offset: 3, bytes: &[1, 2] });
}

#[test]
fn a_transcript_keeps_the_order() {
    for without_notes in [false, true] {
        let mut out = Transcript::new(4);
        if without_notes {
            out = out.without_notes();
        }
        put_all(&mut out);
        assert_eq!(out.outputs.len(), if without_notes { 11 } else { 12 });
        assert_eq!(out.outputs[0], "5 Bytes { port: Port(1), bytes: [1, 2] }");
        assert!(out.outputs[11 - usize::from(without_notes)].starts_with(if without_notes {
            "5 Store"
        } else {
            "5 Log"
        }));
        assert_eq!((out.memory(), out.line), (&[0xFF, 8, 9, 0xFF][..], Some(LINE)));
    }
}

static SPEC: Spec =
    Spec { memory: 2, faults: &["HOT", "COLD"], registers: Reg::TABLE, variant: u8::MAX, ..Spec::EMPTY };

/// A device that puts a store with a code for each input, and has a deadline 1 ms after power-on.
#[derive(Default)]
struct Told {
    due: Option<Instant>,
}

impl Told {
    fn put(code: u8, at: Instant, out: &mut dyn Context) {
        out.put(at, Output::Store { offset: 0, bytes: &[code] });
    }
}

impl Device for Told {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        Self::put(if boot.fast { 1 } else { 2 }, at, out);
        self.due = Some(if boot.fast { at } else { at + Duration::millis(1) });
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        let code = match input {
            Input::Edge { pin: Pin(pin), high } => 10 + 2 * pin + u8::from(high),
            Input::Fault { fault, on } => 20 + 2 * fault.0 + u8::from(on),
            Input::Count { encoder: Encoder(0), .. } => 30,
            other => panic!("{other:?}"),
        };
        Self::put(code, at, out);
    }

    fn deadline(&self) -> Instant {
        self.due.unwrap_or(Instant::NEVER)
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.due.take_if(|due| *due == at).is_some() {
            Self::put(3, at, out);
        }
    }

    fn peek(&self, at: Instant, row: usize) -> i64 {
        row as i64 + at.ticks() as i64
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        if value < 0 {
            return Err(PresetError::OutOfRange);
        }
        Self::put(40 + row as u8, at, out);
        Ok(())
    }
}

drivetwin_protocol::registers! {
    /// Two rows.
    enum Reg: HighFirst {
        /// The first.
        First = rw(0, "1"),
        /// The second.
        Second = rw(1, "2"),
    }
}

impl Fixture<Told> {
    /// The codes of the inputs so far, each with its time in ticks.
    fn told(&mut self) -> Vec<(u64, u8)> {
        core::mem::take(&mut self.out.stores).iter().map(|(at, _, bytes)| (at.ticks(), bytes[0])).collect()
    }
}

#[test]
fn a_fixture_tells_its_device_things_in_time() {
    let mut dut = Fixture::new(Told::default());
    assert_eq!(dut.out.memory(), [0xFF; 2]);
    assert_eq!(dut.told(), []);
    dut = dut.booting();
    let ms = Duration::millis(1).ticks();
    dut.wait(Duration::from_ticks(ms - 1));
    assert_eq!(dut.told(), [(0, 2)]);
    dut.wait(Duration::TICK);
    assert_eq!(dut.told(), [(ms, 3)]);
    dut.input(dut.now + Duration::TICK, Input::Count { encoder: Encoder(0), steps: 1, a: true, b: true });
    dut.edge(Pin(2), true);
    dut.fault("COLD", true);
    assert_eq!(dut.told(), [(ms + 1, 30), (ms + 1, 15), (ms + 1, 23)]);
    dut.set(Reg::Second, 7);
    assert_eq!(
        (dut.try_set(Reg::First, -1), dut.get(Reg::Second)),
        (Err(PresetError::OutOfRange), ms as i64 + 2)
    );
    dut.set_named("First", 1);
    assert_eq!((dut.get_named("Second"), dut.told()), (ms as i64 + 2, vec![(ms + 1, 41), (ms + 1, 40)]));
}

#[test]
fn a_cycle_keeps_the_memory() {
    let mut dut = Fixture::with_memory(Told::default(), vec![5, 6]).ready();
    assert_eq!(dut.told(), [(0, 1), (0, 3)]);
    dut.cycle();
    let second = Duration::secs(1).ticks();
    assert_eq!(dut.told(), [(second, 1), (second, 3)]);
    assert_eq!(dut.out.memory, [3, 6]);
}

#[test]
#[should_panic(expected = "must not put Store")]
fn a_fixture_has_the_rule_of_its_recorder() {
    let _ = Fixture::new(Told::default()).ruled(|_| Treatment::Refuse).ready();
}
