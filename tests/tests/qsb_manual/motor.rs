//! The motor drive of the QSB-M on DIO1 (step) and DIO2 (direction). Times are computed from constant
//! acceleration. Rates and accelerations are rounded down to multiples of 16 (QSB-27): 1,000 steps/s is
//! 992.

use drivetwin_firmware::device::Level;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::PowerAction;

use crate::rig::Rig;

/// Values of register 13.
const INACTIVE: u32 = 0x01;
const READY: u32 = 0x11;
const MOVING: u32 = 0x12;
const PAUSED: u32 = 0x14;
const JOGGING: u32 = 0x18;

/// A QSB-M with an active motor drive, and these settings.
fn active(settings: &[&str]) -> Rig {
    let mut rig = Rig::ready("qsb-m");
    for command in settings {
        rig.write(command);
    }
    rig.write("W162");
    rig.after(1.millis());
    rig
}

/// Numbers of pulses on DIO1 so far, forward and backward.
fn pulses(rig: &Rig) -> (usize, usize) {
    let forward = rig.bench.pulses(rig.seat.step()).filter(|pulse| pulse.forward).count();
    (forward, rig.bench.pulses(rig.seat.step()).count() - forward)
}

impl Rig {
    fn status(&mut self) -> u32 {
        self.read("13")
    }

    /// Asserts the position, with a tolerance of 2 steps.
    #[track_caller]
    fn assert_near(&self, position: i32) {
        let is = self.position();
        assert!((is - position).abs() <= 2, "at {is}, not {position}");
    }
}

/// Example 7.1: the motor drive takes the pins and sets them low.
#[test]
fn activation() {
    let mut rig = Rig::ready("qsb-m");
    assert_eq!(rig.status(), INACTIVE);
    assert!(rig.is_high("DIO1") && rig.is_high("DIO2"));
    rig.write("W162");
    assert_eq!((rig.status(), rig.read("01")), (READY, 0b1001));
    assert_eq!((rig.level("DIO1"), rig.level("DIO2")), (Level::Low, Level::Low));
    // A second activation has no effect.
    rig.write("W162");
    assert_eq!(rig.status(), READY);
    rig.write("W161");
    assert_eq!(rig.status(), READY);
    rig.write("W160");
    assert_eq!((rig.status(), rig.read("01")), (INACTIVE, 0b1111));
    assert!(rig.is_high("DIO1") && rig.is_high("DIO2"));
    assert_eq!(pulses(&rig), (0, 0));
}

/// Example 7.3: 2,000 steps at 992/s with 100,000/s²: 2000 / 992 + 992 / 100000 = 2.026 s.
#[test]
fn a_move() {
    for (steps, sign, direction) in [("W117D0", 1, 0b0100), ("W11FFFFF830", -1, 0)] {
        let mut rig = active(&["W0F3E8", "W10186A0", steps]);
        rig.write("W168");
        rig.after(1.secs());
        // 992 × (1 − 0.00992 / 2)
        rig.assert_near(987 * sign);
        assert!((rig.speed() - f64::from(992 * sign)).abs() < 1.0, "{}", rig.speed());
        assert_eq!(rig.status(), MOVING);
        // The step pulses are too short to be seen here.
        assert_eq!(rig.read("01"), 0b1001 | direction);
        rig.after(1_020.millis());
        assert_eq!(rig.status(), MOVING);
        rig.after(15.millis());
        assert_eq!(rig.status(), READY);
        assert_eq!((rig.position(), rig.speed()), (2_000 * sign, 0.0));
        let made = if sign > 0 { (2_000, 0) } else { (0, 2_000) };
        assert_eq!(pulses(&rig), made);
        // A second move starts at the position of the first.
        rig.write("W168");
        rig.after(3.secs());
        assert_eq!(rig.position(), 4_000 * sign);
    }
}

/// The lowest and the highest rate: 32/s, and 12,992/s for 13,000.
#[test]
fn limits_of_rates() {
    let mut rig = active(&["W0F20", "W1057E40", "W1140"]);
    rig.write("W168");
    rig.after(1.secs());
    assert!((rig.speed() - 32.0).abs() < 0.1, "{}", rig.speed());
    rig.after(2.secs());
    assert_eq!((rig.position(), rig.status()), (64, READY));

    let mut rig = active(&["W0F32C8", "W1057E40", "W11FDE8"]);
    rig.write("W168");
    rig.after(1.secs());
    assert!((rig.speed() - 12_992.0).abs() < 1.0, "{}", rig.speed());
    rig.after(4_040.millis());
    // 65000 / 12992 + 12992 / 360000 = 5.039 s
    assert_eq!((rig.position(), rig.status()), (65_000, READY));
    assert_eq!(pulses(&rig), (65_000, 0));
}

