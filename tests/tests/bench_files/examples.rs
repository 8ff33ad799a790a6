//! The files in `examples/`.

use drivetwin_firmware::device::{Axis, Port};
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;

use drivetwin_sim::bench::{Bench, Client};

use super::{ask, example, moments, register, seat};

const AXIS: Axis = Axis(0);

/// MotionControl (MD3 User Guide, 7.15), and its bit Move.
const MOTION_CONTROL: u16 = 0x11;
const MOVE: u16 = 1;

#[test]
fn two_drives_on_one_line_are_two_addresses() {
    let mut built = example("two-drives");
    let bench = &mut built.bench;
    let (carriage, lift) = (seat(bench, "carriage"), seat(bench, "lift"));
    assert_eq!(built.drives, [carriage, lift]);
    assert_eq!(built.buses, [bench.find_bus("line1").unwrap()]);
    let client = bench.connect(built.buses[0]);
    bench.run_until(2_500.millis());
    assert_eq!(register(bench, lift, "Speed"), 8_000);

    let request = rtu::write(2, MOTION_CONTROL, MOVE);
    assert_eq!(ask(bench, client, &request), request[..]);
    assert!(bench.motion(lift, AXIS).moving);
    assert!(!bench.motion(carriage, AXIS).moving, "a request for the lift is none for the carriage");
    let request = rtu::write(1, MOTION_CONTROL, MOVE);
    assert_eq!(ask(bench, client, &request), request[..]);
    assert!(bench.motion(carriage, AXIS).moving);
    assert_eq!(ask(bench, client, &rtu::read(3, 0, 1)), b"", "there is no third one");

    bench.run_until(6.secs());
    // 10,000 steps are the MD3's factory setting (7.16).
    let position = |seat| bench.motion(seat, AXIS).position;
    assert_eq!((position(carriage), position(lift)), (10_000, -4_000));
}

#[test]
fn the_qsb_moves_the_motor_of_the_md3_and_reads_its_encoder() {
    /// Microsteps per turn of an MD3 with factory settings: 8 microsteps to a step (7.2), and a motor of 200
    /// steps.
    const TURN: u32 = 8 * 200;
    /// Counts per turn: an encoder of 1,000 cycles, of which the QSB counts all four edges (MDR0).
    const COUNTS: i32 = 4 * 1_000;
    let mut built = example("step-and-encoder");
    let bench = &mut built.bench;
    let [reader, stepper] = ["reader", "stepper"].map(|name| seat(bench, name));
    let client = bench.connect(bench.bus(reader, Port(0)).unwrap());
    bench.run_until(1.secs());
    ask(bench, client, b"");
    // The motor drive takes its pins. The step line falls, so the MD3 makes one step.
    assert_eq!(command(bench, client, "W162"), 2);
    let began = (bench.motion(stepper, AXIS).position, command(bench, client, "R0E"));
    let indexes = moments(bench, "reader > pin I high").len();
    command(bench, client, &format!("W11{TURN:08X}"));
    for turns in 1..=3 {
        command(bench, client, "W168");
        bench.run_until(bench.now() + 60.secs());
        let now = (bench.motion(stepper, AXIS).position, command(bench, client, "R0E"));
        let turned = (now.0 - began.0, now.1 - began.1);
        assert_eq!(turned, (turns * TURN.cast_signed(), turns * COUNTS));
        assert_eq!(moments(bench, "reader > pin I high").len() - indexes, turns as usize);
    }
}

#[test]
fn two_wheels_drive_straight_on_with_the_same_command() {
    // PIDs of the manual: UI_COM, START_STOP, VEL_CMD, POSI_RESET, INV_SIGN_CMD (p. 7, 12, 13).
    let mut built = example("two-wheels");
    let bench = &mut built.bench;
    let [left, right] = ["left", "right"].map(|name| seat(bench, name));
    let client = bench.connect(built.buses[0]);
    let position = |bench: &Bench, seat| bench.motion(seat, AXIS).position;
    bench.run_until(5.secs());
    assert_eq!([left, right].map(|seat| bench.motion(seat, AXIS).moving), [false; 2], "no command has come");
    let began = [position(bench, left), position(bench, right)];
    for (pid, value) in [(78, 1), (100, 1), (130, 500)] {
        for id in [1, 2] {
            let request = rtu::write(id, pid, value);
            assert_eq!(ask(bench, client, &request), request[..]);
        }
    }
    bench.run_until(10.secs());
    assert!((register(bench, left, "RPM_DATA") - 500).abs() <= 5);
    assert!((register(bench, right, "RPM_DATA") + 500).abs() <= 5, "measured values are not turned round");
    // A turn has 12 counts. The second drive gets its command 30 ms later.
    let ways = [position(bench, left) - began[0], began[1] - position(bench, right)];
    assert!(ways[0] > 400 && (ways[0] - ways[1]).abs() <= 6, "{ways:?}");
}

/// Sends a command to a QSB and returns the data of its reply.
#[track_caller]
fn command(bench: &mut Bench, client: Client, command: &str) -> i32 {
    bench.send(client, format!("{command}\r").as_bytes());
    bench.run_until(bench.now() + 5.millis());
    let mut reply = Vec::new();
    bench.receive(client, &mut reply);
    let reply = String::from_utf8(reply).unwrap();
    let data = reply.get(5..13).unwrap_or_else(|| panic!("{reply:?} to {command}"));
    u32::from_str_radix(data, 16).unwrap().cast_signed()
}

/// 1,000 rpm and a DEC of 100, which is 545 rps² (RS434-14). The switch opens at ten turns. The drive waits
/// 10 ms (WAITED_INPUTS_EXTERN), in which the switch may bounce, and then brakes.
#[test]
fn the_limit_switch_stops_the_motor() {
    const SPEED: f64 = 1_000.0 / 60.0;
    const DEC: f64 = 100.0 + (100.0 - 10.0) / (1_000.0 - 10.0) * 4_900.0;
    let braked = SPEED * 0.010 + SPEED * SPEED / (2.0 * DEC);
    let mut built = example("limit-switch");
    let bench = &mut built.bench;
    let feeder = seat(bench, "feeder");
    bench.run_until(800.millis());
    assert_eq!(register(bench, feeder, "STATUS"), 1, "it turns forward");
    bench.run_until(5.secs());
    let turn = bench.turn(built.motors[0]);
    assert_eq!((register(bench, feeder, "STATUS"), turn.rpm), (0, 0.0), "it stands");
    let expected = 10.0 + braked;
    assert!((turn.revolutions - expected).abs() < 0.05, "{} turns, expected {expected}", turn.revolutions);
    assert_eq!(moments(bench, "> pin IN1 high").len(), 1, "the switch opens once");
}
