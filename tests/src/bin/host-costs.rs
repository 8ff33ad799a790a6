//! Costs of the bench on this machine, for the check "costs of the bench": a line `what: number` for each.
//!
//! valgrind counts instructions, bytes and allocations: it runs this program with two numbers of rounds, and the
//! difference belongs to the rounds alone.

use std::hint::black_box;
use std::process::Command;

use drivetwin_firmware::device::{Axis, Boot, Context, Device, Input, Instant, Output, Port};
use drivetwin_firmware::md3::{self, Md3};
use drivetwin_firmware::mdrive::Mdrive;
use drivetwin_firmware::motor::stepper::StepperParameters;
use drivetwin_firmware::qsb::{self, Qsb};
use drivetwin_protocol::modbus::{rtu, tcp};
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, DriveId, MotorModel, Setup};
use drivetwin_sim::catalog;
use drivetwin_sim::line::LineMode;
use drivetwin_tests::busy::{Party, Toys};

/// Numbers of drives for the bytes of one. Between powers of two every list has grown by as much as the drives.
const DRIVES: [u64; 2] = [256, 512];

/// Work of which a round is counted.
struct Work {
    name: &'static str,
    /// Numbers of rounds.
    rounds: [u64; 2],
    run: fn(u64),
}

const WORKS: [Work; 9] = [
    Work { name: "event, 1 seat", rounds: [1_000, 11_000], run: |rounds| Toys::new(1).run(rounds) },
    Work { name: "event, 1,000 seats", rounds: [1_000, 11_000], run: |rounds| Toys::new(1_000).run(rounds) },
    Work { name: "edge from a motor to a counter", rounds: [1_000, 11_000], run: edges },
    Work { name: "request to a drive alone", rounds: [100, 1_100], run: requests_alone },
    Work {
        name: "request, a drive on a line",
        rounds: [30, 130],
        run: |rounds| Party::new(1, LineMode::Timed).ask(rounds),
    },
    Work {
        name: "request, 247 drives on a line",
        rounds: [250, 300],
        run: |rounds| Party::new(247, LineMode::Timed).ask(rounds),
    },
    Work {
        name: "request, 247 drives on a fast line",
        rounds: [250, 300],
        run: |rounds| Party::new(247, LineMode::Fast).ask(rounds),
    },
    Work { name: "request, Modbus/TCP", rounds: [100, 1_100], run: tcp_requests },
    Work { name: "line of MCode", rounds: [100, 1_100], run: mcode_lines },
];

/// Adds a drive that starts without a delay.
fn add(bench: &mut Bench, name: &str, device: Box<dyn Device>) -> DriveId {
    let setup = Setup { boot_fast: true, ..Setup::default() };
    bench.add_with(name, device, setup).expect("the name is free")
}

/// Turns a stepper with an encoder, whose edges a QSB counts, for so many edges.
fn edges(edges: u64) {
    // 26,667 microsteps/s in 1/8 steps of a motor with 200 steps, and 1,000 cycles a turn.
    const PER_SECOND: u64 = 66_667;
    let mut bench = Bench::new();
    let presets = vec![(md3::Reg::Speed as usize, 26_667), (md3::Reg::AccelDecel as usize, 100_000)];
    let setup = Setup { boot_fast: true, presets, ..Setup::default() };
    let md3 = bench.add_with("md3", Box::new(Md3::new()), setup).expect("the name is free");
    let qsb = add(&mut bench, "qsb", Box::new(Qsb::m()));
    let motor = bench
        .attach_motor("m", md3, Axis(0), MotorModel::Stepper(StepperParameters::NOMINAL))
        .expect("an MD3 turns steppers");
    let to = ["A", "B", "I"].map(|name| bench.spec(qsb).pin(name).map(|pin| (qsb, pin)));
    bench.encode(motor, 1_000, to);
    let client = bench.connect_to(qsb, Port(0)).expect("a connection is free");
    bench.run_until(100.millis());
    // Quadrature x4: each edge of both channels counts.
    bench.send(client, b"W033\r");
    bench.poke(md3, md3::Reg::MotionControl as usize, md3::motion_control::JOG.into()).expect("a register");
    bench.run_until(1.secs());
    let count = |bench: &Bench| bench.peek(qsb, qsb::Reg::ReadEncoder as usize);
    let before = count(&bench);
    bench.run_until(bench.now() + (edges * 1_000_000 / PER_SECOND).micros());
    assert!(count(&bench).abs_diff(before).abs_diff(edges) < 10, "the edges are counted");
}

