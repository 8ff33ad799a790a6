//! The task with embassy's mock of time: a request, its reply, and every step of the move.

use std::cell::RefCell;
use std::convert::Infallible;
use std::future::{Future as _, poll_fn};
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use drivetwin_firmware::device::{Level, Pin};
use drivetwin_firmware::md3::MEMORY;
use drivetwin_protocol::line::Line;
use drivetwin_protocol::modbus::rtu;
use embassy_time::{Duration, MockDriver};
use embedded_io_async::{ErrorType, Read, Write};
use md3_embassy::Board;

/// A UART whose characters come from a test.
#[derive(Default)]
struct Uart {
    to_drive: RefCell<Vec<u8>>,
    from_drive: RefCell<Vec<u8>>,
}

impl ErrorType for &Uart {
    type Error = Infallible;
}

impl Read for &Uart {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|_| {
            let mut waiting = self.to_drive.borrow_mut();
            let count = waiting.len().min(buffer.len());
            if count == 0 {
                return Poll::Pending;
            }
            buffer[..count].copy_from_slice(&waiting[..count]);
            waiting.drain(..count);
            Poll::Ready(Ok(count))
        })
        .await
    }
}

impl Write for &Uart {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.from_drive.borrow_mut().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

struct Recorder<'a> {
    uart: &'a Uart,
    position: RefCell<i32>,
    /// Settings of the line, each with the number of characters sent before it.
    lines: RefCell<Vec<(u32, usize)>>,
}

impl<'a> Recorder<'a> {
    fn new(uart: &'a Uart) -> Self {
        Self { uart, position: RefCell::default(), lines: RefCell::default() }
    }
}

impl Board for &Recorder<'_> {
    fn set_pin(&mut self, _pin: Pin, _level: Level) {}

    fn step(&mut self, forward: bool) {
        *self.position.borrow_mut() += if forward { 1 } else { -1 };
    }

    fn set_line(&mut self, line: Line) {
        self.lines.borrow_mut().push((line.baud, self.uart.from_drive.borrow().len()));
    }

    fn store(&mut self, _offset: u16, _bytes: &[u8]) {}
}

#[test]
fn a_move_by_the_bus_makes_its_steps() {
    let uart = Uart::default();
    let recorder = Recorder::new(&uart);
    let mut board = &recorder;
    let mut task = pin!(md3_embassy::run(&uart, &mut board, [0xFF; MEMORY]));
    let mut advance = |milliseconds: u64| {
        for _ in 0..milliseconds * 20 {
            MockDriver::get().advance(Duration::from_micros(50));
            assert!(task.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_pending());
        }
    };
    advance(2_600); // The start-up takes 2.5 s.
    // MotionControl = move: 10,000 steps in 2.5 s (7.15).
    let request = rtu::write(1, 0x11, 1);
    uart.to_drive.borrow_mut().extend_from_slice(&request);
    advance(20);
    assert_eq!(uart.from_drive.borrow()[..], request[..]);
    advance(1_000);
    assert!((1_000..10_000).contains(&*recorder.position.borrow()));
    advance(2_000);
    assert_eq!(*recorder.position.borrow(), 10_000);
    // SerialPortConfiguration = 460,800 baud (7.22): the reply leaves with the old settings.
    let request = rtu::write(1, 0x1C, 0x27);
    uart.to_drive.borrow_mut().extend_from_slice(&request);
    advance(20);
    assert_eq!(uart.from_drive.borrow()[request.len()..], request[..]);
    assert_eq!(*recorder.lines.borrow(), [(9_600, 0), (460_800, 2 * request.len())]);
}
