//! TCP ports of a drive and remote serial ports, reached through sockets.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::os::unix::net::UnixStream;
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;

use drivetwin_firmware::device::{Instant, Port};
use drivetwin_sim::bench::{Bench, DriveId, Outlet, PowerAction, Setup, Statistics};
use drivetwin_sim::catalog;
use drivetwin_sim::config::time_mode::TimeMode;

use super::{Ports, bind};
use crate::event_loop::{BenchHandle, EventLoop, handle};
use drivetwin_sim::testing::echo_device::{EchoDevice, MCODE, MODBUS};

/// Timeout that is longer than every action of these tests.
const LONG: Duration = Duration::from_secs(20);

/// An echo device on a bench with an event loop, which runs on a thread of its own.
struct Running {
    addresses: [SocketAddr; 2],
    drive: DriveId,
    bench_handle: BenchHandle,
    stop: UnixStream,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    fn start(time_mode: TimeMode) -> Self {
        let (stop, stopped) = UnixStream::pair().unwrap();
        let (ready, started) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            let mut bench = Bench::new();
            let drive = bench.add::<EchoDevice>("echo");
            let mut ports = Ports::new().unwrap();
            let addresses = [MODBUS, MCODE].map(|port| {
                let uri = ports.add_tcp(Outlet::Tcp(drive, port), bind("127.0.0.1:0").unwrap()).unwrap();
                uri.strip_prefix("tcp:").unwrap().parse().unwrap()
            });
            let (bench_handle, inbox) = handle().unwrap();
            ready.send((addresses, drive, bench_handle)).unwrap();
            EventLoop::new(bench, ports, time_mode, Vec::new(), inbox).run(&stopped).unwrap();
        });
        let (addresses, drive, bench_handle) = started.recv().unwrap();
        Self { addresses, drive, bench_handle, stop, thread: Some(thread) }
    }

    fn connect(&self, port: Port) -> TcpStream {
        let stream = TcpStream::connect(self.addresses[usize::from(port.0)]).unwrap();
        stream.set_nodelay(true).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        stream.set_write_timeout(Some(LONG)).unwrap();
        stream
    }

    /// Connects to the text port, and reads its greeting.
    fn greeted(&self) -> TcpStream {
        let mut stream = self.connect(MCODE);
        expect(&mut stream, b">");
        stream
    }

    /// Calls `act` with the bench, on the bench's thread, and returns the result.
    fn call<T: Send + 'static>(&self, act: impl FnOnce(&mut Bench, DriveId) -> T + Send + 'static) -> T {
        let (done, result) = mpsc::channel();
        let drive = self.drive;
        let caller = std::sync::Arc::new(());
        self.bench_handle.submit(std::sync::Arc::downgrade(&caller), move |host| {
            let result = act(&mut host.bench, drive);
            host.begin_idle_run();
            move || done.send(result).unwrap()
        });
        result.recv_timeout(LONG).unwrap()
    }

    /// Waits until `count` clients are connected.
    fn until_connected(&self, port: Port, count: usize) {
        while self.call(move |bench, drive| bench.connections(drive, port)) != count {
            std::thread::yield_now();
        }
    }

    fn statistics(&self, port: Port) -> Statistics {
        self.call(move |bench, drive| bench.statistics(drive, port))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.write_all(&[0]).unwrap();
        let ended = self.thread.take().unwrap().join();
        assert!(ended.is_ok() || std::thread::panicking(), "the bench's thread has panicked");
    }
}

/// A request that reads the maximum velocity of an MDrive (FB 4.2.4). The argument is the transaction number.
fn adu(transaction: u8) -> [u8; 12] {
    [0, transaction, 0, 0, 0, 6, 1, 3, 0x00, 0x8B, 0x00, 0x02]
}

fn expect(stream: &mut TcpStream, expected: &[u8]) {
    let mut came = vec![0; expected.len()];
    stream.read_exact(&mut came).unwrap();
    assert_eq!(came, expected);
}

fn exchange(stream: &mut TcpStream, transaction: u8) {
    stream.write_all(&adu(transaction)).unwrap();
    expect(stream, &adu(transaction));
}

/// Reads until the other end closes the connection without an error.
fn rest(stream: &mut TcpStream) -> Vec<u8> {
    let mut rest = Vec::new();
    stream.read_to_end(&mut rest).unwrap();
    rest
}

