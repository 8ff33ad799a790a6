//! Time and instructions of an MDrive: a Modbus/TCP request for 2 registers, and a line `PR P` of MCode with its echo and
//! answer. The drive runs as for users: through `dyn Device` and `dyn Context`, one deadline at a time.
//!
//! The time is the shortest of many runs. valgrind counts the instructions.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;

use std::hint::black_box;

use drivetwin_firmware::device::{Boot, Context, Device, Duration, Input, Instant, Link, Output, Port};
use drivetwin_firmware::mdrive::Mdrive;
use drivetwin_protocol::modbus::tcp::{self, Header};

use support::{line, took};

/// The ports of the drive.
const MODBUS: Port = Port(0);
const MCODE: Port = Port(1);
const LINK: Link = Link(0);

/// A message to the drive, and what it sends then.
struct Work {
    name: &'static str,
    port: Port,
    message: fn() -> Vec<u8>,
    /// The maximum velocity in steps per second, 768,000 by default, high word first; the position, 0 (MCode manual 5).
    answer: &'static [u8],
}

const WORKS: [Work; 2] = [
    Work {
        name: "Modbus/TCP, 2 registers",
        port: MODBUS,
        message: || tcp::read(Header { transaction: 7, unit: 1 }, 0x8B, 2).to_vec(),
        answer: &[0, 7, 0, 0, 0, 7, 1, 3, 4, 0x00, 0x0B, 0xB8, 0x00],
    },
    Work { name: "MCode, PR P", port: MCODE, message: || b"PR P\r\n".to_vec(), answer: b"PR P\r\n0\r\n>" },
];

/// A context with an erased memory. It stores what the drive sends.
struct World {
    answer: Vec<u8>,
    memory: Vec<u8>,
}

impl Context for World {
    fn put(&mut self, _at: Instant, output: Output<'_>) {
        if let Output::Message { bytes, .. } = output {
            self.answer.extend_from_slice(bytes);
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// An MDrive with an open connection on the port of the work.
struct Rig {
    mdrive: Box<dyn Device>,
    world: World,
    work: &'static Work,
    message: Vec<u8>,
    at: Instant,
}

impl Rig {
    fn new(work: &'static Work) -> Self {
        let mut mdrive: Box<dyn Device> = black_box(Box::new(Mdrive::plus()));
        let mut world = World { answer: Vec::new(), memory: vec![0xFF; usize::from(mdrive.spec().memory)] };
        mdrive.power_on(Instant::ZERO, Boot { seed: 1, fast: true, ..Boot::default() }, &mut world);
        mdrive.timeout(Instant::ZERO, &mut world);
        let at = Instant::from(Duration::secs(1));
        mdrive.input(at, Input::Opened { port: work.port, link: LINK }, &mut world);
        Self { mdrive, world, work, message: (work.message)(), at }
    }

    /// Sends the message, and lets the drive run until it has nothing more to do.
    fn serve(&mut self) {
        self.world.answer.clear();
        let out: &mut dyn Context = black_box(&mut self.world);
        let bytes = black_box(&self.message);
        self.mdrive.input(self.at, Input::Message { port: self.work.port, link: LINK, bytes }, out);
        let end = self.at + Duration::millis(10);
        while self.mdrive.deadline() <= end {
            let due = self.mdrive.deadline();
            self.mdrive.timeout(due, out);
        }
        self.at = end;
    }

    fn check(&self) {
        let (answer, expected) = (self.world.answer.escape_ascii(), self.work.answer.escape_ascii());
        assert_eq!(answer.to_string(), expected.to_string(), "{}", self.work.name);
    }
}

fn main() {
    if let Some((name, requests)) = count::wanted() {
        let work = WORKS.iter().find(|work| work.name == name).expect("a work of this benchmark");
        let mut rig = Rig::new(work);
        (0..requests).for_each(|_| rig.serve());
        return rig.check();
    }
    println!("an MDrive");
    let mut all_counted = true;
    for work in &WORKS {
        let mut rig = Rig::new(work);
        rig.serve();
        rig.check();
        let least = (0..200).map(|_| took(|| (0..1_000).for_each(|_| rig.serve()))).min();
        let ns = least.unwrap_or_default().as_nanos() as f64 / 1e3;
        let instructions = count::instructions(work.name, 1_000, 11_000);
        line(work.name, &format!("{ns:.0} ns, {}", count::counted(instructions)));
        all_counted &= instructions.is_some();
    }
    count::warn_unless(all_counted);
}
