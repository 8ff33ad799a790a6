//! Pins: the I/O port and the functions of J2 pins 2 to 5 (7.8, 7.9).

use super::*;

#[test]
fn the_port_shows_pins_and_drives_outputs() {
    let mut dut = ready();
    assert_eq!(dut.read(0x0a), 0x000f);
    for (pin, word) in [(0, 0x0007), (1, 0x0003), (2, 0x0001), (3, 0x0000)] {
        dut.input(dut.now, Input::Edge { pin: Pin(pin), high: false });
        assert_eq!(dut.read(0x0a), word);
    }
    dut.input(dut.now, Input::Edge { pin: Pin(5), high: true }); // J2 pin 10
    dut.write(0x0a, 0xFFD0);
    assert_eq!(dut.read(0x0a), 0xFFA0, "inputs show their pins, unused bits what was written");
    assert_eq!((dut.level("J3.8"), dut.level("J2.9")), (Level::Low, Level::Float));
    dut.write(0x09, 0x1000);
    assert_eq!(dut.read(0x0a), 0xFFD0);
    assert_eq!(
        (dut.level("J2.9"), dut.level("J2.10"), dut.level("J2.12")),
        (Level::High, Level::Low, Level::High)
    );
}

#[test]
fn pins_are_where_their_names_say() {
    let names = |pins: &[Pin]| -> Vec<_> { pins.iter().map(|pin| PINS[usize::from(pin.0)].name).collect() };
    assert_eq!(names(&[0, 1, 2, 3].map(Pin)), ["J2.2", "J2.3", "J2.4", "J2.5"]);
    assert_eq!(names(&[J2_9, J2_10, J2_12]), ["J2.9", "J2.10", "J2.12"]);
    assert_eq!(names(&[BUSY, super::J3_8, STEP, DIR]), ["J3.7", "J3.8", "STEP", "DIR"]);
    // Section 2: the heartbeat is green, D6; the cutback light red, D5.
    assert_eq!(names(&[RED, GREEN]), ["D5", "D6"]);
    // Section 2: J2 pins 9, 10, 12 are index, A, B.
    let encoder = &HIGH_CURRENT.encoders[0];
    assert_eq!(names(&[encoder.index.unwrap(), encoder.a, encoder.b]), ["J2.9", "J2.10", "J2.12"]);
}

/// A drive with pins 4 and 5 in `mode`; a move of 100 steps takes 0.2 s.
fn in_mode(mode: i64) -> Fixture<Md3> {
    let mut dut = ready();
    dut.preset(Reg::MoveSteps, 100);
    dut.preset(Reg::PinFunctionAndPolarity, mode << 4);
    dut
}

/// Sets a pin low and high again.
fn pulse(dut: &mut Fixture<Md3>, pin: u8) {
    dut.pin(pin, false);
    dut.pin(pin, true);
}

#[test]
fn mode_0000_makes_a_step_at_each_falling_edge() {
    let mut dut = in_mode(0b0000);
    for _ in 0..250 {
        pulse(&mut dut, 4);
        dut.wait(4.micros());
    }
    assert_eq!((dut.position(), dut.busy()), (250, false));
    dut.pin(5, false);
    pulse(&mut dut, 4);
    assert_eq!(dut.position(), 249);
    // A pulse that comes one tick too early is lost; the next one is in time.
    dut.wait(4.micros() - Duration::TICK);
    pulse(&mut dut, 4);
    assert_eq!(dut.position(), 249);
    dut.wait(Duration::TICK);
    pulse(&mut dut, 4);
    assert_eq!(dut.position(), 248);
    // A move starts at the position after the steps.
    dut.preset(Reg::MotionControl, MOVE);
    dut.wait(1.secs());
    assert_eq!(dut.position(), 348);
}

#[test]
fn mode_0000_takes_rising_edges_when_the_polarity_says_so() {
    let mut dut = in_mode(0);
    dut.pin(4, false);
    dut.preset(Reg::PinFunctionAndPolarity, 0b0010);
    dut.wait(1.secs());
    let position = dut.position();
    dut.pin(4, true);
    assert_eq!(dut.position(), position + 1);
    dut.pin(4, false);
    assert_eq!(dut.position(), position + 1);
}

