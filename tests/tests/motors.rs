//! Drives that turn motors of the bench, and sensors on their shafts: encoders, switches, and the drives' own
//! sensors.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Axis, Device, Duration, Fault, Instant, Level, Pin, Port};
use drivetwin_firmware::md3::{Md3, Reg, motion_control};
use drivetwin_firmware::motor;
use drivetwin_firmware::motor::stepper::StepperParameters;
use drivetwin_firmware::qsb::Qsb;
use drivetwin_firmware::rs434::Rs434;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{
    Bench, CYCLES_PER_REV, Client, Closed, DriveId, FURTHEST_REV, Motor, MotorModel, PowerAction, Settings,
    Setup,
};
use drivetwin_sim::record::trace::{Event, InputRecord, OutputRecord, Retention, Trace};
use drivetwin_sim::replay;
use drivetwin_tests::rs434::{BOOT, at};

const AXIS: Axis = Axis(0);

fn make(kind: &str) -> Option<Box<dyn Device>> {
    match kind {
        "md3" => Some(Box::new(Md3::new())),
        "qsb-m" => Some(Box::new(Qsb::m())),
        "rs434544" => Some(Box::new(Rs434::rs434544())),
        _ => None,
    }
}

fn pin(bench: &Bench, seat: DriveId, name: &str) -> (DriveId, Pin) {
    (seat, bench.spec(seat).pin(name).expect("the manual has that pin"))
}

fn seat(bench: &mut Bench, name: &str, kind: &str) -> DriveId {
    let setup = Setup { boot_fast: true, ..Setup::default() };
    bench.add_with(name, make(kind).unwrap(), setup).unwrap()
}

