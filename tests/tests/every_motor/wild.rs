//! Reports of impossible motors: no arithmetic of a drive overflows.

use std::iter;

use drivetwin_firmware::device::{
    Axis, Boot, Device, Duration, Input, Instant, Pin, Rotation, advance, feed,
};
use drivetwin_firmware::mdrobot::Mdrobot;
use drivetwin_firmware::motor::Parameters;
use drivetwin_firmware::rs434::Rs434;
use drivetwin_firmware::testing::Recorder;
use proptest::prelude::*;

#[derive(Clone, Debug)]
enum Act {
    Motor(Parameters),
    Rotation(Rotation),
    MotorCurrent(i32),
    Edge(u8, bool),
    Poke(usize, i64),
}

fn act() -> impl Strategy<Value = Act> {
    let number = || prop_oneof![any::<u32>(), 0..1_000_u32, (0..32_u32).prop_map(|bits| 1 << bits)];
    let small = || prop_oneof![any::<u16>(), 0..20_u16];
    let motor = (number(), number(), number(), number(), number(), any::<i32>(), small(), 2..4_u8).prop_map(
        |(
            supply_mv,
            no_load_rpm,
            resistance_mohm,
            inertia_gcm2,
            friction_unm,
            load_unm,
            hall_pulses,
            halls,
        )| {
            Act::Motor(Parameters {
                supply_mv,
                no_load_rpm,
                resistance_mohm,
                inertia_gcm2,
                friction_unm,
                load_unm,
                hall_pulses,
                hall_sensors: halls,
                encoder_cycles: 0,
            })
        },
    );
    let long = || prop_oneof![any::<i64>(), -1_000_000..1_000_000_i64, -100..100_i64, Just(0)];
    let rotation = (long(), long(), long()).prop_map(|(angle, speed, acceleration)| {
        Act::Rotation(Rotation { angle, speed, acceleration }.limited())
    });
    prop_oneof![
        2 => motor,
        4 => rotation,
        2 => any::<i32>().prop_map(Act::MotorCurrent),
        6 => (0..16_u8, any::<bool>()).prop_map(|(pin, high)| Act::Edge(pin, high)),
        4 => (0..80_usize, prop_oneof![0..4_i64, 0..3_000_i64, any::<i32>().prop_map(i64::from)])
            .prop_map(|(row, value)| Act::Poke(row, value)),
    ]
}

fn play(mut drive: impl Device, orders: &[(&str, i64)], acts: &[(Act, u64)]) {
    let rows = |names: &[(&str, i64)], drive: &dyn Device| -> Vec<(usize, i64)> {
        names.iter().map(|&(name, value)| (drive.spec().find(name).unwrap().row, value)).collect()
    };
    drive.detach_motor();
    let mut out = Recorder::new(drive.spec().memory.into()).memory_only();
    let mut now = Instant::ZERO;
    drive.power_on(now, Boot { fast: true, ..Boot::default() }, &mut out);
    let orders = rows(orders, &drive);
    for (act, ticks) in acts {
        now += Duration::from_ticks(*ticks);
        let axis = Axis(0);
        let input = match act {
            Act::Motor(parameters) => Input::Motor { axis, parameters },
            Act::Rotation(rotation) => Input::Rotation { axis, rotation: *rotation },
            Act::MotorCurrent(ma) => Input::MotorCurrent { axis, ma: *ma },
            Act::Edge(pin, _) if usize::from(*pin) >= drive.spec().pins.len() => continue,
            Act::Edge(pin, high) => Input::Edge { pin: Pin(*pin), high: *high },
            Act::Poke(row, value) => {
                advance(&mut drive, now, iter::empty(), &mut out);
                // Most rows refuse most values.
                for (row, value) in iter::once((*row, *value)).chain(orders.iter().copied()) {
                    let _ = drive.poke(now, row, value, &mut out);
                }
                continue;
            }
        };
        let due = drive.deadline();
        feed(&mut drive, due, now, input, &mut out);
        for row in 0..drive.spec().registers.rows.len() {
            drive.peek(now, row);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, max_shrink_iters: 500, ..ProptestConfig::default() })]

    #[test]
    fn reports_that_cannot_be_do_no_harm(acts in prop::collection::vec((act(), 0..200_000_u64), 1..60)) {
        play(Rs434::rs434544(), &[("ERROR", 0), ("START_bit", 1)], &acts);
        play(Mdrobot::md400(), &[("ALARM_RESET", 1), ("UI_COM", 1), ("START_STOP", 1), ("VEL_CMD", 700)], &acts);
        play(Mdrobot::md400(), &[("ALARM_RESET", 1), ("UI_COM", 1), ("POSI_CMD", 700)], &acts);
    }
}
