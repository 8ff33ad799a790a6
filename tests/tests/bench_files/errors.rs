//! Errors of bench files: messages and positions.

use drivetwin_sim::config::bench_file;

/// The error message for `text`.
#[track_caller]
fn wrong(text: &str) -> String {
    match bench_file::parse(text) {
        Ok(_) => panic!("nothing is wrong with {text:?}"),
        Err(error) => error.to_string(),
    }
}

/// Checks cases: texts that are added to `before`, each with its error message.
#[track_caller]
fn check(before: &str, cases: &[(&str, &str)]) {
    for (text, told) in cases {
        let text = format!("{before}{text}");
        assert_eq!(wrong(&text), *told, "{text}");
    }
}

#[test]
fn syntax_errors_of_toml() {
    check(
        "",
        &[
            (
                "a = ",
                "line 1, column 5: this is not TOML: string values must be quoted, expected literal string",
            ),
            ("# x\n[[drive\n", "line 2, column 8: this is not TOML: unclosed array table, expected `]]`"),
            ("seed = 1\nseed = 2\n", "line 2, column 1: this is not TOML: duplicate key"),
        ],
    );
}

#[test]
fn the_bench() {
    check(
        "",
        &[
            ("", "line 1, column 1: a bench needs a [[drive]]"),
            ("sed = 1", "line 1, column 1: there is no key of a bench file 'sed'; the nearest is 'seed'"),
            (
                "seed = -1",
                "line 1, column 8: seed takes a whole number from 0 to 18446744073709551615, not -1",
            ),
            (
                "seed = 18446744073709551616",
                "line 1, column 8: seed takes a whole number from 0 to 18446744073709551615, not 18446744073709551616",
            ),
            (
                "seed = 1.5",
                "line 1, column 8: seed takes a whole number from 0 to 18446744073709551615, not 1.5",
            ),
            ("\ntime = 'soon'", "line 2, column 8: time: it takes real, xN (N from 1 to 1000) or manual"),
            ("time = 2", "line 1, column 8: time takes a string, not 2"),
            ("line = 'slow'", "line 1, column 8: line takes timed or fast, not 'slow'"),
            ("[drive]\nname = 'x'", "line 1, column 1: drive is written [[drive]], above its keys"),
            ("drive = ['x']", "line 1, column 10: drive is written [[drive]], above its keys"),
        ],
    );
}