/// Acceleration 64/s²: a short move never reaches its rate. 256 steps take 2 × sqrt(256 / 64) = 4 s.
#[test]
fn a_triangle() {
    let mut rig = active(&["W0F32C8", "W1040", "W11100"]);
    rig.write("W168");
    rig.after(2.secs());
    rig.assert_near(128);
    assert!((rig.speed() - 128.0).abs() < 2.0, "{}", rig.speed());
    rig.after(1_800.millis());
    assert_eq!(rig.status(), MOVING);
    rig.after(300.millis());
    assert_eq!((rig.position(), rig.status()), (256, READY));
}

/// Command 4 ramps down, command 5 stops at once. 992/s with 992/s² is a ramp of 1 s and 496 steps.
#[test]
fn stop_and_quit() {
    let mut rig = active(&["W0F3E8", "W103E8", "W112710"]);
    rig.write("W168");
    rig.after(2.secs());
    rig.assert_near(496 + 992);
    rig.write("W164");
    rig.after(500.millis());
    assert_eq!(rig.status(), MOVING);
    assert!((rig.speed() - 496.0).abs() < 10.0, "{}", rig.speed());
    rig.after(600.millis());
    assert_eq!(rig.status(), READY);
    rig.assert_near(496 + 992 + 496);

    let mut rig = active(&["W0F3E8", "W103E8", "W112710"]);
    rig.write("W168");
    rig.after(2.secs());
    rig.write("W165");
    assert_eq!((rig.status(), rig.speed()), (READY, 0.0));
    let stands = rig.position();
    rig.assert_near(496 + 992);
    rig.after(1.secs());
    assert_eq!(rig.position(), stands);
    // The rest of the move is dropped.
    rig.says(&[("W167", "w 16 00000007 !")]);
    rig.after(1.secs());
    assert_eq!(rig.position(), stands);
}

/// A move that is paused and resumed any number of times, also in its ramps, makes exactly the commanded
/// steps (register 16, commands 6 and 7).
#[test]
fn pause_and_resume_lose_no_step() {
    for (steps, total) in [("W11BB8", 3_000), ("W11FFFFF448", -3_000)] {
        for first in [10, 300, 700, 1_500, 2_900, 3_400] {
            let mut rig = active(&["W0F3E8", "W103E8", steps]);
            rig.write("W168");
            for millis in [first, 150, 40, 400] {
                rig.after(millis.millis());
                rig.says(&[("W166", "w 16 00000006 !")]);
                rig.after(1_100.millis());
                if rig.status() != PAUSED {
                    // The move was complete before the pause.
                    assert_eq!((rig.status(), rig.position()), (READY, total));
                    break;
                }
                let stands = rig.position();
                assert!(stands.abs() <= total.abs());
                rig.after(1.secs());
                assert_eq!((rig.status(), rig.position()), (PAUSED, stands));
                rig.says(&[("W167", "w 16 00000007 !")]);
            }
            rig.after(10.secs());
            assert_eq!((rig.status(), rig.position()), (READY, total), "paused after {first} ms");
            let made = pulses(&rig);
            assert_eq!(made, if total > 0 { (3_000, 0) } else { (0, 3_000) });
        }
    }
}

/// Status 14 means paused and at rest. A resume while the motor still slows down takes effect.
#[test]
fn resume_while_it_slows_down() {
    let mut rig = active(&["W0F3E8", "W103E8", "W11BB8"]);
    rig.write("W168");
    rig.after(1_500.millis());
    rig.write("W166");
    rig.after(500.millis());
    assert_eq!(rig.status(), MOVING);
    rig.write("W167");
    rig.after(10.secs());
    assert_eq!((rig.status(), rig.position()), (READY, 3_000));
    assert_eq!(pulses(&rig), (3_000, 0));
}

/// A stop or a quit ends a paused move.
#[test]
fn a_paused_move_can_be_ended() {
    for command in ["W164", "W165"] {
        let mut rig = active(&["W0F3E8", "W103E8", "W11BB8"]);
        rig.write("W168");
        rig.after(1_500.millis());
        rig.write("W166");
        rig.after(1_100.millis());
        assert_eq!(rig.status(), PAUSED);
        rig.write(command);
        assert_eq!(rig.status(), READY);
        let stands = rig.position();
        rig.write("W167");
        rig.after(1.secs());
        assert_eq!((rig.status(), rig.position()), (READY, stands));
    }
}

