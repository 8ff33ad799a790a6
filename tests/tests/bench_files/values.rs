//! Values of a bench file reach the layout and the bench.

use std::path::Path;

use drivetwin_firmware::device::{Axis, Duration, Fault, Instant, Port};
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{PowerAction, Setup};
use drivetwin_sim::catalog;
use drivetwin_sim::config::board_place::BoardPlace;
use drivetwin_sim::config::layout::{At, Built, MotorKind};
use drivetwin_sim::config::listen::Uri;
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::line::LineMode;
use drivetwin_sim::line::faults::{Direction, FaultRule, LineFaults};
use drivetwin_sim::record::trace::{Event, InputRecord, Trace};
use drivetwin_sim::replay;

use super::{built, layout, moments, register, seat};

#[test]
fn nothing_but_a_drive_is_a_bench() {
    let layout = layout("[[drive]]\nname = 'x'\nkind = 'md3'\n");
    assert_eq!((layout.seed, layout.time, layout.line), (None, None, None));
    // A drive has a pty only if the file lists one.
    assert_eq!(layout.drives[0].listen, [(Port(0), Uri::Tcp("127.0.0.1:0".into()))]);
    assert_eq!(layout.settings(), drivetwin_sim::bench::Settings::default());
}

#[test]
fn every_key_of_a_bench_file() {
    let layout = layout(
        r#"
        seed = 18446744073709551615
        time = "x10"
        line = "fast"
        drive = [
            { name = "x", kind = "md3", address = 7, nv = "x.nv", set = { Speed = 0x10 }, fast_boot = true },
            { name = "y", kind = "rs434546", program = "p.rsasm", faults = ["stall"], listen = [] },
            { name = "q", kind = "qsb-m", listen = ["usb=pty:q.tty", "tcp:127.0.0.1:5020"] },
        ]
        bus = [{ name = "b", drives = ["x"], listen = ["serial:ttyUSB0", "stdio:"], collisions = true }]
        encoder = [{ motor = "m", cycles_per_rev = 500, to = { index = "q.I", a = "q.A" } }]
        switch = [{ motor = "m", closed = { above_rev = 1, below_rev = 1.5 }, to = "x.J2.2" }]
        wire = [{ from = "q.DIO1", to = "x.J2.4" }]

        [[motor]]
        name = "m"
        drive = "x"
        steps_per_rev = 400
        holding_mnm = 1200.5
        rated_ma = 2800
        pull_out_rpm = 2000
        inertia_gcm2 = 300
        friction_mnm = 0.0125
        load_mnm = -3

        [[fault]]
        bus = "b"
        drop = 1
        corrupt = 0.5
        duplicate = 0.25
        truncate = 0.125
        wrong_address = 0.1
        exception = 0.2
        exception_code = 255
        noise = 0.3
        delay_ms = 0.5
        mute = true
        baud = 19200
        "#,
    );
    assert_eq!(
        (layout.seed, layout.time, layout.line),
        (Some(u64::MAX), Some(TimeMode::Times(10)), Some(LineMode::Fast))
    );
    let [x, y, q] = &layout.drives[..] else { panic!("three drives") };
    assert_eq!((x.nv.as_deref(), x.fast_boot), (Some(Path::new("x.nv")), true));
    assert!(x.listen.is_empty(), "its only port is on a bus");
    assert_eq!((y.program.as_deref(), &y.faults[..]), (Some(Path::new("p.rsasm")), &[Fault(8)][..]));
    assert!(y.listen.is_empty());
    let places = [Uri::Pty(Some("q.tty".into())), Uri::Tcp("127.0.0.1:5020".into())];
    assert_eq!(q.listen, places.map(|uri| (Port(0), uri)));
    let bus = &layout.buses[0];
    assert_eq!(bus.listen, [Uri::Serial("ttyUSB0".into()), Uri::Stdio]);
    assert_eq!((&bus.drives[..], bus.collisions), (&[(0, Port(0))][..], true));

    let MotorKind::Stepper(motor) = &layout.motors[0].is else { panic!("an MD3 turns a stepper motor") };
    assert_eq!((motor.steps_per_rev, motor.holding_unm, motor.rated_ma), (400, 1_200_500, 2_800));
    assert_eq!((motor.pull_out_rpm, motor.inertia_gcm2), (2_000, 300));
    assert_eq!((motor.friction_unm, motor.load_unm), (13, -3_000));
    let spec = |drive: usize| catalog::make(layout.drives[drive].kind).unwrap().spec();
    let named = |drive: usize, name: &str| -> At { (drive, spec(drive).pin(name).unwrap()) };
    let encoder = &layout.encoders[0];
    assert_eq!(encoder.cycles_per_rev, 500);
    assert_eq!((encoder.a, encoder.b, encoder.index), (Some(named(2, "A")), None, Some(named(2, "I"))));
    let switch = &layout.switches[0];
    assert_eq!((switch.closed.above_rev, switch.closed.below_rev), (Some(1.0), Some(1.5)));
    assert_eq!(switch.to, named(0, "J2.2"));
    assert_eq!((layout.wires[0].from, layout.wires[0].to), (named(2, "DIO1"), named(0, "J2.4")));
    let disturbed = &layout.faults[0];
    assert_eq!(disturbed.bus, "b");
    let expected = LineFaults {
        drop: FaultRule::rate(1.0),
        corrupt: FaultRule::rate(0.5),
        duplicate: FaultRule::rate(0.25),
        truncate: FaultRule::rate(0.125),
        wrong_address: FaultRule::rate(0.1),
        exception: FaultRule::rate(0.2),
        exception_code: 255,
        noise: FaultRule::rate(0.3),
        delay: Duration::micros(500),
        mute: FaultRule::ALL,
        baud: Some(19_200),
        ..LineFaults::NONE
    };
    assert_eq!(disturbed.faults, expected);
}

