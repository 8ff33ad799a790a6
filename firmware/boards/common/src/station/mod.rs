//! The station: a drive on a board with a [cable](Cable), and what the computer at the other end does with it.
//!
//! The computer has two serial ports. The one of the bus is the drive's line beside the UART: characters arrive at the
//! drive with the times that they would have on the line, and the drive's characters go to both. The one of control
//! carries `drivetwin_control`: the computer reads registers, presses switches, turns encoders, switches the power of the
//! drive and gets a trace of what it receives and does.
//!
//! Each turn of the loop polls the cable, runs the drive, and, if the drive has nothing to do, executes one request of the
//! computer. Nothing waits for the computer: characters and events that it does not read are dropped and counted.
//!
//! | module | what it holds |
//! |---|---|
//! | `inputs` | inputs of the hardware, of the cable and of stimuli, in the order of their times |
//! | `receiver` | characters from the cable, and their times |
//! | `packet` | characters for the cable |
//! | `pins` | signals at the pins, of wires and of stimuli |
//! | `trains` | trains of pulses, turning encoders |
//! | `events` | events that are due |
//! | `outputs` | the board's outputs, noted for the computer; a memory in which power fails |
//! | `motion`, `counts` | motion that the drive commands; statistics |
//! | `trace`, `convert` | the trace, and its events |
//! | `control` | requests and replies as frames |
//! | `calls` | what the station does for a request |

mod calls;
mod control;
mod convert;
mod counts;
mod events;
mod inputs;
mod motion;
mod outputs;
mod packet;
mod pins;
mod receiver;
mod trace;
mod trains;

use drivetwin_control::Event;
use drivetwin_firmware::device::{Axis, Boot, Device, Instant};
use drivetwin_firmware::shell::{Links, Shell};
use embedded_storage::Storage;

use self::control::Control;
use self::events::Events;
use self::inputs::StationInputs;
use self::outputs::StationOutputs;
use self::packet::Packet;
use crate::board::{Board, Leave, wire_outputs};
use crate::bus::Uart;
use crate::cable::{Cable, CablePort};

/// Number of bytes of the ring for the [trace](drivetwin_control::Events). A drive with a user program saves 4 KiB at once,
/// and other events come beside.
pub const TRACE: usize = 6_144;

/// Number of edges in a second that all trains of pulses and encoders together may have (BOARD-15).
pub const MOST_EDGES: u64 = 20_000;

/// Number of turns in which a busy drive keeps the station from the cable.
const PATIENCE: u8 = 64;

/// A drive on a board with a cable, and its loop.
pub struct Station<'a, B: Board, D, M, L, const CHARACTERS: usize, const WIRES: usize> {
    drive: OnStation<'a, B, D, M, L, CHARACTERS, WIRES>,
    cable: B::Cable,
    control: Control,
    packet: Packet,
    /// Turns since the last look at the cable.
    waited: u8,
}

/// The shell of the drive, with its power.
struct OnStation<'a, B: Board, D, M, L, const CHARACTERS: usize, const WIRES: usize> {
    shell: Shell<&'a mut D, StationInputs<B>, StationOutputs<'a, B, M, L, WIRES>, CHARACTERS>,
    boot: Boot,
    is_on: bool,
    /// Time at which the image ends, and the function that ends it.
    leaves: Option<(Instant, Leave)>,
}