#[test]
fn drives() {
    check(
        "[[drive]]\n",
        &[
            ("kind = 'md3'", "line 1, column 1: [[drive]] needs 'name'"),
            ("name = 'x'", "line 1, column 1: [[drive]] needs 'kind'"),
            (
                "nam = 'x'\nkind = 'md3'",
                "line 2, column 1: there is no key of [[drive]] 'nam'; the nearest is 'name'",
            ),
            ("name = 'x'\nkind = 'md4'", "line 3, column 8: there is no kind 'md4'; the nearest is 'md3'"),
            (
                "name = 'x.1'\nkind = 'md3'",
                "line 2, column 8: 'x.1' is no name; a name is one word of letters, digits, - and _, \
                 does not begin with a digit and is not 'end'",
            ),
            ("name = 3", "line 2, column 8: name takes a string, not 3"),
            (
                "name = 'é'\nkind = 'md3'\n[[drive]]\nname = 'é'\nkind = 'md3'",
                "line 5, column 8: there is a drive 'é' already",
            ),
        ],
    );
    check(
        "[[drive]]\nname = 'x'\nkind = 'md3'\n",
        &[
            ("address = 0", "line 4, column 11: DeviceAddress takes 1 to 247, not 0"),
            ("address = '1'", "line 4, column 11: address takes a whole number, not a string"),
            ("nv = ''", "line 4, column 6: nv takes the name of a file"),
            ("nv = true", "line 4, column 6: nv takes a string, not true"),
            ("program = 'a.rsasm'", "line 4, column 11: md3 has no user programs"),
            ("fast_boot = 1", "line 4, column 13: fast_boot takes true or false, not 1"),
            (
                "set = { Sped = 1 }",
                "line 4, column 9: there is no register of md3 'Sped'; the nearest is 'Speed'",
            ),
            (
                "set = { Speed = 2.5 }",
                "line 4, column 17: Speed takes a whole number or a list of them, not 2.5",
            ),
            ("set = { SpeedHigh = 65536 }", "line 4, column 21: SpeedHigh takes 0 to 65535, not 65536"),
            (
                "set = { MotionControl = 1 }",
                "line 4, column 25: only bit 5 of MotionControl can be preset; 1 has other bits",
            ),
            (
                "set = { DeviceAddress = 2 }\naddress = 1",
                "line 4, column 9: DeviceAddress is set by 'address' already",
            ),
            ("set = 5", "line 4, column 7: set takes a table, like { … }, not 5"),
            (
                "faults = ['over_temprature']",
                "line 4, column 11: there is no fault of md3 'over_temprature'; the nearest is 'over_temperature'",
            ),
            ("faults = 'stall'", "line 4, column 10: faults takes a list of strings, not a string"),
            ("listen = [3]", "line 4, column 11: listen takes a list of strings, and 3 is not one"),
            (
                "listen = ['udp:1']",
                "line 4, column 11: cannot listen at 'udp:1': it takes pty:, pty:LINK, tcp:HOST:PORT, \
                 rfc2217:HOST:PORT, serial:DEVICE or stdio:",
            ),
            (
                "listen = ['rfc2217://127.0.0.1:1']",
                "line 4, column 11: cannot listen at 'rfc2217://127.0.0.1:1': rfc2217: takes HOST:PORT, like \
                 rfc2217:127.0.0.1:5020 (port 0: any free one)",
            ),
            (
                "listen = ['pty:', 'rs458=pty:']",
                "line 4, column 19: there is no port of md3 'rs458'; the nearest is 'rs485'",
            ),
            ("listen = ['pty:a', 'pty:./a']", "line 4, column 20: pty:./a is given twice"),
            (
                "listen = ['tcp:127.0.0.1:1', 'tcp:127.0.0.1:1']",
                "line 4, column 30: tcp:127.0.0.1:1 is given twice",
            ),
            (
                "listen = ['rfc2217:127.0.0.1:1', 'rfc2217:127.0.0.1:1']",
                "line 4, column 34: rfc2217:127.0.0.1:1 is given twice",
            ),
            ("listen = ['stdio:', 'stdio:']", "line 4, column 21: stdio: is given twice"),
            (
                "nv = 'x.nv'\n[[drive]]\nname = 'y'\nkind = 'md3'\nnv = './x.nv'",
                "line 8, column 6: ./x.nv is already the memory of another drive; use another file",
            ),
        ],
    );
    check(
        "[[drive]]\nname = 'q'\nkind = 'qsb-m'\n",
        &[
            ("address = 1", "line 4, column 11: qsb-m has no bus address"),
            (
                "set = { Version = 1 }",
                "line 4, column 19: Version cannot be preset: the drive sets it itself",
            ),
        ],
    );
}

/// Three drives in the first line of a file.
const DRIVES: &str =
    "drive = [{name = 'x', kind = 'md3'}, {name = 'q', kind = 'qsb-m'}, {name = 'r', kind = 'rs434544'}]\n";

