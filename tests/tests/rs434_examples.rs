//! The user programs in `examples/`, each on a drive with a motor, and what
//! `docs/reference/rs434-programs.md` says about the language.

use drivetwin_firmware::device::{Device, Instant};
use drivetwin_firmware::rs434::Rs434;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, DriveId, PinStimulus, Setup};
use drivetwin_sim::rsasm::{self, Image};

const IN1: &str = "IN1";
const HARD_STOP: &str = "HARD_STOP";

/// Values of STATUS (6.3).
const STOPPED: i64 = 0;
const FORWARD: i64 = 1;
const BACKWARD: i64 = 2;
/// Values of STATUS_USER_PROGRAM (6.3).
const RUNS: i64 = 4;
const ENDED: i64 = 5;
const FULLY_ENDED: i64 = 6;

/// A drive that starts a program at power-on.
struct Rig {
    bench: Bench,
    seat: DriveId,
}

impl Rig {
    fn new(source: &str) -> Self {
        let program = rsasm::assemble(source).unwrap_or_else(|error| panic!("{error}"));
        let drive = Rs434::rs434544();
        let autostart = drive.spec().find("MODE_USER_PROGRAM").unwrap().row;
        let memory = Some(Image::of(&program).memory());
        let setup = Setup { memory, presets: vec![(autostart, 3)], ..Setup::default() };
        let mut bench = Bench::new();
        let seat = bench.add_with("x", Box::new(drive), setup).unwrap();
        Self { bench, seat }
    }

    fn get(&self, register: &str) -> i64 {
        self.bench.peek(self.seat, self.bench.spec(self.seat).find(register).unwrap().row)
    }

    fn contact(&mut self, name: &str, driving: PinStimulus) {
        let pin = self.bench.spec(self.seat).pin(name).unwrap();
        self.bench.set_pin(self.seat, pin, driving);
    }

    fn after(&mut self, span: Duration) {
        self.bench.run_until(self.bench.now() + span);
    }

    /// Runs until STATUS has this value, for at most `patience`. Returns the time of the change.
    #[track_caller]
    fn until_status(&mut self, status: i64, patience: Duration) -> Instant {
        let end = self.bench.now() + patience;
        while self.get("STATUS") != status {
            assert!(self.bench.now() < end, "STATUS is {}, not {status}", self.get("STATUS"));
            self.after(100.micros());
        }
        self.bench.now()
    }

    /// Presses or releases a button at IN1, which bounces for 5 ms.
    fn button(&mut self, to: PinStimulus) {
        let from = if to == PinStimulus::Low { PinStimulus::Open } else { PinStimulus::Low };
        for driving in [to, from, to, from, to] {
            self.contact(IN1, driving);
            self.after(1.millis());
        }
    }
}

#[test]
fn positioning_goes_out_and_home_at_each_press() {
    let mut rig = Rig::new(include_str!("../../examples/positioning.rsasm"));
    rig.after(1.secs());
    assert_eq!(
        (rig.get("STATUS_USER_PROGRAM"), rig.get("STATUS"), rig.get("CURRENT_POSITION")),
        (RUNS, STOPPED, 0)
    );

    for parts in 1..=3 {
        let pressed = rig.bench.now();
        rig.button(PinStimulus::Low);
        assert_eq!(rig.get("STATUS"), FORWARD, "the first contact starts it");
        // 20 turns at 25 turns/s, and a ramp. The tolerance of some 10 ms covers the current program line and
        // settling.
        let out = rig.until_status(STOPPED, 2.secs());
        let took = out.since(pressed);
        assert!((800.millis()..900.millis()).contains(&took), "{took:?}");
        assert_eq!((rig.get("CURRENT_POSITION"), rig.get("TARGET_POSITION")), (320, 320));

        let back = rig.until_status(BACKWARD, 300.millis());
        let pause = back.since(out);
        assert!((250.millis()..255.millis()).contains(&pause), "{pause:?}");
        rig.until_status(STOPPED, 2.secs());
        rig.after(10.millis());
        assert_eq!((rig.get("CURRENT_POSITION"), rig.get("CX_REG")), (0, parts));

        // Neither holding the button nor releasing it is a press.
        rig.after(1.secs());
        rig.button(PinStimulus::Open);
        rig.after(1.secs());
        assert_eq!((rig.get("STATUS"), rig.get("CURRENT_POSITION"), rig.get("CX_REG")), (STOPPED, 0, parts));
    }

    // HARD_STOP during a move ends the program.
    rig.button(PinStimulus::Low);
    rig.after(200.millis());
    rig.contact(HARD_STOP, PinStimulus::High);
    rig.until_status(STOPPED, 1.secs());
    rig.after(10.millis());
    assert_eq!((rig.get("STATUS_USER_PROGRAM"), rig.get("ERROR") & 1 << 5), (ENDED, 1 << 5));
    assert!((1..320).contains(&rig.get("CURRENT_POSITION")));
}

