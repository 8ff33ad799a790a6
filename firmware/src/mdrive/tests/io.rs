//! I/O points together with the whole drive.

use super::*;
use crate::device::Level;
use crate::mdrive::{ANALOG, CAPTURE, IO1, IO2, IO7, IO8};

impl Dut {
    /// Levels of a pin since power-on.
    fn levels(&self, pin: Pin) -> Vec<(Instant, Level)> {
        let of_pin = self.out.levels.iter().filter(|(_, known, _)| *known == pin);
        of_pin.map(|&(at, _, level)| (at, level)).collect()
    }
}

#[test]
fn a_reset_input_that_is_held_resets_once() {
    let mut dut = Dut::plus();
    dut.set(Reg::S1, 11 << 32);
    dut.set(Reg::R1, 5);
    dut.set(Reg::S, 1);
    dut.wait(1.secs());
    dut.set(Reg::R1, 7);
    dut.edge(IO1, false);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::R1), 5, "as it was saved");
    dut.set(Reg::R1, 7);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::R1), 7);
    dut.edge(IO1, true);
    dut.edge(IO1, false);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::R1), 5);
}

#[test]
fn a_moving_output_shows_mv() {
    let mut dut = Dut::plus();
    // Active low, sinking: the output is low while MV is 1 (MC 5-64).
    dut.set(Reg::S2, 17 << 32);
    let begin = dut.now;
    dut.write(0x46, 2, 1_000);
    dut.wait(1.secs());
    let levels = dut.levels(IO2);
    assert_eq!(levels.iter().map(|(_, level)| *level).collect::<Vec<_>>(), [Level::Low, Level::Float]);
    assert_eq!(levels[0].0, begin, "at once");
    // 2.5 ms, then ramps to √(1,000² + 2 · 1,000,000 · 500) = 31,639 steps/s and back: 2 · 30.64 ms.
    let took = levels[1].0.since(begin);
    assert!((63_700.micros()..63_900.micros()).contains(&took), "{took:?}");
}

#[test]
fn clock_outputs_make_a_pulse_for_each_step() {
    let mut dut = Dut::plus();
    dut.set(Reg::S7, 49 << 16);
    dut.set(Reg::S8, 49 << 16);
    dut.set(Reg::CM, 1);
    dut.set(Reg::MR, 1_000);
    dut.wait(1.secs());
    dut.set(Reg::MR, -500);
    dut.wait(1.secs());
    let fell = dut.levels(IO7).iter().filter(|(_, level)| *level == Level::Low).count();
    assert_eq!(fell, 1_500);
    let direction: Vec<Level> = dut.levels(IO8).iter().map(|(_, level)| *level).collect();
    assert_eq!(direction, [Level::High, Level::Low], "active low is backward");
    // MC 5-13: limits are off in follower mode. Here I/O 7 and 8 are outputs, and the motor is not a
    // follower.
    assert_eq!(dut.get(Reg::C1), 500);
}

#[test]
fn clock_inputs_turn_the_motor() {
    let mut dut = Dut::plus();
    dut.set(Reg::CM, 1);
    for pulse in 0..100 {
        dut.edge(IO8, pulse < 70);
        for high in [false, true] {
            dut.edge(IO7, high);
            dut.wait(10.micros());
        }
    }
    assert_eq!(dut.get(Reg::C1), 70 - 30);
    dut.set(Reg::CM, 0);
    dut.edge(IO7, false);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::C1), 40);
}

#[test]
fn the_analogue_input_is_read_on_the_bus() {
    let mut dut = Dut::plus();
    dut.feed(Input::Millivolts { pin: ANALOG, mv: 2_500 });
    assert_eq!(dut.read(0x31, 1), 512);
    // Range 4 to 20 mA.
    dut.set(Reg::S5, 10 << 16 | 1);
    assert_eq!(dut.read(0x31, 1), 512);
    dut.feed(Input::Millivolts { pin: ANALOG, mv: 0 });
    assert_eq!(dut.read(0x31, 1), 205);
}

#[test]
fn il_and_in_on_the_bus() {
    let mut dut = Dut::plus();
    assert_eq!((dut.read(0x3A, 1), dut.read(0x3B, 1)), (15, 15));
    dut.set(Reg::D1, 100);
    dut.edge(IO1, false);
    dut.edge(CAPTURE, false);
    assert_eq!((dut.read(0x3A, 1), dut.read(0x3B, 1), dut.read(0x2D, 1)), (15, 14, 0));
    dut.wait(100.millis());
    assert_eq!((dut.read(0x3A, 1), dut.read(0x3B, 1), dut.read(0x2D, 1)), (14, 14, 1));
}