/// A board keeps what it is (BENCH-22), and its wires are of copper (BENCH-24).
#[test]
fn boards() {
    let board = "[[drive]]\nname = 'b'\nboard = 'usb:E661'\n";
    check(
        board,
        &[
            ("kind = 'mdd3'", "line 4, column 8: there is no kind 'mdd3'; the nearest is 'md3'"),
            (
                "address = 2",
                "line 4, column 1: 'b' is on a board and takes no 'address': it has the address that it has saved; a master or the control API sets another one",
            ),
            (
                "nv = 'b.nv'",
                "line 4, column 1: 'b' is on a board and takes no 'nv': it has its memory in its flash; the control API reads and replaces it",
            ),
            (
                "set = { Speed = 1 }",
                "line 4, column 1: 'b' is on a board and takes no 'set': it has the registers that it has saved; a master or the control API sets them",
            ),
            (
                "program = 'x.rsasm'",
                "line 4, column 1: 'b' is on a board and takes no 'program': it has its memory in its flash; the control API reads and replaces it",
            ),
            (
                "fast_boot = true",
                "line 4, column 1: 'b' is on a board and takes no 'fast_boot': its image has a start-up delay, or has none",
            ),
            (
                "listen = []",
                "line 4, column 1: 'b' is on a board and takes no 'listen': its line is a real one; 'bus' is the address at which masters open it",
            ),
            (
                "faults = []",
                "line 4, column 1: 'b' is on a board and takes no 'faults': a run does not change it at its start; the control API sets faults",
            ),
            (
                "bus = 'pty:x'",
                "line 4, column 7: bus: pty:x is not where the bus of a board can be; it takes serial:DEVICE, tcp:HOST:PORT or rfc2217:HOST:PORT",
            ),
            (
                "[[drive]]\nname = 'c'\nboard = 'usb:E661'",
                "line 6, column 9: usb:E661 is already the board of 'b'; a board is one drive",
            ),
            (
                "[[bus]]\nname = 'l'\ndrives = ['b']",
                "line 6, column 11: 'b' is on a board: the line of a board is a real one, which a master opens by itself",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'b'",
                "line 6, column 9: 'b' is on a board: a board turns a real motor",
            ),
            (
                "[[fault]]\nbus = 'b.rs485'\ndrop = 1",
                "line 5, column 7: 'b' is on a board: the line of a board is a real one, so drivetwin cannot put faults on it; use an emulated drive",
            ),
            (
                "[[scenario]]\nsteps = [{ at_s = 1, drive = 'b', power = 'off' }]",
                "line 5, column 30: 'b' is on a board: a scenario is played by a bench, and not on a board; switch pins, faults and power from the test",
            ),
        ],
    );
    let both = format!("{board}kind = 'md3'\n[[drive]]\nname = 'x'\nkind = 'md3'\n");
    let copper = "the pins of a board are real, and so are their wires: connect them with copper, or set them by the control API";
    for (text, place) in [
        ("[[wire]]\nfrom = 'b.J3.7'\nto = 'x.J2.2'", "line 9, column 8"),
        ("[[wire]]\nfrom = 'x.J3.7'\nto = 'b.J2.2'", "line 10, column 6"),
        (
            "[[motor]]\nname = 'm'\ndrive = 'x'\n[[switch]]\nmotor = 'm'\nclosed = { above_rev = 1 }\nto = 'b.J2.2'",
            "line 14, column 6",
        ),
        ("[[scenario]]\nsteps = [{ at_s = 1, pin = 'b.J2.2', level = 'low' }]", "line 9, column 28"),
    ] {
        assert_eq!(
            wrong(&format!("{both}{text}")),
            format!("{place}: 'b' is on a board: {copper}"),
            "{text}"
        );
    }
    check(
        "",
        &[
            (
                "[[drive]]\nname = 'b'\nboard = ''",
                "line 3, column 9: there is no board at '': it takes the path of a serial port, usb:SERIAL or tcp:HOST:PORT",
            ),
            (
                "[[drive]]\nname = 'b'\nboard = 'usb'",
                "line 3, column 9: there is no board at 'usb': it needs the USB serial number of the board, usb:SERIAL",
            ),
            (
                "[[drive]]\nname = 'x'\nkind = 'md3'\nbus = 'line1'",
                "line 4, column 1: bus is a key of a drive on a board, and 'x' has no 'board'",
            ),
            (
                "time = 'manual'\n[[drive]]\nname = 'b'\nboard = 'usb:E661'",
                "line 1, column 8: time cannot be 'manual', because 'b' is on a board: a board has no virtual time: its clock goes on by itself",
            ),
            (
                "[[drive]]\nname = 'b'\nboard = 'usb:E661'\n[[drive]]\nname = 'c'",
                "line 4, column 1: [[drive]] needs 'kind'",
            ),
        ],
    );
}