#[test]
fn mode_0001_moves_as_pin_5_says_at_the_edge() {
    let mut dut = in_mode(0b0001);
    pulse(&mut dut, 4);
    assert_eq!(dut.control(), MOVE);
    pulse(&mut dut, 4); // ignored while it moves
    dut.run_until(1.secs());
    assert_eq!((dut.position(), dut.control()), (100, 0));
    dut.pin(5, false);
    pulse(&mut dut, 4);
    dut.pin(5, true); // only the edge counts
    dut.run_until(2.secs());
    assert_eq!((dut.position(), dut.get(Reg::MoveSteps)), (0, 100));
}

#[test]
fn modes_0010_to_0101_move_and_home() {
    let mut dut = in_mode(0b0010);
    dut.pin(4, false);
    dut.wait(1.secs());
    assert_eq!(dut.position(), 100);
    dut.pin(4, true);
    dut.wait(1.secs());
    assert_eq!(dut.position(), 0);

    let mut dut = in_mode(0b0011);
    dut.pin(4, false);
    assert_eq!(dut.control(), MOVE);
    dut.wait(1.secs());
    dut.pin(4, true);
    assert_eq!(dut.control(), HOME);

    let mut dut = in_mode(0b0100);
    pulse(&mut dut, 5);
    dut.wait(1.secs());
    assert_eq!(dut.position(), -100);
    pulse(&mut dut, 4);
    dut.wait(1.secs());
    assert_eq!(dut.position(), 0);

    let mut dut = in_mode(0b0101);
    pulse(&mut dut, 5);
    assert_eq!(dut.control(), HOME);
    dut.preset(Reg::MotionControl, STOP);
    pulse(&mut dut, 4);
    assert_eq!(dut.control(), MOVE);
}

#[test]
fn mode_0110_jogs_while_pin_4_is_low() {
    let mut dut = in_mode(0b0110);
    dut.pin(4, false);
    dut.run_until(1.secs());
    assert_eq!((dut.control(), dut.speed().to_num::<i32>()), (JOG, 5_000));
    dut.pin(5, false);
    dut.run_until(2.secs());
    assert_eq!(dut.speed().to_num::<i32>(), -5_000);
    dut.pin(4, true);
    dut.run_until(2_500.millis() - Duration::TICK);
    assert_eq!((dut.control(), dut.busy()), (JOG, true));
    dut.run_until(2_500.millis());
    assert_eq!((dut.control(), dut.busy()), (0, false));
    // Pin 4 becomes active again before the motor stands still: the jog continues.
    dut.pin(4, false);
    dut.run_until(3.secs());
    dut.pin(4, true);
    dut.run_until(3_250.millis());
    dut.pin(4, false);
    dut.run_until(5.secs());
    assert_eq!((dut.control(), dut.speed().to_num::<i32>()), (JOG, -5_000));
}

#[test]
fn mode_0111_jogs_either_way() {
    let mut dut = in_mode(0b0111);
    dut.pin(5, false);
    dut.run_until(1.secs());
    assert_eq!(dut.speed().to_num::<i32>(), -5_000);
    dut.pin(4, false); // both low: the running direction continues
    dut.run_until(2.secs());
    assert_eq!(dut.speed().to_num::<i32>(), -5_000);
    dut.pin(5, true);
    dut.run_until(4.secs());
    assert_eq!(dut.speed().to_num::<i32>(), 5_000);
    dut.pin(4, true);
    dut.run_until(5.secs());
    assert_eq!(dut.control(), 0);
}

#[test]
fn a_new_function_sees_the_levels_of_its_own_polarity() {
    let mut dut = in_mode(0b1111);
    dut.pin(5, false);
    // One write: mode 0111, and pin 4, which is open and therefore high, becomes active high. From rest, pin 4 decides.
    dut.preset(Reg::PinFunctionAndPolarity, 0b0111 << 4 | 0b0010);
    dut.run_until(1.secs());
    assert_eq!(dut.speed().to_num::<i32>(), 5_000);
}