impl<'a, B, D, M, L, const CHARACTERS: usize, const WIRES: usize> Station<'a, B, D, M, L, CHARACTERS, WIRES>
where
    B: Board,
    D: Device,
    M: Storage + AsRef<[u8]>,
    L: Links,
{
    /// Puts a drive on a board that has [started](Board::start), as [`run`](crate::run()) does. `ring` is the memory of the
    /// trace. The stack that this needs is free again when it returns.
    #[inline(never)]
    pub fn new(
        drive: &'a mut D,
        wires: &[B::Wire; WIRES],
        memory: M,
        links: Option<L>,
        boot: Boot,
        ring: &'a mut [u8; TRACE],
    ) -> Self {
        let spec = drive.spec();
        let outputs =
            StationOutputs::new(spec, wire_outputs::<B, _, _, WIRES>(spec, wires, memory, links), ring);
        let shell = Shell::new(drive, StationInputs::new(spec), outputs);
        let drive = OnStation { shell, boot, is_on: false, leaves: None };
        Self { drive, cable: B::cable(), control: Control::new(), packet: Packet::new(), waited: 0 }
    }

    /// Switches the power of the drive on, and enables the interrupts.
    pub fn start(&mut self) {
        self.drive.start(Instant::ZERO);
        // Not enabled earlier, because the stack is deepest while the drive is put on the board.
        B::unmask();
        B::log(self.drive.shell.device().spec().kind, self.drive.boot);
    }

    /// One turn of the loop. It ends with a sleep if nothing is to be done.
    pub fn turn(&mut self) {
        B::feed();
        B::Uart::bus().look();
        let is_busy = self.drive.run();
        if is_busy && self.waited < PATIENCE {
            self.waited += 1;
            return;
        }
        self.waited = 0;
        self.cable.poll();
        self.serve_bus();
        let Self { drive, cable, control, .. } = self;
        if !control.serve(cable, drive) && !is_busy {
            B::sleep_until(self.drive.deadline());
        }
    }

    /// The drive.
    #[must_use]
    pub fn device(&self) -> &D {
        self.drive.shell.device()
    }

    /// Passes characters between the cable and the drive.
    fn serve_bus(&mut self) {
        let Self { drive, cable, packet, .. } = self;
        let line = drive.shell.outputs().line();
        drive.shell.inputs().listen(B::past(), cable, line);
        let Some(tap) = B::Uart::tap() else { return };
        tap.look();
        packet.fill(tap, B::Uart::bus().sends());
        if cable.is_open(CablePort::Bus) && cable.line() == Some(line) {
            packet.send(cable);
        } else {
            packet.clear();
        }
    }
}

impl<B, D, M, L, const CHARACTERS: usize, const WIRES: usize> OnStation<'_, B, D, M, L, CHARACTERS, WIRES>
where
    B: Board,
    D: Device,
    M: Storage + AsRef<[u8]>,
    L: Links,
{
    /// Switches the power on at `at`.
    fn start(&mut self, at: Instant) {
        self.is_on = true;
        self.shell.outputs().power_on(at);
        self.shell.power_on(at, self.boot);
    }

    /// Does what is due. Returns `true` if there was something.
    fn run(&mut self) -> bool {
        if let Some((at, leave)) = self.leaves
            && B::past() >= at
        {
            leave();
        }
        if !self.is_on {
            self.shell.inputs().skip(B::past());
            return false;
        }
        let is_busy = self.shell.poll().is_ok();
        if self.shell.outputs().has_failed() {
            self.power_off(B::past());
        }
        is_busy
    }

    /// Time of the next work, if no input comes until then.
    fn deadline(&mut self) -> Instant {
        let due = self.shell.inputs().due().min(self.leaves.map_or(Instant::NEVER, |(at, _)| at));
        if self.is_on { due.min(self.shell.deadline()) } else { due }
    }

    fn power_on(&mut self, at: Instant) {
        if !self.is_on {
            self.shell.inputs().skip(at);
            self.start(at);
            self.shell.inputs().report(at);
        }
    }

    fn power_off(&mut self, at: Instant) {
        if self.is_on {
            self.is_on = false;
            let position = self.motion(at).map_or(0, |motion| motion.position);
            self.shell.power_off();
            self.shell.outputs().power_off(at, position);
        }
    }

    fn motion(&mut self, at: Instant) -> Option<drivetwin_control::Motion> {
        let shaft = self.shell.device().shaft(self.shell.drive_time(at), Axis(0));
        self.shell.outputs().motion(at, shaft)
    }

    fn note(&mut self, at: Instant, event: &Event<'_>) {
        self.shell.outputs().trace().put(at, event);
    }
}