/// Returns whether the connection is closed, with or without an error.
fn is_closed(stream: &mut TcpStream) -> bool {
    match stream.read(&mut [0]) {
        Ok(count) => count == 0,
        Err(error) => matches!(error.kind(), ErrorKind::ConnectionReset | ErrorKind::BrokenPipe),
    }
}

#[test]
fn requests_are_answered_however_they_come() {
    let running = Running::start(TimeMode::Times(1));
    let mut stream = running.connect(MODBUS);
    let asked: Vec<u8> = (0..200).flat_map(adu).collect();
    stream.write_all(&asked).unwrap();
    expect(&mut stream, &asked);
    for byte in adu(7) {
        stream.write_all(&[byte]).unwrap();
    }
    expect(&mut stream, &adu(7));
    let mut text = running.greeted();
    text.write_all(b"PR P\r\nM").unwrap();
    expect(&mut text, b"PR P\r\nM");
    let seen = running.statistics(MODBUS);
    assert_eq!((seen.messages, seen.requests, seen.connections), (201, 201, 1));
}

#[test]
fn a_browser_reaches_no_drive() {
    let running = Running::start(TimeMode::Times(1));
    for port in [MODBUS, MCODE] {
        for pieces in [1, 7] {
            let mut stream = if port == MCODE { running.greeted() } else { running.connect(port) };
            let request =
                b"POST /x HTTP/1.1\r\nHost: localhost\r\nContent-Type: text/plain\r\n\r\nMR 1000\r\n";
            for piece in request.chunks(request.len().div_ceil(pieces)) {
                // The connection may be closed by now.
                let _ = stream.write_all(piece);
            }
            assert!(is_closed(&mut stream), "nothing is answered");
            running.until_connected(port, 0);
        }
        assert_eq!(running.statistics(port).messages, 0, "nothing is heard");
    }
    // Letters that may begin an HTTP request are delivered when the client ends its output.
    let mut text = running.greeted();
    text.write_all(b"P").unwrap();
    text.shutdown(Shutdown::Write).unwrap();
    assert_eq!(rest(&mut text), b"P");
}

#[test]
fn a_slow_sender_delays_no_other_client() {
    let running = Running::start(TimeMode::Times(1));
    let (mut slow, mut other) = (running.connect(MODBUS), running.connect(MODBUS));
    slow.write_all(&adu(1)[..11]).unwrap();
    for transaction in 0..100 {
        exchange(&mut other, transaction);
    }
    slow.write_all(&adu(1)[11..]).unwrap();
    expect(&mut slow, &adu(1));
}

#[test]
fn a_wrong_header_is_the_end_of_one_connection() {
    let running = Running::start(TimeMode::Times(1));
    let (mut stream, mut other) = (running.connect(MODBUS), running.connect(MODBUS));
    exchange(&mut other, 1);
    let request = b"GET / HTTP/1.1\r\n\r\n";
    stream.write_all(&[&adu(2), &request[..]].concat()).unwrap();
    assert_eq!(rest(&mut stream), adu(2));
    running.until_connected(MODBUS, 1);
    assert_eq!(running.statistics(MODBUS).broken, 1);
    exchange(&mut other, 3);
}

#[test]
fn the_65th_is_closed_at_once_and_the_others_are_served() {
    let running = Running::start(TimeMode::Times(1));
    let mut streams: Vec<TcpStream> = (0..64).map(|_| running.connect(MODBUS)).collect();
    for (transaction, stream) in (0..).zip(&mut streams) {
        exchange(stream, transaction);
    }
    assert!(is_closed(&mut running.connect(MODBUS)));
    // A client that leaves makes room for another one.
    for transaction in 0..100 {
        drop(streams.pop());
        // The system does not report closings and openings in the order in which they happened.
        running.until_connected(MODBUS, 63);
        streams.push(running.connect(MODBUS));
        exchange(streams.last_mut().unwrap(), transaction);
    }
    streams.iter_mut().for_each(|stream| exchange(stream, 10));
}

#[test]
fn a_drive_closes_when_all_is_read_that_it_said() {
    let running = Running::start(TimeMode::Times(1));
    let mut stream = running.greeted();
    stream.write_all(b"fabx").unwrap();
    let came = rest(&mut stream);
    assert_eq!((came.len(), &came[1 << 20..]), ((1 << 20) + 2, &b"ab"[..]));
    running.until_connected(MCODE, 0);
}

