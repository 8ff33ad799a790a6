//! An MD3 with a motor on the bench: loads, DC motors, encoders, and its STEP and DIR outputs (MD3 User Guide
//! V1.7).
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Axis, Device, Duration, Instant, Pin};
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, DriveId, Motor, PinStimulus, PowerAction, Settings};
use drivetwin_sim::config::bench_file;
use drivetwin_sim::config::layout::Built;
use drivetwin_sim::record::trace::{Event, InputRecord, Retention, Trace};
use drivetwin_sim::replay;
use drivetwin_sim::signals::pulses::Pulse;
use drivetwin_tests::md3::{at, bit};

fn make(kind: &str) -> Option<Box<dyn Device>> {
    drivetwin_sim::catalog::make(kind).ok()
}

/// A bench with the drive `x`, an MD3 that has just started, and the motor `m`.
struct Rig {
    bench: Bench,
    drive: DriveId,
    motor: Motor,
}

impl Rig {
    #[track_caller]
    fn new(text: &str) -> Self {
        let layout = bench_file::parse(text).unwrap_or_else(|error| panic!("{error}"));
        let settings = Settings { trace: Retention::All, ..layout.settings() };
        let built = layout.build(settings, Vec::new()).unwrap_or_else(|error| panic!("{error}"));
        let Built { mut bench, drives, motors, .. } = built;
        bench.run_until(1.millis());
        Self { bench, drive: drives[0], motor: motors[0] }
    }

    #[track_caller]
    fn write(&mut self, address: u16, value: u16) {
        drivetwin_tests::md3::write(&mut self.bench, self.drive, address, value);
    }

    #[track_caller]
    fn write_pair(&mut self, address: u16, value: i32) {
        drivetwin_tests::md3::write_pair(&mut self.bench, self.drive, address, value.cast_unsigned());
    }

    fn wait_ms(&mut self, ms: u64) {
        self.bench.run_until(self.bench.now() + ms.millis());
    }

    fn turns(&self) -> f64 {
        self.bench.turn(self.motor).revolutions
    }
}

/// A motor of 200 steps that holds 100 mN·m at 1 A, the factory's current. With 1/8 steps 1,600 microsteps
/// are a turn (7.2).
const WEAK: &str = "holding_mnm = 300\nrated_ma = 3000\npull_out_rpm = 200000\n";

fn loaded(cutback: u16, load: &str) -> Rig {
    Rig::new(&format!(
        "line = 'fast'\n[[drive]]\nname = 'x'\nkind = 'md3'\nfast_boot = true\n\
         set = {{ CurrentCutbackSettings = {cutback} }}\n\
         [[motor]]\nname = 'm'\ndrive = 'x'\n{WEAK}{load}\n",
    ))
}

/// Section 7.3: the cutback lasts until the next command. Section 7.15: Move moves by MoveSteps.
#[test]
fn a_move_after_the_cutback_has_the_full_current_from_its_first_step() {
    // 0.1 to 0.9 A hold 10 to 90 mN·m. The motor needs 95 mN·m.
    for level in 1..=9 {
        let mut rig = loaded(0x0100 | level, "friction_mnm = 95");
        for end in [6.25, 12.5] {
            rig.wait_ms(1_000);
            assert_eq!(rig.bench.turn(rig.motor).ma, i32::from(100 * level));
            rig.write(at::MOTION, bit::MOVE);
            rig.wait_ms(4_000);
            assert_eq!(rig.turns(), end, "level {level}");
        }
    }
}

