//! Tests of IN1 and IN2 in the five modes of MODE_EXT_IN, and of debouncing (6.1, 6.5).

use super::*;

/// A drive controlled by its inputs.
fn by_inputs(way: i64) -> Fixture<DriveWithMotor<Rs434>> {
    saved(&[(Reg::MODE_DEVICE, 2), (Reg::MODE_EXT_IN, way)])
}

impl Fixture<DriveWithMotor<Rs434>> {
    /// Value of STATUS 500 ms later.
    fn does(&mut self) -> i64 {
        self.wait(500.millis());
        self.get(Reg::STATUS)
    }
}

const LONG: Duration = Duration::millis(20);

#[test]
fn a_pulse_starts_at_its_end_and_the_next_one_stops() {
    for way in [1, 2] {
        let mut dut = by_inputs(way);
        dut.contact(IN1, true);
        assert_eq!(dut.does(), 0, "it has not ended");
        dut.contact(IN1, false);
        dut.wait(Duration::millis(10) - Duration::TICK);
        assert_eq!(dut.get(Reg::STATUS), 0);
        dut.wait(Duration::TICK);
        assert_eq!(dut.get(Reg::STATUS), 1);
        assert_eq!(dut.does(), 1);
        dut.pulse(IN1, LONG, LONG);
        assert_eq!(dut.does(), 0);
    }
}

#[test]
fn what_bounces_is_one_pulse_or_none() {
    let mut dut = by_inputs(1);
    // Closed for too short a time.
    dut.pulse(IN1, 9.millis(), LONG);
    assert_eq!(dut.does(), 0);
    // Open for too short a time between two closures: this is one pulse.
    dut.pulse(IN1, LONG, 9.millis());
    dut.pulse(IN1, LONG, LONG);
    assert_eq!(dut.does(), 1);
    // Two pulses.
    dut.pulse(IN1, 10.millis(), 10.millis());
    dut.wait(100.millis());
    dut.pulse(IN1, 10.millis(), 10.millis());
    assert_eq!(dut.does(), 1);
}

#[test]
fn both_halves_of_a_pulse_have_times_of_their_own() {
    let mut dut = by_inputs(1);
    dut.set(Reg::PRESSED_INPUTS_EXTERN, 0);
    dut.set(Reg::WAITED_INPUTS_EXTERN, 100);
    dut.pulse(IN1, 1.millis(), 99.millis());
    assert_eq!(dut.get(Reg::STATUS), 0);
    dut.wait(1.millis());
    assert_eq!(dut.get(Reg::STATUS), 1);
}

#[test]
fn in2_reverses_at_the_end_of_its_pulse() {
    for way in [1, 3] {
        let mut dut = by_inputs(way);
        dut.pulse(IN2, LONG, LONG);
        assert_eq!(dut.get(Reg::DIRECTION), 2);
        dut.pulse(IN2, LONG, LONG);
        assert_eq!(dut.get(Reg::DIRECTION), 1);
        dut.contact(IN1, true);
        dut.wait(LONG);
        if way == 1 {
            dut.contact(IN1, false);
        }
        assert_eq!(dut.does(), 1);
        dut.pulse(IN2, LONG, LONG);
        assert_eq!(dut.does(), 2);
    }
}

#[test]
fn in2_is_the_direction_by_its_level() {
    for way in [2, 4] {
        let mut dut = by_inputs(way);
        dut.contact(IN1, true);
        dut.wait(LONG);
        if way == 2 {
            dut.contact(IN1, false);
        }
        assert_eq!(dut.does(), 1);
        dut.contact(IN2, true);
        assert_eq!((dut.does(), dut.get(Reg::DIRECTION)), (2, 2));
        dut.contact(IN2, false);
        assert_eq!((dut.does(), dut.get(Reg::DIRECTION)), (1, 1));
    }
}

#[test]
fn in1_runs_the_motor_while_it_is_closed() {
    for way in [3, 4] {
        let mut dut = by_inputs(way);
        dut.contact(IN1, true);
        dut.wait(Duration::millis(10) - Duration::TICK);
        assert_eq!(dut.get(Reg::STATUS), 0);
        assert_eq!(dut.does(), 1);
        dut.contact(IN1, false);
        assert_eq!(dut.does(), 0);
    }
}

#[test]
fn each_input_has_its_direction() {
    let mut dut = by_inputs(5);
    dut.contact(IN1, true);
    assert_eq!(dut.does(), 1);
    dut.contact(IN2, true);
    assert_eq!(dut.does(), 0, "both");
    dut.contact(IN1, false);
    assert_eq!(dut.does(), 2);
    dut.contact(IN2, false);
    assert_eq!(dut.does(), 0);
    assert_eq!(dut.get(Reg::DIRECTION), 1);
}

#[test]
fn each_input_moves_the_offset_its_way() {
    let mut dut = by_inputs(5);
    dut.set(Reg::MODE_ROTATION, 2);
    dut.set(Reg::OFFSET_CONST, 20);
    for (pin, position) in [(IN1, 20), (IN2, 0), (IN2, -20), (IN1, 0)] {
        dut.contact(pin, true);
        dut.wait(1.secs());
        assert_eq!((dut.get(Reg::CURRENT_POSITION), dut.get(Reg::STATUS)), (position, 0));
        dut.contact(pin, false);
        dut.wait(LONG);
    }
    // A released move is continued by the same input.
    dut.set(Reg::OFFSET_CONST, 0);
    dut.set(Reg::OFFSET, 1_000);
    dut.pulse(IN2, 500.millis(), 1.secs());
    let rest = dut.get(Reg::OFFSET);
    assert!(0 < rest && rest < 1_000);
    assert_eq!(dut.get(Reg::CURRENT_POSITION), rest - 1_000);
    dut.contact(IN2, true);
    dut.wait(5.secs());
    assert_eq!((dut.get(Reg::CURRENT_POSITION), dut.get(Reg::OFFSET)), (-1_000, 0));
}