#[test]
fn a_stop_ends_a_jog_of_the_pins_until_the_next_edge() {
    let mut dut = in_mode(0b0110);
    dut.pin(4, false);
    dut.run_until(1.secs());
    dut.preset(Reg::MotionControl, STOP);
    for (reg, value) in [(Reg::Speed, 100), (Reg::AccelDecel, 20_000), (Reg::MoveSteps, 7)] {
        dut.preset(reg, value);
    }
    dut.run_until(2.secs());
    assert_eq!(dut.control(), 0);
    // Pins 4 and 5 also do not take over a jog that the bus has started.
    dut.pin(5, false);
    dut.preset(Reg::MotionControl, STOP);
    dut.preset(Reg::MotionControl, JOG);
    dut.preset(Reg::AccelDecel, 10_000);
    dut.run_until(3.secs());
    assert_eq!((dut.control(), dut.speed().to_num::<i32>()), (JOG, 100));
    dut.preset(Reg::MotionControl, STOP);
    dut.pin(4, true);
    dut.pin(4, false);
    assert_eq!(dut.control(), JOG);
}

#[test]
fn mode_1000_goes_forward_and_backward_for_ever() {
    let mut dut = in_mode(0b1000);
    for round in 0..5 {
        let begun = Instant::from((400 * round).millis());
        dut.run_until(begun);
        assert_eq!((dut.position(), dut.get(Reg::MoveSteps)), (0, 100));
        dut.run_until(begun + 200.millis() - Duration::TICK);
        assert_eq!((dut.position(), dut.get(Reg::MoveSteps), dut.control()), (99, 100, MOVE));
        dut.run_until(begun + 200.millis());
        assert_eq!((dut.position(), dut.get(Reg::MoveSteps), dut.busy()), (100, -100, true));
    }
    let busy: Vec<_> = dut.out.levels.iter().filter(|(_, pin, _)| *pin == BUSY).collect();
    assert_eq!(busy.len(), 2, "no pause between the moves");
    // A stop during a backward move keeps the sign.
    dut.preset(Reg::PinFunctionAndPolarity, 0);
    assert_eq!((dut.control(), dut.get(Reg::MoveSteps)), (0, -100));
}

#[test]
fn endless_modes_without_a_way_stand_until_they_get_one() {
    for mode in [0b1000, 0b1001] {
        let mut dut = ready();
        dut.pin(2, false); // the flag: a home cycle takes no time
        dut.preset(Reg::MoveSteps, 0);
        dut.preset(Reg::PinFunctionAndPolarity, mode << 4);
        dut.run_until(1.secs());
        assert_eq!(dut.control(), 0);
        dut.preset(Reg::MoveSteps, 100);
        assert_eq!(dut.control(), MOVE);
    }
}

#[test]
fn mode_1001_moves_and_homes_for_ever() {
    let mut dut = in_mode(0b1001);
    dut.run_until(200.millis());
    assert_eq!((dut.position(), dut.control()), (100, HOME));
    dut.run_until(1.secs());
    dut.pin(2, false);
    assert_eq!(dut.control(), MOVE);
    dut.pin(2, true);
    dut.run_until(2.secs());
    assert_eq!(dut.control(), HOME);
    dut.preset(Reg::MotionControl, STOP);
    dut.run_until(3.secs());
    assert_eq!(dut.control(), 0);
    dut.preset(Reg::PinFunctionAndPolarity, 0b1001 << 4);
    assert_eq!(dut.control(), MOVE, "it starts when it is written");
}

#[test]
fn an_endless_mode_that_is_saved_starts_by_itself() {
    let mut dut = off(vec![0xFF; MEMORY]);
    let row = Reg::PinFunctionAndPolarity.row();
    dut.drive.poke(Instant::ZERO, row, 0b1000 << 4, &mut dut.out).unwrap();
    dut.power_on(Boot::default());
    dut.run_until(Instant::from(2_500.millis()) - Duration::TICK);
    assert_eq!(dut.control(), 0);
    dut.run_until(2_500.millis());
    assert_eq!(dut.control(), MOVE);
}

#[test]
fn a_new_polarity_is_an_edge() {
    let mut dut = in_mode(0b0001);
    dut.wait(1.millis());
    // An open pin 4 is high, and with this polarity high is active.
    dut.preset(Reg::PinFunctionAndPolarity, 0b0001 << 4 | 0b0010);
    assert_eq!(dut.control(), MOVE);
    // Pin 3 becomes active, too: INHIBIT.
    dut.preset(Reg::PinFunctionAndPolarity, 0b0001 << 4 | 0b0110);
    assert_eq!(dut.current(), 0);
}

