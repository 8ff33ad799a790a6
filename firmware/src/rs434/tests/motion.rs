//! Tests of starts, stops and end positions of the motor (6.2, 6.3, 6.5).

use super::*;

impl Fixture<DriveWithMotor<Rs434>> {
    /// Runs until the motor stands.
    fn stand(&mut self) {
        for _ in 0..600_000 {
            if self.get(Reg::STATUS) == 0 {
                return;
            }
            self.wait(1.millis());
        }
        panic!("it never stands: {}", self.position());
    }

    fn position(&self) -> i64 {
        self.get(Reg::CURRENT_POSITION)
    }

    /// STATUS and SPEED_VALID of the motor 1 s later.
    fn turns(&mut self) -> (i64, i64) {
        self.wait(1.secs());
        (self.get(Reg::STATUS), self.get(Reg::SPEED_VALID))
    }
}

fn about(rpm: i64, expected: i64) {
    assert!((rpm - expected).abs() <= expected / 20, "{rpm} rpm, not {expected}");
}

#[test]
fn start_rotates_and_stop_stops() {
    let mut dut = ready();
    dut.coil(0x2000);
    let (status, rpm) = dut.turns();
    assert_eq!(status, 1);
    about(rpm, 1_000);
    dut.write(0x500E, 2);
    let (status, rpm) = dut.turns();
    assert_eq!(status, 2, "it follows DIRECTION at once");
    about(rpm, 1_000);
    dut.write(0x500B, 1_500);
    about(dut.turns().1, 1_500);
    let forward = dut.position();
    dut.coil(0x2001);
    dut.stand();
    assert!(dut.position() < forward);
    assert_eq!((dut.get(Reg::SPEED_VALID), dut.get(Reg::ERROR)), (0, 0));
}

#[test]
fn of_several_coils_the_strongest_counts() {
    let mut dut = ready();
    // START and STOP together.
    assert_eq!(dut.pdu(&[15, 0x20, 0, 0, 4, 1, 0b0011]), [15, 0x20, 0, 0, 4]);
    dut.wait(100.millis());
    assert_eq!(dut.get(Reg::STATUS), 0);
    dut.coil(0x2000);
    dut.wait(1.secs());
    assert!(dut.position() > 0);
    // START, HARD_STOP and CLR_POSITION together.
    assert_eq!(dut.pdu(&[15, 0x20, 0, 0, 4, 1, 0b1101]), [15, 0x20, 0, 0, 4]);
    assert_eq!(dut.pdu(&[1, 0x20, 0, 0, 4]), [1, 1, 0]);
    dut.stand();
    assert!(dut.position() < 16, "it began anew");
    assert_eq!(dut.get(Reg::ERROR), 0, "only the input is an error");
    dut.coil(0x2000);
    assert_eq!(dut.turns().0, 1, "START works again");
}

#[test]
fn a_0_in_a_coil_does_nothing() {
    let mut dut = ready();
    assert_eq!(dut.pdu(&[5, 0x20, 0, 0, 0]), [5, 0x20, 0, 0, 0]);
    dut.wait(100.millis());
    assert_eq!(dut.get(Reg::STATUS), 0);
}

#[test]
fn an_offset_is_counted_down_and_ends_on_its_count() {
    let mut dut = saved(&[(Reg::MODE_ROTATION, 2), (Reg::OFFSET, -500)]);
    // DIRECTION has no effect on a move by OFFSET.
    dut.coil(0x2000);
    dut.wait(300.millis());
    let (left, gone) = (dut.get(Reg::OFFSET), dut.position());
    assert!(-500 < left && left < 0);
    assert_eq!((left + gone, dut.get(Reg::STATUS)), (-500, 2));
    // Another START and another OFFSET have no effect on a move in progress.
    dut.coil(0x2000);
    dut.set(Reg::OFFSET, 9_999);
    dut.stand();
    assert_eq!((dut.position(), dut.get(Reg::OFFSET)), (-500, 0));
    // An OFFSET of 0 gives no motion.
    dut.coil(0x2000);
    assert_eq!(dut.get(Reg::STATUS), 0);
}

#[test]
fn a_stopped_offset_keeps_its_rest_for_the_next_start() {
    let mut dut = saved(&[(Reg::MODE_ROTATION, 2)]);
    dut.set(Reg::OFFSET, 1_000);
    dut.coil(0x2000);
    dut.wait(500.millis());
    dut.coil(0x2001);
    assert_eq!(dut.get(Reg::STATUS), 1, "it brakes");
    assert_eq!(dut.get(Reg::OFFSET) + dut.position(), 1_000);
    dut.stand();
    let rest = dut.get(Reg::OFFSET);
    assert!(0 < rest && rest < 1_000);
    assert_eq!(rest + dut.position(), 1_000);
    dut.wait(1.secs());
    dut.coil(0x2000);
    dut.stand();
    assert_eq!((dut.position(), dut.get(Reg::OFFSET)), (1_000, 0));
}