#[test]
fn buses() {
    check(
        DRIVES,
        &[
            ("[[bus]]\nname = 'b'", "line 2, column 1: [[bus]] needs 'drives'"),
            ("[[bus]]\nname = 'x'\ndrives = ['x']", "line 3, column 8: there is a drive 'x' already"),
            ("[[bus]]\nname = 'b'\ndrives = []", "line 4, column 10: list at least one drive of the bus"),
            (
                "[[bus]]\nname = 'b'\ndrives = ['x', 'z']",
                "line 4, column 16: there is no drive 'z'; the nearest is 'x'",
            ),
            ("[[bus]]\nname = 'b'\ndrives = ['x', 'q']", "line 4, column 16: qsb-m has no port for a bus"),
            (
                "[[bus]]\nname = 'b'\ndrives = ['q.usb']",
                "line 4, column 11: usb of qsb-m is not a port for a bus",
            ),
            (
                "[[bus]]\nname = 'b'\ndrives = ['x.rs422']",
                "line 4, column 11: there is no port of md3 'rs422'; the nearest is 'rs485'",
            ),
            (
                "[[bus]]\nname = 'b'\ndrives = ['x', 'x.rs485']",
                "line 4, column 16: rs485 of x is on this bus already",
            ),
            (
                "[[bus]]\nname = 'b'\ndrives = ['x']\n[[bus]]\nname = 'c'\ndrives = ['r', 'x']",
                "line 7, column 16: rs485 of x is on the bus 'b' already",
            ),
            (
                "[[bus]]\nname = 'b'\ndrives = ['x']\ncollisions = 'yes'",
                "line 5, column 14: collisions takes true or false, not a string",
            ),
            (
                "[[bus]]\nname = 'b'\ndrives = ['x']\nlisten = ['rs485=pty:']",
                "line 5, column 11: a bus has no ports; leave out 'rs485='",
            ),
            (
                "[[bus]]\nname = 'b'\ndrives = ['x']\nlisten = ['pty:a']\n\
                 [[bus]]\nname = 'c'\ndrives = ['r']\nlisten = ['pty:a']",
                "line 9, column 11: pty:a is given twice",
            ),
        ],
    );
    check(
        "[[drive]]\nname = 'x'\nkind = 'md3'\nlisten = ['pty:']\n",
        &[(
            "[[bus]]\nname = 'b'\ndrives = ['x']",
            "line 7, column 11: rs485 of x is on a bus, so its listen is in the [[bus]] 'b'",
        )],
    );
}

#[test]
fn motors() {
    check(
        DRIVES,
        &[
            ("[[motor]]\ndrive = 'x'", "line 2, column 1: [[motor]] needs 'name'"),
            ("[[motor]]\nname = 'm'", "line 2, column 1: [[motor]] needs 'drive'"),
            (
                "[[motor]]\nname = 'm'\ndrive = 'y'",
                "line 4, column 9: there is no drive 'y'; the nearest is 'x'",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'x'\n[[motor]]\nname = 'n'\ndrive = 'x'",
                "line 7, column 9: 'x' turns the motor 'm' already",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'x'\nsupply_v = 24\nsteps_per_rev = 200",
                "line 6, column 1: steps_per_rev is a key of a stepper motor; supply_v is a key of a brush motor",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'x'\nhall_pulses = 4",
                "line 5, column 1: hall_pulses is a key of a motor with Hall sensors; md3 has no pins for them",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'x'\npoles = 4",
                "line 5, column 1: poles is a key of a brushless motor; md3 turns a stepper or a brush motor",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'x'\nsteps_per_rev = 3",
                "line 5, column 17: steps_per_rev takes a whole number from 4 to 10000, not 3",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'x'\nholding_mnm = -0.5",
                "line 5, column 15: holding_mnm takes a number from 0 to 100000, not -0.5",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'x'\nload_mnm = nan",
                "line 5, column 12: load_mnm takes a number from -100000 to 100000, not nan",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'x'\ninertia_gcm = 3",
                "line 5, column 1: there is no key of [[motor]] 'inertia_gcm'; the nearest is 'inertia_gcm2'",
            ),
        ],
    );
    // Bit 13 selects the motor mode (MD3 User Guide, 7.2).
    let dc = "drive = [{name = 'x', kind = 'md3', set = {MotorCurrentAndMicrostepping = 0x250a}}]\n";
    let says = "line 5, column 1: rated_ma is a key of a stepper motor; MotorCurrentAndMicrostepping of 'x' selects a brush motor";
    check(dc, &[("[[motor]]\nname = 'm'\ndrive = 'x'\nrated_ma = 1000", says)]);
    let encoder = "drive = [{name = 'e', kind = 'qsb-d'}]\n";
    check(encoder, &[("[[motor]]\nname = 'm'\ndrive = 'e'", "line 4, column 9: qsb-d turns no motor")]);
}

