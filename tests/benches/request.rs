//! Time and instructions of an RTU request, function 3 for 10 registers, from its characters to its reply. An
//! MD3 runs as in `drivetwin`, through `dyn Device` and `dyn Context`. It is compared with the `rmodbus`
//! crate on the same frame.
//!
//! The time is the shortest of many runs. valgrind counts the instructions.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;
#[path = "support/world.rs"]
mod world;

use std::hint::black_box;

use drivetwin_firmware::device::{Boot, Context, Device, Duration, Input, Instant, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_protocol::modbus::rtu;
use rmodbus::server::ModbusFrame;
use rmodbus::server::context::ModbusContext;
use rmodbus::server::storage::ModbusStorage;
use rmodbus::{ModbusFrameBuf, ModbusProto};

use support::{line, took};
use world::World;

/// The first register and the number of registers.
const FIRST: u16 = 0x10;
const COUNT: u16 = 10;
/// Values of these registers in a new MD3 (chapter 7).
const VALUES: [u16; COUNT as usize] = [0, 0, 0, 0x2710, 0, 0x1388, 0, 0x09c4, 0, 0x2710];

/// An implementation that answers the request.
trait Slave {
    const NAME: &'static str;

    fn new() -> Self;

    /// Answers one request.
    fn serve(&mut self);

    /// The last reply.
    fn answer(&self) -> Vec<u8>;
}

/// An MD3 that the compiler cannot see through.
struct Drivetwin {
    md3: Box<dyn Device>,
    world: World,
    request: Vec<u8>,
    at: Instant,
}

impl Slave for Drivetwin {
    const NAME: &'static str = "drivetwin, an MD3";

    fn new() -> Self {
        let mut md3: Box<dyn Device> = black_box(Box::new(Md3::new()));
        let mut world = World::default();
        md3.power_on(Instant::ZERO, Boot { seed: 1, fast: true, ..Boot::default() }, &mut world);
        let request = rtu::read(1, FIRST, COUNT).to_vec();
        Self { md3, world, request, at: Instant::from(Duration::secs(1)) }
    }

    fn serve(&mut self) {
        let out: &mut dyn Context = black_box(&mut self.world);
        self.md3.input(self.at, Input::Bytes { port: Port(0), bytes: black_box(&self.request) }, out);
        let due = self.md3.deadline();
        self.md3.timeout(due, out);
        self.at = due + Duration::millis(100);
    }

    fn answer(&self) -> Vec<u8> {
        self.world.answer.clone()
    }
}

/// The crate `rmodbus`, used as its documentation shows.
struct Rmodbus {
    registers: ModbusStorage<0, 0, 0, 32>,
    request: ModbusFrameBuf,
    answer: Vec<u8>,
}

impl Slave for Rmodbus {
    const NAME: &'static str = "rmodbus";

    fn new() -> Self {
        let mut registers = ModbusStorage::new();
        registers.set_holdings_bulk(FIRST, &VALUES).expect("there are 32 registers");
        let mut request = [0; 256];
        let frame = rtu::read(1, FIRST, COUNT);
        request[..frame.len()].copy_from_slice(&frame);
        Self { registers, request, answer: Vec::with_capacity(256) }
    }

    fn serve(&mut self) {
        self.answer.clear();
        let request = black_box(&self.request);
        let mut frame = ModbusFrame::new(1, request, ModbusProto::Rtu, &mut self.answer);
        frame.parse().expect("the request is good");
        frame.process_read(&self.registers).expect("the registers are there");
        frame.finalize_response().expect("the answer fits");
    }

    fn answer(&self) -> Vec<u8> {
        self.answer.clone()
    }
}

/// The reply that every measured implementation must give.
fn expected() -> Vec<u8> {
    let values = VALUES.iter().flat_map(|value| value.to_be_bytes());
    rtu::frame(1, &[3, 2 * COUNT as u8].into_iter().chain(values).collect::<Vec<_>>()).to_vec()
}

/// Answers `requests` requests and checks the last reply.
fn serve<S: Slave>(requests: u64) {
    let mut slave = S::new();
    for _ in 0..requests {
        slave.serve();
    }
    assert_eq!(slave.answer(), expected(), "{}", S::NAME);
}

fn serve_named(name: &str, requests: u64) {
    match name {
        Drivetwin::NAME => serve::<Drivetwin>(requests),
        Rmodbus::NAME => serve::<Rmodbus>(requests),
        _ => panic!("there is no implementation {name}"),
    }
}

/// The shortest time of one call of `act`, in ns, of `runs` runs with `calls` calls each.
fn least_ns(runs: u32, calls: u32, mut act: impl FnMut()) -> f64 {
    let least = (0..runs).map(|_| took(|| (0..calls).for_each(|_| act()))).min();
    least.unwrap_or_default().as_nanos() as f64 / f64::from(calls)
}

/// Measures one slave; returns ns and instructions of a request.
fn measure<S: Slave>() -> (f64, Option<f64>) {
    serve::<S>(1);
    let mut slave = S::new();
    let ns = least_ns(200, 10_000, || slave.serve());
    assert_eq!(slave.answer(), expected(), "{}", S::NAME);
    let instructions = count::instructions(S::NAME, 1_000, 11_000);
    line(S::NAME, &format!("{ns:.1} ns, {}", count::counted(instructions)));
    (ns, instructions)
}

fn main() {
    if let Some((name, requests)) = count::wanted() {
        serve_named(&name, requests);
        return;
    }
    println!("one request: function 3, {COUNT} registers");
    let (ours, our_instructions) = measure::<Drivetwin>();
    let (theirs, their_instructions) = measure::<Rmodbus>();
    let ratio = match (our_instructions, their_instructions) {
        (Some(ours), Some(theirs)) => format!(", {:.2} of its instructions", ours / theirs),
        _ => String::new(),
    };
    line("drivetwin : rmodbus", &format!("{:.2} of its time{ratio}", ours / theirs));
    count::warn_unless(our_instructions.is_some());
}
