//! 100,000 steps in 100 random moves of an MD3: the output of its STEP pin, compared with a model that uses
//! no plans.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Axis, Duration, Instant, Pin};
use drivetwin_firmware::md3::Md3;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, DriveId, Settings, Setup};
use drivetwin_sim::line::LineMode;
use drivetwin_sim::record::trace::Retention;
use drivetwin_sim::signals::pulses::Pulse;
use drivetwin_tests::exact::step_instants;
use drivetwin_tests::md3::{at, bit, write, write_pair};
use proptest::prelude::Rng;
use proptest::test_runner::{RngAlgorithm, TestRng};

const MOVES: usize = 100;
const STEPS: u32 = 100_000;

const AXIS: Axis = Axis(0);

/// A move that an MD3 was commanded to make.
#[derive(Debug)]
struct Move {
    from: Instant,
    steps: i32,
    speed: i32,
    acceleration: u32,
}

/// An MD3 after its start-up, on a bench that keeps the whole trace and whose lines take no time.
fn bench() -> (Bench, DriveId) {
    let settings = Settings { line: LineMode::Fast, trace: Retention::All, ..Settings::default() };
    let mut bench = Bench::with(settings);
    let md3 = seat(&mut bench, "x");
    bench.run_until(1.millis());
    (bench, md3)
}

fn seat(bench: &mut Bench, name: &str) -> DriveId {
    let setup = Setup { boot_fast: true, ..Setup::default() };
    bench.add_with(name, Box::new(Md3::new()), setup).expect("the name is free")
}

impl Move {
    /// Returns true if the move reaches its speed.
    fn cruises(&self) -> bool {
        let (steps, speed) = (self.steps.unsigned_abs(), self.speed.unsigned_abs());
        u64::from(speed).pow(2) < u64::from(steps) * u64::from(self.acceleration)
    }
}

/// Returns random numbers below a bound, the same in each run.
fn dice() -> impl FnMut(u32) -> u32 {
    let mut rng = TestRng::from_seed(RngAlgorithm::ChaCha, b"one hundred moves of one MD3 ...");
    move |below| ((u64::from(rng.next_u32()) * u64::from(below)) >> 32) as u32
}

/// Makes a move to its end and waits 10 µs more.
fn make(bench: &mut Bench, md3: DriveId, steps: i32, speed: i32, acceleration: u32) -> Move {
    write_pair(bench, md3, at::MOVE_STEPS, steps.cast_unsigned());
    write_pair(bench, md3, at::SPEED, speed.cast_unsigned());
    write_pair(bench, md3, at::ACCEL_DECEL, acceleration);
    let from = bench.now();
    write(bench, md3, at::MOTION, bit::MOVE);
    while bench.motion(md3, AXIS).moving {
        bench.run_until(bench.next());
    }
    bench.run_until(bench.now() + 10.micros());
    Move { from, steps, speed, acceleration }
}

/// `MOVES` positive numbers whose sum is `STEPS`.
fn parts(mut random: impl FnMut(u32) -> u32) -> Vec<u32> {
    let mut cuts: Vec<u32> = (1..MOVES).map(|_| random(STEPS - MOVES as u32)).collect();
    cuts.extend([0, STEPS - MOVES as u32]);
    cuts.sort_unstable();
    cuts.windows(2).map(|pair| pair[1] - pair[0] + 1).collect()
}

#[test]
fn every_step_of_100_random_moves_comes_out_of_the_step_pin_at_its_tick() {
    let mut random = dice();
    let (mut bench, md3) = bench();
    let lengths = parts(&mut random);
    assert_eq!((lengths.len(), lengths.iter().sum::<u32>()), (MOVES, STEPS));
    let moves: Vec<Move> = lengths
        .into_iter()
        .map(|length| {
            let length = length.cast_signed();
            let steps = if random(2) == 0 { length } else { -length };
            // Small and large rates are equally likely, up to 40,000 steps/s and 2²⁰ steps/s².
            let (speed, acceleration) = (1 << random(16), 1 << random(20));
            let speed = (speed + random(speed)).min(40_000).cast_signed();
            // The sign of Speed does not matter in a profile move (7.17).
            let speed = if random(2) == 0 { speed } else { -speed };
            make(&mut bench, md3, steps, speed, acceleration + random(acceleration))
        })
        .collect();
    let cruises = moves.iter().filter(|a_move| a_move.cruises()).count();
    assert!((20..80).contains(&cruises), "{cruises} of {MOVES} moves get to their speed");
    let position: i32 = moves.iter().map(|a_move| a_move.steps).sum();
    assert_eq!(bench.motion(md3, AXIS).position, position);

    let pulses: Vec<Pulse> = bench.pulses(md3.step()).collect();
    assert_eq!(pulses.len(), STEPS as usize);
    let mut pulses = pulses.as_slice();
    let mut last_fall = Instant::ZERO;
    for (n, a_move) in moves.iter().enumerate() {
        let until = moves.get(n + 1).map_or(bench.now(), |next| next.from);
        let made;
        (made, pulses) = pulses.split_at(pulses.partition_point(|pulse| pulse.rise <= until));
        assert_eq!(made.len(), a_move.steps.unsigned_abs() as usize, "{a_move:?}");
        let (speed, acceleration) = (a_move.speed.unsigned_abs(), a_move.acceleration);
        let expected = step_instants(a_move.steps.unsigned_abs(), speed, acceleration);
        for (pulse, due) in made.iter().zip(expected) {
            assert_eq!(pulse.forward, a_move.steps > 0, "{a_move:?}");
            let passed = pulse.rise.since(a_move.from);
            assert!(
                passed.ticks().abs_diff(due.ticks()) <= 1,
                "{pulse:?} of {a_move:?} after {passed:?}, not {due:?}"
            );
            assert!(last_fall < pulse.rise && pulse.rise < pulse.fall);
            assert!(pulse.fall.since(pulse.rise) <= 2.micros());
            last_fall = pulse.fall;
        }
    }
}