#[test]
fn brush_motors() {
    check(
        DRIVES,
        &[
            (
                "[[motor]]\nname = 'm'\ndrive = 'r'\nno_load_rpm = 3000\nsteps_per_rev = 200",
                "line 6, column 1: steps_per_rev is a key of a stepper motor; rs434544 turns a brush motor",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'r'\nsupply_v = 0",
                "line 5, column 12: supply_v takes a number from 0.001 to 100, not 0",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'r'\npoles = 4",
                "line 5, column 1: poles is a key of a brushless motor; rs434544 turns a brush motor",
            ),
        ],
    );
}

#[test]
fn brushless_motors() {
    check(
        "drive = [{name = 'd', kind = 'mdrobot'}]\n",
        &[
            (
                "[[motor]]\nname = 'm'\ndrive = 'd'\nhall_pulses = 2",
                "line 5, column 1: hall_pulses is a key of a brush motor; mdrobot turns a brushless motor",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'd'\nsupply_v = 24\nrated_ma = 1",
                "line 6, column 1: rated_ma is a key of a stepper motor; mdrobot turns a brushless motor",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'd'\npoles = 7",
                "line 5, column 9: poles takes an even number, not 7",
            ),
            (
                "[[motor]]\nname = 'm'\ndrive = 'd'\npoles = 0",
                "line 5, column 9: poles takes a whole number from 2 to 2000, not 0",
            ),
        ],
    );
    let fed = "drive = [{name = 'd', kind = 'mdrobot', set = {VOLT_IN = 240}}]\n";
    let motor = "[[motor]]\nname = 'm'\ndrive = 'd'\nsupply_v = 24";
    check(fed, &[(motor, "line 5, column 1: VOLT_IN of 'd' sets the same as supply_v; use one of them")]);
}

#[test]
fn what_is_on_a_shaft() {
    let motor = format!("{DRIVES}motor = [{{name = 'm', drive = 'x'}}]\n");
    check(
        &motor,
        &[
            ("[[encoder]]\ncycles_per_rev = 1", "line 3, column 1: [[encoder]] needs 'motor'"),
            (
                "[[encoder]]\nmotor = 'n'\ncycles_per_rev = 1\nto = { a = 'q.A' }",
                "line 4, column 9: there is no motor 'n'; the nearest is 'm'",
            ),
            (
                "[[encoder]]\nmotor = 'm'\ncycles_per_rev = 0\nto = { a = 'q.A' }",
                "line 5, column 18: cycles_per_rev takes a whole number from 1 to 100000, not 0",
            ),
            ("[[encoder]]\nmotor = 'm'\ncycles_per_rev = 1", "line 3, column 1: [[encoder]] needs 'to'"),
            (
                "[[encoder]]\nmotor = 'm'\ncycles_per_rev = 1\nto = { a = 'q.A', b = 'q.A' }",
                "line 6, column 23: 'q.A' has 'a' of this encoder already",
            ),
            (
                "[[encoder]]\nmotor = 'm'\ncycles_per_rev = 1\nto = {}",
                "line 6, column 6: to takes a, b, index or some of them",
            ),
            (
                "[[encoder]]\nmotor = 'm'\ncycles_per_rev = 1\nto = { i = 'q.I' }",
                "line 6, column 8: there is no key of to 'i'; the nearest is 'a'",
            ),
            (
                "[[encoder]]\nmotor = 'm'\ncycles_per_rev = 1\nto = { a = 'x.STEP' }",
                "line 6, column 12: 'x.STEP' is an output; an input is wanted here",
            ),
            ("[[switch]]\nmotor = 'm'\nto = 'x.J2.2'", "line 3, column 1: [[switch]] needs 'closed'"),
            (
                "[[switch]]\nmotor = 'm'\nclosed = {}\nto = 'x.J2.2'",
                "line 5, column 10: closed takes above_rev, below_rev or both",
            ),
            (
                "[[switch]]\nmotor = 'm'\nclosed = { above_rev = 2, below_rev = -2.5 }\nto = 'x.J2.2'",
                "line 5, column 10: above 2 and below -2.5 is nowhere; two ranges are two switches",
            ),
            (
                "[[switch]]\nmotor = 'm'\nclosed = { below_rev = inf }\nto = 'x.J2.2'",
                "line 5, column 24: below_rev takes a number from -10000000 to 10000000, not inf",
            ),
            (
                "[[switch]]\nmotor = 'm'\nclosed = { below_rev = 1 }\nto = 'x.D5'",
                "line 6, column 6: 'x.D5' is a light; an input is wanted here",
            ),
        ],
    );
}

