//! The board as a machine in virtual time, which stops whenever its processor sleeps (BOARD-10).
//!
//! With `-icount shift=…,sleep=off` QEMU counts time: each instruction takes a power of two of ns, and while
//! the processor is idle, time jumps to the next timer. The image has one WFI. Immediately before it, the image
//! counts its sleeps, and a watchpoint at this count stops the machine there. (A breakpoint at the WFI would do the
//! same, but QEMU discards all translated code at a breakpoint, so that the traces take four times as long.) While
//! the machine is stopped, QEMU's main loop makes the same jump, because all processors are idle. So the machine
//! always stops at the instant at which the next timer is due, before that timer expires. To skip the WFI loses
//! nothing, because a WFI may end at any time.
//!
//! An event that is already pending when the processor reaches its WFI must not wait for a jump. So there are
//! two kinds of stops. TIMER3, which no image uses and whose interrupt is off, distinguishes them:
//!
//! - While the board [runs](Machine::run), TIMER3 expires every microsecond, so that the jump at the first
//!   stop is no longer than that. If something is pending there, the board continues at once.
//! - Then the board [sleeps](Machine::sleep): the machine continues at the instruction that the
//!   watchpoint stopped, so that it executes none. The timer that was due at the stop expires, and time jumps again.
//!   If that timer was TIMER3 alone, it starts its new span, and the jump is long. If it was another timer,
//!   TIMER3 has not expired yet. Then the jump is still no longer than a microsecond, and the board must run
//!   first.
//!
//! There is one exception: another timer that is due in the same nanosecond as TIMER3. It is still pending
//! after the long jump. The machine notices that it has [`Overslept`], and the trace is played again with
//! another duration of an instruction.
//!
//! None of this depends on the speed of the host, and the image is the one that is flashed.

use std::collections::BTreeSet;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use std::{env, fmt, fs, process};

use drivetwin_firmware::device::Level;

use crate::gdb::Gdb;
use crate::image::Image;
use crate::qtest::Qtest;

/// Cycles of the board's clock in a microsecond.
pub(crate) const CYCLES_PER_US: u64 = 50;
/// Cycles in a period of SysTick.
const PERIOD: u64 = 100_000 * CYCLES_PER_US;

/// Longest time on the host from one stop to the next before the machine counts as hung.
const PATIENCE: Duration = Duration::from_secs(60);

/// SysTick's current value, and the register that shows the pending exception (B3.2.4 of the ARMv7-M manual).
const SYST_CVR: u32 = 0xE000_E018;
const ICSR: u32 = 0xE000_ED04;
const VECTPENDING: u32 = 0x1FF << 12;
const PENDSTSET: u32 = 1 << 26;

/// TIMER3: mode, control, raw status, acknowledgement, load (10.6 of the datasheet).
const TIMER3: u32 = 0x4003_3000;
const TAMR: u32 = TIMER3 + 0x004;
const CTL: u32 = TIMER3 + 0x00C;
const RIS: u32 = TIMER3 + 0x01C;
const ICR: u32 = TIMER3 + 0x024;
const TAILR: u32 = TIMER3 + 0x028;
const PERIODIC: u32 = 2;

/// UART0: the register of flags, in which bit 4 means that nothing has been received.
const UART_FLAGS: u32 = 0x4000_C018;
const RX_EMPTY: u32 = 1 << 4;
/// Number of reads of a register before a change counts as missing.
const LOOKS: usize = 1_000_000;

/// A pin of the board: the letter of its port, and its number in the port.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct Gpio(pub(crate) char, pub(crate) u32);

impl fmt::Display for Gpio {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "P{}{}", self.0, self.1)
    }
}

/// Interface of the board that carries the messages of the drive.
#[derive(Clone, Copy)]
pub(crate) enum Jack {
    Uart0,
    /// The Ethernet controller. Each frame is preceded by its length in four bytes.
    Ethernet,
}

impl Jack {
    /// Options of QEMU that connect this interface to its standard output.
    fn arguments(self) -> &'static [&'static str] {
        match self {
            Self::Uart0 => &["-chardev", "socket,id=bus,fd=1", "-serial", "chardev:bus"],
            Self::Ethernet => &["-nic", "socket,model=stellaris,fd=1"],
        }
    }
}

/// Addresses of the registers of ports A to G (8.4 of the datasheet).
const PORTS: [u32; 7] =
    [0x4000_4000, 0x4000_5000, 0x4000_6000, 0x4000_7000, 0x4002_4000, 0x4002_5000, 0x4002_6000];

/// The port whose output changes are recorded.
pub(crate) const LISTENED: char = 'B';

impl Gpio {
    /// The index of the pin's port.
    fn port(self) -> usize {
        usize::from(self.0 as u8 - b'A')
    }
}