#[test]
fn what_a_shaft_turns_on_after_a_hard_stop_is_counted_too() {
    for n in 0..100 {
        let mut dut = saved(&[(Reg::MODE_ROTATION, 2)]);
        dut.set(Reg::OFFSET, 500);
        dut.set(Reg::START_bit, 1);
        dut.wait(200.millis() + Duration::micros(n * 137));
        dut.set(Reg::HARD_STOP_bit, 1);
        dut.wait(1.secs());
        assert_eq!((dut.get(Reg::STATUS), dut.position() + dut.get(Reg::OFFSET)), (0, 500), "{n}");
        dut.set(Reg::START_bit, 1);
        dut.wait(5.secs());
        assert_eq!((dut.position(), dut.get(Reg::OFFSET)), (500, 0), "{n}");
    }
}

#[test]
fn an_offset_written_at_rest_takes_the_place_of_what_was_left() {
    let mut dut = saved(&[(Reg::MODE_ROTATION, 2)]);
    dut.set(Reg::OFFSET, 100_000);
    dut.coil(0x2000);
    dut.wait(500.millis());
    dut.coil(0x2001);
    dut.stand();
    let left = dut.get(Reg::OFFSET);
    // Writes only the high half of OFFSET.
    dut.write(0x5016, 0);
    assert_eq!(dut.get(Reg::OFFSET), left & 0xFFFF);
    assert_eq!(dut.try_write_all(0x5015, &[40, 0])[0], 16);
    let before = dut.position();
    // Missing sensors are not an error while no move needs them.
    dut.write(0x5010, 1);
    dut.write(0x5010, 2);
    dut.coil(0x2000);
    dut.stand();
    assert_eq!((dut.position(), dut.get(Reg::OFFSET), dut.get(Reg::ERROR)), (before + 40, 0, 0));
}

#[test]
fn a_constant_offset_is_taken_by_every_start() {
    let mut dut = saved(&[(Reg::MODE_ROTATION, 2), (Reg::OFFSET_CONST, 100)]);
    for n in 1..4 {
        dut.coil(0x2000);
        dut.stand();
        assert_eq!((dut.position(), dut.get(Reg::OFFSET), dut.get(Reg::OFFSET_CONST)), (100 * n, 0, 100));
    }
}

#[test]
fn compensation_moves_where_it_stops() {
    let mut dut = saved(&[(Reg::MODE_ROTATION, 2), (Reg::OFFSET_COMPENSATION, -15)]);
    for (offset, position) in [(200, 185), (-200, 0)] {
        dut.set(Reg::OFFSET, offset);
        dut.coil(0x2000);
        dut.stand();
        assert_eq!((dut.position(), dut.get(Reg::OFFSET)), (position, 0));
    }
}

#[test]
fn positions_are_reached_from_anywhere() {
    let mut dut = saved(&[
        (Reg::MODE_ROTATION, 3),
        (Reg::TARGET_POSITION1, 300),
        (Reg::TARGET_POSITION2, -100),
        (Reg::TARGET_POSITION3, 1),
    ]);
    dut.set(Reg::TARGET_POSITION4, 40);
    for (n, target) in [(1, 300), (2, -100), (4, 40), (3, 1), (3, 1)] {
        dut.write(0x5008, n);
        dut.coil(0x2000);
        // The move keeps the values with which it began.
        dut.write(0x5008, 2);
        dut.set(Reg::TARGET_POSITION4, 40);
        assert_eq!(dut.get(Reg::TARGET_POSITION), target);
        dut.stand();
        assert_eq!(dut.position(), target);
    }
    dut.coil(0x2003);
    assert_eq!(dut.position(), 0);
}

#[test]
fn a_way_that_no_move_has_never_goes_the_other_way() {
    let mut dut = saved(&[
        (Reg::MODE_ROTATION, 3),
        (Reg::TARGET_POSITION1, -10),
        (Reg::TARGET_POSITION2, 2_147_483_647),
    ]);
    dut.coil(0x2000);
    dut.stand();
    dut.write(0x5008, 2);
    dut.coil(0x2000);
    dut.wait(100.millis());
    assert_eq!(dut.get(Reg::STATUS), 1);
}

