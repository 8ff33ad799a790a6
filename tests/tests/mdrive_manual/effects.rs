//! Effects of every register, and of every variable that only MCode has, apart from reading back, typed by
//! hand from FB 5 and the pages of MC. S1 to S13 and trips have their own tests (inputs, outputs, trips), and
//! so has EM (console).

use drivetwin_firmware::device::{Encoder, Level};
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::PinStimulus;

use crate::rig::{CALIBRATION, KINDS, Kind, Rig, START};
use crate::table::{Access, TABLE, find};

/// Effect of a register: preparation, then pairs of a written value (`None`: no write) and the value observed
/// after it.
struct Effect {
    name: &'static str,
    prepare: fn(&mut Rig),
    seen: &'static [(Option<i64>, i64)],
    observe: fn(&mut Rig) -> i64,
}

const fn effect(
    name: &'static str,
    prepare: fn(&mut Rig),
    seen: &'static [(Option<i64>, i64)],
    observe: fn(&mut Rig) -> i64,
) -> Effect {
    Effect { name, prepare, seen, observe }
}

/// Registers without an effect apart from reading back.
const WITHOUT: &[(&str, &str)] = &[("CA", "this motor has no torque to compensate (MC 5-9)")];

fn nothing(_: &mut Rig) {}

// Addresses of FB 5.
const A: u16 = 0x0000;
const C1: u16 = 0x0005;
const C2: u16 = 0x0007;
const EE: u16 = 0x001E;
const EF: u16 = 0x001F;
const ER: u16 = 0x0021;
const I1: u16 = 0x002D;
const MR: u16 = 0x0046;
const MV: u16 = 0x004A;
const P: u16 = 0x0057;
const R1: u16 = 0x005F;
const SL: u16 = 0x0078;
const ST: u16 = 0x007B;
const V: u16 = 0x0085;
const AS: u16 = 0x008E;
const AF: u16 = 0x008F;
const LL: u16 = 0x0099;
const LR: u16 = 0x009B;
const SC: u16 = 0x00A1;

/// Whole turns of the shaft by its encoder: 512 lines on a Plus, 1,000 on a Hybrid (MC 5-22).
fn turns(rig: &mut Rig) -> i64 {
    let counts = if rig.kind == Kind::Plus { 2_048 } else { 4_000 };
    i64::from(rig.long(C2)) / counts
}

fn current_ma(rig: &mut Rig) -> i64 {
    rig.motion().current_ma.into()
}

fn level(rig: &mut Rig, io: &str) -> i64 {
    i64::from(rig.level(io) == Level::Low)
}

/// Outputs 1 to 4 as bits; a bit is 1 while its output pulls low.
fn outputs(rig: &mut Rig) -> i64 {
    ["IO4", "IO3", "IO2", "IO1"].into_iter().fold(0, |bits, io| bits << 1 | level(rig, io))
}

fn are_outputs(rig: &mut Rig) {
    rig.set(&["S1=16,0,0", "S2=16,0,0", "S3=16,0,0", "S4=16,0,0"]);
}

/// Pulls input `n` + 1 low; returns 1 if the input is active 20 ms later.
fn follows(rig: &mut Rig, n: u16) -> i64 {
    rig.low(["IO1", "IO2", "IO3", "IO4"][usize::from(n)]);
    rig.after(20.millis());
    rig.word(I1 + n).into()
}

/// Commands a slew at `speed`; returns the speed after `ms` milliseconds.
fn speed_after(rig: &mut Rig, ms: u64, speed: i32) -> i64 {
    rig.write_long(SL, speed);
    rig.after(ms.millis());
    rig.long(V).into()
}

/// Switches to closed loop and holds the shaft.
fn held_in_closed_loop(rig: &mut Rig) {
    rig.write(EE, 1);
    rig.fault("stall", true);
}

fn slews_in_closed_loop(rig: &mut Rig) {
    rig.write_long(SL, 1_000);
    rig.after(100.millis());
}