/// Every way to begin a motion: a jog, a home cycle, and a step of pin 4.
#[test]
fn every_motion_after_the_cutback_has_the_full_current() {
    let mut rig = loaded(0x0105, "friction_mnm = 95");
    rig.wait_ms(1_000);
    rig.write(at::MOTION, bit::JOG);
    rig.wait_ms(1_000);
    rig.write(at::MOTION, bit::DECEL_STOP);
    rig.wait_ms(2_000);
    // The motor reached 5,000 steps/s after half a second, and took half a second to stop.
    assert_eq!((rig.turns() * 1_600.0).round(), 5_000.0);

    let mut rig = loaded(0x0105, "friction_mnm = 95");
    rig.write_pair(at::PRE_HOME_OFFSET, -1_600);
    rig.wait_ms(1_000);
    rig.write(at::MOTION, bit::HOME);
    rig.wait_ms(250);
    assert!(rig.turns() < -0.1, "{}", rig.turns());

    let mut rig = loaded(0x0105, "friction_mnm = 95");
    let pin = rig.bench.spec(rig.drive).pin("J2.4").expect("the manual has that pin");
    for n in 1..=3 {
        rig.wait_ms(1_000);
        rig.bench.set_pin(rig.drive, pin, PinStimulus::Low);
        rig.wait_ms(10);
        rig.bench.set_pin(rig.drive, pin, PinStimulus::Open);
        rig.wait_ms(10);
        assert_eq!((rig.turns() * 1_600.0).round(), f64::from(n));
    }
}

/// The drive `x` reads the encoder of its own motor: 250 cycles, 1,000 counts per turn.
fn with_encoder(settings: &str) -> Rig {
    Rig::new(&format!(
        "line = 'fast'\n[[drive]]\nname = 'x'\nkind = 'md3'\nfast_boot = true\nset = {{ {settings} }}\n\
         [[motor]]\nname = 'm'\ndrive = 'x'\n\
         [[encoder]]\nmotor = 'm'\ncycles_per_rev = 250\nto = {{ a = 'x.J2.10', b = 'x.J2.12', index = 'x.J2.9' }}\n",
    ))
}

impl Rig {
    /// Moves by that many turns of 1,600 microsteps.
    fn turn(&mut self, turns: i32) {
        self.write_pair(at::SPEED, 16_000);
        self.write_pair(at::ACCEL_DECEL, 160_000);
        self.write_pair(at::MOVE_STEPS, 1_600 * turns);
        self.write(at::MOTION, bit::MOVE);
        self.wait_ms(3_000);
    }

    /// Reads EncoderIndexCount (7.13).
    fn indexes(&mut self) -> i32 {
        let words = self.read(at::INDEX_COUNT, 2);
        (u32::from(words[0]) << 16 | u32::from(words[1])).cast_signed()
    }

    /// Reads QuadratureEncoderCount (7.14).
    fn count(&mut self) -> u16 {
        self.read(at::ENCODER_COUNT, 1)[0]
    }