/// The first bench file, on which documentation and scripts of others are based.
#[test]
fn the_first_bench_file_there_was() {
    let layout = layout(
        r#"
        seed = 1
        time = "real"

        [[bus]]
        name = "line1"
        listen = ["tcp:127.0.0.1:5020", "pty:line1.tty"]
        drives = ["x", "y"]

        [[drive]]
        name = "x"
        kind = "md3"
        address = 1
        nv = "x.nv"
        set = { Speed = 8000 }

        [[drive]]
        name = "y"
        kind = "md3"

        [[drive]]
        name = "reader"
        kind = "qsb-m"
        listen = ["pty:qsb.tty"]

        [[motor]]
        name = "m"
        drive = "x"
        steps_per_rev = 200

        [[encoder]]
        motor = "m"
        cycles_per_rev = 1000
        to = { a = "reader.A", b = "reader.B", index = "reader.I" }

        [[switch]]
        motor = "m"
        closed = { below_rev = -2.0 }
        to = "x.J2.2"

        [[wire]]
        from = "reader.DIO1"
        to = "x.J2.4"

        [[fault]]
        bus = "line1"
        drop = 0.01
        corrupt = 0.01
        delay_ms = 5
        "#,
    );
    assert_eq!(layout.buses[0].drives, [(0, Port(0)), (1, Port(0))]);
    assert_eq!(layout.switches[0].closed.below_rev, Some(-2.0));
    assert_eq!(layout.faults[0].faults.delay, Duration::millis(5));
}

#[test]
fn a_thousand_drives_are_a_bench() {
    let drives =
        (0..1_000).map(|n| format!("[[drive]]\nname = 'd{n}'\nkind = 'md3'\naddress = {}\n", n % 247 + 1));
    let bus = (0..247).map(|n| format!("'d{n}'")).collect::<Vec<_>>().join(",");
    let text = format!("[[bus]]\nname = 'line'\ndrives = [{bus}]\n{}", drives.collect::<String>());
    let built = built(&text);
    assert_eq!((built.drives.len(), built.bench.ports(built.buses[0]).len()), (1_000, 247));
}