/// A board under QEMU. QEMU ends when this is dropped, or when the thread that started it ends.
pub(crate) struct Machine {
    qemu: Child,
    gdb: Gdb,
    test: Qtest,
    /// Bytes to and from UART0, or Ethernet frames.
    line: UnixStream,
    /// QEMU's names of the ports A to G.
    ports: Vec<String>,
    /// Address of the image's count of SysTick periods.
    periods: u32,
    /// Address of the instruction after the WFI.
    wakes_at: u32,
    /// True after the first stop before the WFI; false while the board is at its first instruction.
    started: bool,
    /// Time of the last stop, in cycles of the board's clock.
    now: u64,
    /// Number of stops.
    stops: u32,
}

/// State of the board at a stop.
struct Stop {
    /// True if an exception is pending.
    pending: bool,
    /// True if TIMER3 has expired.
    ticked: bool,
}

/// The board slept although an interrupt was pending.
#[derive(Debug)]
pub(crate) struct Overslept;

impl Machine {
    /// A board with this image, stopped before its first instruction. An instruction takes 2^`shift` ns.
    pub(crate) fn new(image: &Image, jack: Jack, shift: u32) -> Self {
        let (gdb, its_gdb) = UnixStream::pair().expect("a pair of sockets");
        let (line, its_line) = UnixStream::pair().expect("a pair of sockets");
        for socket in [&gdb, &line] {
            socket.set_read_timeout(Some(PATIENCE)).expect("a time-out");
        }
        let qtest = Address::new();
        let qemu = Command::new("setpriv")
            .args(["--pdeathsig", "KILL", "qemu-system-arm", "-M", "lm3s6965evb", "-nodefaults"])
            .args(["-display", "none", "-icount", &format!("shift={shift},sleep=off"), "-S"])
            .args(["-chardev", "socket,id=gdb,fd=0", "-gdb", "chardev:gdb"])
            .args(jack.arguments())
            .args(["-qtest", &format!("unix:{},server=on,wait=off", qtest.0), "-qtest-log", "none"])
            .arg("-kernel")
            .arg(&image.path)
            .stdin(Stdio::from(OwnedFd::from(its_gdb)))
            .stdout(Stdio::from(OwnedFd::from(its_line)))
            .stderr(Stdio::null())
            .spawn()
            .expect("qemu-system-arm starts");
        let mut gdb = Gdb::new(gdb);
        gdb.greet();
        let test = UnixStream::connect(&qtest.0).expect("QEMU listens");
        test.set_read_timeout(Some(PATIENCE)).expect("a time-out");
        drop(qtest);
        // QEMU creates the ports in the order of their letters.
        let ports: Vec<String> = gdb
            .monitor("qom-list /machine/unattached")
            .lines()
            .filter(|line| line.contains("child<pl061_luminary>"))
            .filter_map(|line| line.split_whitespace().next())
            .map(|name| format!("/machine/unattached/{name}"))
            .collect();
        assert_eq!(ports.len(), 7, "QEMU's board has seven ports");
        gdb.stop_before_write(image.symbol("SLEEPS"));
        let mut machine = Self {
            qemu,
            gdb,
            test: Qtest::new(test),
            line,
            ports,
            periods: image.symbol("PERIODS"),
            wakes_at: image.wakes_at,
            started: false,
            now: 0,
            stops: 0,
        };
        let listened = machine.path(Gpio(LISTENED, 0)).to_owned();
        machine.test.listen(&listened);
        machine.test.write([(TAMR, PERIODIC)]);
        machine.tick();
        machine
    }

    /// Memory and registers of the board.
    pub(crate) fn memory(&mut self) -> &mut Qtest {
        &mut self.test
    }

    /// Resets the board. It is then stopped before its first instruction, and its inputs are undriven.
    pub(crate) fn reset(&mut self) {
        let slept_at = self.gdb.pc();
        self.gdb.monitor("system_reset");
        // QEMU takes an unknown time to reset.
        let reset = (0..LOOKS).any(|_| self.gdb.pc() != slept_at);
        assert!(reset, "QEMU resets the board");
        self.started = false;
        self.test.changes();
        self.tick();
    }

    /// Runs the board until it sleeps with nothing pending; it stops there within a microsecond. Returns the
    /// time since its last reset, in cycles of its clock.
    pub(crate) fn run(&mut self) -> u64 {
        loop {
            self.gdb.run(self.started.then_some(self.wakes_at));
            self.started = true;
            let Stop { pending, .. } = self.stop();
            if !pending {
                return self.now;
            }
        }
    }

