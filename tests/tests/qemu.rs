//! The image of the LM3S6965 board under QEMU: the unchanged firmware, with requests over its UART.
//!
//! `cargo xtask test` builds the image, names it in `DRIVETWIN_BOARD` and runs this test. QEMU's UARTs do not
//! pace bytes, so gaps are not tested. A master without an answer repeats its request, as masters do.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use drivetwin_protocol::modbus::{Expect, Scan, rtu};
use drivetwin_tests::md3::{at, bit};

/// Longest time that a master waits for an answer. The drive's start-up takes 2.5 s.
const PATIENCE: Duration = Duration::from_secs(3);
/// Number of times that a request is sent before the test fails.
const TRIES: usize = 20;

/// A running board. QEMU ends when this value is dropped, or when the thread that started it ends.
struct Board {
    qemu: Child,
    bus: ChildStdin,
    heard: Receiver<u8>,
    /// Lines from UART1 of the board.
    said: Receiver<String>,
    /// Connection for qtest, QEMU's protocol for tests.
    control: TcpStream,
}

impl Board {
    /// Starts the image and waits until it reports that the drive has power. Only the test of the watchdog
    /// sets `watchdog`, because a busy machine may stop QEMU for a second.
    fn boot(watchdog: bool) -> Self {
        let control = TcpListener::bind("127.0.0.1:0").expect("a port is free");
        let qtest = format!("tcp:{}", control.local_addr().expect("it is bound"));
        let action = if watchdog { "watchdog=reset" } else { "watchdog=none" };
        let image = std::env::var("DRIVETWIN_BOARD").expect("DRIVETWIN_BOARD names the image");
        let mut qemu = Command::new("setpriv")
            .args(["--pdeathsig", "KILL", "qemu-system-arm", "-M", "lm3s6965evb", "-display", "none"])
            .args(["-monitor", "none", "-serial", "stdio", "-serial", "file:/dev/stderr", "-kernel", &image])
            .args(["-accel", "tcg", "-qtest", &qtest, "-qtest-log", "none", "-action", action])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("qemu-system-arm starts");
        let bus = qemu.stdin.take().expect("it is piped");
        let out = BufReader::new(qemu.stdout.take().expect("it is piped"));
        let lines = BufReader::new(qemu.stderr.take().expect("it is piped"));

        let (hear, heard) = channel();
        thread::spawn(move || out.bytes().map_while(Result::ok).try_for_each(|byte| hear.send(byte)));
        let (say, said) = channel();
        thread::spawn(move || lines.lines().map_while(Result::ok).try_for_each(|line| say.send(line)));

        let (control, _) = control.accept().expect("QEMU calls");
        let board = Self { qemu, bus, heard, said, control };
        board.wait_for_power();
        board
    }

    /// Waits until the board reports that the drive has power, at the first start or a later one.
    fn wait_for_power(&self) {
        let line = || self.said.recv_timeout(10 * PATIENCE).expect("the board boots");
        while !line().ends_with(" has power") {}
    }

    /// Writes a word to a hardware register.
    fn poke(&mut self, address: u32, word: u32) {
        let mut done = String::new();
        writeln!(self.control, "writel {address:#x} {word:#x}").expect("QEMU listens");
        BufReader::new(&self.control).read_line(&mut done).expect("QEMU answers");
        assert_eq!(done.trim_end(), "OK");
    }

    /// Sends a request until there is an answer, and returns the answer.
    fn ask(&mut self, request: &[u8]) -> Vec<u8> {
        for _ in 0..TRIES {
            self.bus.write_all(request).expect("QEMU listens");
            self.bus.flush().expect("QEMU listens");
            let mut answer = Vec::new();
            while let Ok(byte) = self.heard.recv_timeout(PATIENCE) {
                answer.push(byte);
                if rtu::scan(&answer, Expect::Replies) == Scan::Complete(answer.len()) {
                    return answer;
                }
            }
        }
        panic!("{request:02x?} was never answered");
    }

    /// Writes a register. The reply must repeat the request (6.2).
    fn write(&mut self, register: u16, value: u16) {
        let request = rtu::write(1, register, value);
        assert_eq!(self.ask(&request), request.as_slice());
    }

    /// Reads a register until it has this value.
    fn wait_for(&mut self, register: u16, value: u16) {
        let [high, low] = value.to_be_bytes();
        // An answer takes at least t3.5 and a character, so this is at least a minute of the board's time.
        let came = (0..12_000).any(|_| self.ask(&rtu::read(1, register, 1)) == answer(&[3, 2, high, low]));
        assert!(came, "{register:#04x} never was {value:#06x}");
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.qemu.kill();
        let _ = self.qemu.wait();
    }
}

/// A reply frame of the drive.
fn answer(pdu: &[u8]) -> Vec<u8> {
    rtu::frame(1, pdu).to_vec()
}

#[test]
#[ignore = "needs QEMU and the image of the board: `cargo xtask test` brings both"]
fn the_board_answers() {
    let mut board = Board::boot(false);
    // Chapter 7: SpeedHigh and SpeedLow of a new drive.
    assert_eq!(board.ask(&rtu::read(1, at::SPEED, 2)), answer(&[3, 4, 0x00, 0x00, 0x13, 0x88]));
    // Sections 6.2, 7.23: a write and a read of UserRegister.
    board.write(at::USER, 0x1234);
    assert_eq!(board.ask(&rtu::read(1, at::USER, 1)), answer(&[3, 2, 0x12, 0x34]));
    // Sections 6.1, 6.2: exceptions.
    assert_eq!(board.ask(&rtu::frame(1, &[4, 0, 0, 0, 1])), answer(&[0x84, 1]));
    assert_eq!(board.ask(&rtu::write(1, at::PRODUCT, 0)), answer(&[0x86, 2]));
    // Section 7.15: the bit of a move reads 1 while the motor moves, then 0.
    board.write(at::MOTION, bit::MOVE);
    assert_eq!(board.ask(&rtu::read(1, at::MOTION, 1)), answer(&[3, 2, 0, 1]));
    board.wait_for(at::MOTION, 0);
    // Section 7.20: after a save the status of the CRC is 0.
    board.write(at::EEPROM, 1);
    board.wait_for(at::EEPROM, 0);
    // Section 7.22: the UART changes its rate after the reply, and communication continues.
    board.write(at::SERIAL_PORT, 0x25);
    assert_eq!(board.ask(&rtu::read(1, at::SERIAL_PORT, 1)), answer(&[3, 2, 0, 0x25]));
}

#[test]
#[ignore = "needs QEMU and the image of the board: `cargo xtask test` brings both"]
fn a_board_that_hangs_starts_again_with_what_it_saved() {
    /// Control of SysTick in every Cortex-M3 (ARMv7-M B3.3.3). Writing 0 stops the clock that wakes the loop.
    const SYST_CSR: u32 = 0xE000_E010;

    let mut board = Board::boot(true);
    board.write(at::USER, 0x1234);
    board.write(at::EEPROM, 1);
    board.wait_for(at::EEPROM, 0);
    board.write(at::USER, 0x5678);
    board.poke(SYST_CSR, 0);
    board.wait_for_power();
    assert_eq!(board.ask(&rtu::read(1, at::USER, 1)), answer(&[3, 2, 0x12, 0x34]));
}