#[test]
fn paths_are_relative_to_the_folder_of_the_file() {
    let mut layout = layout(
        "[[drive]]\nname = 'x'\nkind = 'rs434544'\nnv = 'x.nv'\nprogram = '/abs.rsasm'\n\
         listen = ['pty:x.tty', 'serial:/dev/ttyUSB0', 'tcp:127.0.0.1:0']\n",
    );
    layout.relative_to(Path::new("/benches"));
    let drive = &layout.drives[0];
    assert_eq!(drive.nv.as_deref(), Some(Path::new("/benches/x.nv")));
    assert_eq!(drive.program.as_deref(), Some(Path::new("/abs.rsasm")));
    let places = drive.listen.iter().map(|(_, uri)| uri.to_string()).collect::<Vec<_>>();
    assert_eq!(places, ["pty:/benches/x.tty", "serial:/dev/ttyUSB0", "tcp:127.0.0.1:0"]);
}

#[test]
fn a_bench_file_names_boards_by_their_places() {
    let mut layout = layout(
        "time = 'real'
        [defaults.drive]
        kind = 'md3'
        fast_boot = true
        [[drive]]
        name = 'x'
        [[drive]]
        name = 'b{1..2}'
        board = 'tcp:127.0.0.1:{5000+n}'
        bus = 'rfc2217:127.0.0.1:{6000+n}'
        [[drive]]
        name = 'c'
        board = 'ttyACM1'
        [[fault]]
        bus = 'rs485'
        drop = 1
        ",
    );
    layout.relative_to(Path::new("/dev"));
    let boards: Vec<_> = layout.drives.iter().map(|drive| drive.board.clone()).collect();
    let board = |index: usize| boards[index].as_ref().unwrap();
    assert!(boards[0].is_none() && layout.has_boards());
    assert_eq!(board(2).place, BoardPlace::Tcp("127.0.0.1:5002".into()));
    assert_eq!(board(2).bus, Some(Uri::Rfc2217("127.0.0.1:6002".into())));
    assert_eq!(board(3).place, BoardPlace::Port("/dev/ttyACM1".into()));
    // Defaults are for the other drives.
    assert_eq!(
        layout.drives.iter().map(|drive| drive.fast_boot).collect::<Vec<_>>(),
        [true, false, false, false]
    );
    assert_eq!(layout.drives.iter().map(|drive| drive.kind).collect::<Vec<_>>(), ["md3", "", "", ""]);
    assert_eq!(layout.drives.iter().map(|drive| drive.listen.len()).collect::<Vec<_>>(), [1, 0, 0, 0]);
    // `rs485` alone is the line of the only emulated drive.
    assert_eq!(layout.faults[0].bus, "x.rs485");
    assert!(
        layout.check_emulated().unwrap_err().starts_with("'b1' is on a board, which only a run attaches")
    );
}

#[test]
fn a_board_of_any_kind_is_no_warning() {
    let layout = layout("[[drive]]\nname = 'b'\nboard = 'usb:E661'\n[[drive]]\nname = 'x'\nkind = 'md3'\n");
    assert_eq!(layout.drives[0].kind, "");
    assert_eq!(layout.warnings().unwrap(), [""; 0]);
}

