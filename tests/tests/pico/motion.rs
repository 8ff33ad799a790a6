//! Every step pulse of a move, beside the plan.

use fixed::types::U24F8;
use standin_firmware::device::{Instant, Plan};
use standin_firmware::motion::{Rates, Walker};
use standin_protocol::modbus::rtu;
use standin_tests::md3::{at, bit};

use crate::play::{Drive, MS, Nanos, Run, Script, US};
use crate::{CHARACTER, TURN, image, pin, value, write};

const STEPS: u32 = 12_000;
const SPEED: u32 = 40_000;
const ACCELERATION: u32 = 400_000;

/// Registers of such a move (7.16, 7.17, 7.19).
const MOVE: [(u16, u16); 6] = [
    (at::MOVE_STEPS, (STEPS >> 16) as u16),
    (at::MOVE_STEPS + 1, STEPS as u16),
    (at::SPEED, (SPEED >> 16) as u16),
    (at::SPEED + 1, SPEED as u16),
    (at::ACCEL_DECEL, (ACCELERATION >> 16) as u16),
    (at::ACCEL_DECEL + 1, ACCELERATION as u16),
];

/// The steps of a plan, in ticks since its start.
fn steps(plan: &Plan) -> Vec<u64> {
    Walker::new(plan, plan.start()).map(|step| step.at.since(plan.start()).ticks()).collect()
}

/// How late pulses come, in ns, at least and at most. `due` is when the plan starts, if the stamp of the
/// request's last character is exact; the stamp is up to some µs later, in whole µs. The plan's instants
/// are rounded to the Pico's microsecond.
fn lateness(rises: &[Nanos], steps: &[u64], due: Nanos) -> (Nanos, i64, i64) {
    assert_eq!(rises.len(), steps.len(), "every step is made, and no other");
    let late = |start: Nanos| {
        let late = rises.iter().zip(steps).map(move |(&rise, &step)| {
            let instant = start + step * 125 / 2;
            rise as i64 - ((instant + US / 2) / US * US) as i64
        });
        late.fold((i64::MAX, i64::MIN), |(least, most), late| (least.min(late), most.max(late)))
    };
    let starts = (0..6).map(|n| due + n * US);
    let (start, (least, most)) = starts
        .map(|start| (start, late(start)))
        .filter(|(_, (least, _))| *least >= 0)
        .min_by_key(|(_, (least, most))| (most - least, *least))
        .expect("no step is early");
    (start - due, least, most)
}

/// When the drive takes a request whose first character's stop bit ends at `asked`: 4.5 characters after
/// its eighth, in ticks of 1/16 µs (docs/decisions.md, the house, 2 and 3).
fn taken(asked: Nanos) -> Nanos {
    let stamp = (asked + 7 * CHARACTER).div_ceil(US) * US;
    stamp + (64_166 + 18_333) * 125 / 2
}

fn width(run: &Run) -> (Nanos, Nanos) {
    let rises = run.edges(pin::STEP, Drive::High);
    let falls = run.edges(pin::STEP, Drive::Low);
    let widths = rises.iter().map(|rise| falls.iter().find(|fall| *fall > rise).expect("it falls") - rise);
    widths.fold((Nanos::MAX, 0), |(least, most), width| (least.min(width), most.max(width)))
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn every_pulse_of_a_move_is_where_the_plan_has_it() {
    let mut script = Script::fast();
    let asked = write(&mut script, 20 * MS, &MOVE);
    script.hear(asked, &rtu::write(1, at::MOTION, bit::MOVE));
    // While it moves, the bus is busy, too.
    let polls: Vec<Nanos> = (1..9).map(|n| asked + n * TURN).collect();
    for &poll in &polls {
        script.hear(poll, &rtu::read(1, at::MOTION, 1));
    }
    let end = asked + 10 * TURN + 200 * MS;
    script.hear(end, &rtu::read(1, at::MOTION, 1));
    let run = script.play(&image(), end + TURN);

    let rates = Rates::even(U24F8::from_num(SPEED), ACCELERATION);
    let plan = Plan::profile(Instant::ZERO, 0, STEPS as i32, rates);
    let rises = run.edges(pin::STEP, Drive::High);
    let (stamp, least, most) = lateness(&rises, &steps(&plan), taken(asked));
    let (narrow, wide) = width(&run);
    println!(
        "{STEPS} steps at {SPEED}/s: stamp of the request {stamp} ns, pulses {least} to {most} ns late, \
         {narrow} to {wide} ns wide"
    );
    assert!(most - least <= 1_500, "pulses are {least} to {most} ns late");
    assert!(most <= 4_000, "pulses are up to {most} ns late");
    // At least 2 µs, at most half of the 25 µs between two.
    assert!(narrow >= 2 * US && wide <= 12_500, "{narrow} to {wide} ns");
    let dir = run.edges(pin::DIR, Drive::High);
    assert!(matches!(dir[..], [turn] if turn + 4 * US <= rises[0]), "DIR at {dir:?}, STEP at {}", rises[0]);
    for poll in polls {
        assert_eq!(value(&run, poll), bit::MOVE);
    }
    assert_eq!(value(&run, end), 0);
}