#[test]
fn a_drive_without_power_refuses_connections() {
    let running = Running::start(TimeMode::Times(1));
    let mut stream = running.connect(MODBUS);
    exchange(&mut stream, 1);
    running.call(|bench, drive| bench.power(drive, PowerAction::Off));
    assert_eq!(rest(&mut stream), [0; 0]);
    assert!(is_closed(&mut running.connect(MODBUS)));
    running.call(|bench, drive| bench.power(drive, PowerAction::On));
    let mut stream = running.connect(MODBUS);
    exchange(&mut stream, 2);
    running.call(|bench, drive| bench.power(drive, PowerAction::Cycle));
    assert_eq!(rest(&mut stream), [0; 0]);
    exchange(&mut running.connect(MODBUS), 3);
}

#[test]
fn a_client_that_has_sent_all_gets_its_answers_and_then_the_end() {
    let running = Running::start(TimeMode::Times(1));
    let mut stream = running.connect(MODBUS);
    let asked: Vec<u8> = (0..100).flat_map(adu).collect();
    stream.write_all(&asked).unwrap();
    // A partial request is dropped.
    stream.write_all(&adu(100)[..7]).unwrap();
    stream.shutdown(Shutdown::Write).unwrap();
    assert_eq!(rest(&mut stream), asked);
    running.until_connected(MODBUS, 0);
}

#[test]
fn who_does_not_read_is_not_read() {
    // 65 MB, more than the system holds between two sockets.
    const MESSAGES: usize = 250_000;
    let mut longest = [0xA5; 260];
    longest[..6].copy_from_slice(&[0, 5, 0, 0, 0, 254]);
    let running = Running::start(TimeMode::Times(1));
    let (mut not_reading, mut other) = (running.connect(MODBUS), running.connect(MODBUS));
    let mut writer = not_reading.try_clone().unwrap();
    writer.set_write_timeout(None).unwrap();
    let thread = std::thread::spawn(move || {
        let piece = longest.repeat(100);
        (0..MESSAGES / 100).try_for_each(|_| writer.write_all(&piece))
    });
    // Waits until the bench takes none of the messages while it answers another client 200 times.
    let mut received = 0;
    loop {
        (0..200).for_each(|transaction| exchange(&mut other, transaction));
        let before = std::mem::replace(&mut received, running.statistics(MODBUS).messages);
        if received == before + 200 {
            break;
        }
    }
    assert!(received < MESSAGES as u64 / 2, "{received} of {MESSAGES}");
    let mut came = longest.repeat(100);
    for _ in 0..MESSAGES / 100 {
        not_reading.read_exact(&mut came).unwrap();
        assert!(came.chunks(260).all(|reply| reply == longest));
    }
    thread.join().unwrap().unwrap();
}

#[test]
fn many_long_answers_are_given_as_they_are_read_and_hold_up_nobody() {
    const LINES: usize = 60;
    for time_mode in [TimeMode::Times(1), TimeMode::Manual] {
        let running = Running::start(time_mode);
        let (mut not_reading, mut other) = (running.greeted(), running.greeted());
        not_reading.write_all(&b"f\r".repeat(LINES)).unwrap();
        for _ in 0..LINES {
            other.write_all(b"a").unwrap();
            expect(&mut other, b"a");
        }
        // The sockets of the system buffer a part of the replies.
        let received = running.statistics(MCODE).messages - LINES as u64;
        assert!(received < LINES as u64 / 2, "{received} of {LINES}");
        let mut came = vec![0; LINES * ((1 << 20) + 1)];
        not_reading.read_exact(&mut came).unwrap();
        assert_eq!(running.statistics(MCODE).messages, 2 * LINES as u64);
    }
}

#[test]
fn who_never_reads_is_disconnected() {
    let running = Running::start(TimeMode::Times(1));
    let (mut not_reading, mut other) = (running.greeted(), running.greeted());
    // Causes more unread bytes than the maximum, although the system buffers a part of them.
    not_reading.write_all(&[b'f'; 40]).unwrap();
    running.until_connected(MCODE, 1);
    other.write_all(b"a").unwrap();
    expect(&mut other, b"a");
}