#[test]
fn another_mode_ramps_a_jog_of_the_pins_down_and_leaves_a_move_alone() {
    let mut dut = in_mode(0b0110);
    dut.pin(4, false);
    dut.run_until(1.secs());
    dut.preset(Reg::PinFunctionAndPolarity, 0b0001 << 4);
    assert_eq!(dut.control(), JOG);
    dut.run_until(1_500.millis());
    assert_eq!(dut.control(), 0);
    dut.preset(Reg::MotionControl, MOVE);
    dut.preset(Reg::PinFunctionAndPolarity, 0b0010 << 4);
    assert_eq!(dut.control(), MOVE);
}

#[test]
fn speedsel_selects_the_alternate_speed_with_the_sign_of_speed() {
    let mut dut = ready();
    dut.preset(Reg::HomingConfiguration, 2 << 1);
    dut.preset(Reg::PinFunctionAndPolarity, 1 << 10);
    dut.preset(Reg::Speed, -5_000);
    dut.preset(Reg::MotionControl, JOG);
    dut.run_until(1.secs());
    dut.pin(2, false);
    dut.run_until(2.secs());
    assert_eq!(dut.speed().to_num::<i32>(), -2_500);
    dut.preset(Reg::AlternateSpeed, 50_000);
    dut.run_until(6.secs());
    assert_eq!(dut.speed().to_num::<i32>(), -40_000);
    dut.preset(Reg::MotionControl, STOP);
    // A profile move uses the speed that is selected when the move begins (7.8).
    dut.preset(Reg::AlternateSpeed, 1_000);
    dut.preset(Reg::MotionControl, MOVE);
    dut.wait(1.secs());
    dut.pin(2, true);
    dut.wait(1.secs());
    assert_eq!((dut.control(), dut.speed().to_num::<i32>()), (MOVE, 1_000));
}

#[test]
fn speedsel_turns_a_move_into_a_jog_if_7_18_is_chosen() {
    let mut dut = ready();
    dut.preset(Reg::SpeedselJogsProfile, 1);
    dut.preset(Reg::HomingConfiguration, 2 << 1);
    dut.preset(Reg::PinFunctionAndPolarity, 1 << 10);
    dut.preset(Reg::MotionControl, MOVE);
    dut.wait(1.secs());
    dut.pin(2, false);
    dut.wait(5.secs());
    assert_eq!((dut.control(), dut.speed().to_num::<i32>()), (JOG, 2_500));
}

#[test]
fn with_homing_by_flag_pin_2_is_nothing_else() {
    let mut dut = ready();
    dut.preset(Reg::CurrentCutbackSettings, 0x0005);
    for function in [0, 1] {
        dut.preset(Reg::PinFunctionAndPolarity, function << 10);
        dut.pin(2, false);
        dut.preset(Reg::MotionControl, JOG);
        dut.wait(1.secs());
        assert_eq!((dut.current(), dut.speed().to_num::<i32>()), (1_000, 5_000));
        dut.pin(2, true);
    }
}

#[test]
fn home_on_pin_3_homes_at_the_falling_edge() {
    let mut dut = ready();
    dut.preset(Reg::PinFunctionAndPolarity, 1 << 8);
    dut.pin(3, false);
    assert_eq!(dut.control(), HOME);
    assert_eq!(dut.current(), 1_000, "it does not inhibit");
}

#[test]
fn inhibit_modbus_motion_leaves_the_bus_only_disable() {
    let mut dut = ready();
    dut.preset(Reg::PinFunctionAndPolarity, 2 << 8 | 0b0001 << 4);
    dut.preset(Reg::MotionControl, JOG);
    dut.run_until(1.secs());
    dut.pin(3, false);
    assert_eq!((dut.control(), dut.speed().to_num::<i32>(), dut.current()), (0, 0, 1_000));
    for command in [MOVE, JOG, HOME] {
        dut.preset(Reg::MotionControl, command);
        assert_eq!(dut.control(), 0);
    }
    dut.preset(Reg::MotionControl, DISABLE | MOVE);
    assert_eq!((dut.control(), dut.current()), (DISABLE, 0));
    dut.preset(Reg::MotionControl, 0);
    dut.pin(4, false);
    assert_eq!(dut.control(), MOVE, "pins work");
    dut.preset(Reg::MotionControl, STOP);
    assert_eq!(dut.control(), MOVE);
    dut.pin(3, true);
    dut.preset(Reg::MotionControl, STOP);
    assert_eq!(dut.control(), 0);
}