/// Holds a Hybrid's shaft while its field moves at `speed` for `ms` milliseconds. A turn has 200 full steps
/// of 256 steps.
fn lags(rig: &mut Rig, speed: i32, ms: u64) {
    rig.fault("stall", true);
    rig.write_long(SL, speed);
    rig.after(ms.millis());
}

/// Makes a Hybrid's shaft miss a turn; returns 1 if the drive has made up for it after `ms` milliseconds, so
/// that LL is 0.
fn missed_turn_is_made_up(rig: &mut Rig, ms: u64) -> i64 {
    rig.fault("stall", true);
    rig.write_long(MR, 51_200);
    rig.wait_still(2.secs());
    rig.fault("stall", false);
    rig.after(ms.millis());
    i64::from(rig.long(LL) == 0)
}

/// Types a program that counts the calls of a trip in R1.
fn trip_program(rig: &mut Rig) {
    rig.program("PG 1\nLB K1\nIC R1\nRT\nE\nPG");
    rig.set(&["TT=100,K1"]);
}

fn spins(rig: &mut Rig) {
    rig.write(AS, 3);
    rig.after(1.secs());
}

fn declares(rig: &mut Rig) {
    for n in 1..=8 {
        rig.set(&[&format!("VA V{n}")]);
    }
}

/// Value of a variable in MCode, measured as the distance of a move.
fn as_distance(rig: &mut Rig, name: &str) -> i64 {
    rig.set(&[&format!("MR {name}")]);
    rig.wait_still(1.secs());
    rig.long(P).into()
}

