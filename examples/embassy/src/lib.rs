//! An MD3 as a task of somebody else's firmware: embassy's time, any UART with the traits of embedded-io-async, and pins of
//! the board.
//!
//! The drive is a state machine, so the task is a loop: wait for a character, for the drive's deadline or for the next step,
//! and tell the drive. Nothing of drivetwin runs besides.
#![no_std]

use drivetwin_firmware::device::{
    self, Boot, Context, Device, Input, Instant, Level, Output, Pin, Port, advance,
};
use drivetwin_firmware::md3::{MEMORY, Md3};
use drivetwin_firmware::motion::{Step, StepIterator};
use drivetwin_protocol::line::{Line, Parity};
use embassy_futures::select::{Either3, select3};
use embassy_time::Timer;
use embedded_io_async::{Read, Write};
use heapless::Vec;

/// What the firmware does for the drive.
pub trait Board {
    /// Sets an output or a light, by its index in the drive's description: J2.9 is 4, the red light 11.
    fn set_pin(&mut self, pin: Pin, level: Level);

    /// Makes a pulse at STEP with this level at DIR.
    fn step(&mut self, forward: bool);

    /// Sets the UART to another line. The characters written so far have left.
    fn set_line(&mut self, line: Line);

    /// Stores bytes of the drive's memory in flash.
    fn store(&mut self, offset: u16, bytes: &[u8]);
}

/// What the drive wants done. A reply waits here until the UART can send it.
struct Outputs<'a, B> {
    board: &'a mut B,
    memory: [u8; MEMORY],
    reply: Vec<u8, 256>,
    line: Line,
    /// True while the UART still has the line before `line`, because a reply leaves with it.
    is_line_new: bool,
    steps: StepIterator,
    next_step: Option<Step>,
}

impl<B: Board> Context for Outputs<'_, B> {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::Bytes { bytes, .. } => {
                // The drive answers one request after the other, so the buffer is empty.
                let _ = self.reply.extend_from_slice(bytes);
            }
            Output::Level { pin, level } => self.board.set_pin(pin, level),
            // Blinking lights are left to the board; here they are on.
            Output::Wave { pin, .. } => self.board.set_pin(pin, Level::High),
            Output::Plan { plan, .. } => {
                self.steps = StepIterator::new(plan, at);
                self.next_step = self.steps.next();
            }
            Output::Step { steps, .. } => (0..steps.abs()).for_each(|_| self.board.step(steps > 0)),
            // The reply leaves with the old settings first.
            Output::Line { line, .. } => (self.line, self.is_line_new) = (line, true),
            Output::Store { offset, bytes } => {
                let place = usize::from(offset)..usize::from(offset) + bytes.len();
                if let Some(memory) = self.memory.get_mut(place) {
                    memory.copy_from_slice(bytes);
                }
                self.board.store(offset, bytes);
            }
            // Current, duty and log are for boards with a bridge or a console; an MD3 has no TCP port.
            _ => {}
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

impl<B: Board> Outputs<'_, B> {
    /// Changes the line of the UART, behind the reply.
    fn change_line(&mut self) {
        if core::mem::take(&mut self.is_line_new) {
            self.board.set_line(self.line);
        }
    }
}

/// Runs an MD3 with the saved registers in `memory` (all `0xFF` if nothing was saved), until the UART cannot send.
///
/// # Errors
/// An error of the UART when it sends.
pub async fn run<U, B>(mut uart: U, board: &mut B, memory: [u8; MEMORY]) -> Result<(), U::Error>
where
    U: Read + Write,
    B: Board,
{
    let mut drive = Md3::new();
    let plan = device::Plan::at_rest(now(), 0);
    let steps = StepIterator::new(&plan, now());
    let mut out = Outputs {
        board,
        memory,
        reply: Vec::new(),
        line: Line::new(9_600, 8, Parity::Even, 1),
        is_line_new: false,
        steps,
        next_step: None,
    };
    drive.power_on(now(), Boot::default(), &mut out);
    out.change_line();
    let mut received = [0; 32];
    let mut last = now();
    loop {
        while let Some(step) = out.next_step.filter(|step| step.at <= now()) {
            out.board.step(step.forward);
            out.next_step = out.steps.next();
        }
        let step_at = out.next_step.map_or(Instant::NEVER, |step| step.at);
        let event = select3(uart.read(&mut received), until(drive.deadline()), until(step_at)).await;
        let now = now();
        let input = match event {
            Either3::First(Ok(count)) if count > 0 => {
                // The last character ends now, the others one after the other before it.
                let first = now - out.line.character() * (count - 1) as u64;
                let bytes = received.get(..count).unwrap_or(&[]);
                Some((first.max(last), Input::Bytes { port: Port(0), bytes }))
            }
            // A framing or parity error spoils the frame, nothing else.
            Either3::First(Err(_)) => Some((now, Input::RxError { port: Port(0) })),
            _ => None,
        };
        advance(&mut drive, now, input.into_iter(), &mut out);
        last = now;
        if !out.reply.is_empty() {
            uart.write_all(&out.reply).await?;
            uart.flush().await?;
            out.reply.clear();
        }
        out.change_line();
    }
}

/// The present time in the drive's ticks of 62.5 ns.
fn now() -> Instant {
    Instant::from_ticks(embassy_time::Instant::now().as_micros() * 16)
}

/// Waits until a time of the drive.
async fn until(at: Instant) {
    Timer::at(embassy_time::Instant::from_micros(at.ticks().div_ceil(16))).await;
}