#[test]
fn an_md3_follows_the_step_and_direction_outputs_of_another() {
    let mut random = dice();
    let (mut bench, x) = bench();
    let y = seat(&mut bench, "y");
    bench.run_until(2.millis());
    // In mode 0000, the usual one, J2 pins 4 and 5 are step and direction (7.8).
    let pin = |name| {
        let names = bench.spec(x).pins.iter().map(|pin| pin.name);
        (0..).map(Pin).zip(names).find(|(_, pin)| *pin == name).expect("a pin of an MD3").0
    };
    let wires = [(pin("STEP"), pin("J2.4")), (pin("DIR"), pin("J2.5"))];
    for (from, to) in wires {
        bench.wire((x, from), (y, to));
    }
    bench.run_until(3.millis());
    // The first wire pulled J2.4 low, which is a step. J2.5 was still open, which is forward.
    let offset = bench.motion(y, AXIS).position;
    assert_eq!(offset, 1);
    for _ in 0..20 {
        let steps = random(1_000).cast_signed() - 500;
        make(&mut bench, x, steps, 1 + random(40_000).cast_signed(), 1_000 + random(1_000_000));
        assert_eq!(bench.motion(y, AXIS).position - offset, bench.motion(x, AXIS).position);
    }
    // A jog that is reversed and then stopped at once.
    write_pair(&mut bench, x, at::ACCEL_DECEL, 200_000);
    write_pair(&mut bench, x, at::SPEED, 20_000);
    write(&mut bench, x, at::MOTION, bit::JOG);
    bench.run_until(bench.now() + 500.millis());
    write_pair(&mut bench, x, at::SPEED, (-30_000_i32).cast_unsigned());
    bench.run_until(bench.now() + 700.millis());
    write(&mut bench, x, at::MOTION, bit::STOP);
    bench.run_until(bench.now() + 10.micros());
    assert_eq!(bench.motion(y, AXIS).position - offset, bench.motion(x, AXIS).position);
    let pulses: Vec<Pulse> = bench.pulses(x.step()).collect();
    let made = pulses.iter().map(|pulse| if pulse.forward { 1 } else { -1 }).sum::<i32>();
    assert_eq!(made, bench.motion(x, AXIS).position);
}

#[test]
fn the_factory_move_makes_10_000_pulses() {
    let mut bench = Bench::new();
    let md3 = bench.add::<Md3>("x");
    bench.run_until(2_500.millis());
    write(&mut bench, md3, at::MOTION, bit::MOVE);
    bench.run_until(6.secs());
    assert_eq!(bench.pulses(md3.step()).count(), 10_000);
}

#[test]
fn nothing_is_counted_before_it_is_made() {
    let (mut bench, md3) = bench();
    make(&mut bench, md3, 3, 40_000, 200);
    let start = bench.now();
    // Step n is due after sqrt(2n/200) s, the first step after 0.1 s.
    write(&mut bench, md3, at::MOTION, bit::MOVE);
    bench.run_until(start + 100.millis() - Duration::TICK);
    assert_eq!(bench.pulses(md3.step()).count(), 3);
    bench.run_until(start + 100.millis());
    let pulse = bench.pulses(md3.step()).last();
    let rise = start + 100.millis();
    assert_eq!(pulse, Some(Pulse { rise, fall: rise + 2.micros(), forward: true }));
    // After a stop at once the remaining two steps are never made.
    write(&mut bench, md3, at::MOTION, bit::STOP);
    bench.run_until(bench.now() + 10.secs());
    assert_eq!(bench.pulses(md3.step()).count(), 4);
}

#[test]
#[should_panic(expected = "the trace has lost its beginning, or keeps nothing")]
fn what_is_not_kept_cannot_be_counted() {
    let mut bench = Bench::with(Settings { trace: Retention::Off, ..Settings::default() });
    let md3 = bench.add::<Md3>("x");
    let _ = bench.pulses(md3.step()).count();
}

#[test]
#[should_panic(expected = "toy has no STEP output")]
fn what_has_no_step_output_has_no_pulses() {
    let mut bench = Bench::new();
    let toy = bench.add::<drivetwin_tests::toy::Toy>("toy");
    let _ = bench.pulses(toy.step()).count();
}