/// Passes requests for ten registers to an MD3, without a bench.
fn requests_alone(count: u64) {
    struct Reply(usize);
    impl Context for Reply {
        fn put(&mut self, _at: Instant, output: Output<'_>) {
            if let Output::Bytes { bytes, .. } = output {
                self.0 = bytes.len();
            }
        }

        fn memory(&self) -> &[u8] {
            &[]
        }
    }
    let (mut drive, mut out): (Box<dyn Device>, _) = (black_box(Box::new(Md3::new())), Reply(0));
    drive.power_on(Instant::ZERO, Boot { fast: true, ..Boot::default() }, &mut out);
    let request = rtu::read(1, 0x10, 10);
    let mut at = Instant::from(1.secs());
    for _ in 0..count {
        out.0 = 0;
        drive.input(at, Input::Bytes { port: Port(0), bytes: black_box(&request) }, &mut out);
        let due = drive.deadline();
        drive.timeout(due, &mut out);
        // Address, function, count of bytes, ten words, CRC.
        assert_eq!(out.0, 3 + 2 * 10 + 2);
        at = due + 100.millis();
    }
}

/// Sends messages to a port of an MDrive, each with an answer.
fn mdrive(port: Port, message: &[u8], answer: &[u8], count: u64) {
    let mut bench = Bench::new();
    let drive = add(&mut bench, "x", Box::new(Mdrive::plus()));
    bench.run_until(1.secs());
    let client = bench.connect_to(drive, port).expect("a connection is free");
    let mut received = Vec::new();
    for _ in 0..count {
        bench.send(client, message);
        bench.run_until(bench.now() + 10.millis());
        received.clear();
        bench.receive(client, &mut received);
        assert!(received.ends_with(answer), "{}", received.escape_ascii());
    }
}

fn tcp_requests(count: u64) {
    let request = tcp::read(tcp::Header { transaction: 7, unit: 1 }, 0x8B, 2);
    // The maximum velocity, 768,000 steps per second (MCode manual 5).
    mdrive(Port(0), &request, &[1, 3, 4, 0x00, 0x0B, 0xB8, 0x00], count);
}

fn mcode_lines(count: u64) {
    mdrive(Port(1), b"PR P\r\n", b"PR P\r\n0\r\n>", count);
}

/// A bench of drives of one kind, each on a line of its own, that nobody asks anything.
fn idle(kind: &str, count: u64) {
    let mut bench = Bench::new();
    for number in 0..count {
        add(&mut bench, &format!("x{number}"), catalog::make(kind).expect("a kind"));
    }
    bench.run_until(1.secs());
}

/// What a tool of valgrind says of this program, started with these arguments. The numbers have no commas.
fn valgrind(tool: &str, arguments: [&str; 2]) -> String {
    let this = std::env::current_exe().expect("this program has a path");
    let files = ["--callgrind-out-file=/dev/null", "--dhat-out-file=/dev/null"];
    let file = files.into_iter().find(|option| option.contains(tool)).expect("one of two tools");
    let run =
        Command::new("valgrind").args([&format!("--tool={tool}"), file]).arg(this).args(arguments).output();
    let run = run.expect("valgrind runs");
    let said = String::from_utf8_lossy(&run.stderr).replace(',', "");
    assert!(run.status.success(), "valgrind failed:\n{said}");
    said
}

/// The number behind `words`.
fn number(said: &str, words: &str) -> u64 {
    let (_, behind) = said.split_once(words).expect("valgrind says what it counted");
    behind.split_whitespace().next().and_then(|number| number.parse().ok()).expect("a number")
}

/// Instructions that callgrind has counted.
fn instructions(said: &str) -> u64 {
    number(said, "Collected :")
}

/// Allocations that DHAT has counted.
fn allocations(said: &str) -> u64 {
    let (_, blocks) = said.split_once("Total:").expect("DHAT says what it counted");
    number(blocks, "bytes in")
}

/// Count of one round. `count` reads it from the output of `tool`.
fn of_round(work: &Work, tool: &str, count: fn(&str) -> u64) -> u64 {
    let [few, many] = work.rounds;
    let of = |rounds: u64| count(&valgrind(tool, [work.name, &rounds.to_string()]));
    (of(many) - of(few)) / (many - few)
}

/// Bytes of an idle drive at the highest point, and allocations until then.
fn heap(kind: &str) -> [u64; 2] {
    let [few, many] = DRIVES;
    let of = |count: u64| {
        let said = valgrind("dhat", [kind, &count.to_string()]);
        [number(&said, "At t-gmax:"), allocations(&said)]
    };
    let (few_drives, many_drives) = (of(few), of(many));
    [0, 1].map(|what| (many_drives[what] - few_drives[what]) / (many - few))
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    if let [name, rounds] = &words[..] {
        let rounds = rounds.parse().expect("a number of rounds");
        return match WORKS.iter().find(|work| work.name == name) {
            Some(work) => (work.run)(rounds),
            None => idle(name, rounds),
        };
    }
    for kind in catalog::specs().map(|spec| spec.kind) {
        let [bytes, allocations] = heap(kind);
        println!("idle {kind}, bytes: {bytes}");
        println!("idle {kind}, allocations: {allocations}");
    }
    for work in &WORKS {
        println!("{}, instructions: {}", work.name, of_round(work, "callgrind", instructions));
        println!("{}, allocations: {}", work.name, of_round(work, "dhat", allocations));
    }
}