/// Values missing in a `[[motor]]` come from the registers of its drive at power-on, either presets or from
/// the memory. Later changes of the registers do not change the motor. Both edges of two sensors count, four
/// for each pulse.
#[test]
fn a_motor_is_what_its_drive_says_at_power_on() {
    let counts_per_turn = |set: &str, motor: &str, memory: Option<Vec<u8>>, later: Option<i64>| {
        let drive = format!("[[drive]]\nname = 'x'\nkind = 'rs434544'\nset = {{{set}}}\n");
        let layout = layout(&format!("{drive}[[motor]]\nname = 'm'\ndrive = 'x'\n{motor}"));
        let given = vec![Setup { memory, ..Setup::default() }];
        let Built { mut bench, drives, motors, .. } = layout.build(layout.settings(), given).unwrap();
        bench.run_until(600.millis());
        if let Some(pulses) = later {
            let row = bench.spec(drives[0]).find("PULSES_PER_REVOLUTION").unwrap().row;
            bench.poke(drives[0], row, pulses).unwrap();
        }
        bench.ask(drives[0], &rtu::frame(1, &[5, 0x20, 0, 0xFF, 0]));
        bench.run_until(3.secs());
        let (turns, counts) = (bench.turn(motors[0]).revolutions, bench.motion(drives[0], Axis(0)).position);
        assert!(turns > 10.0, "{turns}");
        ((f64::from(counts) / turns).round(), bench.memory(drives[0]).to_vec())
    };
    let eight = "PULSES_PER_REVOLUTION = 8";
    assert_eq!(counts_per_turn("", "", None, None).0, 16.0);
    let (counts, memory) = counts_per_turn(eight, "", None, None);
    assert_eq!(counts, 32.0);
    assert_eq!(counts_per_turn("", "", Some(memory), None).0, 32.0);
    assert_eq!(counts_per_turn(eight, "", None, Some(4)).0, 32.0);
    assert_eq!(counts_per_turn("", "", None, Some(8)).0, 16.0);
    assert_eq!(counts_per_turn(eight, "hall_pulses = 5", None, None).0, 20.0);
}

/// A load turns a shaft forward. HU, HV and HW are three sensors, each with an edge per pole; channels A and
/// B belong to an encoder. HALL_TYPE 0 means 4 poles, 3 means 12 (p. 8). UI_COM 1 leaves the motor terminals
/// open; with 0 an open RUN/BRAKE would short them.
#[test]
fn a_brushless_motor_has_its_configured_poles() {
    for (set, poles, has) in
        [("", "", 4), (", HALL_TYPE = 3", "", 12), (", HALL_TYPE = 3", "poles = 8", 8), ("", "poles = 2", 2)]
    {
        let Built { mut bench, drives, motors, .. } = built(&format!(
            "[[drive]]\nname = 'd'\nkind = 'mdrobot'\nset = {{UI_COM = 1{set}}}\n\
             [[motor]]\nname = 'm'\ndrive = 'd'\nload_mnm = -50\n{poles}\n\
             [[encoder]]\nmotor = 'm'\ncycles_per_rev = 100\nto = {{ a = 'd.ENC_A', b = 'd.ENC_B' }}\n"
        ));
        bench.run_until(2.secs());
        let turns = bench.turn(motors[0]).revolutions;
        // 40 mN·m on 5,000 g·cm² are 80 rad/s²: 25.46 turns, slightly changed by what the drive does at the
        // end of its start.
        assert!((turns - 25.46).abs() < 0.2, "{turns}");
        // A shaft starts in the middle of a count.
        let counts = |a_turn: f64| (turns * a_turn + 0.5).floor() as usize;
        let halls = ["HU", "HV", "HW"].map(|name| bench.spec(drives[0]).pin(name).unwrap());
        let channels = ["ENC_A", "ENC_B"].map(|name| bench.spec(drives[0]).pin(name).unwrap());
        let (mut state, mut states, mut edges) = ([true; 3], vec![], 0);
        for entry in bench.trace().events() {
            let Event::Input(InputRecord::Edge { pin, high }) = entry.event else { continue };
            edges += usize::from(channels.contains(&pin));
            if let Some(hall) = halls.iter().position(|hall| *hall == pin) {
                state[hall] = high;
                states.push(state.map(u8::from));
            }
        }
        let forward = [[1, 0, 1], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]];
        assert!(states.iter().zip(forward.iter().cycle()).all(|(state, expected)| state == expected));
        // The first state is the state at rest.
        assert_eq!(states.len() - 1, counts(3.0 * f64::from(has)), "{has} poles, {turns} turns");
        assert_eq!(bench.motion(drives[0], Axis(0)).position as usize, counts(3.0 * f64::from(has)));
        assert_eq!(edges, counts(400.0));
    }
}