/// QSB-27: moves and jogs are refused while the motor drive is inactive, and during another motion or pause.
#[test]
fn refused_commands() {
    let mut rig = Rig::ready("qsb-m");
    rig.says(&[("W168", "e 16 00000008 !"), ("W169", "e 16 00000009 !")]);
    rig.says(&[
        ("W164", "w 16 00000004 !"),
        ("W165", "w 16 00000005 !"),
        ("W166", "w 16 00000006 !"),
        ("W167", "w 16 00000007 !"),
    ]);
    let mut rig = active(&["W0F3E8", "W10186A0", "W11BB8"]);
    rig.says(&[
        ("W164", "w 16 00000004 !"),
        ("W165", "w 16 00000005 !"),
        ("W166", "w 16 00000006 !"),
        ("W167", "w 16 00000007 !"),
    ]);
    assert_eq!(rig.status(), READY);
    rig.says(&[("W168", "w 16 00000008 !")]);
    rig.after(500.millis());
    rig.says(&[("W168", "e 16 00000008 !"), ("W169", "e 16 00000009 !"), ("R13", "r 13 00000012 !")]);
    rig.write("W166");
    rig.after(500.millis());
    rig.says(&[("R13", "r 13 00000014 !"), ("W168", "e 16 00000008 !"), ("W167", "w 16 00000007 !")]);
    rig.after(5.secs());
    // The refused commands had no effect.
    assert_eq!((rig.status(), rig.position()), (READY, 3_000));
    rig.write("W169");
    rig.after(500.millis());
    rig.says(&[("W168", "e 16 00000008 !"), ("R13", "r 13 00000018 !")]);
}

/// Example 7.2 in both directions. A new rate takes effect with the next W169, which ramps to it.
#[test]
fn a_jog() {
    for (jog, rate) in [("W123E8", 992.0), ("W12FFFFFC18", -992.0)] {
        let mut rig = active(&["W10186A0", jog]);
        rig.write("W169");
        rig.after(1.secs());
        assert!((rig.speed() - rate).abs() < 1.0, "{}", rig.speed());
        assert_eq!(rig.status(), JOGGING);
        rig.assert_near((rate * (1.0 - 0.00992 / 2.0)) as i32);
        rig.write("W12190");
        rig.after(1.secs());
        assert!((rig.speed() - rate).abs() < 1.0, "{}", rig.speed());
        rig.write("W169");
        rig.after(100.millis());
        assert!((rig.speed() - 400.0).abs() < 1.0, "{}", rig.speed());
        assert_eq!(rig.status(), JOGGING);
        rig.write("W164");
        rig.after(100.millis());
        assert_eq!((rig.status(), rig.speed()), (READY, 0.0));
    }
}

/// A jog can be paused and resumed, too.
#[test]
fn a_paused_jog() {
    let mut rig = active(&["W10186A0", "W123E8"]);
    rig.write("W169");
    rig.after(500.millis());
    rig.write("W166");
    rig.after(100.millis());
    assert_eq!((rig.status(), rig.speed()), (PAUSED, 0.0));
    rig.write("W167");
    rig.after(100.millis());
    assert_eq!(rig.status(), JOGGING);
    assert!((rig.speed() - 992.0).abs() < 1.0, "{}", rig.speed());
}

/// QSB-29: a jog below 16 steps/s does not move, and a move of 0 steps is complete at once.
#[test]
fn nothing_to_do() {
    let mut rig = active(&["W12F"]);
    rig.write("W169");
    rig.after(2.secs());
    assert_eq!((rig.position(), rig.speed()), (0, 0.0));
    let mut rig = active(&["W110"]);
    rig.says(&[("W168", "w 16 00000008 !"), ("R13", "r 13 00000011 !")]);
    rig.after(1.secs());
    assert_eq!(pulses(&rig), (0, 0));
}

/// Rates written during a move take effect with the next command.
#[test]
fn writes_on_the_way() {
    let mut rig = active(&["W0F3E8", "W10186A0", "W117D0"]);
    rig.write("W168");
    rig.after(500.millis());
    for command in ["W0F20", "W1040", "W11A"] {
        rig.write(command);
    }
    rig.after(500.millis());
    assert!((rig.speed() - 992.0).abs() < 1.0, "{}", rig.speed());
    rig.after(1_100.millis());
    assert_eq!((rig.status(), rig.position()), (READY, 2_000));
}