#[test]
fn moves_need_two_hall_sensors() {
    for mode in [2, 3] {
        for halls in [0, 1] {
            let mut dut = saved(&[
                (Reg::MODE_ROTATION, mode),
                (Reg::USE_HALL, halls),
                (Reg::OFFSET, 100),
                (Reg::TARGET_POSITION1, 100),
            ]);
            dut.coil(0x2000);
            dut.wait(100.millis());
            assert_eq!((dut.get(Reg::STATUS), dut.get(Reg::ERROR), dut.position()), (0, 1 << 15, 0));
            dut.write(0x5023, 0);
            assert_eq!(dut.get(Reg::ERROR), 0);
            dut.write(0x5006, 1);
            dut.coil(0x2000);
            dut.wait(100.millis());
            assert_eq!((dut.get(Reg::STATUS), dut.get(Reg::ERROR)), (1, 0));
        }
    }
}

#[test]
fn a_move_that_loses_its_hall_sensors_stops() {
    for halls in [0, 1] {
        let mut dut = saved(&[(Reg::MODE_ROTATION, 2)]);
        dut.set(Reg::OFFSET, 100_000);
        dut.coil(0x2000);
        dut.wait(500.millis());
        let left = dut.get(Reg::OFFSET);
        assert_eq!(left + dut.position(), 100_000);
        dut.set(Reg::USE_HALL, halls);
        assert_eq!(dut.get(Reg::STATUS), 1, "it brakes");
        dut.wait(1.secs());
        assert_eq!((dut.get(Reg::STATUS), dut.get(Reg::ERROR)), (0, 1 << 15), "USE_HALL {halls}");
        assert_eq!(dut.get(Reg::OFFSET), left, "nobody counts any more");
        // With its sensors the move can continue.
        dut.set(Reg::USE_HALL, 2);
        dut.write(0x5023, 0);
        dut.coil(0x2000);
        dut.wait(100.millis());
        assert_eq!((dut.get(Reg::STATUS), dut.get(Reg::ERROR)), (1, 0));
    }
}

#[test]
fn a_rotation_may_lose_its_hall_sensors() {
    for halls in [0, 1] {
        let mut dut = ready();
        dut.coil(0x2000);
        dut.wait(500.millis());
        dut.set(Reg::USE_HALL, halls);
        assert_eq!((dut.turns().0, dut.get(Reg::ERROR)), (1, 0), "USE_HALL {halls}");
    }
}

#[test]
fn an_error_stops_the_motor_and_no_start_moves_it() {
    for name in ["short_circuit", "mcu_overheat"] {
        let mut dut = ready();
        dut.coil(0x2000);
        dut.wait(1.secs());
        dut.fault(name, true);
        dut.fault(name, false);
        dut.stand();
        let position = dut.position();
        dut.coil(0x2000);
        dut.wait(1.secs());
        assert_eq!((dut.get(Reg::STATUS), dut.position()), (0, position));
        dut.write(0x5026, 0x95AF);
        dut.wait(1.secs());
        assert_eq!((dut.get(Reg::STATUS), dut.position()), (0, 0), "and it is not remembered");
        dut.coil(0x2000);
        assert_eq!(dut.turns().0, 1);
    }
}

#[test]
fn a_warning_stops_nothing() {
    let mut dut = ready();
    dut.coil(0x2000);
    dut.wait(1.secs());
    dut.fault("current_limit", true);
    let (status, rpm) = dut.turns();
    assert_eq!(status, 1);
    about(rpm, 1_000);
}

#[test]
fn the_fault_current_limit_halves_the_limit() {
    let mut dut = saved(&[(Reg::REF_CURRENT, 4_000)]);
    dut.fault("stall", true);
    dut.coil(0x2000);
    let held = |dut: &mut Fixture<DriveWithMotor<Rs434>>| {
        dut.wait(200.millis());
        dut.drive.shaft(dut.now, Axis(0)).unwrap().ma.abs()
    };
    assert!((3_600..=4_000).contains(&held(&mut dut)));
    dut.fault("current_limit", true);
    assert!((1_800..=2_000).contains(&held(&mut dut)));
    dut.write(0x5009, 6_000);
    assert!((2_700..=3_000).contains(&held(&mut dut)));
    dut.fault("current_limit", false);
    assert!((5_400..=6_000).contains(&held(&mut dut)));
}

#[test]
fn an_open_emergency_stop_stops_at_once() {
    let mut dut = saved(&[(Reg::DEC, 10)]);
    dut.coil(0x2000);
    dut.wait(1.secs());
    let position = dut.position();
    dut.contact(HARD_STOP, false);
    dut.stand();
    // With DEC = 10 (100 rps²) a stop from 1,000 rpm would take 22 counts, with 16 per turn, and 167 ms.
    assert!(dut.position() - position < 22, "{}", dut.position() - position);
    assert_eq!(dut.get(Reg::ERROR), 1 << 5);
}

