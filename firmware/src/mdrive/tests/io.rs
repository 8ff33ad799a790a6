//! What the I/O points do with the drive behind them.

use super::*;
use crate::device::Level;
use crate::mdrive::{ANALOG, CAPTURE, IO1, IO2, IO7, IO8};

impl Bed {
    fn edge(&mut self, pin: Pin, high: bool) {
        self.input(Input::Edge { pin, high });
    }

    /// The levels of a pin since power-on.
    fn levels(&self, pin: Pin) -> Vec<(Instant, Level)> {
        let of_pin = self.world.levels.iter().filter(|(_, known, _)| *known == pin);
        of_pin.map(|&(at, _, level)| (at, level)).collect()
    }
}

#[test]
fn a_reset_input_that_is_held_resets_once() {
    let mut bed = Bed::plus();
    bed.set(Reg::S1, 11 << 32);
    bed.set(Reg::R1, 5);
    bed.set(Reg::S, 1);
    bed.wait(1.secs());
    bed.set(Reg::R1, 7);
    bed.edge(IO1, false);
    bed.wait(1.secs());
    assert_eq!(bed.get(Reg::R1), 5, "as it was saved");
    bed.set(Reg::R1, 7);
    bed.wait(1.secs());
    assert_eq!(bed.get(Reg::R1), 7);
    bed.edge(IO1, true);
    bed.edge(IO1, false);
    bed.wait(1.secs());
    assert_eq!(bed.get(Reg::R1), 5);
}

#[test]
fn a_moving_output_shows_mv() {
    let mut bed = Bed::plus();
    // Active low, sinking: MV 1 is low (MC 5-64).
    bed.set(Reg::S2, 17 << 32);
    let begin = bed.now;
    bed.write(0x46, 2, 1_000);
    bed.wait(1.secs());
    let levels = bed.levels(IO2);
    assert_eq!(levels.iter().map(|(_, level)| *level).collect::<Vec<_>>(), [Level::Low, Level::Float]);
    assert_eq!(levels[0].0, begin, "at once");
    // 2.5 ms, and to √(1,000² + 2 · 1,000,000 · 500) = 31,639 steps/s and back: 2 · 30.64 ms.
    let took = levels[1].0.since(begin);
    assert!((63_700.micros()..63_900.micros()).contains(&took), "{took:?}");
}

#[test]
fn clock_outputs_make_a_pulse_for_each_step() {
    let mut bed = Bed::plus();
    bed.set(Reg::S7, 49 << 16);
    bed.set(Reg::S8, 49 << 16);
    bed.set(Reg::CM, 1);
    bed.set(Reg::MR, 1_000);
    bed.wait(1.secs());
    bed.set(Reg::MR, -500);
    bed.wait(1.secs());
    let fell = bed.levels(IO7).iter().filter(|(_, level)| *level == Level::Low).count();
    assert_eq!(fell, 1_500);
    let direction: Vec<Level> = bed.levels(IO8).iter().map(|(_, level)| *level).collect();
    assert_eq!(direction, [Level::High, Level::Low], "active low is backward");
    // MC 5-13: limits are off in follower mode, and these are outputs.
    assert_eq!(bed.get(Reg::C1), 500);
}

#[test]
fn clock_inputs_turn_the_motor() {
    let mut bed = Bed::plus();
    bed.set(Reg::CM, 1);
    for pulse in 0..100 {
        bed.edge(IO8, pulse < 70);
        for high in [false, true] {
            bed.edge(IO7, high);
            bed.wait(10.micros());
        }
    }
    assert_eq!(bed.get(Reg::C1), 70 - 30);
    bed.set(Reg::CM, 0);
    bed.edge(IO7, false);
    bed.wait(1.secs());
    assert_eq!(bed.get(Reg::C1), 40);
}

#[test]
fn the_analogue_input_is_read_on_the_bus() {
    let mut bed = Bed::plus();
    bed.input(Input::Millivolts { pin: ANALOG, mv: 2_500 });
    assert_eq!(bed.read(0x31, 1), 512);
    // 4 to 20 mA.
    bed.set(Reg::S5, 10 << 16 | 1);
    assert_eq!(bed.read(0x31, 1), 512);
    bed.input(Input::Millivolts { pin: ANALOG, mv: 0 });
    assert_eq!(bed.read(0x31, 1), 205);
}

#[test]
fn il_and_in_on_the_bus() {
    let mut bed = Bed::plus();
    assert_eq!((bed.read(0x3A, 1), bed.read(0x3B, 1)), (15, 15));
    bed.set(Reg::D1, 100);
    bed.edge(IO1, false);
    bed.edge(CAPTURE, false);
    assert_eq!((bed.read(0x3A, 1), bed.read(0x3B, 1), bed.read(0x2D, 1)), (15, 14, 0));
    bed.wait(100.millis());
    assert_eq!((bed.read(0x3A, 1), bed.read(0x3B, 1), bed.read(0x2D, 1)), (14, 14, 1));
}