#[track_caller]
fn assert_replays(bench: &Bench) {
    let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

/// An MD3 that turns a motor of 200 steps in 1/8 steps. A QSB-M reads the motor's encoder of 1,000 cycles.
struct Fixture {
    bench: Bench,
    md3: DriveId,
    motor: Motor,
    qsb: DriveId,
    client: Client,
}

impl Fixture {
    fn new() -> Self {
        Self::with(StepperParameters::NOMINAL, 1_000)
    }

    fn with(motor: StepperParameters, cycles_per_rev: u32) -> Self {
        let mut bench = Bench::with(Settings { trace: Retention::All, ..Settings::default() });
        let md3 = seat(&mut bench, "x", "md3");
        let qsb = seat(&mut bench, "reader", "qsb-m");
        let motor = bench.attach_motor("m", md3, AXIS, MotorModel::Stepper(motor)).unwrap();
        let to = ["A", "B", "I"].map(|name| Some(pin(&bench, qsb, name)));
        bench.encode(motor, cycles_per_rev, to);
        let client = bench.connect(bench.bus(qsb, Port(0)).unwrap());
        bench.run_until(100.millis());
        let mut fixture = Self { bench, md3, motor, qsb, client };
        // Quadrature in which each edge of both channels counts.
        fixture.bench.send(fixture.client, b"W033\r");
        fixture.wait(5.millis());
        fixture.heard();
        fixture
    }

    fn heard(&mut self) -> String {
        let mut bytes = Vec::new();
        self.bench.receive(self.client, &mut bytes);
        String::from_utf8(bytes).unwrap()
    }

    fn set(&mut self, reg: Reg, value: i64) {
        self.bench.poke(self.md3, reg as usize, value).unwrap();
    }

    fn wait(&mut self, span: Duration) {
        self.bench.run_until(self.bench.now() + span);
    }

    /// Reads the count of the QSB.
    fn counted(&mut self) -> i32 {
        self.bench.send(self.client, b"R0E\r");
        self.wait(5.millis());
        let reply = self.heard();
        let data = reply.strip_prefix("r 0E ").and_then(|reply| reply.strip_suffix(" !\r\n"));
        u32::from_str_radix(data.unwrap_or_else(|| panic!("{reply:?}")), 16).unwrap().cast_signed()
    }

    /// Edges of A and B at the QSB after `since`: the tick at the shaft, true for A, and true for a rising
    /// edge.
    fn edges(&self, since: Instant) -> Vec<(u64, bool, bool)> {
        let (a, b) = (pin(&self.bench, self.qsb, "A").1, pin(&self.bench, self.qsb, "B").1);
        let events = self.bench.trace().events().filter(|entry| entry.drive == 1 && entry.at > since);
        let edges = events.filter_map(|entry| match entry.event {
            // The wire delays the edge by a tick.
            Event::Input(InputRecord::Edge { pin, high }) if pin == a || pin == b => {
                Some((entry.at.ticks() - 1, pin == a, high))
            }
            _ => None,
        });
        edges.collect()
    }
}

#[test]
fn a_qsb_reads_exactly_what_an_md3_moves() {
    let mut fixture = Fixture::new();
    assert_eq!(fixture.counted(), 0);
    // 1,600 steps and 4,000 counts per turn make 2.5 counts per step.
    let mut position = 0;
    for steps in [10_000, -3_200, 1, 1, -70_002, 2, 64_000] {
        fixture.set(Reg::MoveSteps, steps);
        fixture.set(Reg::Speed, 20_000);
        fixture.set(Reg::AccelDecel, 100_000);
        fixture.set(Reg::MotionControl, motion_control::MOVE.into());
        fixture.wait(5.secs());
        position += steps;
        // The shaft is in the middle of a count, or at an edge, which belongs to the count after it.
        let counts = (position as f64 * 2.5 + 0.5).floor();
        assert_eq!(f64::from(fixture.counted()), counts, "at {position}");
        let turn = fixture.bench.turn(fixture.motor);
        assert_eq!((turn.revolutions * 1_600.0).round(), position as f64);
        assert_eq!((turn.rpm, turn.stalled), (0.0, false));
    }
    assert_replays(&fixture.bench);
}

#[test]
fn every_edge_of_an_encoder_is_at_its_tick() {
    let mut fixture = Fixture::new();
    fixture.set(Reg::MoveSteps, 10_000);
    let start = fixture.bench.now();
    fixture.set(Reg::MotionControl, motion_control::MOVE.into());
    fixture.wait(3.secs());
    let edges = fixture.edges(start);
    // 10,000 steps at 1,600 per turn are 25,000 counts at 4,000 per turn.
    assert_eq!(edges.len(), 25_000);
    for (count, (edge, ..)) in (1_u32..).zip(edges) {
        // An edge is half a count before its count. Factory rates: 5,000 steps/s, 10,000 steps/s², ramps of
        // 1,250 steps.
        let steps = (f64::from(count) - 0.5) / 2.5;
        let seconds = if steps < 1_250.0 {
            (steps / 5_000.0).sqrt()
        } else if steps < 8_750.0 {
            0.5 + (steps - 1_250.0) / 5_000.0
        } else {
            2.5 - ((10_000.0 - steps) / 5_000.0).sqrt()
        };
        // The motor receives the step a tick later.
        let made = (edge - start.ticks() - 1) as f64;
        let late = made - seconds * 16e6;
        // The edge is at the tick after the exact time. The angle is rounded to 2⁻³² turns.
        assert!((-0.5..1.5).contains(&late), "count {count} is {late} ticks late");
    }
}

/// An encoder with more than one count per tick leaves out counts. At each tick it shows where the shaft is.
#[test]
fn an_encoder_does_not_lag() {
    // 32 steps and 400,000 counts per turn make 12,500 counts per step.
    let most = *CYCLES_PER_REV.end();
    let mut fixture =
        Fixture::with(StepperParameters { steps_per_rev: 4, ..StepperParameters::NOMINAL }, most + 1);
    let counts_per_step = f64::from(4 * most) / 32.0;
    fixture.set(Reg::MoveSteps, 128);
    fixture.set(Reg::Speed, 20_000);
    fixture.set(Reg::AccelDecel, 80_000);
    let start = fixture.bench.now();
    fixture.set(Reg::MotionControl, motion_control::MOVE.into());
    fixture.wait(100.millis());
    // 64 steps at 80,000 steps/s² take 40 ms, and 64 more to stop. The top speed of 3,200 steps/s is 2.5
    // counts per tick.
    let half = 0.04;
    // The motor receives the step a tick later.
    let made = |tick: u64| (tick - start.ticks() - 1) as f64 / 16e6;
    let counts = |seconds: f64| {
        let left = (2.0 * half - seconds).max(0.0);
        let steps =
            if seconds < half { 40_000.0 * seconds * seconds } else { 128.0 - 40_000.0 * left * left };
        steps * counts_per_step
    };
    let edges = fixture.edges(start);
    let (mut a, mut b, mut clear) = (true, true, 0_u32);
    for together in edges.chunk_by(|one, next| one.0 == next.0) {
        let tick = together[0].0;
        assert!(together.len() <= 2, "{} edges at {tick}", together.len());
        for &(_, is_a, high) in together {
            let level = if is_a { &mut a } else { &mut b };
            assert_ne!(*level, high, "an edge is a change, at {tick}");
            *level = high;
        }
        // Checks only times at which floating point can resolve the count. An edge is half a count before its
        // count.
        let at = counts(made(tick)) + 0.5;
        if (at - at.round()).abs() > 0.01 {
            clear += 1;
            let quarter = at.floor().rem_euclid(4.0);
            assert_eq!((a, b), (quarter == 0.0 || quarter == 3.0, quarter <= 1.0), "at {tick}: {at}");
        }
    }
    assert!(clear > 500_000, "{clear}");
    assert!(edges.len() < 1_600_000, "{} edges: nothing was left out", edges.len());
    let last = made(edges.last().unwrap().0);
    assert!(last <= 2.0 * half + 1e-6, "at {last} s it goes on, and the shaft stands from {} on", 2.0 * half);
}

#[test]
fn a_switch_may_be_anywhere() {
    let bounds = |above_rev, below_rev| Closed { above_rev, below_rev };
    for (closed, level) in [
        (bounds(Some(f64::MAX), None), Level::High),
        (bounds(Some(f64::INFINITY), None), Level::High),
        (bounds(Some(FURTHEST_REV), None), Level::High),
        (bounds(None, Some(f64::MAX)), Level::Low),
        (bounds(None, Some(-f64::MAX)), Level::High),
        (bounds(Some(-f64::INFINITY), Some(f64::INFINITY)), Level::Low),
        (bounds(Some(2.0), Some(-2.0)), Level::High),
        // NaN means no bound.
        (bounds(Some(f64::NAN), Some(1.0)), Level::Low),
        (bounds(Some(1.0), Some(f64::NAN)), Level::High),
    ] {
        let most = StepperParameters {
            steps_per_rev: StepperParameters::MOST.steps_per_rev,
            ..StepperParameters::NOMINAL
        };
        let mut fixture = Fixture::with(most, 1);
        let to = pin(&fixture.bench, fixture.md3, "J2.2");
        fixture.bench.switch(fixture.motor, closed, to);
        fixture.set(Reg::MoveSteps, 1_000);
        fixture.set(Reg::MotionControl, motion_control::MOVE.into());
        fixture.wait(1.secs());
        assert_eq!(fixture.bench.level(to.0, to.1), level, "{closed:?}");
    }
}

#[test]
fn an_md3_homes_onto_a_switch() {
    let mut fixture = Fixture::new();
    let home = pin(&fixture.bench, fixture.md3, "J2.2");
    fixture.bench.switch(fixture.motor, Closed { above_rev: None, below_rev: Some(-2.0) }, home);
    fixture.wait(1.millis());
    assert_eq!(fixture.bench.level(home.0, home.1), Level::High);
    // Moves backward to the flag on J2 pin 2 and stops there at once (7.5), at the factory's 5,000 steps/s.
    fixture.set(Reg::HomingConfiguration, 1 << 4);
    fixture.set(Reg::MotionControl, motion_control::HOME.into());
    fixture.wait(5.secs());
    // The flag is at −3,200 steps. It is sampled every 4 µs, a fiftieth of a step, and a step that has begun
    // is completed.
    assert_eq!(fixture.bench.motion(fixture.md3, AXIS).position, -3_200);
    assert_eq!(fixture.bench.level(home.0, home.1), Level::High, "the shaft is at −2 turns and not below");
    assert_replays(&fixture.bench);
}

/// An action on an RS drive.
enum Act {
    Write(u16, u16),
    Coil(u16),
    Read(u16, u16),
    Hold(bool),
}

/// The actions, each with its time in ms.
const SCRIPT: [(u64, Act); 14] = [
    (600, Act::Write(at::SPEED, 200)),
    (620, Act::Coil(at::START)),
    (1_000, Act::Read(at::CURRENT_VALID, 4)),
    (1_300, Act::Write(at::SPEED, 100)),
    (1_600, Act::Read(at::CURRENT_VALID, 4)),
    (1_700, Act::Hold(true)),
    (1_712, Act::Read(at::CURRENT_VALID, 4)),
    (1_730, Act::Hold(false)),
    (2_000, Act::Read(at::CURRENT_VALID, 4)),
    (2_100, Act::Coil(at::STOP)),
    (2_101, Act::Read(at::CURRENT_VALID, 4)),
    (2_500, Act::Read(at::STATUS, 5)),
    (2_600, Act::Coil(at::START)),
    (3_000, Act::Read(at::CURRENT_VALID, 4)),
];

/// Tick, pin, and true for a rising edge.
type Edge = (u64, Pin, bool);

/// Index of a register of an RS drive.
fn row(name: &str) -> usize {
    Rs434::rs434544().spec().find(name).expect("the manual has that register").row
}

/// Runs the script on an RS drive with some registers preset. Returns the bench, the answers with the motion
/// of the motor after each action, and the edges of the Hall sensors.
fn rs_drive(external_motor: bool, presets: &[(usize, i64)]) -> (Bench, Vec<Vec<u8>>, Vec<Edge>) {
    let mut bench = Bench::with(Settings { trace: Retention::All, ..Settings::default() });
    let setup = Setup { external_motor, presets: presets.to_vec(), ..Setup::default() };
    let drive = bench.add_with("d", Box::new(Rs434::rs434544()), setup).unwrap();
    assert_eq!(bench.detached_motor(drive).is_some(), external_motor);
    if let Some(parameters) = bench.detached_motor(drive) {
        bench.attach_motor("m", drive, AXIS, MotorModel::Brush(parameters)).unwrap();
    }
    let stall = bench.spec(drive).faults.iter().position(|fault| *fault == "stall").unwrap();
    let mut replies = Vec::new();
    assert!(BOOT <= 600.millis());
    for (ms, act) in SCRIPT {
        bench.run_until(ms.millis());
        match act {
            Act::Write(reg, value) => replies.push(bench.ask(drive, &rtu::write(1, reg, value))),
            Act::Coil(coil) => {
                let [high, low] = coil.to_be_bytes();
                replies.push(bench.ask(drive, &rtu::frame(1, &[5, high, low, 0xFF, 0])));
            }
            Act::Read(reg, count) => {
                let [high, low] = reg.to_be_bytes();
                replies.push(bench.ask(drive, &rtu::frame(1, &[4, high, low, 0, count as u8])));
            }
            Act::Hold(on) => bench.fault(drive, Fault(stall as u8), on),
        }
        let motion = bench.motion(drive, AXIS);
        replies.push(format!("{motion:?}").into_bytes());
    }
    let halls = ["HA", "HB"].map(|name| pin(&bench, drive, name).1);
    let edges = bench.trace().events().filter_map(|entry| match entry.event {
        // Edges of the drive's own motor are outputs of the drive, a tick before the drive receives them.
        Event::Output(OutputRecord::Level { pin, level }) if halls.contains(&pin) => {
            Some((entry.at.ticks() + 1, pin, level == Level::High))
        }
        Event::Input(InputRecord::Edge { pin, high }) if halls.contains(&pin) => {
            Some((entry.at.ticks(), pin, high))
        }
        _ => None,
    });
    // At power-on the drive's own motor reports that both sensors are high. A drive without a motor starts
    // with that state.
    let edges = edges.filter(|(at, ..)| *at > 1).collect();
    (bench, replies, edges)
}

#[test]
fn an_rs_drive_apart_is_the_same_drive() {
    // Factory settings, and a motor that its registers describe differently.
    for presets in [vec![], vec![(row("PULSES_PER_REVOLUTION"), 8), (row("RATED_SPEED"), 4_500)]] {
        let (_, replies, edges) = rs_drive(false, &presets);
        let (bench, replies_apart, edges_apart) = rs_drive(true, &presets);
        assert!(edges.len() > 50, "{}", edges.len());
        assert_eq!(edges_apart, edges);
        assert_eq!(replies_apart, replies);
        let text = bench.trace().to_text();
        assert!(text.contains("\ndrive d rs434544 apart\n"), "{}", &text[..200]);
        assert!(text.contains(" > draws motor "));
        assert_replays(&bench);
    }
}

/// The drive assumes RATED_SPEED 3,000 and PULSES_PER_REVOLUTION 4, but the motors differ. Only the edges
/// determine the speed.
#[test]
fn an_rs_drive_holds_the_speed_that_its_sensors_count() {
    let factory = motor::Parameters::NOMINAL;
    for (hall_pulses, no_load_rpm, shaft_rpm) in [(8, 3_000, 500.0), (4, 4_500, 1_000.0), (4, 2_000, 1_000.0)]
    {
        let mut bench = Bench::new();
        let setup = Setup { external_motor: true, ..Setup::default() };
        let drive = bench.add_with("d", Box::new(Rs434::rs434544()), setup).unwrap();
        assert_eq!(bench.detached_motor(drive), Some(factory));
        let parameters = motor::Parameters { hall_pulses, no_load_rpm, ..factory };
        let motor = bench.attach_motor("m", drive, AXIS, MotorModel::Brush(parameters)).unwrap();
        bench.run_until(600.millis());
        // SPEED is 1,000, then START.
        bench.ask(drive, &rtu::write(1, at::SPEED, 1_000));
        bench.ask(drive, &rtu::frame(1, &[5, 0x20, 0, 0xFF, 0]));
        bench.run_until(2_600.millis());
        // For 0.2 s the speeds are within 1 %, without an error.
        for ms in (2_600..2_800).step_by(10) {
            bench.run_until(ms.millis());
            let (valid, shaft) = (bench.peek(drive, row("SPEED_VALID")), bench.turn(motor).rpm);
            assert!((990..=1_010).contains(&valid), "SPEED_VALID {valid} with {parameters:?}");
            assert!((shaft / shaft_rpm - 1.0).abs() <= 0.01, "{shaft} rpm with {parameters:?}");
        }
        assert_eq!(bench.peek(drive, row("ERROR")), 0, "{parameters:?}");
    }
}

#[test]
fn a_motor_of_other_parameters_turns_otherwise() {
    let mut ways = Vec::new();
    for inertia_gcm2 in [motor::Parameters::NOMINAL.inertia_gcm2, 100_000] {
        let mut bench = Bench::new();
        let setup = Setup { external_motor: true, ..Setup::default() };
        let drive = bench.add_with("d", Box::new(Rs434::rs434544()), setup).unwrap();
        let parameters = motor::Parameters { inertia_gcm2, ..bench.detached_motor(drive).unwrap() };
        let motor = bench.attach_motor("m", drive, AXIS, MotorModel::Brush(parameters)).unwrap();
        bench.run_until(600.millis());
        bench.ask(drive, &rtu::frame(1, &[5, 0x20, 0, 0xFF, 0]));
        bench.run_until(1_600.millis());
        let turn = bench.turn(motor);
        assert!(turn.rpm > 0.0 && turn.ma > 0 && !turn.stalled, "{turn:?}");
        ways.push(turn.revolutions);
        // Without power the motor coasts and comes to rest.
        bench.power(drive, PowerAction::Off);
        bench.run_until(1_601.millis());
        let coasts = bench.turn(motor);
        assert!(coasts.rpm > 0.0 && coasts.ma == 0, "{coasts:?}");
        bench.run_until(300.secs());
        assert_eq!(bench.turn(motor).rpm, 0.0);
    }
    assert!(ways[1] < ways[0], "{ways:?}");
}