    /// Keeps the board asleep until `until`, or until one of its own timers expires before that. Nothing may
    /// be pending. Returns the time as [`run`](Self::run) does; the next call must be `run`.
    pub(crate) fn sleep(&mut self, until: u64) -> Result<u64, Overslept> {
        let span = u32::try_from(until.saturating_sub(self.now).max(1)).unwrap_or(u32::MAX);
        // TIMER3 starts the span when it expires, which is now.
        self.test.write([(TAILR, span), (ICR, 1)]);
        self.gdb.run(None);
        let Stop { pending, ticked } = self.stop();
        self.tick();
        if ticked && pending { Err(Overslept) } else { Ok(self.now) }
    }

    /// Makes TIMER3 expire every microsecond from now on.
    fn tick(&mut self) {
        self.test.write([(CTL, 0), (TAILR, CYCLES_PER_US as u32), (CTL, 1)]);
    }

    /// Reads the time and the reason of a stop.
    fn stop(&mut self) -> Stop {
        self.stops += 1;
        // The low word of the count of periods is enough for years.
        let words = self.test.words(&[self.periods, SYST_CVR, ICSR, RIS]);
        let [periods, left, pending, ticked] = words.try_into().expect("four words");
        let periods = u64::from(periods) + u64::from(pending & PENDSTSET != 0);
        // SysTick begins a period at 0 and continues at its greatest value.
        let cycles = if left == 0 { 0 } else { PERIOD.saturating_sub(u64::from(left)) };
        self.now = periods * PERIOD + cycles;
        Stop { pending: pending & VECTPENDING != 0, ticked: ticked != 0 }
    }

    /// Sends a character to UART0.
    pub(crate) fn hear(&mut self, byte: u8) {
        self.line.write_all(&[byte]).expect("QEMU listens");
        let heard = (0..LOOKS).any(|_| self.test.word(UART_FLAGS) & RX_EMPTY == 0);
        assert!(heard, "UART0 receives what is sent to it");
    }

    /// Sends frames to the Ethernet controller, which gets them when the board continues.
    pub(crate) fn take(&mut self, frames: &[Vec<u8>]) {
        for frame in frames {
            let length = u32::try_from(frame.len()).expect("no frame is that long").to_be_bytes();
            self.line.write_all(&[&length[..], frame].concat()).expect("QEMU listens");
        }
        // QEMU keeps the frames while the machine is stopped, if it has read them before the machine
        // continues. It polls all its sockets before it answers the second query.
        for _ in 0..2 {
            self.test.word(UART_FLAGS);
        }
    }

    /// Number of stops.
    pub(crate) fn stops(&self) -> u32 {
        self.stops
    }

    /// Bytes that the board has sent since the last call.
    pub(crate) fn said(&mut self) -> Vec<u8> {
        let mut said = Vec::new();
        self.line.set_nonblocking(true).expect("a socket");
        match self.line.read_to_end(&mut said) {
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => panic!("QEMU is gone: {error}"),
            Ok(_) => panic!("QEMU is gone"),
        }
        self.line.set_nonblocking(false).expect("a socket");
        said
    }

    /// Drives an input of the board.
    pub(crate) fn drive(&mut self, gpio: Gpio, high: bool) {
        let path = self.path(gpio).to_owned();
        self.test.drive(&path, gpio.1, high);
    }

    /// Levels of output pins.
    pub(crate) fn levels(&mut self, gpios: &[Gpio]) -> Vec<Level> {
        /// The data register of all eight pins, and the direction register.
        const REGISTERS: [u32; 2] = [0x3FC, 0x400];
        let ports: BTreeSet<usize> = gpios.iter().map(|gpio| gpio.port()).collect();
        let addresses: Vec<u32> =
            ports.iter().flat_map(|port| REGISTERS.map(|register| PORTS[*port] + register)).collect();
        let words = self.test.words(&addresses);
        let level = |gpio: &Gpio| {
            let place = ports.iter().position(|port| *port == gpio.port());
            let [data, driven] = place.and_then(|place| words.chunks_exact(2).nth(place))?.try_into().ok()?;
            let is_set = |word: u32| word >> gpio.1 & 1 != 0;
            Some(match (is_set(driven), is_set(data)) {
                (false, _) => Level::Float,
                (true, false) => Level::Low,
                (true, true) => Level::High,
            })
        };
        gpios.iter().map(|gpio| level(gpio).expect("two words of its port")).collect()
    }

    /// Changes of the outputs of port B since the last call.
    pub(crate) fn changes(&mut self) -> Vec<(u32, bool)> {
        self.test.changes()
    }

    fn path(&self, gpio: Gpio) -> &str {
        &self.ports[gpio.port()]
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        let _ = self.qemu.kill();
        let _ = self.qemu.wait();
    }
}

/// Path of a socket. The file is removed when both ends have opened the socket.
struct Address(String);

impl Address {
    fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("drivetwin-qtest-{}-{number}", process::id());
        Self(env::temp_dir().join(name).to_str().expect("a path in UTF-8").to_owned())
    }
}

impl Drop for Address {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}
