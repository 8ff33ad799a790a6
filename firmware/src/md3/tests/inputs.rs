//! Pins: the I/O port and the functions of J2 pins 2 to 5 (7.8, 7.9).

use super::*;

#[test]
fn the_port_shows_pins_and_drives_outputs() {
    let mut bed = Bed::ready();
    assert_eq!(bed.read(0x0a), 0x000f);
    for (pin, word) in [(0, 0x0007), (1, 0x0003), (2, 0x0001), (3, 0x0000)] {
        bed.input(bed.now, Input::Edge { pin: Pin(pin), high: false });
        assert_eq!(bed.read(0x0a), word);
    }
    bed.input(bed.now, Input::Edge { pin: Pin(5), high: true }); // J2 pin 10
    bed.write(0x0a, 0xFFD0);
    assert_eq!(bed.read(0x0a), 0xFFA0, "inputs show their pins, unused bits what was written");
    assert_eq!((bed.level("J3.8"), bed.level("J2.9")), (Level::Low, Level::Float));
    bed.write(0x09, 0x1000);
    assert_eq!(bed.read(0x0a), 0xFFD0);
    assert_eq!(
        (bed.level("J2.9"), bed.level("J2.10"), bed.level("J2.12")),
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

/// A drive whose pins 4 and 5 are in `mode`; a move of 100 steps takes it 0.2 s.
fn in_mode(mode: i64) -> Bed {
    let mut bed = Bed::ready();
    bed.set(Reg::MoveSteps, 100);
    bed.set(Reg::PinFunctionAndPolarity, mode << 4);
    bed
}

/// A pin goes low and up again.
fn pulse(bed: &mut Bed, pin: u8) {
    bed.pin(pin, false);
    bed.pin(pin, true);
}

#[test]
fn mode_0000_makes_a_step_at_each_falling_edge() {
    let mut bed = in_mode(0b0000);
    for _ in 0..250 {
        pulse(&mut bed, 4);
        bed.wait(4.micros());
    }
    assert_eq!((bed.position(), bed.busy()), (250, false));
    bed.pin(5, false);
    pulse(&mut bed, 4);
    assert_eq!(bed.position(), 249);
    // A tick too fast, and again in time.
    bed.wait(4.micros() - Duration::TICK);
    pulse(&mut bed, 4);
    assert_eq!(bed.position(), 249);
    bed.wait(Duration::TICK);
    pulse(&mut bed, 4);
    assert_eq!(bed.position(), 248);
    // A move begins where the steps have come to.
    bed.set(Reg::MotionControl, MOVE);
    bed.wait(1.secs());
    assert_eq!(bed.position(), 348);
}

#[test]
fn mode_0000_takes_rising_edges_when_the_polarity_says_so() {
    let mut bed = in_mode(0);
    bed.pin(4, false);
    bed.set(Reg::PinFunctionAndPolarity, 0b0010);
    bed.wait(1.secs());
    let position = bed.position();
    bed.pin(4, true);
    assert_eq!(bed.position(), position + 1);
    bed.pin(4, false);
    assert_eq!(bed.position(), position + 1);
}

#[test]
fn mode_0001_moves_as_pin_5_says_at_the_edge() {
    let mut bed = in_mode(0b0001);
    pulse(&mut bed, 4);
    assert_eq!(bed.control(), MOVE);
    pulse(&mut bed, 4); // ignored while it moves
    bed.run_until(1.secs());
    assert_eq!((bed.position(), bed.control()), (100, 0));
    bed.pin(5, false);
    pulse(&mut bed, 4);
    bed.pin(5, true); // only the edge counts
    bed.run_until(2.secs());
    assert_eq!((bed.position(), bed.get(Reg::MoveSteps)), (0, 100));
}

#[test]
fn modes_0010_to_0101_move_and_home() {
    let mut bed = in_mode(0b0010);
    bed.pin(4, false);
    bed.wait(1.secs());
    assert_eq!(bed.position(), 100);
    bed.pin(4, true);
    bed.wait(1.secs());
    assert_eq!(bed.position(), 0);

    let mut bed = in_mode(0b0011);
    bed.pin(4, false);
    assert_eq!(bed.control(), MOVE);
    bed.wait(1.secs());
    bed.pin(4, true);
    assert_eq!(bed.control(), HOME);

    let mut bed = in_mode(0b0100);
    pulse(&mut bed, 5);
    bed.wait(1.secs());
    assert_eq!(bed.position(), -100);
    pulse(&mut bed, 4);
    bed.wait(1.secs());
    assert_eq!(bed.position(), 0);

    let mut bed = in_mode(0b0101);
    pulse(&mut bed, 5);
    assert_eq!(bed.control(), HOME);
    bed.set(Reg::MotionControl, STOP);
    pulse(&mut bed, 4);
    assert_eq!(bed.control(), MOVE);
}

#[test]
fn mode_0110_jogs_while_pin_4_is_low() {
    let mut bed = in_mode(0b0110);
    bed.pin(4, false);
    bed.run_until(1.secs());
    assert_eq!((bed.control(), bed.speed().to_num::<i32>()), (JOG, 5_000));
    bed.pin(5, false);
    bed.run_until(2.secs());
    assert_eq!(bed.speed().to_num::<i32>(), -5_000);
    bed.pin(4, true);
    bed.run_until(2_500.millis() - Duration::TICK);
    assert_eq!((bed.control(), bed.busy()), (JOG, true));
    bed.run_until(2_500.millis());
    assert_eq!((bed.control(), bed.busy()), (0, false));
    // Low again before it stands: it goes on.
    bed.pin(4, false);
    bed.run_until(3.secs());
    bed.pin(4, true);
    bed.run_until(3_250.millis());
    bed.pin(4, false);
    bed.run_until(5.secs());
    assert_eq!((bed.control(), bed.speed().to_num::<i32>()), (JOG, -5_000));
}

#[test]
fn mode_0111_jogs_either_way() {
    let mut bed = in_mode(0b0111);
    bed.pin(5, false);
    bed.run_until(1.secs());
    assert_eq!(bed.speed().to_num::<i32>(), -5_000);
    bed.pin(4, false); // both low: the direction that runs stays
    bed.run_until(2.secs());
    assert_eq!(bed.speed().to_num::<i32>(), -5_000);
    bed.pin(5, true);
    bed.run_until(4.secs());
    assert_eq!(bed.speed().to_num::<i32>(), 5_000);
    bed.pin(4, true);
    bed.run_until(5.secs());
    assert_eq!(bed.control(), 0);
}

#[test]
fn a_stop_ends_a_jog_of_the_pins_until_the_next_edge() {
    let mut bed = in_mode(0b0110);
    bed.pin(4, false);
    bed.run_until(1.secs());
    bed.set(Reg::MotionControl, STOP);
    for (reg, value) in [(Reg::Speed, 100), (Reg::AccelDecel, 20_000), (Reg::MoveSteps, 7)] {
        bed.set(reg, value);
    }
    bed.run_until(2.secs());
    assert_eq!(bed.control(), 0);
    // Nor do they take over a jog of the bus.
    bed.pin(5, false);
    bed.set(Reg::MotionControl, STOP);
    bed.set(Reg::MotionControl, JOG);
    bed.set(Reg::AccelDecel, 10_000);
    bed.run_until(3.secs());
    assert_eq!((bed.control(), bed.speed().to_num::<i32>()), (JOG, 100));
    bed.set(Reg::MotionControl, STOP);
    bed.pin(4, true);
    bed.pin(4, false);
    assert_eq!(bed.control(), JOG);
}

#[test]
fn mode_1000_goes_forward_and_backward_for_ever() {
    let mut bed = in_mode(0b1000);
    for round in 0..5 {
        let begun = Instant::from((400 * round).millis());
        bed.run_until(begun);
        assert_eq!((bed.position(), bed.get(Reg::MoveSteps)), (0, 100));
        bed.run_until(begun + 200.millis() - Duration::TICK);
        assert_eq!((bed.position(), bed.get(Reg::MoveSteps), bed.control()), (99, 100, MOVE));
        bed.run_until(begun + 200.millis());
        assert_eq!((bed.position(), bed.get(Reg::MoveSteps), bed.busy()), (100, -100, true));
    }
    let busy: Vec<_> = bed.world.levels.iter().filter(|(_, pin, _)| *pin == BUSY).collect();
    assert_eq!(busy.len(), 2, "no pause between the moves");
    // Stopped while it goes back: the sign stays.
    bed.set(Reg::PinFunctionAndPolarity, 0);
    assert_eq!((bed.control(), bed.get(Reg::MoveSteps)), (0, -100));
}

#[test]
fn endless_modes_without_a_way_stand_until_they_get_one() {
    for mode in [0b1000, 0b1001] {
        let mut bed = Bed::ready();
        bed.pin(2, false); // the flag: a home cycle takes no time
        bed.set(Reg::MoveSteps, 0);
        bed.set(Reg::PinFunctionAndPolarity, mode << 4);
        bed.run_until(1.secs());
        assert_eq!(bed.control(), 0);
        bed.set(Reg::MoveSteps, 100);
        assert_eq!(bed.control(), MOVE);
    }
}

#[test]
fn mode_1001_moves_and_homes_for_ever() {
    let mut bed = in_mode(0b1001);
    bed.run_until(200.millis());
    assert_eq!((bed.position(), bed.control()), (100, HOME));
    bed.run_until(1.secs());
    bed.pin(2, false);
    assert_eq!(bed.control(), MOVE);
    bed.pin(2, true);
    bed.run_until(2.secs());
    assert_eq!(bed.control(), HOME);
    bed.set(Reg::MotionControl, STOP);
    bed.run_until(3.secs());
    assert_eq!(bed.control(), 0);
    bed.set(Reg::PinFunctionAndPolarity, 0b1001 << 4);
    assert_eq!(bed.control(), MOVE, "it starts when it is written");
}

#[test]
fn an_endless_mode_that_is_saved_starts_by_itself() {
    let mut bed = Bed::off(vec![0xFF; MEMORY]);
    let row = Reg::PinFunctionAndPolarity.row();
    bed.drive.poke(Instant::ZERO, row, 0b1000 << 4, &mut bed.world).unwrap();
    bed.power_on(Boot::default());
    bed.run_until(Instant::from(2_500.millis()) - Duration::TICK);
    assert_eq!(bed.control(), 0);
    bed.run_until(2_500.millis());
    assert_eq!(bed.control(), MOVE);
}

#[test]
fn a_new_polarity_is_an_edge() {
    let mut bed = in_mode(0b0001);
    bed.wait(1.millis());
    // An open pin 4 is high: now that is active.
    bed.set(Reg::PinFunctionAndPolarity, 0b0001 << 4 | 0b0010);
    assert_eq!(bed.control(), MOVE);
    // And pin 3 inhibits.
    bed.set(Reg::PinFunctionAndPolarity, 0b0001 << 4 | 0b0110);
    assert_eq!(bed.current(), 0);
}

#[test]
fn another_mode_ramps_a_jog_of_the_pins_down_and_leaves_a_move_alone() {
    let mut bed = in_mode(0b0110);
    bed.pin(4, false);
    bed.run_until(1.secs());
    bed.set(Reg::PinFunctionAndPolarity, 0b0001 << 4);
    assert_eq!(bed.control(), JOG);
    bed.run_until(1_500.millis());
    assert_eq!(bed.control(), 0);
    bed.set(Reg::MotionControl, MOVE);
    bed.set(Reg::PinFunctionAndPolarity, 0b0010 << 4);
    assert_eq!(bed.control(), MOVE);
}

#[test]
fn speedsel_selects_the_alternate_speed_with_the_sign_of_speed() {
    let mut bed = Bed::ready();
    bed.set(Reg::HomingConfiguration, 2 << 1);
    bed.set(Reg::PinFunctionAndPolarity, 1 << 10);
    bed.set(Reg::Speed, -5_000);
    bed.set(Reg::MotionControl, JOG);
    bed.run_until(1.secs());
    bed.pin(2, false);
    bed.run_until(2.secs());
    assert_eq!(bed.speed().to_num::<i32>(), -2_500);
    bed.set(Reg::AlternateSpeed, 50_000);
    bed.run_until(6.secs());
    assert_eq!(bed.speed().to_num::<i32>(), -40_000);
    bed.set(Reg::MotionControl, STOP);
    // A profile move takes what is selected when it begins (7.8).
    bed.set(Reg::AlternateSpeed, 1_000);
    bed.set(Reg::MotionControl, MOVE);
    bed.wait(1.secs());
    bed.pin(2, true);
    bed.wait(1.secs());
    assert_eq!((bed.control(), bed.speed().to_num::<i32>()), (MOVE, 1_000));
}

#[test]
fn speedsel_turns_a_move_into_a_jog_if_7_18_is_chosen() {
    let mut bed = Bed::ready();
    bed.set(Reg::SpeedselJogsProfile, 1);
    bed.set(Reg::HomingConfiguration, 2 << 1);
    bed.set(Reg::PinFunctionAndPolarity, 1 << 10);
    bed.set(Reg::MotionControl, MOVE);
    bed.wait(1.secs());
    bed.pin(2, false);
    bed.wait(5.secs());
    assert_eq!((bed.control(), bed.speed().to_num::<i32>()), (JOG, 2_500));
}

#[test]
fn with_homing_by_flag_pin_2_is_nothing_else() {
    let mut bed = Bed::ready();
    bed.set(Reg::CurrentCutbackSettings, 0x0005);
    for function in [0, 1] {
        bed.set(Reg::PinFunctionAndPolarity, function << 10);
        bed.pin(2, false);
        bed.set(Reg::MotionControl, JOG);
        bed.wait(1.secs());
        assert_eq!((bed.current(), bed.speed().to_num::<i32>()), (1_000, 5_000));
        bed.pin(2, true);
    }
}

#[test]
fn home_on_pin_3_homes_at_the_falling_edge() {
    let mut bed = Bed::ready();
    bed.set(Reg::PinFunctionAndPolarity, 1 << 8);
    bed.pin(3, false);
    assert_eq!(bed.control(), HOME);
    assert_eq!(bed.current(), 1_000, "it does not inhibit");
}

#[test]
fn inhibit_modbus_motion_leaves_the_bus_only_disable() {
    let mut bed = Bed::ready();
    bed.set(Reg::PinFunctionAndPolarity, 2 << 8 | 0b0001 << 4);
    bed.set(Reg::MotionControl, JOG);
    bed.run_until(1.secs());
    bed.pin(3, false);
    assert_eq!((bed.control(), bed.speed().to_num::<i32>(), bed.current()), (0, 0, 1_000));
    for command in [MOVE, JOG, HOME] {
        bed.set(Reg::MotionControl, command);
        assert_eq!(bed.control(), 0);
    }
    bed.set(Reg::MotionControl, DISABLE | MOVE);
    assert_eq!((bed.control(), bed.current()), (DISABLE, 0));
    bed.set(Reg::MotionControl, 0);
    bed.pin(4, false);
    assert_eq!(bed.control(), MOVE, "pins work");
    bed.set(Reg::MotionControl, STOP);
    assert_eq!(bed.control(), MOVE);
    bed.pin(3, true);
    bed.set(Reg::MotionControl, STOP);
    assert_eq!(bed.control(), 0);
}

#[test]
fn a_disabled_drive_moves_for_no_pin_until_it_is_enabled() {
    let mut bed = in_mode(0b0110);
    bed.set(Reg::MotionControl, DISABLE);
    bed.pin(4, false);
    assert_eq!(bed.control(), DISABLE);
    bed.set(Reg::MotionControl, 0);
    assert_eq!(bed.control(), JOG);
}

#[test]
fn what_pins_ask_for_in_a_ramp_down_is_done_when_it_stands() {
    // An endless mode that is written while a jog of the pins, or a Decel-stop, slows down.
    for by_pins in [true, false] {
        let mut bed = in_mode(0b0110);
        if by_pins {
            bed.pin(4, false);
        } else {
            bed.set(Reg::MotionControl, JOG);
        }
        bed.run_until(1.secs());
        bed.set(Reg::MotionControl, if by_pins { 0 } else { DECEL_STOP });
        bed.set(Reg::PinFunctionAndPolarity, 0b1000 << 4);
        assert_ne!(bed.control(), MOVE);
        bed.run_until(1_500.millis());
        assert_eq!(bed.control(), MOVE);
    }
    // A pin that becomes active after a Decel-stop.
    let mut bed = in_mode(0b0110);
    bed.set(Reg::MotionControl, JOG);
    bed.run_until(1.secs());
    bed.set(Reg::MotionControl, DECEL_STOP);
    bed.pin(4, false);
    bed.run_until(3.secs());
    assert_eq!(bed.control(), JOG);
}

#[test]
fn a_jog_that_waited_for_an_acceleration_turns_round_with_it() {
    let mut bed = in_mode(0b0110);
    bed.pin(4, false);
    bed.run_until(1.secs());
    bed.set(Reg::AccelDecel, 0);
    bed.pin(5, false);
    bed.set(Reg::Speed, 2_000);
    bed.run_until(2.secs());
    assert_eq!(bed.speed(), 5_000);
    bed.set(Reg::AccelDecel, 10_000);
    bed.run_until(4.secs());
    assert_eq!(bed.speed(), -2_000);
}

#[test]
fn an_endless_mode_without_a_way_looks_at_offsets_and_at_the_index() {
    let stands = || {
        let mut bed = Bed::ready();
        bed.pin(9, true);
        bed.set(Reg::HomingConfiguration, 2 << 1);
        bed.set(Reg::MoveSteps, 0);
        bed.set(Reg::PinFunctionAndPolarity, 0b1001 << 4);
        bed.wait(1.secs());
        assert_eq!(bed.control(), 0);
        bed
    };
    let mut bed = stands();
    bed.set(Reg::HomeOffset, 10);
    assert_eq!(bed.control(), HOME);
    let mut bed = stands();
    bed.pin(9, false);
    assert_eq!(bed.control(), HOME);
}

#[test]
fn one_write_changes_several_pins_in_their_order() {
    // Open pins are high: an inverted polarity makes them active.
    let write = |bed: &mut Bed, value| {
        bed.wait(1.millis());
        bed.set(Reg::PinFunctionAndPolarity, value);
    };
    let mut bed = in_mode(0);
    write(&mut bed, 0b0110); // INHIBIT and a step: no step
    assert_eq!((bed.position(), bed.current()), (0, 0));
    let mut bed = in_mode(0);
    write(&mut bed, 0b0100);
    write(&mut bed, 0b0010); // INHIBIT goes, and a step
    assert_eq!((bed.position(), bed.current()), (1, 1_000));
    let mut bed = in_mode(0);
    bed.input(Instant::from(1.millis()), Input::Fault { fault: Fault(1), on: true });
    write(&mut bed, 2 << 8 | 0b0110); // INHIBIT_MODBUS_MOTION clears a fault, and a step
    assert_eq!((bed.position(), bed.control()), (1, 0));
}