/// HARD_STOP opens while the feeder is at rest, at home or out. A part counts only if the feeder went out and
/// came back for it.
#[test]
fn positioning_counts_no_part_when_hard_stop_is_open() {
    for opens_at in [0, 320] {
        let mut rig = Rig::new(include_str!("../../examples/positioning.rsasm"));
        rig.after(1.secs());
        // Feeds one part first, so that the registers are those of a working feeder.
        rig.button(PinStimulus::Low);
        rig.after(3.secs());
        rig.button(PinStimulus::Open);
        rig.after(100.millis());
        assert_eq!((rig.get("STATUS_USER_PROGRAM"), rig.get("CX_REG")), (RUNS, 1));

        if opens_at == 0 {
            rig.contact(HARD_STOP, PinStimulus::High);
            rig.button(PinStimulus::Low);
        } else {
            rig.button(PinStimulus::Low);
            rig.until_status(STOPPED, 2.secs());
            rig.contact(HARD_STOP, PinStimulus::High);
        }
        rig.after(3.secs());
        let registers = ["STATUS_USER_PROGRAM", "STATUS", "CX_REG", "CURRENT_POSITION"];
        assert_eq!(registers.map(|name| rig.get(name)), [ENDED, STOPPED, 1, opens_at]);
        assert_eq!(rig.get("ERROR"), 1 << 5);
    }
}

#[test]
fn the_speed_profile_climbs_and_descends_both_ways() {
    let mut rig = Rig::new(include_str!("../../examples/speed-profile.rsasm"));
    for status in [FORWARD, BACKWARD] {
        let before = rig.get("CURRENT_POSITION");
        let start = rig.until_status(status, 1.secs());
        // Reads the speed in the middle of each half second.
        for (n, rpm) in (0..).zip([500, 750, 1_000, 1_250, 1_500, 1_500, 1_500, 1_250, 1_000, 750, 500]) {
            rig.bench.run_until(start + 250.millis() + 500.millis() * n);
            let speed = rig.get("SPEED_VALID");
            assert!((speed - rpm).abs() <= rpm / 25, "{speed} instead of {rpm} rpm at step {n}");
            assert_eq!((rig.get("STATUS"), rig.get("STATUS_USER_PROGRAM")), (status, RUNS));
        }
        let end = rig.until_status(STOPPED, 1.secs());
        let took = end.since(start);
        assert!((5_500.millis()..5_700.millis()).contains(&took), "{took:?}");
        // The speeds add up to 11,500 rpm, each for half a second, at 16 counts per turn.
        let counts = 11_500 * 16 / 120;
        let moved = (rig.get("CURRENT_POSITION") - before).abs();
        assert!((moved - counts).abs() <= counts / 50, "{moved} counts");
    }
    rig.after(10.millis());
    // The program has restored the factory settings.
    let settings = ["STATUS_USER_PROGRAM", "PC_REG", "SPEED", "ACC", "DIRECTION"].map(|name| rig.get(name));
    assert_eq!(settings, [FULLY_ENDED, 0, 1_000, 100, 1]);
    assert_eq!(rig.get("ERROR"), 0);
}

const LANGUAGE: &str = include_str!("../../docs/reference/rs434-programs.md");

#[test]
fn examples_of_the_language_reference_assemble() {
    let blocks: Vec<&str> = LANGUAGE.split("```").skip(1).step_by(2).collect();
    let programs: Vec<&str> = blocks.iter().filter_map(|block| block.strip_prefix("text\n")).collect();
    assert_eq!(programs.len(), 2);
    for program in programs {
        rsasm::assemble(program).unwrap_or_else(|error| panic!("{error}\n{program}"));
    }
    // The last cell of each table row has examples in backticks.
    let cells = LANGUAGE.lines().filter_map(|line| line.strip_suffix(" |")?.rsplit(" | ").next());
    let examples: Vec<&str> = cells.flat_map(|cell| cell.split('`').skip(1).step_by(2)).collect();
    assert!(examples.len() > 15, "{examples:?}");
    for example in examples {
        let program = format!("wait: move: {example}\ndone:");
        rsasm::assemble(&program).unwrap_or_else(|error| panic!("{error}\n{program}"));
    }
}

#[test]
fn comparisons_have_no_sign_unless_both_sides_are_moved() {
    let less = |moved: &str| {
        let source = format!(
            "dmov_sysreg_const gx, -1\n dmov_sysreg_const ix, 1000\n {moved}
            djmp_gx_less_ix less\n stop_program
            less: mov_sysreg_const ax, 1\n stop_program"
        );
        let mut rig = Rig::new(&source);
        rig.after(1.secs());
        assert_eq!(rig.get("STATUS_USER_PROGRAM"), ENDED);
        rig.get("AX_REG") == 1
    };
    assert!(!less(""));
    assert!(less("dadd_sysreg_const gx, 0x80000000\n dadd_sysreg_const ix, 0x80000000"));
}