#[test]
fn levels_act_at_power_up_and_edges_do_not() {
    for (way, status) in [(1, 0), (2, 0), (3, 1), (4, 2), (5, 0)] {
        let mut dut = without_power();
        dut.set(Reg::MODE_DEVICE, 2);
        dut.set(Reg::MODE_EXT_IN, way);
        dut.power_on(Boot::default());
        for pin in [IN1, IN2] {
            dut.contact(pin, true);
        }
        dut.run_until(Instant::from(500.millis()) - Duration::TICK);
        assert_eq!((dut.get(Reg::STATUS), dut.get(Reg::DIRECTION)), (0, 1));
        assert_eq!(dut.does(), status, "way {way}");
        let level = way == 2 || way == 4;
        assert_eq!(dut.get(Reg::DIRECTION), if level { 2 } else { 1 }, "way {way}");
    }
}

#[test]
fn levels_act_when_the_mode_is_written() {
    let mut dut = ready();
    dut.set(Reg::MODE_EXT_IN, 3);
    dut.contact(IN1, true);
    assert_eq!(dut.does(), 0, "the bus controls it");
    dut.write(0x5004, 2);
    assert_eq!(dut.does(), 1);
    dut.write(0x5007, 5);
    assert_eq!(dut.does(), 1);
    dut.contact(IN2, true);
    assert_eq!(dut.does(), 0);
    dut.write(0x5007, 4);
    assert_eq!((dut.does(), dut.get(Reg::DIRECTION)), (2, 2));
    dut.write(0x5004, 1);
    assert_eq!(dut.does(), 2);
}

#[test]
fn a_level_goes_on_while_the_motor_brakes() {
    let mut dut = saved(&[(Reg::MODE_DEVICE, 2), (Reg::MODE_EXT_IN, 3), (Reg::DEC, 10)]);
    dut.set(Reg::MODE_ROTATION, 2);
    dut.set(Reg::OFFSET, 1_000);
    dut.contact(IN1, true);
    dut.wait(500.millis());
    dut.contact(IN1, false);
    dut.wait(20.millis());
    assert_eq!(dut.get(Reg::STATUS), 1, "it brakes");
    dut.contact(IN1, true);
    dut.wait(10.secs());
    assert_eq!((dut.get(Reg::CURRENT_POSITION), dut.get(Reg::OFFSET)), (1_000, 0));
}

#[test]
fn in_way_5_the_inputs_alone_are_the_direction() {
    let mut dut = by_inputs(5);
    dut.contact(IN2, true);
    assert_eq!(dut.does(), 2);
    // Writes SPEED, ACC, DEC, and DIRECTION with its present value.
    assert_eq!(dut.try_write_all(0x500B, &[1_500, 100, 100, 1])[0], 16);
    assert_eq!(dut.does(), 2);
    let rpm = dut.get(Reg::SPEED_VALID);
    assert!((1_400..=1_600).contains(&rpm), "SPEED is followed: {rpm} rpm");
    // The bus takes over a running motor. A written DIRECTION then takes effect.
    dut.write(0x5004, 1);
    assert_eq!(dut.does(), 2);
    dut.write(0x500E, 1);
    assert_eq!(dut.does(), 1);
}

#[test]
fn a_level_takes_over_with_its_direction() {
    let mut dut = by_inputs(5);
    dut.set(Reg::DIRECTION, 2);
    dut.contact(IN1, true);
    assert_eq!(dut.does(), 1);
    dut.write(0x5007, 3);
    assert_eq!(dut.does(), 2);
}

#[test]
fn inputs_that_change_together_turn_a_move_round() {
    let mut dut = by_inputs(5);
    dut.set(Reg::MODE_ROTATION, 2);
    dut.set(Reg::OFFSET, 1_000);
    dut.contact(IN1, true);
    dut.wait(500.millis());
    dut.contact(IN1, false);
    dut.contact(IN2, true);
    dut.wait(10.millis());
    let position = dut.get(Reg::CURRENT_POSITION);
    assert!(0 < position && position < 1_000);
    // The remaining distance is made in the other direction.
    assert_eq!(dut.get(Reg::OFFSET), 1_000 - position);
    dut.wait(10.secs());
    assert_eq!(dut.get(Reg::CURRENT_POSITION), position - (1_000 - position));
    assert_eq!((dut.get(Reg::OFFSET), dut.get(Reg::STATUS), dut.get(Reg::ERROR)), (0, 0, 0));
}

#[test]
fn each_input_moves_to_the_position() {
    let mut dut = by_inputs(5);
    dut.set(Reg::MODE_ROTATION, 3);
    dut.set(Reg::TARGET_POSITION1, 1_000);
    dut.contact(IN1, true);
    dut.wait(500.millis());
    assert_eq!(dut.get(Reg::STATUS), 1);
    // The motion does not change when the other input takes over.
    dut.contact(IN1, false);
    dut.contact(IN2, true);
    dut.wait(10.secs());
    assert_eq!((dut.get(Reg::CURRENT_POSITION), dut.get(Reg::STATUS)), (1_000, 0));
    dut.contact(IN2, false);
    dut.set(Reg::TARGET_POSITION1, 0);
    dut.wait(LONG);
    dut.contact(IN2, true);
    dut.wait(10.secs());
    assert_eq!((dut.get(Reg::CURRENT_POSITION), dut.get(Reg::STATUS)), (0, 0));
}