#[test]
fn by_inputs_the_bus_starts_nothing_but_stops() {
    let mut dut = ready();
    dut.coil(0x2000);
    dut.wait(1.secs());
    dut.write(0x5004, 2);
    assert_eq!(dut.turns().0, 1);
    dut.coil(0x2001);
    dut.stand();
    dut.coil(0x2000);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::STATUS), 0);
}

#[test]
fn the_motor_warms_the_drive_a_little() {
    let mut dut = ready();
    dut.coil(0x2000);
    dut.wait(300.secs());
    for reg in [Reg::TEMPERATURE_MCU, Reg::TEMPERATURE_MOSFET, Reg::TEMPERATURE_BRAKE] {
        assert!((250..600).contains(&dut.get(reg)), "{reg:?}: {}", dut.get(reg));
    }
    assert_eq!(dut.get(Reg::ERROR), 0);
}

#[test]
fn a_program_that_ends_leaves_the_motor_turning_and_one_that_ends_fully_stops_it() {
    // START, a delay, and the end.
    let lines = |end| [0x0001_0001, 0x2000_1002, 0x01F4_0004, end];
    let load = |dut: &mut Fixture<DriveWithMotor<Rs434>>, lines: [u32; 4]| {
        let image = super::super::program::image(lines);
        dut.out.memory[SETTINGS..].copy_from_slice(&image);
        dut.cycle();
        dut.set(Reg::MODE_USER_PROGRAM, 2);
        dut.wait(400.millis());
        assert_eq!(dut.get(Reg::STATUS), 1);
        dut.wait(200.millis());
    };
    let mut dut = ready();
    load(&mut dut, lines(0x00));
    assert_eq!(dut.get(Reg::STATUS_USER_PROGRAM), 5);
    assert_eq!(dut.turns().0, 1);
    dut.write(0x5005, 1);
    assert_eq!(dut.turns().0, 1);
    dut.coil(0x2001);
    dut.stand();
    for (end, status) in [(0x0D, 6), (0x7F, 7)] {
        load(&mut dut, lines(end));
        assert_eq!(dut.get(Reg::STATUS_USER_PROGRAM), status);
        dut.stand();
    }
}

#[test]
fn a_full_stop_brings_offset_back_while_the_motor_brakes() {
    // MODE_ROTATION = 2, START, 300 ms, full stop.
    let image = super::super::program::image([
        0x0002_0001,
        0x5006_3002,
        0x0001_0001,
        0x2000_1002,
        0x012C_0004,
        0x0000_000D,
    ]);
    let mut dut = without_power();
    dut.out.memory[SETTINGS..].copy_from_slice(&image);
    dut.set(Reg::OFFSET, 1_000);
    dut.power_on(Boot { fast: true, ..Boot::default() });
    dut.run_until(Instant::ZERO);
    dut.set(Reg::MODE_USER_PROGRAM, 2);
    dut.wait(200.millis());
    assert!(dut.get(Reg::OFFSET) < 1_000);
    dut.wait(200.millis());
    dut.stand();
    assert_eq!((dut.get(Reg::OFFSET), dut.get(Reg::MODE_ROTATION)), (1_000, 1));
}

#[test]
fn a_full_stop_brakes_with_the_deceleration_that_was() {
    // DEC = 10, MODE_ROTATION = 2, START, 400 ms, full stop.
    let image = super::super::program::image([
        0x000A_0001,
        0x500D_3002,
        0x0002_0001,
        0x5006_3002,
        0x0001_0001,
        0x2000_1002,
        0x0190_0004,
        0x0000_000D,
    ]);
    let mut dut = without_power();
    dut.out.memory[SETTINGS..].copy_from_slice(&image);
    dut.set(Reg::OFFSET, 100_000);
    dut.power_on(Boot { fast: true, ..Boot::default() });
    dut.run_until(Instant::ZERO);
    dut.set(Reg::MODE_USER_PROGRAM, 2);
    dut.wait(401.millis());
    assert_eq!((dut.get(Reg::STATUS_USER_PROGRAM), dut.get(Reg::DEC), dut.get(Reg::STATUS)), (6, 100, 1));
    // A stop from 1,000 rpm takes 31 ms with DEC = 100 (545 rps²), and 167 ms with DEC = 10 (100 rps²).
    dut.wait(60.millis());
    assert_eq!(dut.get(Reg::STATUS), 0);
}