/// Writes to the digital port do not disturb a move, and its other pins still work (QSB-26).
#[test]
fn the_port_during_a_move() {
    let mut rig = active(&["W0F3E8", "W10186A0", "W117D0"]);
    rig.write("W168");
    for command in ["W02F00", "W010", "W01F", "W02000", "W02600", "W016", "W010", "W02F00", "W010"] {
        rig.after(100.millis());
        rig.write(command);
    }
    assert_eq!(rig.status(), MOVING);
    assert_eq!(rig.read("01"), 0b0100);
    assert!(!rig.is_high("DIO0") && !rig.is_high("DIO3"));
    rig.after(2.secs());
    assert_eq!((rig.status(), rig.position()), (READY, 2_000));
    assert_eq!(pulses(&rig), (2_000, 0));
}

/// Command 0: "Motor is immediately stopped". The port returns to its saved state, and the streams end.
#[test]
fn command_0_on_the_way() {
    let mut rig = active(&["W0F3E8", "W10186A0", "W117D0"]);
    rig.write("W168");
    rig.after(1.secs());
    rig.write("W160");
    assert_eq!((rig.status(), rig.speed(), rig.read("01")), (INACTIVE, 0.0, 0xF));
    let stands = rig.position();
    rig.assert_near(987);
    rig.after(2.secs());
    assert_eq!(rig.position(), stands);
    // The pins belong to the port again.
    rig.write("W02F00");
    rig.write("W019");
    assert!(!rig.is_high("DIO1") && !rig.is_high("DIO2"));
    rig.write("W016");
    assert!(rig.is_high("DIO1") && rig.is_high("DIO2"));
    // The pins belong to the motor drive again.
    rig.write("W162");
    rig.write("W168");
    rig.after(3.secs());
    assert_eq!((rig.status(), rig.position()), (READY, stands + 2_000));
}

/// A reset or a power failure during a move: the motor stops and the pins are released.
#[test]
fn reset_on_the_way() {
    for cut in [false, true] {
        let mut rig = active(&["W0F3E8", "W10186A0", "W117D0"]);
        rig.write("W168");
        rig.after(1.secs());
        if cut {
            rig.bench.power(rig.seat, PowerAction::Off);
        } else {
            rig.bench.attach(rig.bus, true);
        }
        rig.after(1.millis());
        assert_eq!(rig.speed(), 0.0);
        assert!(rig.is_high("DIO1") && rig.is_high("DIO2"));
        let made = pulses(&rig);
        assert!((986..=988).contains(&made.0) && made.1 == 0, "{made:?}");
        // A reset by DTR does not change the position of the motor (QSB-6).
        assert!(cut || rig.position() == made.0 as i32, "at {}", rig.position());
        rig.after(2.secs());
        assert_eq!(pulses(&rig), made);
        if cut {
            rig.bench.power(rig.seat, PowerAction::On);
        }
        rig.after(1.secs());
        rig.hear(Duration::ZERO);
        assert_eq!((rig.status(), rig.read("01")), (INACTIVE, 0xF));
        rig.says(&[("W168", "e 16 00000008 !")]);
    }
}

/// S13: "the new MD STATUS is output upon a state change".
#[test]
fn status_is_streamed() {
    let mut rig = active(&["W0F3E8", "W10186A0", "W117D0", "W123E8"]);
    rig.says(&[("S13", "s 13 00000011 !"), ("W168", "w 16 00000008 !")]);
    let start = rig.now();
    let heard = rig.hear(3.secs());
    let texts: Vec<&str> = heard.iter().map(|(_, text)| text.as_str()).collect();
    assert_eq!(texts, ["s 13 00000012 !", "s 13 00000011 !"]);
    let took = heard[1].0.since(start);
    assert!(took > 2_020.millis() && took < 2_032.millis(), "{took:?}");
    let mut after = |command: &str, span: Duration| {
        rig.write(command);
        rig.texts(span)
    };
    assert_eq!(after("W169", 500.millis()), ["s 13 00000018 !"]);
    assert_eq!(after("W166", 500.millis()), ["s 13 00000014 !"]);
    assert_eq!(after("W167", 500.millis()), ["s 13 00000018 !"]);
    assert_eq!(after("W164", 500.millis()), ["s 13 00000011 !"]);
    assert_eq!(after("W160", 500.millis()), [""; 0]);
}
