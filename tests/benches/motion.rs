//! Simulated seconds per second while something moves: a jog that nobody listens to, the same with a
//! wire on STEP, and step/direction and encoder inputs.
//!
//! Everything goes through `dyn Device` on a bench with its usual settings, trace included.

#[path = "support/mod.rs"]
mod support;

use standin_firmware::device::{
    Axis, Boot, Device, Encoder, Input, Instant, Level, Pin, PinSpec, Refused, Role, Sink, Spec,
};
use standin_firmware::md3::{Md3, Reg};
use standin_protocol::registers::Register;
use standin_protocol::time::{Duration, Span};
use standin_sim::bench::{Bench, Drive, Seat, Setup};

use support::{line, took};

/// Steps per second, the most that an MD3 makes.
const SPEED: i64 = 40_000;
/// What each measurement simulates of a jog.
const JOG: Duration = Duration::secs(600);
/// What each measurement simulates of an input.
const INPUT: Duration = Duration::secs(60);
/// The fastest step/direction input of an MD3 (7.8), in pulses per second.
const PULSES: u32 = 250_000;

/// Pins of an MD3.
const J2_4: Pin = Pin(2);
const STEP: Pin = Pin(9);

standin_protocol::registers! {
    /// What a counter shows.
    enum Show: HighFirst {
        /// Nothing.
        Nothing = ro(0, "1"),
    }
}

static COUNTER: Spec = Spec {
    kind: "counter",
    product: "counts rising edges",
    manual: "this file",
    ports: &[],
    pins: &[PinSpec { name: "IN", role: Role::Input, rest: Level::High }],
    axes: &[],
    encoders: &[],
    faults: &[],
    memory: 0,
    registers: Show::TABLE,
    address: None,
    not_modelled: &[],
};

/// Counts rising edges, and does nothing else.
#[derive(Default)]
struct Counter {
    edges: i64,
}

impl Device for Counter {
    fn spec(&self) -> &'static Spec {
        &COUNTER
    }

    fn power_on(&mut self, _at: Instant, _boot: Boot, _out: &mut dyn Sink) {
        self.edges = 0;
    }

    fn input(&mut self, _at: Instant, input: Input<'_>, _out: &mut dyn Sink) {
        self.edges += i64::from(matches!(input, Input::Edge { high: true, .. }));
    }

    fn deadline(&self) -> Instant {
        Instant::NEVER
    }

    fn timeout(&mut self, _at: Instant, _out: &mut dyn Sink) {}

    fn peek(&self, _at: Instant, _row: usize) -> i64 {
        self.edges
    }

    fn poke(&mut self, _at: Instant, _row: usize, _value: i64, _out: &mut dyn Sink) -> Result<(), Refused> {
        Err(Refused::ReadOnly)
    }
}

/// A bench with an MD3 that listens.
fn md3() -> (Bench, Seat) {
    let mut bench = Bench::new();
    let setup = Setup { boot_fast: true, ..Setup::default() };
    let seat = bench.seat("x", Box::new(Md3::new()), setup).expect("a fresh bench has room");
    bench.run_until(1.millis());
    (bench, seat)
}

/// Lets it jog at full speed; the ramp is over.
fn jog(bench: &mut Bench, seat: Seat) {
    for (reg, value) in [(Reg::Speed, SPEED), (Reg::AccelDecel, 400_000), (Reg::MotionControl, 2)] {
        bench.poke(seat, reg as usize, value).expect("an MD3 takes these");
    }
    bench.run_until(bench.now() + 1.secs());
}

/// Runs for `span`, in slices of a millisecond as whoever paces a bench does, and prints how much
/// faster that is than the world.
fn measure(name: &str, bench: &mut Bench, span: Duration, events: u64) {
    let end = bench.now() + span;
    let seconds = took(|| {
        while bench.now() < end {
            bench.run_until(bench.now() + 1.millis());
        }
    });
    let seconds = seconds.as_secs_f64();
    let simulated = (span / 1.micros()) as f64 / 1e6;
    let each = seconds * 1e9 / events as f64;
    let detail = if events > 0 { format!(", {each:.0} ns an edge") } else { String::new() };
    line(name, &format!("{:.0} simulated seconds per second{detail}", simulated / seconds));
}

fn main() {
    println!("motion");
    let simulated = JOG / 1.secs();

    let (mut bench, x) = md3();
    jog(&mut bench, x);
    let before = bench.motion(x, Axis(0)).position;
    measure("jog, nobody listens", &mut bench, JOG, 0);
    let steps = i64::from(bench.motion(x, Axis(0)).position - before);
    assert_eq!(steps, simulated as i64 * SPEED);

    let (mut bench, x) = md3();
    let counter = bench.add::<Counter>("counter");
    bench.wire((x, STEP), (counter, Pin(0)));
    jog(&mut bench, x);
    let before = bench.peek(counter, 0);
    measure("jog, a wire on STEP", &mut bench, JOG, 2 * simulated * SPEED as u64);
    assert_eq!(bench.peek(counter, 0) - before, simulated as i64 * SPEED);

    let simulated = INPUT / 1.secs();
    let (mut bench, x) = md3();
    let pulses = u32::try_from(simulated).expect("a short while") * PULSES;
    bench.pulse(x, J2_4, pulses, f64::from(PULSES)).expect("nothing runs there");
    measure("step/direction input", &mut bench, INPUT, 2 * u64::from(pulses));

    let (mut bench, x) = md3();
    let counts = i32::try_from(pulses).expect("a short while");
    bench.encoder(x, Encoder(0), counts, f64::from(PULSES)).expect("it stands");
    measure("encoder input", &mut bench, INPUT, u64::from(pulses));

    let mut bench = Bench::new();
    let counter = bench.add::<Counter>("counter");
    bench.set_pin(counter, Pin(0), Drive::Low);
    bench.run_until(1.millis());
    bench.pulse(counter, Pin(0), pulses, f64::from(PULSES)).expect("nothing runs there");
    measure("pulses into a counter", &mut bench, INPUT, 2 * u64::from(pulses));
    assert_eq!(bench.peek(counter, 0), i64::from(pulses));
}
