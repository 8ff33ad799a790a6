//! What starts and stops the motor, and where it ends (6.2, 6.3, 6.5).

use super::*;

impl Bed {
    /// Time goes on until the motor stands.
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

    /// The most that STATUS and SPEED_VALID tell of a motor that turns for a while.
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
    let mut bed = Bed::ready();
    bed.coil(0x2000);
    let (status, rpm) = bed.turns();
    assert_eq!(status, 1);
    about(rpm, 1_000);
    bed.write(0x500E, 2);
    let (status, rpm) = bed.turns();
    assert_eq!(status, 2, "it follows DIRECTION at once");
    about(rpm, 1_000);
    bed.write(0x500B, 1_500);
    about(bed.turns().1, 1_500);
    let forward = bed.position();
    bed.coil(0x2001);
    bed.stand();
    assert!(bed.position() < forward);
    assert_eq!((bed.get(Reg::SPEED_VALID), bed.get(Reg::ERROR)), (0, 0));
}

#[test]
fn of_several_coils_the_strongest_counts() {
    let mut bed = Bed::ready();
    // START and STOP.
    assert_eq!(bed.pdu(&[15, 0x20, 0, 0, 4, 1, 0b0011]), [15, 0x20, 0, 0, 4]);
    bed.wait(100.millis());
    assert_eq!(bed.get(Reg::STATUS), 0);
    bed.coil(0x2000);
    bed.wait(1.secs());
    assert!(bed.position() > 0);
    // START, HARD_STOP and CLR_POSITION.
    assert_eq!(bed.pdu(&[15, 0x20, 0, 0, 4, 1, 0b1101]), [15, 0x20, 0, 0, 4]);
    assert_eq!(bed.pdu(&[1, 0x20, 0, 0, 4]), [1, 1, 0]);
    bed.stand();
    assert!(bed.position() < 16, "it began anew");
    assert_eq!(bed.get(Reg::ERROR), 0, "only the input is an error");
    bed.coil(0x2000);
    assert_eq!(bed.turns().0, 1, "START works again");
}

#[test]
fn a_0_in_a_coil_does_nothing() {
    let mut bed = Bed::ready();
    assert_eq!(bed.pdu(&[5, 0x20, 0, 0, 0]), [5, 0x20, 0, 0, 0]);
    bed.wait(100.millis());
    assert_eq!(bed.get(Reg::STATUS), 0);
}

#[test]
fn an_offset_is_counted_down_and_ends_on_its_count() {
    let mut bed = Bed::saved(&[(Reg::MODE_ROTATION, 2), (Reg::OFFSET, -500)]);
    // DIRECTION does not matter.
    bed.coil(0x2000);
    bed.wait(300.millis());
    let (left, gone) = (bed.get(Reg::OFFSET), bed.position());
    assert!(-500 < left && left < 0);
    assert_eq!((left + gone, bed.get(Reg::STATUS)), (-500, 2));
    // Neither another START nor another OFFSET matters to what runs.
    bed.coil(0x2000);
    bed.set(Reg::OFFSET, 9_999);
    bed.stand();
    assert_eq!((bed.position(), bed.get(Reg::OFFSET)), (-500, 0));
    // 0 is no motion.
    bed.coil(0x2000);
    assert_eq!(bed.get(Reg::STATUS), 0);
}

#[test]
fn a_stopped_offset_keeps_its_rest_for_the_next_start() {
    let mut bed = Bed::saved(&[(Reg::MODE_ROTATION, 2)]);
    bed.set(Reg::OFFSET, 1_000);
    bed.coil(0x2000);
    bed.wait(500.millis());
    bed.coil(0x2001);
    assert_eq!(bed.get(Reg::STATUS), 1, "it brakes");
    assert_eq!(bed.get(Reg::OFFSET) + bed.position(), 1_000);
    bed.stand();
    let rest = bed.get(Reg::OFFSET);
    assert!(0 < rest && rest < 1_000);
    assert_eq!(rest + bed.position(), 1_000);
    bed.wait(1.secs());
    bed.coil(0x2000);
    bed.stand();
    assert_eq!((bed.position(), bed.get(Reg::OFFSET)), (1_000, 0));
}

