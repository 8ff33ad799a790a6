//! Modbus/TCP: speed of a drive's replies, compared with a server of the `tokio-modbus` crate in the same
//! run, and the resources of idle connections.
//!
//! Both run in their own processes and get requests from the same client, in turns. Their resources are read
//! from `/proc`. The server has a few registers in memory and runs on one thread, as a bench does. Each turn
//! is so long that the system's clock ticks of 10 ms do not matter.

#[path = "support/running.rs"]
mod running;
mod support;

use std::fmt::Write as _;
use std::future;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::process::Command;
use std::time::Duration;

use drivetwin_protocol::modbus::tcp::{self, HEADER_BYTES, Header};
use running::{Running, build, wait};
use support::{line, took};
use tokio_modbus::server::Service;
use tokio_modbus::server::tcp::{Server, accept_tcp_connection};
use tokio_modbus::{ExceptionCode, Request, Response};

/// Kind of the drive that gets the requests.
const KIND: &str = "mdrive";
/// Ports of the drive; the first one is Modbus/TCP.
const PORTS: usize = 2;
/// First register of a read: the maximum velocity, which has two registers.
const FIRST: u16 = 0x8B;
const COUNT: u16 = 2;

/// Requests in a turn, and turns of each server; the best turn counts.
const REQUESTS: usize = 100_000;
const TURNS: usize = 3;

/// Idle connections: number of drives, and connections to each.
const DRIVES: usize = 20;
const EACH: usize = 50;

/// Observation time of idle connections.
const WATCH: Duration = Duration::from_secs(5);

/// The argument that starts this program as the server.
const SERVE: &str = "serve";

fn main() {
    if std::env::args().nth(1).as_deref() == Some(SERVE) {
        return serve();
    }
    let drivetwin = build();
    let start = |drives: usize| {
        let mut file = String::new();
        for drive in 0..drives {
            let _ = write!(file, "[[drive]]\nname = 'd{drive}'\nkind = '{KIND}'\nfast_boot = true\n");
        }
        let mut bench = Running::start(&drivetwin, &file, &[]);
        assert_eq!(bench.places.len(), drives * PORTS, "drivetwin has started no {KIND}");
        bench.places = std::mem::take(&mut bench.places).into_iter().step_by(PORTS).collect();
        bench
    };
    let this = std::env::current_exe().expect("a benchmark is a file");
    let server = Running::of(Command::new(this).arg(SERVE));
    {
        let bench = start(1);
        for connections in [1, 50] {
            println!("{connections} connection(s), each with a request of {COUNT} registers under way");
            let (mut ours, mut theirs) = (Taken::NOTHING, Taken::NOTHING);
            for _ in 0..TURNS {
                ours = ours.best(turn(&bench, connections));
                theirs = theirs.best(turn(&server, connections));
            }
            line("drivetwin", &ours.to_string());
            line("tokio-modbus", &theirs.to_string());
            let (speed, cpu) = (ours.rate / theirs.rate, ours.cpu_us / theirs.cpu_us);
            line("drivetwin is", &format!("{speed:.2} times as fast, and takes {cpu:.2} times the CPU time"));
        }
    }
    println!("{} connections on which nothing is said", DRIVES * EACH);
    let bench = start(DRIVES);
    idle(&format!("drivetwin, {DRIVES} drives"), &bench, EACH);
    idle("tokio-modbus", &server, DRIVES * EACH);
}

/// Measured speed of requests.
#[derive(Clone, Copy)]
struct Taken {
    /// Requests per second.
    rate: f64,
    /// CPU time for each request, in µs of a core.
    cpu_us: f64,
}

impl Taken {
    const NOTHING: Self = Self { rate: 0.0, cpu_us: f64::INFINITY };

    fn best(self, other: Self) -> Self {
        Self { rate: self.rate.max(other.rate), cpu_us: self.cpu_us.min(other.cpu_us) }
    }
}

impl std::fmt::Display for Taken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.0} requests/s, {:.1} µs of a core each", self.rate, self.cpu_us)
    }
}

/// Sends requests on `connections` connections at once.
fn turn(running: &Running, connections: usize) -> Taken {
    let mut streams: Vec<TcpStream> = (0..connections).map(|_| connect(&running.places[0])).collect();
    let before = running.cpu();
    let rounds = REQUESTS / connections;
    let seconds = took(|| {
        for round in 0..rounds {
            let transaction = round as u16;
            let request = tcp::read(Header { transaction, unit: 1 }, FIRST, COUNT);
            for stream in &mut streams {
                stream.write_all(&request).expect("the server is running");
            }
            for stream in &mut streams {
                reply(stream, transaction);
            }
        }
    });
    let requests = (rounds * connections) as f64;
    Taken { rate: requests / seconds.as_secs_f64(), cpu_us: 1e6 * (running.cpu() - before) / requests }
}

fn connect(place: &String) -> TcpStream {
    let stream = TcpStream::connect(place).expect("the port is there");
    stream.set_nodelay(true).expect("it is TCP");
    stream.set_read_timeout(Some(Duration::from_secs(10))).expect("it is TCP");
    stream
}

/// Reads a reply with this transaction and all registers.
fn reply(stream: &mut TcpStream, transaction: u16) {
    let mut adu = [0; HEADER_BYTES + 2 + 2 * COUNT as usize];
    stream.read_exact(&mut adu).expect("the server answers");
    let (header, pdu) = tcp::parse(&adu).expect("a whole reply");
    assert_eq!((header.transaction, &pdu[..2]), (transaction, &[3, 2 * COUNT as u8][..]), "{adu:02X?}");
}

/// Prints the resources of idle connections, `each` of them to every address.
fn idle(name: &str, running: &Running, each: usize) {
    let memory = running.memory();
    let mut streams: Vec<TcpStream> =
        running.places.iter().flat_map(|place| (0..each).map(move |_| connect(place))).collect();
    // A reply shows that the server has accepted the connection.
    for stream in &mut streams {
        stream
            .write_all(&tcp::read(Header { transaction: 0, unit: 1 }, FIRST, COUNT))
            .expect("the server is running");
        reply(stream, 0);
    }
    let each = (running.memory() - memory) / streams.len() as f64;
    let cpu = running.cpu();
    wait(WATCH);
    let cpu = (running.cpu() - cpu) / WATCH.as_secs_f64();
    let all = running.memory();
    let cpu = 100.0 * cpu;
    line(name, &format!("{all:.0} KiB of the process, {each:.2} KiB a connection, {cpu:.2} % of a core"));
}

/// The registers of the server.
struct Registers([u16; 256]);

impl Service for Registers {
    type Request = Request<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = future::Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        future::ready(match request {
            Request::ReadHoldingRegisters(first, count) => {
                let first = usize::from(first);
                let words = self.0.get(first..first + usize::from(count));
                words
                    .map(|words| Response::ReadHoldingRegisters(words.to_vec()))
                    .ok_or(ExceptionCode::IllegalDataAddress)
            }
            _ => Err(ExceptionCode::IllegalFunction),
        })
    }
}

/// Serves the registers until the process is killed.
fn serve() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let served = runtime.block_on(async {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await?;
        println!("tcp:{}\"", listener.local_addr()?);
        let connected = |stream: tokio::net::TcpStream, peer| async move {
            stream.set_nodelay(true)?;
            accept_tcp_connection(stream, peer, |_| Ok(Some(Registers([0; 256]))))
        };
        Server::new(listener).serve(&connected, |error| eprintln!("{error}")).await
    });
    served.expect("a server");
}