#[test]
fn in_manual_time_the_clock_stands_while_all_is_answered() {
    let running = Running::start(TimeMode::Manual);
    let mut text = running.greeted();
    let mut stream = running.connect(MODBUS);
    for transaction in 0..20 {
        exchange(&mut stream, transaction);
    }
    text.write_all(b"a").unwrap();
    expect(&mut text, b"a");
    assert_eq!(running.call(|bench, _| bench.now()), Instant::ZERO);
    drop(stream);
    running.until_connected(MODBUS, 0);
    let last = running.call(|bench, _| {
        let trace = bench.trace();
        trace.events().last().map(|entry| trace.words(entry))
    });
    assert_eq!(last.as_deref(), Some("closed 0"));
}

#[test]
fn while_the_clock_is_advanced_all_is_answered() {
    let running = Running::start(TimeMode::Manual);
    let (mut text, mut stream) = (running.greeted(), running.connect(MODBUS));
    text.write_all(b"t").unwrap();
    expect(&mut text, b"T");
    // The advance is so long that it never ends. Each second of it sends a `T`.
    let (done, mut there) = tokio::sync::oneshot::channel();
    let caller = std::sync::Arc::new(());
    running.bench_handle.submit(std::sync::Arc::downgrade(&caller), move |host| {
        let until = host.bench.now() + drivetwin_firmware::device::Duration::secs(1 << 36);
        host.advance(until, done);
        || ()
    });
    expect(&mut text, b"T");
    (0..20).for_each(|transaction| exchange(&mut stream, transaction));
    exchange(&mut running.connect(MODBUS), 20);
    assert!(there.try_recv().is_err(), "it goes on");
    drop(there);
    assert!(running.call(|bench, _| bench.now()) > Instant::ZERO);
}

/// Runs a QSB with a remote port (RFC 2217). A client sends `bytes`, and then closes its direction of the connection.
/// Returns the bytes that the client gets, and the trace.
fn remote_port(bytes: &[u8]) -> (Vec<u8>, String) {
    let (mut stop, stopped) = UnixStream::pair().unwrap();
    let (ready, started) = mpsc::channel();
    let thread = std::thread::spawn(move || {
        let mut bench = Bench::new();
        let setup = Setup { boot_fast: true, ..Setup::default() };
        let qsb = bench.add_with("qsb-d", catalog::make("qsb-d").unwrap(), setup).unwrap();
        let bus = bench.bus(qsb, Port(0)).unwrap();
        let mut ports = Ports::new().unwrap();
        let uri = ports.add_rfc2217(bus, bind("127.0.0.1:0").unwrap()).unwrap();
        let (bench_handle, inbox) = handle().unwrap();
        ready.send((uri, bench_handle)).unwrap();
        let mut event_loop = EventLoop::new(bench, ports, TimeMode::Manual, Vec::new(), inbox);
        event_loop.run(&stopped).unwrap();
        event_loop.bench.trace().to_text()
    });
    let (uri, _bench_handle) = started.recv().unwrap();
    let mut stream = TcpStream::connect(uri.strip_prefix("rfc2217:").unwrap()).unwrap();
    stream.set_read_timeout(Some(LONG)).unwrap();
    stream.write_all(bytes).unwrap();
    stream.shutdown(Shutdown::Write).unwrap();
    let came = rest(&mut stream);
    stop.write_all(&[0]).unwrap();
    (came, thread.join().unwrap())
}

#[test]
fn a_remote_port_answers_resumes_and_hangs_up() {
    const REPLY: &[u8] = b"r 0E 00000000 !\r\n";
    // WILL COM-PORT-OPTION, FLOWCONTROL-SUSPEND, and READ ENCODER.
    let open = [255, 251, 44, 255, 250, 44, 8, 255, 240];
    let (came, trace) = remote_port(&[&open[..], b"R0E\r"].concat());
    let proposals = [255, 253, 44, 255, 253, 0, 255, 251, 0];
    let modem_state = [255, 250, 44, 107, 0xB0, 255, 240];
    assert!(came.starts_with(&[&proposals[..], &modem_state].concat()), "{came:?}");
    assert!(came.ends_with(REPLY), "{came:?}");
    let attached: Vec<&str> = trace.lines().filter(|line| line.contains("attached")).collect();
    assert!(matches!(attached[..], [on, off] if on.ends_with("on") && off.ends_with("off")), "{attached:?}");
    // Without Telnet, the connection has the bytes of the line only, and DTR does nothing.
    let (came, trace) = remote_port(b"R0E\r");
    assert_eq!((came.as_slice(), trace.contains("attached")), (REPLY, false));
}
