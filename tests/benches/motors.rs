//! Run time of ten simulated minutes of a motor with an encoder and two switches: 40 million edges that the
//! bench makes and delivers and a QSB counts. valgrind counts the instructions of a few seconds.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;

use drivetwin_firmware::device::{Axis, Port};
use drivetwin_firmware::md3::{Md3, Reg, motion_control};
use drivetwin_firmware::motor::stepper::StepperParameters;
use drivetwin_firmware::qsb::Qsb;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, Closed, MotorModel, Settings, Setup};
use drivetwin_sim::record::trace::Retention;

use support::{line, took};

/// Cycles of the encoder.
const CYCLES: u32 = 1_000;
/// Speed in microsteps per second: 1,000 rpm in 1/8 microsteps of a motor with 200 steps, 1,600 in a turn.
const SPEED: u32 = 26_667;

fn main() {
    if let Some((_, seconds)) = count::wanted() {
        run(CYCLES, seconds);
        return;
    }
    println!("a motor of a bench");
    let (no_edges, _) = run(0, 600);
    line("10 min, no sensor", &format!("{no_edges:.3} s"));
    let (seconds, count) = run(CYCLES, 600);
    let ns = seconds * 1e9 / f64::from(count);
    // After the ramp, which takes 0.3 s.
    let in_a_second = count::instructions("edges", 1, 3);
    let edges = f64::from(SPEED) / 1_600.0 * f64::from(4 * CYCLES);
    let instructions = count::counted(in_a_second.map(|instructions| instructions / edges));
    line("10 min, 1,000 rpm", &format!("{seconds:.2} s, {ns:.0} ns and {instructions} an edge of {count}"));
    count::warn_unless(in_a_second.is_some());
}

/// Runs `seconds` at 1,000 rpm, with an encoder of `cycles` cycles. Returns the seconds of wall time and the
/// count of a QSB.
fn run(cycles: u32, seconds: u64) -> (f64, u32) {
    let mut bench = Bench::with(Settings { trace: Retention::Off, ..Settings::default() });
    let fast = |presets| Setup { boot_fast: true, presets, ..Setup::default() };
    let rates = vec![(Reg::Speed as usize, SPEED.into()), (Reg::AccelDecel as usize, 100_000)];
    let md3 = bench.add_with("md3", Box::new(Md3::new()), fast(rates)).expect("a drive that can be seated");
    let qsb =
        bench.add_with("qsb", Box::new(Qsb::m()), fast(Vec::new())).expect("a drive that can be seated");
    let motor = bench
        .attach_motor("m", md3, Axis(0), MotorModel::Stepper(StepperParameters::NOMINAL))
        .expect("an MD3 turns steppers");
    let pin =
        |bench: &Bench, seat, name| (seat, bench.spec(seat).pin(name).expect("the manual has that pin"));
    if cycles > 0 {
        let to = ["A", "B", "I"].map(|name| Some(pin(&bench, qsb, name)));
        bench.encode(motor, cycles, to);
        for (name, rev) in [("DIO0", 1_000.0), ("DIO1", 5_000.0)] {
            let closed = Closed { above_rev: Some(rev), below_rev: Some(rev + 0.5) };
            bench.switch(motor, closed, pin(&bench, qsb, name));
        }
    }
    let client = bench.connect(bench.bus(qsb, Port(0)).expect("a serial port"));
    bench.run_until(100.millis());
    // Quadrature x4: each edge of both channels counts.
    bench.send(client, b"W033\r");
    bench.run_until(200.millis());
    bench.poke(md3, Reg::MotionControl as usize, motion_control::JOG.into()).expect("a register");
    let end = bench.now() + seconds.secs();
    let seconds = took(|| bench.run_until(end)).as_secs_f64();
    let mut reply = Vec::new();
    bench.receive(client, &mut reply);
    reply.clear();
    bench.send(client, b"R0E\r");
    bench.run_until(end + 5.millis());
    bench.receive(client, &mut reply);
    let reply = String::from_utf8(reply).expect("text");
    let count = u32::from_str_radix(reply[5..].trim_end_matches(['!', '\r', '\n', ' ']), 16);
    (seconds, count.unwrap_or_else(|_| panic!("{reply:?}")))
}
