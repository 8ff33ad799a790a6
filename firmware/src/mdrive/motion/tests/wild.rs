//! Random commands in random order: time always advances, motion always ends, and no position is lost.

use std::vec;

use proptest::prelude::*;

use super::super::Channel;
use super::*;

#[derive(Clone, Copy, Debug)]
enum Does {
    Orders(Order),
    Touches(Contact, bool),
    Sets(Settings),
    Holds(bool),
    Edges(Channel, Option<bool>),
    Clocks(i32),
    Stops,
    Halts,
    Pauses,
    Resumes,
    Presets(i32),
    Restarts,
}

fn order() -> impl Strategy<Value = Order> {
    let way = prop_oneof![Just(0), -100..100_i32, any::<i32>()];
    prop_oneof![
        (way.clone(), any::<bool>(), any::<bool>()).prop_map(|(position, notify_on_end, continuous)| {
            Order::To { position, notify_on_end, continuous }
        }),
        (way, any::<bool>(), any::<bool>()).prop_map(|(distance, notify_on_end, continuous)| Order::By {
            distance,
            notify_on_end,
            continuous
        }),
        prop_oneof![Just(0), -5_000..5_000_i32, -5_000_000..5_000_000_i32].prop_map(Order::Slew),
        (0..6_u8).prop_map(Order::Home),
        (0..6_u8).prop_map(Order::HomeToIndex),
    ]
}

fn settings() -> impl Strategy<Value = Settings> {
    let rates = (1..5_000_000_u32, 1..5_000_000_u32, 91..1_525_878_997_u32, 0..8_u32);
    let times = (0..100_u16, prop_oneof![Just(0), 2..100_u16]);
    let modes = (1..=6_u8, any::<[bool; 6]>(), prop_oneof![Just(1_000_u16), 1..2_000_u16]);
    let loop_ = (any::<bool>(), prop_oneof![Just(512_u16), 1..u16::MAX], 0..50_u16, 0..50_u16);
    (rates, times, modes, loop_, machine()).prop_map(
        |((start, speed, ramp, shift), times, modes, loop_, machine)| Settings {
            start: start.min(speed),
            speed: start.max(speed) + 1,
            up: ramp,
            down: (ramp >> shift).max(91),
            microsteps: if loop_.0 { 256 } else { [1, 2, 50, 108, 250, 256][usize::from(times.0 % 6)] },
            settle_ms: times.0,
            hold_delay_ms: times.1,
            run_percent: 1 + modes.0 * 10,
            hold_percent: modes.0 * 10 - 10,
            limit_mode: modes.0,
            home_debounce_ms: (times.0 % 3) as u8,
            enabled: modes.1[0],
            response: u32::MAX,
            keeps_field: modes.1[5],
            jogs: modes.1[1],
            follows_clock: modes.1[2],
            goes_on_stalled: modes.1[3],
            maintains: modes.1[4],
            ratio: modes.2,
            closed: loop_.0,
            lines: loop_.1,
            deadband: loop_.2,
            stall_factor: loop_.3,
            machine,
        },
    )
}

/// A motor without a load model, which follows any motion, or one with some load.
fn machine() -> impl Strategy<Value = StepperParameters> {
    let steps_per_rev = prop_oneof![Just(200_u16), 4..=10_000_u16];
    let loads = (steps_per_rev, 0..2_000_000_u32, 1..100_000_u32, 0..500_000_u32, -500_000..500_000_i32);
    let loads = loads.prop_map(|(steps_per_rev, holding_unm, inertia_gcm2, friction_unm, load_unm)| {
        StepperParameters {
            steps_per_rev,
            holding_unm,
            inertia_gcm2,
            friction_unm,
            load_unm,
            ..StepperParameters::NOMINAL
        }
    });
    prop_oneof![Just(StepperParameters::NOMINAL), loads]
}

fn does() -> impl Strategy<Value = Does> {
    let contact = prop_oneof![
        Just(Contact::Home),
        Just(Contact::PlusLimit),
        Just(Contact::MinusLimit),
        Just(Contact::JogPlus),
        Just(Contact::JogMinus),
    ];
    let channel = prop_oneof![Just(Channel::A), Just(Channel::B), Just(Channel::Index)];
    prop_oneof![
        8 => order().prop_map(Does::Orders),
        4 => (contact, any::<bool>()).prop_map(|(contact, active)| Does::Touches(contact, active)),
        2 => settings().prop_map(Does::Sets),
        1 => any::<bool>().prop_map(Does::Holds),
        2 => (channel, any::<Option<bool>>()).prop_map(|(channel, level)| Does::Edges(channel, level)),
        2 => (-3..4_i32).prop_map(Does::Clocks),
        1 => Just(Does::Stops),
        1 => Just(Does::Halts),
        1 => Just(Does::Pauses),
        1 => Just(Does::Resumes),
        1 => any::<i32>().prop_map(Does::Presets),
        1 => Just(Does::Restarts),
    ]
}

proptest! {
    #[test]
    fn it_always_gets_on(
        settings in settings(),
        list in proptest::collection::vec((does(), prop_oneof![Just(0), 0..50_000_u64, 0..200_000_000_u64]), 1..40),
    ) {
        let mut bench = Bench::new(settings);
        let mut now = settings;
        for (does, wait) in list {
            let before = bench.c1();
            let jumps = matches!(does, Does::Presets(_) | Does::Restarts)
                || matches!(does, Does::Clocks(_)) && now.ratio == 1_000;
            bench.feed(|motion, at, out| match does {
                Does::Orders(order) => {
                    let _ = motion.order(at, order, out);
                }
                Does::Touches(contact, active) => motion.contact(at, contact, active, out),
                Does::Sets(settings) => {
                    now = settings;
                    motion.set(at, settings, out);
                }
                Does::Holds(held) => motion.block_shaft(at, held, out),
                Does::Edges(channel, level) => motion.channel(at, channel, level, out),
                Does::Clocks(steps) => motion.follow(at, steps, out),
                Does::Stops => motion.stop(at, out),
                Does::Halts => motion.halt(at, out),
                Does::Pauses => motion.pause(at, out),
                Does::Resumes => motion.resume(at, out),
                Does::Presets(steps) => {
                    motion.shaft_mut().set_steps(at, steps);
                    motion.shaft_mut().set_counts(at, steps);
                }
                Does::Restarts => motion.power_on(at, now, out),
            });
            prop_assert!(jumps || bench.c1() == before, "{:?}", does);
            bench.run(Duration::from_ticks(wait));
            // A motor at rest has no speed and no flags of motion.
            let rests = !bench.is_moving();
            prop_assert!(!rests || bench.v() == 0 && !bench.is_positioning() && !bench.is_changing());
            let ma = bench.out.currents.last().map(|(.., ma)| *ma);
            let percent = if rests && bench.motion.current.holds() { now.hold_percent } else { now.run_percent };
            prop_assert_eq!(ma, Some(if now.enabled { u32::from(percent) * 30 } else { 0 }));
            // The outputs agree with the motor's position.
            let planned = bench.out.plan();
            let position = planned.position_at(bench.now).wrapping_add(bench.out.steps_since_plan());
            prop_assert_eq!(position, bench.motion.shaft.position(bench.now));
        }
        bench.feed(|motion, at, out| motion.halt(at, out));
        bench.run(1.secs());
        let stands = !bench.is_moving() || now.closed && now.maintains || bench.motion.shaft.has_remote_encoder();
        prop_assert!(stands, "{:?}", bench.motion.activity);
    }
}