/// `supply_v` is also the supply of the drive. The drive shows the voltage after each power-on, and more than
/// 60 V is an alarm.
#[test]
fn supply_v_of_a_motor_sets_the_supply_of_its_drive() {
    for (said, shown, status) in [("supply_v = 36.04", 360, 0), ("supply_v = 60.1", 601, 0b101), ("", 240, 0)]
    {
        let motor = format!("[[motor]]\nname = 'm'\ndrive = 'd'\n{said}");
        let mut built =
            built(&format!("drive = [{{name = 'd', kind = 'mdrobot', fast_boot = true}}]\n{motor}"));
        let bench = &mut built.bench;
        let drive = seat(bench, "d");
        for _ in 0..2 {
            bench.run_until(bench.now() + 10.millis());
            let read = |name| register(bench, drive, name);
            assert_eq!((read("VOLT_IN"), read("CTRL_STATUS")), (shown, status), "{said}");
            bench.power(drive, PowerAction::Cycle);
        }
    }
    // A preset of the drive also sets the supply of the motor, which is as fast as at 12 V.
    let mut built = built(
        "drive = [{name = 'd', kind = 'mdrobot', fast_boot = true, set = {VOLT_IN = 120}}]\n\
         [[motor]]\nname = 'm'\ndrive = 'd'",
    );
    let drive = seat(&built.bench, "d");
    built.bench.run_until(10.millis());
    for (name, value) in [("UI_COM", 1), ("START_STOP", 1), ("OPEN_VEL_CMD", 1_023)] {
        let row = built.bench.spec(drive).find(name).unwrap().row;
        built.bench.poke(drive, row, value).unwrap();
    }
    built.bench.run_until(3.secs());
    let rpm = built.bench.turn(built.motors[0]).rpm;
    assert!((rpm - 1_902.0).abs() < 5.0, "{rpm}");
}

/// RS, 3: "Power supply protection, VDC: 8 - 30", rated 12 to 24. Outside that range bit 0 of ERROR is set
/// and the motor does not turn, after each power-on. Inside the range the motor turns.
#[test]
fn supply_v_of_a_brush_motor_sets_the_supply_of_its_drive() {
    for kind in ["rs434544", "rs434546"] {
        for (said, error) in
            [("5", 1), ("7.94", 1), ("8", 0), ("24", 0), ("30", 0), ("30.1", 1), ("31", 1), ("48", 1)]
        {
            let mut built = built(&format!(
                "drive = [{{name = 'd', kind = '{kind}'}}]\n[[motor]]\nname = 'm'\ndrive = 'd'\nsupply_v = {said}"
            ));
            let bench = &mut built.bench;
            let drive = seat(bench, "d");
            let start = bench.spec(drive).find("START_bit").unwrap().row;
            for _ in 0..2 {
                bench.run_until(bench.now() + 600.millis());
                assert_eq!(register(bench, drive, "ERROR") & 1, error, "{said} V");
                bench.poke(drive, start, 1).unwrap();
                bench.run_until(bench.now() + 200.millis());
                let carries = bench.turn(built.motors[0]).ma != 0;
                assert_eq!(
                    (register(bench, drive, "STATUS") == 0, carries),
                    (error == 1, error == 0),
                    "{said} V"
                );
                bench.power(drive, PowerAction::Cycle);
            }
        }
    }
    let twice = "[[drive]]\nname = 'd'\nkind = 'rs434544'\nset = { SUPPLY = 120 }\n\
                 [[motor]]\nname = 'm'\ndrive = 'd'\nsupply_v = 12";
    let error = drivetwin_sim::config::bench_file::parse(twice).unwrap_err().to_string();
    assert!(error.contains("SUPPLY of 'd' sets the same as supply_v"), "{error}");
}