#[rustfmt::skip]
const EFFECTS: &[Effect] = &[
    // The speed is VI, 1,000, and 10 ms later it has increased by A times 10 ms.
    effect("A", nothing, &[(Some(1_000_000), 11_000), (Some(500_000), 6_000)], |rig| speed_after(rig, 10, 200_000)),
    effect("C1", nothing, &[(Some(123), 123), (Some(-7), -7)], |rig| rig.long(P).into()),
    effect("C2", |rig| rig.write(EE, 1), &[(Some(123), 123), (Some(-7), -7)], |rig| rig.long(P).into()),
    effect("CE", |rig| rig.write_long(R1, 5), &[(Some(1), 0), (Some(0), 5)], |rig| {
        rig.key(&[0x03]);
        rig.after(START);
        rig.long(R1).into()
    }),
    effect("CM", nothing, &[(Some(0), 0), (Some(1), 3)], |rig| {
        for _ in 0..3 {
            rig.low("IO7");
            rig.after(1.millis());
            rig.high("IO7");
            rig.after(1.millis());
        }
        rig.long(C1).into()
    }),
    effect("D1", nothing, &[(Some(10), 1), (Some(50), 0)], |rig| follows(rig, 0)),
    effect("D2", nothing, &[(Some(10), 1), (Some(50), 0)], |rig| follows(rig, 1)),
    effect("D3", nothing, &[(Some(10), 1), (Some(50), 0)], |rig| follows(rig, 2)),
    effect("D4", nothing, &[(Some(10), 1), (Some(50), 0)], |rig| follows(rig, 3)),
    // Half of 5 V reads 512.
    effect("D5", nothing, &[(Some(0), 1), (Some(255), 0)], |rig| {
        rig.drive("ANALOG", PinStimulus::Millivolts(2_500));
        rig.after(10.millis());
        i64::from(rig.word(0x0031) == 512)
    }),
    effect("D", |rig| { speed_after(rig, 500, 100_000); }, &[(Some(1_000_000), 90_000), (Some(500_000), 95_000)],
        |rig| speed_after(rig, 10, 0)),
    // The held shaft misses 100 counts, and three corrections fail: error 92 (MC 9.6).
    effect("DB", |rig| { rig.set(&["EE=1", "SM=1", "SF=65000"]); rig.fault("stall", true); },
        &[(Some(200), 0), (Some(10), 92)], |rig| {
            rig.write_long(MR, 100);
            rig.wait_still(10.secs());
            rig.word(ER).into()
        }),
    effect("DC", |rig| rig.write_long(R1, 5), &[(None, 5), (Some(0x5F), 4), (Some(0x61), 5)], |rig| rig.long(R1).into()),
    effect("DE", nothing, &[(Some(1), 1), (Some(0), 0)], |rig| {
        rig.write_long(MR, 51_200);
        rig.wait_still(2.secs());
        turns(rig)
    }),
    // With EE = 1 the distance is in counts, which are more steps.
    effect("EE", nothing, &[(Some(0), 1), (Some(1), 0)], |rig| {
        rig.write_long(MR, 100);
        rig.wait_still(2.secs());
        i64::from(rig.long(C1) == 100)
    }),
    effect("ER", |rig| { rig.say("VM=1"); }, &[(None, 1), (Some(0), 0)], |rig| rig.word(EF).into()),
    effect("HC", |rig| rig.after(1.secs()), &[(Some(5), 150), (Some(50), 1_500)], current_ma),
    // Type 1 starts towards the minus side, type 3 towards the plus side.
    effect("HM", |rig| rig.set(&["S1=1,0,0"]), &[(Some(1), -1), (Some(3), 1)], |rig| {
        rig.after(100.millis());
        rig.long(V).signum().into()
    }),
    effect("HT", nothing, &[(Some(100), 150), (Some(1_000), 750)], |rig| {
        rig.write_long(MR, 100);
        rig.wait_still(1.secs());
        rig.after(500.millis());
        current_ma(rig)
    }),
    effect("IC", |rig| rig.write_long(R1, 5), &[(None, 5), (Some(0x5F), 6), (Some(0x61), 5)], |rig| rig.long(R1).into()),
    effect("JE", |rig| rig.set(&["S1=7,0,0"]), &[(Some(0), 0), (Some(1), 1)], |rig| {
        rig.low("IO1");
        rig.after(10.millis());
        rig.long(V).signum().into()
    }),
    // LM 1 stops with a ramp. LM 4 stops without a ramp, at the next step, within 10 µs.
    effect("LM", |rig| { rig.set(&["S1=2,0,0"]); speed_after(rig, 500, 100_000); }, &[(Some(1), 1), (Some(4), 0)], |rig| {
        rig.low("IO1");
        rig.after(20.micros());
        rig.long(V).signum().into()
    }),
    effect("MA", |rig| rig.write_long(P, 300), &[(Some(500), 500), (Some(-500), -500)], |rig| {
        rig.wait_still(1.secs());
        rig.long(P).into()
    }),
    effect("MR", |rig| rig.write_long(P, 300), &[(Some(500), 800), (Some(-500), -200)], |rig| {
        rig.wait_still(1.secs());
        rig.long(P).into()
    }),
    // A turn has 200 times MS steps.
    effect("MS", nothing, &[(Some(256), 1), (Some(128), 2), (Some(64), 4)], |rig| {
        rig.after(CALIBRATION);
        rig.write_long(MR, 51_200);
        rig.wait_still(2.secs());
        turns(rig)
    }),
    effect("MT", nothing, &[(Some(0), 0), (Some(1_000), 1)], |rig| {
        rig.write_long(MR, 100);
        rig.after(500.millis());
        rig.word(MV).into()
    }),
    effect("O1", are_outputs, &[(Some(0), 0), (Some(1), 1)], outputs),
    effect("O2", are_outputs, &[(Some(0), 0), (Some(1), 2)], outputs),
    effect("O3", are_outputs, &[(Some(0), 0), (Some(1), 4)], outputs),
    effect("O4", are_outputs, &[(Some(0), 0), (Some(1), 8)], outputs),
    effect("OL", are_outputs, &[(Some(0), 0), (Some(5), 5), (Some(15), 15)], outputs),
    effect("OT", are_outputs, &[(Some(0), 0), (Some(10), 10), (Some(15), 15)], outputs),
    effect("P", nothing, &[(Some(77), 77), (Some(-1), -1)], |rig| rig.long(C1).into()),
    // 12 counts are more than DB and less than SF.
    effect("PM", |rig| { rig.turn(Encoder(0), 4); rig.write(EE, 1); }, &[(Some(0), 0), (Some(1), 1)], |rig| {
        rig.turn(Encoder(0), 12);
        rig.after(1.secs());
        i64::from(rig.long(C1) != 0)
    }),
    effect("R1", nothing, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "R1")),
    effect("R2", nothing, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "R2")),
    effect("R3", nothing, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "R3")),
    effect("R4", nothing, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "R4")),
    effect("RC", |rig| rig.write_long(SL, 1_000), &[(Some(25), 750), (Some(50), 1_500)], current_ma),
    effect("S", |rig| rig.write_long(R1, 5), &[(None, 0), (Some(1), 5)], |rig| {
        rig.after(1.secs());
        rig.power_cycle();
        rig.long(R1).into()
    }),
    // The field is 100 counts ahead of the shaft.
    effect("SF", held_in_closed_loop, &[(Some(15), 1), (Some(1_000), 0)], |rig| {
        slews_in_closed_loop(rig);
        rig.word(ST).into()
    }),
    effect("SL", nothing, &[(Some(5_000), 5_000), (Some(-5_000), -5_000)], |rig| {
        rig.after(1.secs());
        rig.long(V).into()
    }),
    effect("SM", held_in_closed_loop, &[(Some(0), 0), (Some(1), 1)], |rig| {
        slews_in_closed_loop(rig);
        rig.word(MV).into()
    }),
    // Type 19 is a stall output.
    effect("ST", |rig| rig.set(&["S1=19,0,0"]), &[(Some(0), 0), (Some(1), 1)], |rig| level(rig, "IO1")),
    effect("TE", trip_program, &[(Some(0), 0), (Some(8), 1)], |rig| {
        rig.after(1.secs());
        rig.long(R1).into()
    }),
    effect("VI", |rig| rig.write_long(A, 91), &[(Some(500), 500), (Some(2_000), 2_000)], |rig| speed_after(rig, 1, 200_000)),
    effect("VM", nothing, &[(Some(50_000), 50_000), (Some(100_000), 100_000)], |rig| {
        rig.write_long(MR, 1_000_000);
        rig.after(1.secs());
        rig.long(V).into()
    }),

    // Torque mode turns the shaft.
    effect("AS", nothing, &[(Some(0), 0), (Some(2), 0), (Some(3), 1)], |rig| {
        rig.after(1.secs());
        rig.long(C2).signum().into()
    }),
    // A lag of 350 steps is more than 1.1 full steps of 256 (CB 0), and less than 1.7 (CB 3).
    effect("CB", nothing, &[(Some(0), 16), (Some(3), 0)], |rig| {
        lags(rig, 1_000, 350);
        i64::from(rig.word(AF) & 16)
    }),
    effect("CC", nothing, &[(Some(100), 3_000), (Some(50), 1_500)], |rig| {
        rig.write(SC, 1);
        rig.after(10.millis());
        current_ma(rig)
    }),
    effect("CF", |rig| {
        lags(rig, 1_000, 3_000);
        rig.write_long(SL, 0);
        rig.wait_still(1.secs());
        rig.fault("stall", false);
    }, &[(None, 1), (Some(1), 0)], |rig| rig.word(LR).into()),
    // A calibration takes three times CT, and moves of 2.37 s.
    effect("CT", nothing, &[(Some(200), 128), (Some(1_000), 0)], |rig| {
        rig.write(SC, 1);
        rig.after(4.secs());
        i64::from(rig.word(AF) & 128)
    }),
    effect("LD", nothing, &[(Some(100), 1), (Some(1_000), 0)], |rig| {
        lags(rig, -1_000, 200);
        i64::from(rig.word(AF) & 1)
    }),
    effect("LG", nothing, &[(Some(100), 2), (Some(1_000), 0)], |rig| {
        lags(rig, 1_000, 200);
        i64::from(rig.word(AF) & 2)
    }),
    effect("LT", nothing, &[(Some(500), 1), (Some(5_000), 0)], |rig| {
        lags(rig, 1_000, 1_500);
        rig.word(LR).into()
    }),
    effect("MF", |rig| rig.write(0x00A0, 1), &[(Some(768_000), 1), (Some(306), 0)], |rig| missed_turn_is_made_up(rig, 500)),
    effect("MU", nothing, &[(Some(0), 0), (Some(1), 1), (Some(2), 1)], |rig| missed_turn_is_made_up(rig, 500)),
    effect("SC", nothing, &[(None, 128), (Some(1), 0)], |rig| i64::from(rig.word(AF) & 128)),
    // SS 0 is 5,000,000 steps/s, SS 255 is 38,910.
    effect("SS", |rig| rig.write(0x00A0, 2), &[(Some(0), 1), (Some(255), 0)], |rig| missed_turn_is_made_up(rig, 500)),
    effect("TD", nothing, &[(Some(1), 1), (Some(0), -1)], |rig| {
        spins(rig);
        rig.long(C2).signum().into()
    }),
    effect("TQ", nothing, &[(Some(25), 750), (Some(50), 1_500)], |rig| {
        spins(rig);
        current_ma(rig)
    }),
    effect("TS", nothing, &[(Some(255), 38_910), (Some(98), 100_000)], |rig| {
        spins(rig);
        rig.motion().speed.to_num()
    }),

    effect("V1", declares, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "V1")),
    effect("V2", declares, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "V2")),
    effect("V3", declares, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "V3")),
    effect("V4", declares, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "V4")),
    effect("V5", declares, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "V5")),
    effect("V6", declares, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "V6")),
    effect("V7", declares, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "V7")),
    effect("V8", declares, &[(Some(42), 42), (Some(-42), -42)], |rig| as_distance(rig, "V8")),
];