#[test]
fn what_a_shaft_turns_on_after_a_hard_stop_is_counted_too() {
    for n in 0..100 {
        let mut bed = Bed::saved(&[(Reg::MODE_ROTATION, 2)]);
        bed.set(Reg::OFFSET, 500);
        bed.set(Reg::START_bit, 1);
        bed.wait(200.millis() + Duration::micros(n * 137));
        bed.set(Reg::HARD_STOP_bit, 1);
        bed.wait(1.secs());
        assert_eq!((bed.get(Reg::STATUS), bed.position() + bed.get(Reg::OFFSET)), (0, 500), "{n}");
        bed.set(Reg::START_bit, 1);
        bed.wait(5.secs());
        assert_eq!((bed.position(), bed.get(Reg::OFFSET)), (500, 0), "{n}");
    }
}

#[test]
fn an_offset_written_at_rest_takes_the_place_of_what_was_left() {
    let mut bed = Bed::saved(&[(Reg::MODE_ROTATION, 2)]);
    bed.set(Reg::OFFSET, 100_000);
    bed.coil(0x2000);
    bed.wait(500.millis());
    bed.coil(0x2001);
    bed.stand();
    let left = bed.get(Reg::OFFSET);
    // One half of it.
    bed.write(0x5016, 0);
    assert_eq!(bed.get(Reg::OFFSET), left & 0xFFFF);
    assert_eq!(bed.try_write_all(0x5015, &[40, 0])[0], 16);
    let before = bed.position();
    // Sensors that nobody needs just now are no error.
    bed.write(0x5010, 1);
    bed.write(0x5010, 2);
    bed.coil(0x2000);
    bed.stand();
    assert_eq!((bed.position(), bed.get(Reg::OFFSET), bed.get(Reg::ERROR)), (before + 40, 0, 0));
}

#[test]
fn a_constant_offset_is_taken_by_every_start() {
    let mut bed = Bed::saved(&[(Reg::MODE_ROTATION, 2), (Reg::OFFSET_CONST, 100)]);
    for n in 1..4 {
        bed.coil(0x2000);
        bed.stand();
        assert_eq!((bed.position(), bed.get(Reg::OFFSET), bed.get(Reg::OFFSET_CONST)), (100 * n, 0, 100));
    }
}

#[test]
fn compensation_moves_where_it_stops() {
    let mut bed = Bed::saved(&[(Reg::MODE_ROTATION, 2), (Reg::OFFSET_COMPENSATION, -15)]);
    for (offset, position) in [(200, 185), (-200, 0)] {
        bed.set(Reg::OFFSET, offset);
        bed.coil(0x2000);
        bed.stand();
        assert_eq!((bed.position(), bed.get(Reg::OFFSET)), (position, 0));
    }
}

#[test]
fn positions_are_reached_from_anywhere() {
    let mut bed = Bed::saved(&[
        (Reg::MODE_ROTATION, 3),
        (Reg::TARGET_POSITION1, 300),
        (Reg::TARGET_POSITION2, -100),
        (Reg::TARGET_POSITION3, 1),
    ]);
    bed.set(Reg::TARGET_POSITION4, 40);
    for (n, target) in [(1, 300), (2, -100), (4, 40), (3, 1), (3, 1)] {
        bed.write(0x5008, n);
        bed.coil(0x2000);
        // What the move began with, it keeps.
        bed.write(0x5008, 2);
        bed.set(Reg::TARGET_POSITION4, 40);
        assert_eq!(bed.get(Reg::TARGET_POSITION), target);
        bed.stand();
        assert_eq!(bed.position(), target);
    }
    bed.coil(0x2003);
    assert_eq!(bed.position(), 0);
}

#[test]
fn a_way_that_no_move_has_never_goes_the_other_way() {
    let mut bed = Bed::saved(&[
        (Reg::MODE_ROTATION, 3),
        (Reg::TARGET_POSITION1, -10),
        (Reg::TARGET_POSITION2, 2_147_483_647),
    ]);
    bed.coil(0x2000);
    bed.stand();
    bed.write(0x5008, 2);
    bed.coil(0x2000);
    bed.wait(100.millis());
    assert_eq!(bed.get(Reg::STATUS), 1);
}