/// RS, 6: "operation is permitted with closed contact". The switch and the motor have no settings of their
/// own.
#[test]
fn an_emergency_switch_on_a_shaft_opens() {
    let mut built = built(
        "drive = [{ name = 'd', kind = 'rs434544' }]\nmotor = [{ name = 'm', drive = 'd' }]\n\
         switch = [{ motor = 'm', closed = { below_rev = 3 }, to = 'd.HARD_STOP' }]",
    );
    let bench = &mut built.bench;
    let drive = seat(bench, "d");
    bench.run_until(600.millis());
    let start = bench.spec(drive).find("START_bit").unwrap().row;
    bench.poke(drive, start, 1).unwrap();
    bench.run_until(3.secs());
    // 1,000 rpm, braked by shorted terminals: the motor comes to rest within a turn.
    let turn = bench.turn(built.motors[0]);
    assert!((3.0..4.0).contains(&turn.revolutions) && turn.rpm == 0.0, "{turn:?}");
    let read = |name| register(bench, drive, name);
    assert_eq!((read("IN_HARD_STOP_bit"), read("ERROR"), read("STATUS")), (0, 1 << 5, 0));
}

/// The emergency stop is wired to CLUTCH of an MDROBOT. CLUTCH floats until CLUTCH_OFF (CMD 18) makes it low;
/// CLUTCH_ON (17) makes it high. A released contact is open.
#[test]
fn an_emergency_stop_on_a_wire() {
    let mut built = built(
        "drive = [{ name = 'a', kind = 'rs434544' }, { name = 'b', kind = 'mdrobot' }]\n\
         wire = [{ from = 'b.CLUTCH', to = 'a.HARD_STOP' }]",
    );
    let bench = &mut built.bench;
    let [a, b] = ["a", "b"].map(|name| seat(bench, name));
    let [restart, command] =
        [(a, "FLAG_RESTART"), (b, "COMMAND")].map(|(of, name)| bench.spec(of).find(name).unwrap().row);
    bench.run_until(600.millis());
    for (code, seen) in [(None, [0, 1 << 5]), (Some(18), [1, 0]), (Some(17), [0, 1 << 5])] {
        if let Some(code) = code {
            bench.poke(b, command, code).unwrap();
            bench.run_until(bench.now() + 1.millis());
            bench.poke(a, restart, 0x95AF).unwrap();
            bench.run_until(bench.now() + 600.millis());
        }
        assert_eq!(["IN_HARD_STOP_bit", "ERROR"].map(|name| register(bench, a, name)), seen, "{code:?}");
    }
}

/// A preset of a half register is merged into the whole register that is preset beside it, else into the
/// value in the memory. The factory value of Speed is 5,000 (7.17).
#[test]
fn presets_are_there_at_power_on() {
    for (set, speed) in
        [("{ SpeedHigh = 1 }", 65_536 + 5_000), ("{ SpeedHigh = 1, Speed = 0x20 }", 65_536 + 32)]
    {
        let built = built(&format!("[[drive]]\nname = 'x'\nkind = 'md3'\naddress = 9\nset = {set}\n"));
        let x = seat(&built.bench, "x");
        assert_eq!(register(&built.bench, x, "DeviceAddress"), 9);
        assert_eq!(register(&built.bench, x, "Speed"), speed, "{set}");
    }
}

#[test]
fn what_the_host_gives_a_drive_is_kept() {
    let layout = layout("[[drive]]\nname = 'x'\nkind = 'md3'\nset = { SpeedHigh = 1 }\n");
    let mut first = layout.build(layout.settings(), Vec::new()).unwrap();
    let x = first.drives[0];
    let memory = first.bench.memory(x).to_vec();
    first.bench.run_until_idle();
    let given = vec![Setup { memory: Some(memory), boot_fast: true, ..Setup::default() }];
    let mut low = super::layout("[[drive]]\nname = 'x'\nkind = 'md3'\nset = { SpeedLow = 2 }\n");
    low.seed = Some(2);
    let second = low.build(low.settings(), given).unwrap();
    assert_eq!(register(&second.bench, second.drives[0], "Speed"), 65_538);
}