#[test]
fn a_disabled_drive_moves_for_no_pin_until_it_is_enabled() {
    let mut dut = in_mode(0b0110);
    dut.preset(Reg::MotionControl, DISABLE);
    dut.pin(4, false);
    assert_eq!(dut.control(), DISABLE);
    dut.preset(Reg::MotionControl, 0);
    assert_eq!(dut.control(), JOG);
}

#[test]
fn what_pins_ask_for_in_a_ramp_down_is_done_when_it_stands() {
    // An endless mode is selected while a jog of the pins, or a Decel-stop, slows down.
    for by_pins in [true, false] {
        let mut dut = in_mode(0b0110);
        if by_pins {
            dut.pin(4, false);
        } else {
            dut.preset(Reg::MotionControl, JOG);
        }
        dut.run_until(1.secs());
        dut.preset(Reg::MotionControl, if by_pins { 0 } else { DECEL_STOP });
        dut.preset(Reg::PinFunctionAndPolarity, 0b1000 << 4);
        assert_ne!(dut.control(), MOVE);
        dut.run_until(1_500.millis());
        assert_eq!(dut.control(), MOVE);
    }
    // A pin becomes active after a Decel-stop.
    let mut dut = in_mode(0b0110);
    dut.preset(Reg::MotionControl, JOG);
    dut.run_until(1.secs());
    dut.preset(Reg::MotionControl, DECEL_STOP);
    dut.pin(4, false);
    dut.run_until(3.secs());
    assert_eq!(dut.control(), JOG);
}

#[test]
fn a_jog_that_waited_for_an_acceleration_turns_round_with_it() {
    let mut dut = in_mode(0b0110);
    dut.pin(4, false);
    dut.run_until(1.secs());
    dut.preset(Reg::AccelDecel, 0);
    dut.pin(5, false);
    dut.preset(Reg::Speed, 2_000);
    dut.run_until(2.secs());
    assert_eq!(dut.speed(), 5_000);
    dut.preset(Reg::AccelDecel, 10_000);
    dut.run_until(4.secs());
    assert_eq!(dut.speed(), -2_000);
}

#[test]
fn an_endless_mode_without_a_way_looks_at_offsets_and_at_the_index() {
    let stands = || {
        let mut dut = ready();
        dut.pin(9, true);
        dut.preset(Reg::HomingConfiguration, 2 << 1);
        dut.preset(Reg::MoveSteps, 0);
        dut.preset(Reg::PinFunctionAndPolarity, 0b1001 << 4);
        dut.wait(1.secs());
        assert_eq!(dut.control(), 0);
        dut
    };
    let mut dut = stands();
    dut.preset(Reg::HomeOffset, 10);
    assert_eq!(dut.control(), HOME);
    let mut dut = stands();
    dut.pin(9, false);
    assert_eq!(dut.control(), HOME);
}

#[test]
fn one_write_changes_several_pins_in_their_order() {
    // Open pins are high, so an inverted polarity makes them active.
    let write = |dut: &mut Fixture<Md3>, value| {
        dut.wait(1.millis());
        dut.preset(Reg::PinFunctionAndPolarity, value);
    };
    let mut dut = in_mode(0);
    write(&mut dut, 0b0110); // INHIBIT and a step in one write: no step is made
    assert_eq!((dut.position(), dut.current()), (0, 0));
    // Pin 3 is active already, with a code that has no function: a new polarity of pin 4 makes a step.
    let mut dut = in_mode(0);
    write(&mut dut, 3 << 8 | 0b0100);
    write(&mut dut, 3 << 8 | 0b0110);
    assert_eq!((dut.position(), dut.current()), (1, 1_000));
    let mut dut = in_mode(0);
    write(&mut dut, 3 << 8 | 0b0100);
    write(&mut dut, 0b0110); // The same with INHIBIT as the new function: no step is made
    assert_eq!((dut.position(), dut.current()), (0, 0));
    let mut dut = in_mode(0);
    write(&mut dut, 0b0100);
    write(&mut dut, 0b0010); // INHIBIT ends and a step follows in one write
    assert_eq!((dut.position(), dut.current()), (1, 1_000));
    let mut dut = in_mode(0);
    dut.input(Instant::from(1.millis()), Input::Fault { fault: Fault(1), on: true });
    write(&mut dut, 2 << 8 | 0b0110); // INHIBIT_MODBUS_MOTION clears the fault, then a step is made
    assert_eq!((dut.position(), dut.control()), (1, 0));
}