#[test]
fn written_registers_have_effects() {
    for kind in KINDS {
        for effect in EFFECTS {
            let row = find(effect.name);
            if !row.is_on(kind) {
                continue;
            }
            for &(value, seen) in effect.seen {
                let mut rig = Rig::new(kind);
                (effect.prepare)(&mut rig);
                if let Some(value) = value {
                    assert_eq!(
                        rig.try_write(row.address, &row.words(value)),
                        Ok(()),
                        "{} = {value}",
                        row.name
                    );
                }
                assert_eq!((effect.observe)(&mut rig), seen, "{kind:?}: {} = {value:?}", row.name);
            }
        }
    }
}

/// Each writable register is in exactly one of the lists above, with at least two different observations.
#[test]
fn no_register_is_left_out() {
    for row in TABLE.iter().filter(|row| row.access != Access::ReadOnly) {
        let lines = EFFECTS.iter().filter(|effect| effect.name == row.name).count();
        let without = WITHOUT.iter().filter(|(name, _)| *name == row.name).count();
        assert_eq!(lines + without, 1, "{}", row.name);
    }
    for effect in EFFECTS {
        let [(_, first), rest @ ..] = effect.seen else { panic!("{} sees nothing", effect.name) };
        assert!(rest.iter().any(|(_, seen)| seen != first), "{} sees the same", effect.name);
    }
}