/// An MD3 with factory settings steps when J2.4 falls. An MD3 that is too hot does not move (7.15).
#[test]
fn wires_and_faults_are_there_from_the_beginning() {
    let mut built = built(
        "drive = [{ name = 'x', kind = 'md3', fast_boot = true, set = { MoveSteps = 300 } }, \
         { name = 'y', kind = 'md3', fast_boot = true }, \
         { name = 'z', kind = 'md3', fast_boot = true, faults = ['over_temperature'] }]\n\
         wire = [{ from = 'x.STEP', to = 'y.J2.4' }]\n",
    );
    let bench = &mut built.bench;
    bench.run_until(10.millis());
    let [x, y, z] = [0, 1, 2].map(|drive| built.drives[drive]);
    let before = bench.motion(y, Axis(0)).position;
    bench.ask(x, &rtu::write(1, 0x11, 1));
    bench.run_until(5.secs());
    assert_eq!(bench.motion(y, Axis(0)).position - before, 300);
    bench.ask(z, &rtu::write(1, 0x11, 1));
    bench.run_until(10.secs());
    assert_eq!(bench.motion(z, Axis(0)).position, 0);
}

/// A level at power-on is not an edge. An MD3 with factory settings steps when J2.4 falls (7.8), not because
/// of a switch that is closed from the beginning, or an output that is low.
#[test]
fn a_contact_that_is_closed_at_power_on_is_no_edge() {
    for fast in [true, false] {
        let mut built = built(&format!(
            "drive = [{{ name = 'm', kind = 'md3', address = 2, fast_boot = {fast} }}, \
             {{ name = 'x', kind = 'md3', fast_boot = {fast} }}, \
             {{ name = 'y', kind = 'md3', address = 3, fast_boot = {fast} }}]\n\
             motor = [{{ name = 'shaft', drive = 'm' }}]\n\
             switch = [{{ motor = 'shaft', closed = {{ below_rev = 1 }}, to = 'x.J2.4' }}]\n\
             wire = [{{ from = 'm.STEP', to = 'y.J2.4' }}]\n"
        ));
        let bench = &mut built.bench;
        bench.run_until(10.secs());
        for name in ["x", "y"] {
            let at = seat(bench, name);
            assert!(moments(bench, &format!("{name} > pin J2.4 low")).contains(&Instant::ZERO), "{name}");
            assert_eq!(bench.motion(at, Axis(0)).position, 0, "{name}, fast: {fast}");
        }
    }
}

/// A preset of a register that is not saved is applied after the contacts have their levels. So an MD3 that
/// is ready by then does not step because of a closed contact.
#[test]
fn a_contact_that_is_closed_at_power_on_is_no_edge_to_a_drive_with_presets() {
    for fast in [true, false] {
        let mut built = built(&format!(
            "drive = [{{ name = 'a', kind = 'md3', fast_boot = {fast}, set = {{ QuadratureEncoderCount = 7 }} }}, \
             {{ name = 'm', kind = 'md3', address = 2, fast_boot = {fast}, set = {{ EncoderIndexCount = 8 }} }}, \
             {{ name = 'y', kind = 'md3', address = 3, fast_boot = {fast}, set = {{ QuadratureEncoderCount = 9 }} }}]\n\
             motor = [{{ name = 'shaft', drive = 'm' }}]\n\
             switch = [{{ motor = 'shaft', closed = {{ below_rev = 1 }}, to = 'a.J2.4' }}]\n\
             wire = [{{ from = 'm.STEP', to = 'y.J2.4' }}]\n"
        ));
        let bench = &mut built.bench;
        let registers = [
            ("a", "QuadratureEncoderCount", 7),
            ("m", "EncoderIndexCount", 8),
            ("y", "QuadratureEncoderCount", 9),
        ];
        for (name, row, value) in registers {
            assert_eq!(register(bench, seat(bench, name), row), value, "{name}, fast: {fast}");
        }
        bench.run_until(10.secs());
        for name in ["a", "y"] {
            let at = seat(bench, name);
            assert_eq!(
                moments(bench, &format!("{name} > pin J2.4 low")),
                [Instant::ZERO],
                "{name}, fast: {fast}"
            );
            assert_eq!(bench.motion(at, Axis(0)).position, 0, "{name}, fast: {fast}");
        }
        // The same holds after a power cycle. "m" is left out, because its power cycle would cause an edge.
        for (name, row, value) in [registers[0], registers[2]] {
            let at = seat(bench, name);
            bench.power(at, PowerAction::Cycle);
            bench.run_until(bench.now() + 10.secs());
            assert_eq!(register(bench, at, row), value, "{name}, fast: {fast}");
            assert_eq!(bench.motion(at, Axis(0)).position, 0, "{name}, fast: {fast}");
        }
        let make = |kind: &str| catalog::make(kind).ok();
        let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
        assert_eq!(replay::run(&trace, &make), Ok(None), "fast: {fast}");
    }
}