#[test]
fn wires() {
    check(
        &format!("{DRIVES}[[wire]]\n"),
        &[
            ("to = 'x.J2.4'", "line 2, column 1: [[wire]] needs 'from'"),
            ("from = 'q.DIO1'", "line 2, column 1: [[wire]] needs 'to'"),
            (
                "from = 'q.DIO1'\nto = 'x.J2.44'",
                "line 4, column 6: there is no pin of md3 'J2.44'; the nearest is 'J2.4'",
            ),
            (
                "from = 'q.DIO1'\nto = 'J2'",
                "line 4, column 6: 'J2' is not a pin; write drive and pin, like x.J2.2",
            ),
            ("from = 'y.DIO1'\nto = 'x.J2.4'", "line 3, column 8: there is no drive 'y'; the nearest is 'x'"),
            (
                "from = 'x.J2.2'\nto = 'x.J2.4'",
                "line 3, column 8: 'x.J2.2' is an input; an output is wanted here",
            ),
            (
                "from = 'q.DIO1'\nto = 'x.DIR'",
                "line 4, column 6: 'x.DIR' is an output; an input is wanted here",
            ),
            ("from = 'x.J2.9'\nto = 'x.J2.9'", "line 4, column 6: 'x.J2.9' is wired to itself"),
            (
                "from = 'q.DIO1'\nto = 'x.J2.4'\n[[wire]]\nto = 'x.J2.4'\nfrom = 'q.DIO1'",
                "line 7, column 8: 'q.DIO1' is wired to 'x.J2.4' already",
            ),
        ],
    );
}

#[test]
fn faults_of_lines() {
    check(
        &format!("{DRIVES}[[fault]]\n"),
        &[
            ("drop = 0.5", "line 2, column 1: [[fault]] needs 'bus'"),
            ("bus = 'x.rs422'", "line 3, column 7: there is no port of md3 'rs422'; the nearest is 'rs485'"),
            (
                "bus = 'line1'",
                "line 3, column 7: there is no bus 'line1'; available: x.rs485, q.usb, r.rs485",
            ),
            ("bus = 'rs485'", "line 3, column 7: several drives have a port 'rs485'; 'x.rs485' is one"),
            ("bus = 'usb'\ndrop = 1.1", "line 4, column 8: drop takes a number from 0 to 1, not 1.1"),
            (
                "bus = 'x.rs485'\nexception_code = 0",
                "line 4, column 18: exception_code takes a whole number from 1 to 255, not 0",
            ),
            (
                "bus = 'x.rs485'\ndelay_ms = 60001",
                "line 4, column 12: delay_ms takes a number from 0 to 60000, not 60001",
            ),
            (
                "bus = 'x.rs485'\nbaud = 0",
                "line 4, column 8: baud takes a whole number from 50 to 4000000, not 0",
            ),
            (
                "bus = 'usb'\nexception = 0.1",
                "line 4, column 1: exception is for Modbus lines only, and usb is not one",
            ),
            ("bus = 'usb'\n[[fault]]\nbus = 'q.usb'", "line 5, column 7: 'q.usb' has a [[fault]] already"),
            (
                "bus = 'x.rs485'\n[[bus]]\nname = 'b'\ndrives = ['x']",
                "line 3, column 7: x.rs485 is on the bus 'b'",
            ),
        ],
    );
}

