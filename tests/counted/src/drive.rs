// Counts the instructions that a drive on a board takes for a byte, and for a request or a command. Each
// program of a drive includes this file.

use core::cell::Cell;
use core::convert::Infallible;

use cortex_m_rt::entry;
use counted::{count, done, group};
use drivetwin_firmware::device::{Boot, Device, Duration, Framing, Instant, Line, Pin, Port};
use drivetwin_firmware::shell::{BoardEvent, Inputs, NoNetwork, Outputs, Shell};
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::registers::Space;
use embedded_hal::digital::{self, OutputPin};
use embedded_io::{Write, WriteReady};
use embedded_storage::{ReadStorage, Storage};

/// The memory of a drive that has never saved. It is larger than any drive needs.
static MEMORY: [u8; 8 << 10] = [0xFF; _];

type DriveShell<'a, D> = Shell<&'a mut D, &'a Board, Hands<'a>>;

/// Measures a drive with its factory settings: each received byte, then the whole request. The request reads
/// the first ten registers. If addresses name whole values, it reads the longest value. If the drive receives
/// text, it is the command `R0E`. Not inlined, because RAM has room for one drive.
#[inline(never)]
fn measure<D: Device>(make: impl FnOnce() -> D) {
    let mut drive = make();
    const STARTED: Duration = Duration::secs(10);
    let port = drive.spec().ports.first().expect("the drive has a port");
    let character = port.line.expect("it is a serial one").character();
    let hears_lines = port.framing == Framing::Character;
    let objects = drive.spec().registers.layout.objects;
    let registers = drive.spec().registers.list.iter();
    let registers = registers.filter(|row| row.space == Space::Holding && row.access.reads());
    let (first, words) = if objects {
        registers.map(|row| (row.address, row.shape.words())).max_by_key(|(_, words)| *words)
    } else {
        registers.map(|row| row.address).min().map(|first| (first, 10))
    }
    .expect("there is something to read");
    let board = Board::default();
    let boot = Boot { fast: true, ..Boot::default() };
    let mut shell = DriveShell::<D>::new(&mut drive, &board, Hands(&board));
    shell.power_on(Instant::ZERO, boot);
    while shell.deadline() <= Instant::ZERO + STARTED {
        board.now.set(shell.deadline());
        turn(&mut shell);
    }
    board.now.set(Instant::ZERO + STARTED);

    let hear = |byte| {
        board.now.set(board.now.get() + character);
        board.caught.set(Some(BoardEvent::Byte(Port(0), byte)));
    };
    group(c"byte received");
    let request = rtu::read(1, first, words);
    for byte in if hears_lines { b"R0E" } else { request.as_slice() } {
        hear(*byte);
        count(|| turn(&mut shell));
    }
    let answer = if hears_lines {
        group(c"command R0E");
        hear(b'\r');
        (17, *b"r 0")
    } else {
        group(if objects { c"request of the longest value" } else { c"request of 10 registers" });
        board.now.set(shell.deadline());
        (5 + 2 * usize::from(words), [1, 3, 2 * words as u8])
    };
    count(|| turn(&mut shell));
    assert_eq!(board.said.get(), answer, "the drive answers at once");
}

#[inline(never)]
fn turn<D: Device>(shell: &mut DriveShell<'_, D>) {
    // The result tells whether the board may sleep. It is not needed.
    let _ = shell.poll();
}

/// A board with only the necessary parts.
#[derive(Default)]
struct Board {
    now: Cell<Instant>,
    caught: Cell<Option<BoardEvent>>,
    /// Length and first three bytes of the drive's last message.
    said: Cell<(usize, [u8; 3])>,
}

impl Inputs for &Board {
    fn now(&self) -> Instant {
        self.now.get()
    }

    fn next_event(&mut self, _until: Instant) -> Option<(Instant, BoardEvent)> {
        self.caught.take().map(|caught| (self.now.get(), caught))
    }
}

/// The outputs of the board that the drive uses.
struct Hands<'a>(&'a Board);

impl Outputs for Hands<'_> {
    type Serial = Self;
    type Pin = Self;
    type Memory = Self;
    type Links = NoNetwork;

    fn serial(&mut self, _port: Port) -> Option<&mut Self> {
        Some(self)
    }

    fn set_line(&mut self, _port: Port, _line: Line) {}

    fn pin(&mut self, _pin: Pin) -> Option<&mut Self> {
        Some(self)
    }

    fn memory(&mut self) -> &mut Self {
        self
    }

    fn stored(&self) -> &[u8] {
        &MEMORY
    }
}

impl digital::ErrorType for Hands<'_> {
    type Error = Infallible;
}

impl OutputPin for Hands<'_> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl embedded_io::ErrorType for Hands<'_> {
    type Error = Infallible;
}

impl WriteReady for Hands<'_> {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
}

impl Write for Hands<'_> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let begin = bytes.first_chunk().copied().unwrap_or_default();
        self.0.said.set((bytes.len(), begin));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl ReadStorage for Hands<'_> {
    type Error = Infallible;

    fn read(&mut self, _offset: u32, _bytes: &mut [u8]) -> Result<(), Infallible> {
        Ok(())
    }

    fn capacity(&self) -> usize {
        0
    }
}

impl Storage for Hands<'_> {
    fn write(&mut self, _offset: u32, _bytes: &[u8]) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Defines a program from the function that makes a drive.
macro_rules! program {
    ($make:path) => {
        #[entry]
        fn main() -> ! {
            measure(|| $make());
            done()
        }
    };
}
