//! Throughput of a QSB per second: commands that it answers, records that it streams, edges that it counts.
//! The QSB runs as for users: through `dyn Device` and `dyn Context`, character by character.
//!
//! The time is the shortest of many runs. valgrind counts the instructions.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;
#[path = "support/world.rs"]
mod world;

use std::hint::black_box;

use drivetwin_firmware::device::{Boot, Context, Device, Duration, Input, Instant, Pin, Port};
use drivetwin_firmware::qsb::Qsb;

use support::{line, took};
use world::World;

/// The counting pins, by their index in the spec.
const A: Pin = Pin(0);
const B: Pin = Pin(1);

/// A QSB-M that the compiler cannot see through.
struct Adapter {
    qsb: Box<dyn Device>,
    world: World,
    at: Instant,
}

impl Adapter {
    fn new() -> Self {
        let mut qsb: Box<dyn Device> = black_box(Box::new(Qsb::m()));
        let mut world = World::default();
        qsb.power_on(Instant::ZERO, Boot { seed: 1, fast: true, ..Boot::default() }, &mut world);
        qsb.timeout(Instant::ZERO, &mut world);
        Self { qsb, world, at: Instant::from(Duration::secs(1)) }
    }

    /// Sends a command, 10 ms after the previous input.
    fn command(&mut self, command: &[u8]) {
        self.at += Duration::millis(10);
        let out: &mut dyn Context = black_box(&mut self.world);
        for character in black_box(command).chunks(1) {
            self.at += Duration::micros(44);
            self.qsb.input(self.at, Input::Bytes { port: Port(0), bytes: character }, out);
        }
    }

    /// Advances to the next record of a stream.
    fn record(&mut self) {
        let out: &mut dyn Context = black_box(&mut self.world);
        self.at = self.qsb.deadline();
        self.qsb.timeout(self.at, out);
    }

    /// A cycle of the encoder that counts up, starting from both channels high, with 1 µs for each of its
    /// four edges.
    fn turn(&mut self) {
        let out: &mut dyn Context = black_box(&mut self.world);
        for (pin, high) in black_box([(A, false), (B, false), (A, true), (B, true)]) {
            self.at += Duration::micros(1);
            self.qsb.input(self.at, Input::Edge { pin, high }, out);
        }
    }
}

/// A measured operation, which each round does `per` times.
struct Work {
    name: &'static str,
    per: u32,
    /// Commands sent before the rounds.
    before: &'static [&'static [u8]],
    round: fn(&mut Adapter),
    /// Command sent after the given number of rounds, and its expected reply.
    check: fn(u64) -> (&'static [u8], String),
}

const WORKS: [Work; 4] = [
    Work {
        name: "command R0E",
        per: 1,
        before: &[],
        round: |adapter| adapter.command(b"R0E\r"),
        check: |_| (b"R14\r", "r 14 0000110E !\r\n".to_owned()),
    },
    Work {
        name: "command W081F3",
        per: 1,
        before: &[],
        round: |adapter| adapter.command(b"W081F3\r"),
        check: |_| (b"R08\r", "r 08 000001F3 !\r\n".to_owned()),
    },
    Work {
        name: "record of a stream",
        per: 1,
        before: &[b"W0C1\r", b"S0E\r"],
        round: Adapter::record,
        check: |_| (b"R0E\r", "r 0E 00000000 !\r\n".to_owned()),
    },
    Work {
        name: "edge in x4",
        per: 4,
        // Free-running, quadrature x4.
        before: &[b"W0303\r"],
        round: Adapter::turn,
        check: |rounds| (b"R0E\r", format!("r 0E {:08X} !\r\n", 4 * rounds)),
    },
];

/// Runs `rounds` rounds and checks the result.
fn run(work: &Work, rounds: u64) {
    let mut adapter = Adapter::new();
    for command in work.before {
        adapter.command(command);
    }
    for _ in 0..rounds {
        (work.round)(&mut adapter);
    }
    let (command, answer) = (work.check)(rounds);
    adapter.command(command);
    assert_eq!(String::from_utf8_lossy(&adapter.world.answer), answer, "{}", work.name);
}

fn main() {
    if let Some((name, rounds)) = count::wanted() {
        let work = WORKS.iter().find(|work| work.name == name).expect("a work of this benchmark");
        run(work, rounds);
        return;
    }
    println!("a QSB");
    let mut all_counted = true;
    for work in &WORKS {
        const ROUNDS: u32 = 10_000;
        let least = (0..200).map(|_| took(|| run(work, ROUNDS.into()))).min().unwrap_or_default();
        let per = f64::from(work.per);
        let ns = least.as_nanos() as f64 / f64::from(ROUNDS) / per;
        let instructions = count::instructions(work.name, 1_000, 11_000);
        all_counted &= instructions.is_some();
        let counted = count::counted(instructions.map(|all| all / per));
        line(work.name, &format!("{:.2} million/s, {ns:.1} ns, {counted}", 1_000.0 / ns));
    }
    count::warn_unless(all_counted);
}
