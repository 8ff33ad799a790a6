//! Simulated seconds per second of wall time during motion: a jog without observers, a jog with a wire on
//! STEP, and step/direction and encoder inputs.
//!
//! All drives run through `dyn Device` on a bench with its usual settings, including the trace.

#[path = "support/mod.rs"]
mod support;

use drivetwin_firmware::device::{
    Axis, Boot, Context, Device, Encoder, Input, Instant, Level, Pin, PinSpec, PresetError, Role, Spec,
};
use drivetwin_firmware::md3::{Md3, Reg};
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, DriveId, PinStimulus, Setup};

use support::{line, took};

/// Speed in steps per second, the greatest of an MD3.
const SPEED: i64 = 40_000;
/// Simulated time of each jog measurement.
const JOG: Duration = Duration::secs(600);
/// Simulated time of each input measurement.
const INPUT: Duration = Duration::secs(60);
/// Pulses per second on a step input, the most that an MD3 accepts (7.8). Also edges per second of an
/// encoder.
const HZ: u64 = 250_000;

/// Pins of an MD3.
const J2_4: Pin = Pin(2);
const STEP: Pin = Pin(9);

drivetwin_protocol::registers! {
    /// Registers that show a counter.
    enum Show: HighFirst {
        /// An empty register.
        Nothing = ro(0, "1"),
    }
}

static COUNTER: Spec = Spec {
    kind: "counter",
    product: "counts rising edges",
    manual: "this file",
    pins: &[PinSpec::new("IN", Role::Input, Level::High)],
    registers: Show::TABLE,
    ..Spec::EMPTY
};

/// A device that only counts rising edges.
#[derive(Default)]
struct Counter {
    edges: i64,
}

impl Device for Counter {
    fn spec(&self) -> &'static Spec {
        &COUNTER
    }

    fn power_on(&mut self, _at: Instant, _boot: Boot, _out: &mut dyn Context) {
        self.edges = 0;
    }

    fn input(&mut self, _at: Instant, input: Input<'_>, _out: &mut dyn Context) {
        self.edges += i64::from(matches!(input, Input::Edge { high: true, .. }));
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
        _at: Instant,
        _row: usize,
        _value: i64,
        _out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        Err(PresetError::ReadOnly)
    }
}

/// A bench with an MD3 that is ready.
fn md3() -> (Bench, DriveId) {
    let mut bench = Bench::new();
    let setup = Setup { boot_fast: true, ..Setup::default() };
    let seat = bench.add_with("x", Box::new(Md3::new()), setup).expect("a fresh bench has room");
    bench.run_until(1.millis());
    (bench, seat)
}

/// Starts a jog at full speed; returns after the ramp.
fn jog(bench: &mut Bench, seat: DriveId) {
    for (reg, value) in [(Reg::Speed, SPEED), (Reg::AccelDecel, 400_000), (Reg::MotionControl, 2)] {
        bench.poke(seat, reg as usize, value).expect("an MD3 takes these");
    }
    bench.run_until(bench.now() + 1.secs());
}

/// Number of parts of a measurement. Only the fastest part counts, because other programs may use the
/// machine.
const PARTS: u64 = 20;

/// Runs for `span`, in slices of a millisecond as a paced bench does, and prints the ratio of simulated to
/// real time.
fn measure(name: &str, bench: &mut Bench, span: Duration, edges: u64) {
    let part = Duration::from_ticks(span.ticks() / PARTS);
    let mut run = || {
        let end = bench.now() + part;
        took(|| {
            while bench.now() < end {
                bench.run_until(bench.now() + 1.millis());
            }
        })
    };
    let least = (0..PARTS).map(|_| run()).min().unwrap_or_default();
    let simulated = (span / 1.secs()) as f64 / PARTS as f64;
    let ns = least.as_secs_f64() * 1e9 * PARTS as f64 / edges as f64;
    let each = if edges > 0 { format!(", {ns:.0} ns an edge") } else { String::new() };
    line(name, &format!("{:.0}{each}", simulated / least.as_secs_f64()));
}

/// A jog without observers, in which time advances from one plan to the next.
fn jog_unheard(name: &str) {
    let (mut bench, x) = md3();
    jog(&mut bench, x);
    let before = bench.motion(x, Axis(0)).position;
    measure(name, &mut bench, JOG, 0);
    let steps = i64::from(bench.motion(x, Axis(0)).position - before);
    assert_eq!(steps, seconds(JOG) as i64 * SPEED);
}

/// A jog with an observer, which gets a rising and a falling edge for each step.
fn jog_heard(name: &str) {
    let (mut bench, x) = md3();
    let counter = bench.add::<Counter>("counter");
    bench.wire((x, STEP), (counter, Pin(0)));
    jog(&mut bench, x);
    let before = bench.peek(counter, 0);
    measure(name, &mut bench, JOG, 2 * seconds(JOG) * SPEED as u64);
    assert_eq!(bench.peek(counter, 0) - before, seconds(JOG) as i64 * SPEED);
}

/// Pulses on the step input of an MD3 in its default mode 0000 (7.8).
fn step_direction(name: &str) {
    let (mut bench, x) = md3();
    let pulses = seconds(INPUT) * HZ;
    bench.pulse(x, J2_4, pulses as u32, HZ as f64).expect("nothing runs there");
    measure(name, &mut bench, INPUT, 2 * pulses);
    assert_eq!(bench.motion(x, Axis(0)).position, pulses as i32);
}

/// Edges on the encoder inputs of an MD3.
fn encoder(name: &str) {
    let (mut bench, x) = md3();
    let edges = seconds(INPUT) * HZ;
    bench.encoder(x, Encoder(0), edges as i32, HZ as f64).expect("an encoder without a motor");
    measure(name, &mut bench, INPUT, edges);
}

/// Edges on a device that only counts, to measure the bench's own time for an edge.
fn pulses_alone(name: &str) {
    let mut bench = Bench::new();
    let counter = bench.add::<Counter>("counter");
    bench.set_pin(counter, Pin(0), PinStimulus::Low);
    bench.run_until(1.millis());
    let pulses = seconds(INPUT) * HZ;
    bench.pulse(counter, Pin(0), pulses as u32, HZ as f64).expect("nothing runs there");
    measure(name, &mut bench, INPUT, 2 * pulses);
    assert_eq!(bench.peek(counter, 0), pulses as i64);
}

/// A function that measures a case and prints the result under the given name.
type Case = fn(&str);

fn seconds(span: Duration) -> u64 {
    span / 1.secs()
}

/// `cargo bench --bench motion -- wire` measures only the cases with that word in their names.
fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    println!("simulated seconds per second");
    let cases: [(_, Case); 5] = [
        ("jog, nobody listens", jog_unheard),
        ("jog, a wire on STEP", jog_heard),
        ("step/direction input", step_direction),
        ("encoder input", encoder),
        ("pulses on a counter", pulses_alone),
    ];
    for (name, case) in cases {
        if words.iter().all(|word| name.contains(word.as_str())) {
            case(name);
        }
    }
}