/// Effect of a variable that only MCode has: preparation, then pairs of a typed line and the value observed
/// after it.
struct Typed {
    lines: fn(&mut Rig),
    seen: &'static [(&'static str, i64)],
    observe: fn(&mut Rig) -> i64,
    only: Option<Kind>,
}

const fn typed(
    lines: fn(&mut Rig),
    seen: &'static [(&'static str, i64)],
    observe: fn(&mut Rig) -> i64,
    only: Option<Kind>,
) -> Typed {
    Typed { lines, seen, observe, only }
}

/// Drives a pin low for `us` µs.
fn dips(rig: &mut Rig, io: &str, us: u64) {
    rig.low(io);
    rig.after(us.micros());
    rig.high(io);
    rig.after(1.millis());
}

const PLUS: Option<Kind> = Some(Kind::Plus);
const HYBRID: Option<Kind> = Some(Kind::Hybrid);

#[rustfmt::skip]
const TYPED: &[Typed] = &[
    // The clock input gets four pulses (MC 5-14).
    typed(|rig| rig.set(&["CM=1"]), &[("CR=1.000", 4), ("CR=2.000", 8), ("CR=0.500", 2)], |rig| {
        for _ in 0..4 {
            dips(rig, "IO7", 1_000);
        }
        rig.after(1.secs());
        rig.long(C1).into()
    }, PLUS),
    // CW is the width of a pulse in units of 50 ns. So the pulse of a trip lasts more or less than 5 µs, but
    // always less than 15 µs (MC 5-15).
    typed(|rig| rig.set(&["S13=61,1", "TP=20,0", "TE=2"]), &[("CW=40", 0), ("CW=255", 1)], |rig| {
        rig.write_long(SL, 1_000);
        rig.wait(1.secs(), 1.micros(), |rig| rig.level("CAPTURE") == Level::High);
        rig.after(5.micros());
        let is_long = rig.level("CAPTURE") == Level::High;
        rig.after(10.micros());
        assert_eq!(rig.level("CAPTURE"), Level::Low);
        is_long.into()
    }, None),
    // 51,200 steps are 2,048 counts, or 1,024 with EL=256 (MC 5-22).
    typed(nothing, &[("EL=512", 2_500), ("EL=256", 5_000)], |rig| {
        rig.set(&["EE=1", "SM=1", "SF=65000", "DB=65000", "MR 100"]);
        rig.wait_still(1.secs());
        rig.long(C1).into()
    }, PLUS),
    // The motion stops with Esc (ES=1) or Ctrl-E (ES=0) (MC 5-23).
    typed(nothing, &[("ES=1", 0), ("ES=0", 5_000)], |rig| {
        speed_after(rig, 500, 5_000);
        rig.key(&[0x1B]);
        rig.long(V).into()
    }, None),
    // The filter passes pulses from 50 ns (FC=0) or 12.9 µs (FC=9) (MC 5-25).
    typed(|rig| { trip_program(rig); rig.set(&["S13=60,0", "TC=K1", "TE=4"]); }, &[("FC=0", 1), ("FC=9", 0)], |rig| {
        rig.high("CAPTURE");
        rig.after(1.millis());
        dips(rig, "CAPTURE", 5);
        rig.after(100.millis());
        rig.long(R1).into()
    }, None),
    // FM filters in the same way (MC 5-26).
    typed(|rig| rig.set(&["CM=1"]), &[("FM=0", 1), ("FM=9", 0)], |rig| {
        dips(rig, "IO7", 5);
        rig.long(C1).into()
    }, PLUS),
    // After IF=0 the next typed line is not stored in R1 (MC 5-36).
    typed(|rig| rig.set(&["IV R1"]), &[("PR IF", 42), ("IF=0", 0)], |rig| {
        rig.say("42");
        rig.long(R1).into()
    }, None),
    // Error 44: the program is locked (MC 5-42).
    typed(trip_program, &[("LK=0", 0), ("LK=1", 44)], |rig| {
        rig.say("CP 1");
        rig.word(ER).into()
    }, None),
    // A number alone moves again (MC 5-51).
    typed(nothing, &[("NE=1", 150), ("NE=0", 100)], |rig| {
        rig.say("MR 100");
        rig.wait_still(1.secs());
        rig.say("50");
        rig.wait_still(1.secs());
        rig.long(C1).into()
    }, None),
    // Error 71: the drive is warmer than WT (MC 5-81).
    typed(nothing, &[("WT=84", 0), ("WT=0", 71)], |rig| rig.word(ER).into(), HYBRID),
];

#[test]
fn typed_lines_have_effects() {
    for kind in KINDS {
        for typed in TYPED.iter().filter(|typed| typed.only.is_none_or(|only| only == kind)) {
            for &(line, seen) in typed.seen {
                let mut rig = Rig::new(kind);
                (typed.lines)(&mut rig);
                rig.say(line);
                assert_eq!((typed.observe)(&mut rig), seen, "{kind:?}: {line}");
            }
        }
    }
}
