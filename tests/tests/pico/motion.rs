//! Every step pulse of a move, compared with the plan.

use std::path::Path;

use drivetwin_firmware::device::{Instant, Plan};
use drivetwin_firmware::motion::{Limits, StepIterator};
use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::md3::{at, bit};
use fixed::types::{I24F8, U24F8};
use object::{Object, ObjectSymbol};

use crate::play::{Drive, MS, Nanos, OutputRecord, Run, Script, US};
use crate::{CHARACTER, START, TURN, image, pin, value, write};

pub(crate) const STEPS: u32 = 12_000;
pub(crate) const SPEED: u32 = 40_000;
pub(crate) const ACCELERATION: u32 = 400_000;

/// Registers of the move (7.16, 7.17, 7.19).
pub(crate) const MOVE: [(u16, u16); 6] = [
    (at::MOVE_STEPS, (STEPS >> 16) as u16),
    (at::MOVE_STEPS + 1, STEPS as u16),
    (at::SPEED, (SPEED >> 16) as u16),
    (at::SPEED + 1, SPEED as u16),
    (at::ACCEL_DECEL, (ACCELERATION >> 16) as u16),
    (at::ACCEL_DECEL + 1, ACCELERATION as u16),
];

/// Instants of the steps of a plan, in ticks since its start.
pub(crate) fn steps(plan: &Plan) -> Vec<u64> {
    StepIterator::new(plan, plan.start()).map(|step| step.at.since(plan.start()).ticks()).collect()
}

/// Ticks in a microsecond.
const TICKS: u64 = 16;

/// Error of the request's timestamp, and the least and greatest delay of the pulses, in ns. The plan starts
/// at the tick `due` if the timestamp of the request's last character is exact. The timestamp is from 1 µs earlier, because
/// the Pico's clock does not begin with that of the emulator, to 5 µs later, in whole µs. The plan's instants are rounded to the Pico's microsecond.
pub(crate) fn lateness(rises: &[Nanos], steps: &[u64], due: u64) -> (i64, i64, i64) {
    assert_eq!(rises.len(), steps.len(), "every step is made, and no other");
    let late = |start: u64| {
        let late = rises.iter().zip(steps).map(move |(&rise, &step)| {
            let micros = (start + step + TICKS / 2) / TICKS;
            rise as i64 - (micros * US) as i64
        });
        late.fold((i64::MAX, i64::MIN), |(least, most), late| (least.min(late), most.max(late)))
    };
    let starts = (0..7).map(|n| (n as i64 - 1, due + n * TICKS - TICKS));
    let starts = starts.map(|(micros, start)| (micros * US as i64, start));
    let (error, (least, most)) = starts
        .map(|(error, start)| (error, late(start)))
        .filter(|(_, (least, _))| *least >= 0)
        .min_by_key(|(_, (least, most))| (most - least, *least))
        .expect("no step is early");
    (error, least, most)
}

/// Tick at which the drive accepts a request. The stop bit of the request's first character ends at
/// `asked`; the drive accepts the request 4.5 characters after its eighth character, in ticks of 1/16 µs
/// (PROJECT-2, PROJECT-3).
pub(crate) fn taken(asked: Nanos) -> u64 {
    (asked + 7 * CHARACTER).div_ceil(US) * TICKS + 64_166 + 18_333
}