/// An MDROBOT with START_STOP closed at power-on reads it as closed before it is ready. DIR gets its level by
/// a wire from another drive.
#[test]
fn an_mdrobot_reads_its_contacts_at_power_on() {
    let built = built(
        "drive = [{ name = 'm', kind = 'md3', fast_boot = true }, { name = 'r', kind = 'mdrobot', fast_boot = true }]\n\
         motor = [{ name = 'shaft', drive = 'm' }]\n\
         switch = [{ motor = 'shaft', closed = { below_rev = 1 }, to = 'r.START_STOP' }]\n\
         encoder = [{ motor = 'shaft', cycles_per_rev = 100, to = { a = 'm.J2.10' } }]\n\
         wire = [{ from = 'm.STEP', to = 'r.DIR' }]\n",
    );
    let mut bench = built.bench;
    bench.run_until(1.millis());
    assert_eq!(moments(&bench, "r > pin START_STOP low"), [Instant::ZERO]);
    assert_eq!(moments(&bench, "r > pin DIR low"), [Instant::ZERO]);
    assert_eq!(moments(&bench, "m > pin J2.10 high"), [Instant::ZERO]);
}

/// Every fault takes a table, and a TCP port is a bus.
#[test]
fn faults_have_rules() {
    let text = "drive = [{name = 'z', kind = 'md3'}, {name = 'b', kind = 'md3', address = 2}, {name = 'm', kind = 'mdrive'}]\n\
        [[bus]]\nname = 'line1'\ndrives = ['z', 'b']\n\
        [[fault]]\nbus = 'line1'\n\
        drop = { count = 3, direction = 'reply', drive = 'z', function = 6, register = 'Speed' }\n\
        corrupt = { rate = 0.25 }\n\
        exception = { count = 1, code = 2 }\n\
        delay_ms = { ms = 5, spread_ms = 2.5, function = 3 }\n\
        mute = {}\n\
        [[fault]]\nbus = 'm.modbus'\nclose = { count = 1, register = 'A' }\nwrong_transaction = 0.5\n\
        [[fault]]\nbus = 'mcode'\ndrop = 1";
    let layout = layout(text);
    let built = layout.build(layout.settings(), Vec::new()).unwrap();
    let (bench, [z, _, m]) = (built.bench, built.drives[..].try_into().unwrap());
    let drop = FaultRule::next(3).direction(Direction::Reply).drive(z).function(6).register("Speed");
    let expected = LineFaults {
        drop,
        corrupt: FaultRule::rate(0.25),
        exception: FaultRule::next(1),
        exception_code: 2,
        delay: Duration::millis(5),
        delay_spread: Duration::micros(2_500),
        delayed: FaultRule::ALL.function(3),
        mute: FaultRule::ALL,
        ..LineFaults::NONE
    };
    assert_eq!(bench.faults(bench.find_outlet("line1").unwrap()), expected);
    let expected = LineFaults {
        close: FaultRule::next(1).register("A"),
        wrong_transaction: FaultRule::rate(0.5),
        ..LineFaults::NONE
    };
    assert_eq!(bench.faults(bench.outlet(m, Port(0))), expected);
    assert_eq!(
        bench.faults(bench.outlet(m, Port(1))),
        LineFaults { drop: FaultRule::ALL, ..LineFaults::NONE }
    );
}