#[test]
fn moves_need_two_hall_sensors() {
    for mode in [2, 3] {
        for halls in [0, 1] {
            let mut bed = Bed::saved(&[
                (Reg::MODE_ROTATION, mode),
                (Reg::USE_HALL, halls),
                (Reg::OFFSET, 100),
                (Reg::TARGET_POSITION1, 100),
            ]);
            bed.coil(0x2000);
            bed.wait(100.millis());
            assert_eq!((bed.get(Reg::STATUS), bed.get(Reg::ERROR), bed.position()), (0, 1 << 15, 0));
            bed.write(0x5023, 0);
            assert_eq!(bed.get(Reg::ERROR), 0);
            bed.write(0x5006, 1);
            bed.coil(0x2000);
            bed.wait(100.millis());
            assert_eq!((bed.get(Reg::STATUS), bed.get(Reg::ERROR)), (1, 0));
        }
    }
}

#[test]
fn a_move_that_loses_its_hall_sensors_stops() {
    for halls in [0, 1] {
        let mut bed = Bed::saved(&[(Reg::MODE_ROTATION, 2)]);
        bed.set(Reg::OFFSET, 100_000);
        bed.coil(0x2000);
        bed.wait(500.millis());
        let left = bed.get(Reg::OFFSET);
        assert_eq!(left + bed.position(), 100_000);
        bed.set(Reg::USE_HALL, halls);
        assert_eq!(bed.get(Reg::STATUS), 1, "it brakes");
        bed.wait(1.secs());
        assert_eq!((bed.get(Reg::STATUS), bed.get(Reg::ERROR)), (0, 1 << 15), "USE_HALL {halls}");
        assert_eq!(bed.get(Reg::OFFSET), left, "nobody counts any more");
        // With its sensors it goes on.
        bed.set(Reg::USE_HALL, 2);
        bed.write(0x5023, 0);
        bed.coil(0x2000);
        bed.wait(100.millis());
        assert_eq!((bed.get(Reg::STATUS), bed.get(Reg::ERROR)), (1, 0));
    }
}

#[test]
fn a_rotation_may_lose_its_hall_sensors() {
    for halls in [0, 1] {
        let mut bed = Bed::ready();
        bed.coil(0x2000);
        bed.wait(500.millis());
        bed.set(Reg::USE_HALL, halls);
        assert_eq!((bed.turns().0, bed.get(Reg::ERROR)), (1, 0), "USE_HALL {halls}");
    }
}

#[test]
fn an_error_stops_the_motor_and_no_start_moves_it() {
    for name in ["short_circuit", "mcu_overheat"] {
        let mut bed = Bed::ready();
        bed.coil(0x2000);
        bed.wait(1.secs());
        bed.fault(name, true);
        bed.fault(name, false);
        bed.stand();
        let position = bed.position();
        bed.coil(0x2000);
        bed.wait(1.secs());
        assert_eq!((bed.get(Reg::STATUS), bed.position()), (0, position));
        bed.write(0x5026, 0x95AF);
        bed.wait(1.secs());
        assert_eq!((bed.get(Reg::STATUS), bed.position()), (0, 0), "and it is not remembered");
        bed.coil(0x2000);
        assert_eq!(bed.turns().0, 1);
    }
}

#[test]
fn a_warning_stops_nothing() {
    let mut bed = Bed::ready();
    bed.coil(0x2000);
    bed.wait(1.secs());
    bed.fault("current_limit", true);
    let (status, rpm) = bed.turns();
    assert_eq!(status, 1);
    about(rpm, 1_000);
}

#[test]
fn the_fault_current_limit_halves_the_limit() {
    let mut bed = Bed::saved(&[(Reg::REF_CURRENT, 4_000)]);
    bed.fault("stall", true);
    bed.coil(0x2000);
    let held = |bed: &mut Bed| {
        bed.wait(200.millis());
        bed.drive.shaft(bed.now, Axis(0)).unwrap().ma.abs()
    };
    assert!((3_600..=4_000).contains(&held(&mut bed)));
    bed.fault("current_limit", true);
    assert!((1_800..=2_000).contains(&held(&mut bed)));
    bed.write(0x5009, 6_000);
    assert!((2_700..=3_000).contains(&held(&mut bed)));
    bed.fault("current_limit", false);
    assert!((5_400..=6_000).contains(&held(&mut bed)));
}