/// Width of each pulse, and the interval to the next pulse. The last pulse is left out.
fn widths(run: &Run) -> Vec<(Nanos, Nanos)> {
    let rises = run.edges(pin::STEP, Drive::High);
    let falls = run.edges(pin::STEP, Drive::Low);
    let falls = falls.strip_prefix(&[falls[0]]).expect("it is low at first");
    assert_eq!(rises.len(), falls.len(), "each pulse ends");
    let intervals = rises.windows(2).map(|pair| pair[1] - pair[0]);
    rises.iter().zip(falls).zip(intervals).map(|((rise, fall), interval)| (fall - rise, interval)).collect()
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn every_pulse_of_a_move_is_where_the_plan_has_it() {
    expect_every_pulse(&image(), Script::fast(), START, |_, _, _| {});
}

/// Appends a move to a script, from `start` on, and asserts that every pulse is where the plan has it. `meanwhile` adds what
/// else happens between two instants.
pub(crate) fn expect_every_pulse(
    image: &Path,
    mut script: Script,
    start: Nanos,
    meanwhile: impl Fn(&mut Script, Nanos, Nanos),
) {
    let asked = write(&mut script, start, &MOVE);
    script.hear(asked, &rtu::write(1, at::MOTION, bit::MOVE));
    // The bus is also busy during the move.
    let polls: Vec<Nanos> = (1..9).map(|n| asked + n * TURN).collect();
    for &poll in &polls {
        meanwhile(&mut script, poll - TURN, poll);
        script.hear(poll, &rtu::read(1, at::MOTION, 1));
    }
    let end = asked + 10 * TURN + 200 * MS;
    script.hear(end, &rtu::read(1, at::MOTION, 1));
    let run = script.play(image, end + TURN);

    let rates = Limits::even(U24F8::from_num(SPEED), ACCELERATION);
    let plan = Plan::profile(Instant::ZERO, 0, STEPS as i32, rates);
    let rises = run.edges(pin::STEP, Drive::High);
    let (stamp, least, most) = lateness(&rises, &steps(&plan), taken(asked));
    println!("{STEPS} steps at {SPEED}/s: stamp of the request {stamp} ns, pulses {least} to {most} ns late");
    assert!(most - least <= 1_100, "pulses are {least} to {most} ns late");
    assert!(most <= 1_300, "pulses are up to {most} ns late");
    for (width, interval) in widths(&run) {
        assert!(width >= 2 * US && width <= interval / 2, "{width} ns in an interval of {interval} ns");
    }
    let dir = run.edges(pin::DIR, Drive::High);
    assert!(matches!(dir[..], [turn] if turn + 4 * US <= rises[0]), "DIR at {dir:?}, STEP at {}", rises[0]);
    for poll in polls {
        assert_eq!(value(&run, poll), bit::MOVE);
    }
    assert_eq!(value(&run, end), 0);
}

/// Address of a symbol in an image.
fn address(image: &Path, name: &str) -> u64 {
    let bytes = std::fs::read(image).expect("the image is there");
    let file = object::File::parse(bytes.as_slice()).expect("it is an ELF file");
    let symbol = file.symbols().find(|symbol| symbol.name().is_ok_and(|of| of.contains(name)));
    symbol.unwrap_or_else(|| panic!("no {name} in the image")).address()
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_plan_that_comes_late_slips_and_nothing_is_lost() {
    // A jog with steps 25 µs apart that stops at once. The board needs more than 25 µs to process the stop.
    let orders = [
        (at::MOTION, bit::JOG, Some(SPEED as i32)),
        (at::SPEED + 1, 20_000, Some(20_000)),
        (at::SPEED + 1, SPEED as u16, Some(SPEED as i32)),
        (at::MOTION, bit::STOP, None),
    ];
    let mut script = Script::fast();
    let mut asked = write(&mut script, START, &MOVE);
    let mut plan = Plan::at_rest(Instant::ZERO, 0);
    for (register, value, speed) in orders {
        script.hear(asked, &rtu::write(1, register, value));
        // The timestamp is a microsecond later than the character.
        let at = Instant::from_ticks(taken(asked) + TICKS);
        plan = match speed {
            Some(speed) => plan.ramp_to(at, I24F8::from_num(speed), ACCELERATION),
            None => plan.halt(at),
        };
        asked += 200 * MS;
    }
    script.at(asked, format_args!("peek {:08x}", address(&image(), "SLIPPED")));
    let run = script.play(&image(), asked + MS);

    let peeked = run.did.iter().find_map(|(_, did)| match did {
        OutputRecord::Peeked(word) => Some(word.cast_signed()),
        _ => None,
    });
    let slipped = peeked.expect("it was looked at");
    let made = run.edges(pin::STEP, Drive::High).len() as i32;
    let planned = plan.position_at(Instant::NEVER);
    println!("{made} steps made, {planned} planned, {slipped} slipped");
    assert!(slipped > 0, "nothing slipped: the test forces nothing");
    // A timestamp error of a microsecond shifts the plan by less than a step.
    assert!((made - planned - slipped).abs() <= 1, "{made} made, {planned} planned, {slipped} slipped");
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn moves_shorter_than_planning_them_lose_no_step_and_no_request() {
    // Section 7.8: endless moves forward and backward, two steps at a time, at the greatest acceleration.
    let writes = [
        (at::MOVE_STEPS, 0),
        (at::MOVE_STEPS + 1, 2),
        (at::SPEED, 0),
        (at::SPEED + 1, SPEED as u16),
        (at::ACCEL_DECEL, 0x7FFF),
        (at::ACCEL_DECEL + 1, 0xFFFF),
        (at::PINS, 0b1000 << 4),
    ];
    let mut script = Script::fast();
    let begun = write(&mut script, START, &writes);
    // The board has more work than time. It answers, but may take 100 ms.
    let polls: Vec<Nanos> = (1..20).map(|n| begun + n * 4 * TURN).collect();
    for &poll in &polls {
        script.hear(poll, &rtu::read(1, at::SPEED + 1, 1));
    }
    let run = script.play(&image(), begun + 20 * 4 * TURN);
    let [high, low] = (SPEED as u16).to_be_bytes();
    let answer = rtu::frame(1, &[3, 2, high, low]);
    for poll in polls {
        assert_eq!(run.sent(poll, poll + 4 * TURN).1, answer.as_slice());
    }
    assert!(!run.did.iter().any(|(_, did)| *did == OutputRecord::Watchdog));
    let (mut position, mut forward, mut made) = (0, false, 0);
    for (at, did) in &run.did {
        match did {
            OutputRecord::Pin(pin::DIR, drive) => forward = *drive == Drive::High,
            OutputRecord::Pin(pin::STEP, Drive::High) => {
                position += if forward { 1 } else { -1 };
                made += 1;
                assert!((0..=2).contains(&position), "at {position} at {at} ns");
            }
            _ => {}
        }
    }
    println!("{made} steps of endless moves of 2, {} a second", made * 1_000 * MS / (20 * 4 * TURN));
    assert!(made > 1_000, "{made} steps");
}