#[test]
fn rules_of_faults() {
    let drives = "drive = [{name = 'x', kind = 'md3'}, {name = 'y', kind = 'md3-low'}, \
         {name = 'q', kind = 'qsb-m'}, {name = 'm', kind = 'mdrive'}]\n\
         [[bus]]\nname = 'line1'\ndrives = ['x', 'y']\n[[fault]]\n";
    check(
        drives,
        &[
            (
                "bus = 'line1'\ndrop = { rate = 0.5, count = 1 }",
                "line 7, column 30: a fault takes rate or count, not both",
            ),
            (
                "bus = 'line1'\ndrop = { count = -1 }",
                "line 7, column 18: count takes a whole number from 0 to 4294967295, not -1",
            ),
            (
                "bus = 'line1'\ndrop = { rat = 0.5 }",
                "line 7, column 10: there is no key of drop 'rat'; the nearest is 'rate'",
            ),
            (
                "bus = 'line1'\ndrop = { code = 4 }",
                "line 7, column 10: there is no key of drop 'code'; available: rate, count, direction, drive, function, register",
            ),
            (
                "bus = 'line1'\ndrop = { direction = 'answer' }",
                "line 7, column 22: direction takes request or reply, not 'answer'",
            ),
            (
                "bus = 'line1'\ndrop = { drive = 'q' }",
                "line 7, column 18: there is no drive 'q' on this bus; the nearest is 'x'",
            ),
            (
                "bus = 'line1'\ndrop = { register = 'Sped' }",
                "line 7, column 21: there is no register 'Sped' on this bus, with the drives x, y; the nearest is 'Speed'",
            ),
            (
                "bus = 'line1'\ndrop = { register = 'SpeedLow' }",
                "line 7, column 21: register takes a whole register: Speed, not SpeedLow",
            ),
            (
                "bus = 'line1'\ndrop = { function = 200 }",
                "line 7, column 21: function takes a whole number from 1 to 127, not 200",
            ),
            (
                "bus = 'usb'\ndrop = { function = 3 }",
                "line 7, column 1: function of drop is for Modbus lines only, and usb is not one",
            ),
            ("bus = 'line1'\ndelay_ms = { spread_ms = 3 }", "line 7, column 12: delay_ms needs 'ms'"),
            (
                "bus = 'line1'\ndelay_ms = { ms = 59_999, spread_ms = 3 }",
                "line 7, column 39: spread_ms takes a number from 0 to 1, not 3",
            ),
            (
                "bus = 'line1'\nmute = { direction = 'request' }",
                "line 5, column 1: mute is for replies only; leave out direction = 'request'",
            ),
            (
                "bus = 'line1'\nclose = 0.1",
                "line 7, column 1: close is for TCP ports only, and rs485 is a serial line",
            ),
            (
                "bus = 'm.mcode'\nexception = { count = 1 }",
                "line 7, column 1: exception is for Modbus lines only, and mcode is not one",
            ),
            (
                "bus = 'modbus'\nbaud = 9_600",
                "line 7, column 1: baud is for serial lines only, and modbus is a TCP port",
            ),
            ("bus = 'm.mcod'", "line 6, column 7: there is no port of mdrive 'mcod'; the nearest is 'mcode'"),
        ],
    );
}