#[test]
fn an_open_emergency_stop_stops_at_once() {
    let mut bed = Bed::saved(&[(Reg::DEC, 10)]);
    bed.coil(0x2000);
    bed.wait(1.secs());
    let position = bed.position();
    bed.contact(HARD_STOP, false);
    bed.stand();
    // With DEC = 10, 100 rps², 1,000 rpm would take 22 counts of 16 a turn, and 167 ms.
    assert!(bed.position() - position < 22, "{}", bed.position() - position);
    assert_eq!(bed.get(Reg::ERROR), 1 << 5);
}

#[test]
fn by_inputs_the_bus_starts_nothing_but_stops() {
    let mut bed = Bed::ready();
    bed.coil(0x2000);
    bed.wait(1.secs());
    bed.write(0x5004, 2);
    assert_eq!(bed.turns().0, 1);
    bed.coil(0x2001);
    bed.stand();
    bed.coil(0x2000);
    bed.wait(1.secs());
    assert_eq!(bed.get(Reg::STATUS), 0);
}

#[test]
fn the_motor_warms_the_drive_a_little() {
    let mut bed = Bed::ready();
    bed.coil(0x2000);
    bed.wait(300.secs());
    for reg in [Reg::TEMPERATURE_MCU, Reg::TEMPERATURE_MOSFET, Reg::TEMPERATURE_BRAKE] {
        assert!((250..600).contains(&bed.get(reg)), "{reg:?}: {}", bed.get(reg));
    }
    assert_eq!(bed.get(Reg::ERROR), 0);
}

#[test]
fn a_program_that_ends_leaves_the_motor_turning_and_one_that_ends_fully_stops_it() {
    // START, wait, and the end.
    let lines = |end| [0x0001_0001, 0x2000_1002, 0x01F4_0004, end];
    let load = |bed: &mut Bed, lines: [u32; 4]| {
        let image = super::super::program::image(lines);
        bed.world.memory[SETTINGS..].copy_from_slice(&image);
        bed.cycle();
        bed.set(Reg::MODE_USER_PROGRAM, 2);
        bed.wait(400.millis());
        assert_eq!(bed.get(Reg::STATUS), 1);
        bed.wait(200.millis());
    };
    let mut bed = Bed::ready();
    load(&mut bed, lines(0x00));
    assert_eq!(bed.get(Reg::STATUS_USER_PROGRAM), 5);
    assert_eq!(bed.turns().0, 1);
    bed.write(0x5005, 1);
    assert_eq!(bed.turns().0, 1);
    bed.coil(0x2001);
    bed.stand();
    for (end, status) in [(0x0D, 6), (0x7F, 7)] {
        load(&mut bed, lines(end));
        assert_eq!(bed.get(Reg::STATUS_USER_PROGRAM), status);
        bed.stand();
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
    let mut bed = Bed::new();
    bed.world.memory[SETTINGS..].copy_from_slice(&image);
    bed.set(Reg::OFFSET, 1_000);
    bed.power_on(Boot { fast: true, ..Boot::default() });
    bed.run_until(Instant::ZERO);
    bed.set(Reg::MODE_USER_PROGRAM, 2);
    bed.wait(200.millis());
    assert!(bed.get(Reg::OFFSET) < 1_000);
    bed.wait(200.millis());
    bed.stand();
    assert_eq!((bed.get(Reg::OFFSET), bed.get(Reg::MODE_ROTATION)), (1_000, 1));
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
    let mut bed = Bed::new();
    bed.world.memory[SETTINGS..].copy_from_slice(&image);
    bed.set(Reg::OFFSET, 100_000);
    bed.power_on(Boot { fast: true, ..Boot::default() });
    bed.run_until(Instant::ZERO);
    bed.set(Reg::MODE_USER_PROGRAM, 2);
    bed.wait(401.millis());
    assert_eq!((bed.get(Reg::STATUS_USER_PROGRAM), bed.get(Reg::DEC), bed.get(Reg::STATUS)), (6, 100, 1));
    // 1,000 rpm are gone in 31 ms with DEC = 100, 545 rps²; with 10, 100 rps², in 167 ms.
    bed.wait(60.millis());
    assert_eq!(bed.get(Reg::STATUS), 0);
}