    fn read(&mut self, first: u16, words: u16) -> Vec<u16> {
        let reply = self.bench.ask(self.drive, &rtu::read(1, first, words));
        assert_eq!(reply.len(), 5 + 2 * usize::from(words), "{reply:02x?}");
        reply[3..reply.len() - 2].chunks(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect()
    }
}

/// Section 7.11: the factory's 0x0005 clears the counter at the index while A and B are low, where US
/// Digital's encoders have their index. 7.13: 5 rotations in one direction count 5, and 3 rotations in the
/// other direction subtract 3.
#[test]
fn the_factorys_gating_counts_the_index_and_clears() {
    for filter in ["", "QuadratureEncoderConfiguration = 0x0205", "QuadratureEncoderConfiguration = 0x020d"] {
        let mut rig = with_encoder(filter);
        assert_eq!((rig.count(), rig.indexes()), (0, 0), "{filter}: with fast boot, too");
        rig.turn(5);
        let swapped = filter.ends_with("0d");
        assert_eq!(rig.indexes(), if swapped { -5 } else { 5 }, "{filter}");
        if !swapped {
            // The index is 2 counts after the starting angle. Of its five clears the last was 998 counts
            // before the end.
            assert_eq!(rig.count(), 998, "{filter}");
        }
        rig.turn(-3);
        assert_eq!(rig.indexes(), if swapped { -2 } else { 2 }, "{filter}");
    }
}

/// Section 7.11: x4 decoding gates the index with one of four states of A and B. The index of an encoder is
/// in only one of them.
#[test]
fn one_of_four_gates_responds() {
    // Tests the index without the filter, with it, with the slowest filter, and with A and B swapped.
    for others in [0, 1 << 9, 1 << 9 | 7 << 6, 1 << 3] {
        let responds: Vec<u16> = (0..4)
            .filter(|gate| {
                let mut rig =
                    with_encoder(&format!("QuadratureEncoderConfiguration = {}", 5 | gate << 4 | others));
                rig.turn(3);
                let there = rig.indexes();
                assert!(there == 0 || there.abs() == 3, "{gate}: {there}");
                rig.turn(-3);
                assert_eq!(rig.indexes(), 0);
                there != 0
            })
            .collect();
        assert_eq!(responds, [0], "{others:#x}");
    }
    // x2 gates the index with one channel: A low, or B low.
    for (gate, indexes) in [(0, 3), (1, 0), (2, 3), (3, 0)] {
        let mut rig = with_encoder(&format!("QuadratureEncoderConfiguration = {}", 1 | gate << 4));
        rig.turn(3);
        assert_eq!(rig.indexes(), indexes, "{gate}");
    }
}

/// A fast boot counts nothing: the levels of the encoder at power-on are not edges.
#[test]
fn the_counter_starts_at_0() {
    for settings in ["", "Speed = 1000", "QuadratureEncoderConfiguration = 0x0204"] {
        let mut rig = with_encoder(settings);
        assert_eq!((rig.count(), rig.indexes()), (0, 0), "{settings}");
        rig.bench.power(rig.drive, PowerAction::Cycle);
        rig.wait_ms(1);
        assert_eq!((rig.count(), rig.indexes()), (0, 0), "{settings}");
        rig.write_pair(at::MOVE_STEPS, 160);
        rig.write(at::MOTION, bit::MOVE);
        rig.wait_ms(1_000);
        // A tenth of a turn is 100 counts. If the index clears the counter, it does so after 2 counts.
        let behind = if settings.ends_with("4") { 100 } else { 98 };
        assert_eq!(rig.count(), behind, "{settings}");
    }
}

/// Two drives. STEP and DIR of `x` are wired to pins of `y` that have no function.
const WATCHED: &str = "line = 'fast'\n\
     [[drive]]\nname = 'x'\nkind = 'md3'\nfast_boot = true\n[[drive]]\nname = 'y'\nkind = 'md3'\nfast_boot = true\n\
     [[motor]]\nname = 'm'\ndrive = 'x'\n\
     [[wire]]\nfrom = 'x.STEP'\nto = 'y.J2.10'\n[[wire]]\nfrom = 'x.DIR'\nto = 'y.J2.12'\n";

/// Section 7.8, mode 0000: a falling edge of pin 4 makes a step, at up to 250 kHz. Pin 5 at that edge is the
/// direction.
#[test]
fn a_direction_that_alternates_at_250_khz_settles_before_each_step() {
    let mut rig = Rig::new(WATCHED);
    let pin = |name: &str| rig.bench.spec(rig.drive).pin(name).expect("the manual has that pin");
    let (step, direction) = (pin("J2.4"), pin("J2.5"));
    let began = rig.bench.now() + 1.millis();
    for n in 0..2_000_u64 {
        // A low pin 5 means backward.
        let forward = n % 2 == 0;
        let to = if forward { PinStimulus::High } else { PinStimulus::Low };
        rig.bench.run_until(began + (4 * n).micros());
        rig.bench.set_pin(rig.drive, direction, to);
        rig.bench.set_pin(rig.drive, step, PinStimulus::Low);
        rig.bench.run_until(began + (4 * n + 2).micros());
        rig.bench.set_pin(rig.drive, step, PinStimulus::High);
    }
    rig.wait_ms(1);
    let pulses: Vec<Pulse> = rig.bench.pulses(rig.drive.step()).collect();
    assert_eq!(pulses.len(), 2_000);
    for (n, pulse) in (0..).zip(&pulses) {
        assert_eq!(pulse.forward, n % 2 == 0, "step {n}");
        let late = pulse.rise.since(began + (4 * n).micros());
        // A pin change by the test may take effect a tick later.
        assert!(late <= 2.micros() + Duration::TICK, "step {n} is {late:?} late");
    }
    // At the other ends of the wires DIR changes at least 200 ns before STEP rises, and not while STEP is
    // high.
    let (a, b) = (Pin(5), Pin(6));
    let edges = rig.bench.trace().events().filter(|entry| entry.drive == 1 && entry.at > began);
    let edges = edges.filter_map(|entry| match entry.event {
        Event::Input(InputRecord::Edge { pin, high }) if pin == a || pin == b => Some((entry.at, pin, high)),
        _ => None,
    });
    let edges: Vec<(Instant, Pin, bool)> = edges.collect();
    assert_eq!(edges.iter().filter(|edge| edge.1 == a && edge.2).count(), 2_000);
    let (mut turned, mut high) = (began, false);
    for (at, pin, level) in edges {
        if pin == b {
            assert!(!high, "{at:?}");
            turned = at;
        } else {
            high = level;
            assert!(!level || at.since(turned).ticks() >= 4, "{at:?}");
        }
    }
    assert_eq!(rig.bench.motion(rig.drive, Axis(0)).position, 0);
}

/// The drive `x` in DC motor mode at 16 kHz, where 5,000 counts are the full duty (7.2, code 5). Its motor
/// has brushes: 3,000 rpm at 24 V, so 1 A makes 76.39 mN·m, and 0.5 Ω. The drive reads the motor's encoder,
/// 1,000 counts per turn.
fn dc(current: u16, motor: &str) -> Rig {
    Rig::new(&format!(
        "line = 'fast'\n[[drive]]\nname = 'x'\nkind = 'md3'\nfast_boot = true\n\
         set = {{ MotorCurrentAndMicrostepping = {}, AccelDecel = 50000, QuadratureEncoderConfiguration = 4 }}\n\
         [[motor]]\nname = 'm'\ndrive = 'x'\nsupply_v = 24\nno_load_rpm = 3000\nresistance_ohm = 0.5\n{motor}\n\
         [[encoder]]\nmotor = 'm'\ncycles_per_rev = 250\nto = {{ a = 'x.J2.10', b = 'x.J2.12', index = 'x.J2.9' }}\n",
        0x2500 | current,
    ))
}

/// Speed in rpm with this duty against this torque. It follows from the voltage that the resistance leaves.
fn steady_rpm(duty: f64, mnm: f64) -> f64 {
    let torque_constant = 24.0 / (3_000.0 * std::f64::consts::TAU / 60.0);
    let amperes = mnm / 1_000.0 / torque_constant;
    3_000.0 * (duty.abs() * 24.0 - amperes * 0.5) / 24.0 * duty.signum()
}

impl Rig {
    fn jog(&mut self, speed: i32) {
        self.write_pair(at::SPEED, speed);
        self.write(at::MOTION, bit::JOG);
    }