#[test]
fn scenarios() {
    let drives = "drive = [{name = 'x', kind = 'md3'}, {name = 'q', kind = 'qsb-m'}, {name = 'm', kind = 'mdrive'}]\n\
         [[scenario]]\n";
    check(
        drives,
        &[("step = []", "line 3, column 1: there is no key of [[scenario]] 'step'; the nearest is 'steps'")],
    );
    check(
        drives,
        &[
            ("steps = []", "line 2, column 1: a scenario needs a step"),
            ("steps = 3", "line 3, column 9: steps takes a list of tables, like [{ … }], not 3"),
        ],
    );
    let step = format!("{drives}steps = [\n");
    check(
        &step,
        &[
            (
                "{ at_s = 1 }]",
                "line 4, column 1: a step needs an action: faults, fault, clear, power, level, volts, pulses",
            ),
            (
                "{ after_m = 1, drive = 'x', power = 'off' }]",
                "line 4, column 3: there is no key of a step 'after_m'; the nearest is 'after_ms'",
            ),
            (
                "{ at_s = -1, drive = 'x', power = 'off' }]",
                "line 4, column 10: at_s takes a number from 0 to 1000000000, not -1",
            ),
            (
                "{ at_s = 5, after_ms = 500, drive = 'x', power = 'off' },\n{ at_s = 5.4, drive = 'x', power = 'on' }]",
                "line 5, column 10: at_s = 5.4 is before the step above, which is at 5.5 s",
            ),
            (
                "{ at_s = 5, when = { drive = 'x', register = 'Speed' }, drive = 'x', power = 'off' }]",
                "line 4, column 10: a step takes at_s or when, not both",
            ),
            (
                "{ drive = 'y', power = 'off' }]",
                "line 4, column 11: there is no drive 'y'; the nearest is 'x'",
            ),
            (
                "{ drive = 'x', power = 'of' }]",
                "line 4, column 24: power takes off, on, cycle or cut, not 'of'",
            ),
            ("{ power = 'off' }]", "line 4, column 1: a step needs 'drive'"),
            (
                "{ drive = 'x', power = 'off', fault = 'over_current' }]",
                "line 4, column 31: a step with 'power' takes no 'fault'",
            ),
            (
                "{ drive = 'x', fault = 'over_heat' }]",
                "line 4, column 24: there is no fault of md3 'over_heat'; available: over_temperature, over_current",
            ),
            (
                "{ pin = 'x.J2.1', level = 'low' }]",
                "line 4, column 9: there is no pin of md3 'J2.1'; the nearest is 'J2.2'",
            ),
            (
                "{ pin = 'x.STEP', level = 'low' }]",
                "line 4, column 9: 'x.STEP' is an output; an input is wanted here",
            ),
            (
                "{ pin = 'x.J2.2', level = 'up' }]",
                "line 4, column 27: level takes low, high or open, not 'up'",
            ),
            ("{ pin = 'x.J2.2', volts = 3 }]", "line 4, column 19: x.J2.2 takes a level, not volts"),
            ("{ pin = 'x.J2.2', pulses = 3 }]", "line 4, column 1: a step needs 'hz'"),
            (
                "{ bus = 'x.rs422', faults = { drop = 1 } }]",
                "line 4, column 9: there is no port of md3 'rs422'; the nearest is 'rs485'",
            ),
            (
                "{ bus = 'rs485', faults = { drip = 1 } }]",
                "line 4, column 29: there is no key of faults 'drip'; the nearest is 'drop'",
            ),
            (
                "{ bus = 'rs485', faults = { close = 1 } }]",
                "line 4, column 29: close is for TCP ports only, and rs485 is a serial line",
            ),
            (
                "{ when = { drive = 'x', register = 'Sped' }, drive = 'x', power = 'off' }]",
                "line 4, column 36: there is no register 'Sped' of md3 that a master writes; the nearest is 'Speed'",
            ),
            (
                "{ when = { drive = 'x', register = 'ProductInformation' }, drive = 'x', power = 'off' }]",
                "line 4, column 36: no master writes ProductInformation of md3",
            ),
            (
                "{ when = { drive = 'x', register = 'SpeedLow' }, drive = 'x', power = 'off' }]",
                "line 4, column 36: register takes a whole register: Speed, not SpeedLow",
            ),
            (
                "{ when = { drive = 'x', register = 'DeviceAddress', value = 300 }, drive = 'x', power = 'off' }]",
                "line 4, column 61: DeviceAddress never has the value 300: it takes 1 to 247",
            ),
            (
                "{ when = { drive = 'x', register = 'Speed', value = 9_000_000_000 }, drive = 'x', power = 'off' }]",
                "line 4, column 53: Speed never has the value 9000000000: it takes -2147483648 to 2147483647",
            ),
            (
                "{ when = { drive = 'z', register = 'Speed' }, drive = 'x', power = 'off' }]",
                "line 4, column 20: there is no drive 'z'; the nearest is 'x'",
            ),
            (
                "{ when = { drive = 'x' }, drive = 'x', power = 'off' }]",
                "line 4, column 10: when needs 'register'",
            ),
        ],
    );
}