    fn rpm(&self) -> f64 {
        self.bench.turn(self.motor).rpm
    }
}

/// Sections 7.2, 7.17: the on time in counts turns the motor. The sign of the on time is the direction.
#[test]
fn a_dc_motor_turns_with_its_duty_and_its_encoder_is_counted() {
    let mut rig = dc(0x0a, "friction_mnm = 10");
    for speed in [2_500, 5_000, -1_250, 500, -5_000] {
        rig.jog(speed);
        rig.wait_ms(1_000);
        let (duty, began) = (f64::from(speed) / 5_000.0, rig.turns());
        let expected = steady_rpm(duty, 10.0);
        assert!((rig.rpm() - expected).abs() < 1.0, "{speed}: {} rpm, not {expected}", rig.rpm());
        let counted = rig.count();
        rig.wait_ms(500);
        let (way, counted) = (rig.turns() - began, rig.count().wrapping_sub(counted).cast_signed());
        assert!(
            (f64::from(counted) - 1_000.0 * way).abs() <= 1.0,
            "{speed}: {counted} counts in {way} turns"
        );
        assert!((way - expected / 120.0).abs() < 0.01, "{speed}: {way} turns in half a second");
    }
    // A replay of the trace, which has no motor, gives the same outputs.
    let trace = Trace::parse(&rig.bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

/// Section 7.2: the phase current parameter limits the current of a DC motor, which is on phase B.
#[test]
fn the_phase_current_limits_a_dc_motor() {
    // 1 A makes 76.4 mN·m, 1.4 A make 106.9 mN·m.
    for (code, friction, turns) in
        [(0x0a, 70, true), (0x0a, 80, false), (0x0e, 100, true), (0x0e, 112, false)]
    {
        let mut rig = dc(code, &format!("friction_mnm = {friction}"));
        rig.jog(5_000);
        rig.wait_ms(5_000);
        let expected = if turns { steady_rpm(1.0, f64::from(friction)) } else { 0.0 };
        assert!(
            (rig.rpm() - expected).abs() < 1.0,
            "{code:#x}, {friction}: {} rpm, not {expected}",
            rig.rpm()
        );
        let ma = rig.bench.turn(rig.motor).ma;
        assert!(ma <= 100 * i32::from(code), "{ma} mA");
    }
    // A load that exceeds the limit turns the motor backward.
    let mut rig = dc(0x0a, "load_mnm = 90");
    rig.jog(5_000);
    rig.wait_ms(500);
    assert!(rig.rpm() < 0.0, "{} rpm", rig.rpm());
}

/// Section 7.15: Stop leaves the current on, so the motor brakes. Disable switches it off, so the motor
/// coasts.
#[test]
fn a_dc_motor_is_braked_by_stop_and_coasts_when_disabled() {
    let way = |bits: u16| {
        let mut rig = dc(0x1e, "friction_mnm = 1");
        rig.jog(5_000);
        rig.wait_ms(2_000);
        let began = rig.turns();
        rig.write(at::MOTION, bits);
        rig.wait_ms(15_000);
        assert_eq!(rig.bench.motion(rig.drive, Axis(0)).duty, 0);
        assert!(rig.rpm().abs() < 0.001);
        rig.turns() - began
    };
    // 400 g·cm² at 3,000 rpm, braked by 1 mN·m: ½·J·ω² / M = 1.974 J / 0.001 N·m = 314 turns.
    let coasted = way(bit::DISABLE);
    assert!((310.0..316.0).contains(&coasted), "{coasted} turns");
    assert!(way(bit::STOP) < 2.0);
    assert!(way(bit::DECEL_STOP) < 10.0);
}

/// Section 7.2: the motor must fit the motor mode. A motor with brushes does not turn in stepper mode, and a
/// stepper motor does not turn in DC motor mode.
#[test]
fn a_motor_of_the_other_mode_does_not_turn() {
    let mut rig = dc(0x0a, "");
    rig.write(at::CURRENT_AND_MICROSTEPPING, 0x030a);
    rig.write(at::MOTION, bit::MOVE);
    rig.wait_ms(5_000);
    assert_eq!(rig.turns(), 0.0);
    rig.write(at::CURRENT_AND_MICROSTEPPING, 0x250a);
    rig.jog(2_500);
    rig.wait_ms(2_000);
    assert!(rig.rpm() > 1_000.0);

    let mut rig = loaded(0, "");
    rig.write(at::CURRENT_AND_MICROSTEPPING, 0x250a);
    rig.jog(2_500);
    rig.wait_ms(2_000);
    assert_eq!(rig.turns(), 0.0);
}

/// The keys of `[[motor]]` decide the type of the motor. Without such keys the motor mode decides that `set`
/// gives the drive.
#[test]
fn the_motor_mode_in_set_makes_a_motor_one_with_brushes() {
    for (mode, turns) in [(0x250a, true), (0x030a, false)] {
        let mut rig = Rig::new(&format!(
            "line = 'fast'\n[[drive]]\nname = 'x'\nkind = 'md3-low'\nfast_boot = true\n\
             set = {{ MotorCurrentAndMicrostepping = {mode} }}\n[[motor]]\nname = 'm'\ndrive = 'x'\n",
        ));
        rig.write(at::CURRENT_AND_MICROSTEPPING, 0x250a);
        rig.jog(2_500);
        rig.wait_ms(3_000);
        assert_eq!(rig.turns() > 10.0, turns, "{mode:#x}");
    }
}

/// `describe` lists, for both versions, the limits of the model that a test could notice.
#[test]
fn limits_of_the_motor_model_are_listed() {
    for kind in ["md3", "md3-low"] {
        let said = make(kind).expect("there is such a drive").spec().not_modelled;
        for word in
            ["supply", "over_current", "isolators", "ripple", "resonance", "inductance", "DC motor", "index"]
        {
            assert!(said.iter().any(|line| line.contains(word)), "{kind} says nothing of {word}");
        }
    }
}
