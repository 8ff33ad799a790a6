//! The board as a machine of virtual time, which stands whenever its processor sleeps.
//!
//! With `-icount shift=…,sleep=off` QEMU's time is counted: a power of two of ns an instruction, and while
//! the processor has nothing to do, time hops to the next timer. A breakpoint on the one WFI of the image stops the
//! machine there, and while it stops, QEMU's main loop makes that very hop, because all processors are
//! idle. So the machine always stands at the instant at which a timer is due next, before it has come, and
//! nothing is lost if the WFI is then skipped: its interrupt is pending, and WFI may end at any time.
//!
//! There is one exception. What comes in the few instructions between the loop's last look and its WFI is
//! pending while time hops, where a WFI would not have waited. It is then served at the next timer, at
//! most a millisecond late, and whatever the trace has to say about that is said by its bounds. If that
//! timer is SysTick again, the board misses a millisecond: [`Machine::now`] notices, and the trace is
//! played once more with instructions that take another time.
//!
//! TIMER3, which no image uses, makes it stand where a test wants to: its interrupt is off, so that the
//! board sees nothing of it. Behind its instant it goes on every microsecond, so that a processor that
//! was busy over that instant stands right after, and so that the time of an answer is seen.
//!
//! Nothing of this depends on the speed of the host, and the image is the one that is flashed.

use std::io::{ErrorKind, Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use std::{env, fs, process};

use crate::gdb::Gdb;
use crate::image::Image;
use crate::qtest::Qtest;

/// Cycles of the board's clock in a microsecond.
pub(crate) const CYCLES_PER_US: u64 = 50;
const CYCLES_PER_MS: u64 = 1_000 * CYCLES_PER_US;

/// How long the host may take from one stop to the next before it counts as hung.
const PATIENCE: Duration = Duration::from_secs(60);

/// SysTick's current value, and the register that says whether its interrupt is pending (bit 26).
const SYST_CVR: u32 = 0xE000_E018;
const ICSR: u32 = 0xE000_ED04;
const PENDSTSET: u32 = 1 << 26;

/// TIMER3: configuration, mode, control, interrupt mask, load.
const TIMER3: u32 = 0x4003_3000;
const CFG: u32 = TIMER3;
const TAMR: u32 = TIMER3 + 0x004;
const CTL: u32 = TIMER3 + 0x00C;
const TAILR: u32 = TIMER3 + 0x028;
const PERIODIC: u32 = 2;

/// UART0: flags, of which bit 4 says that nothing has been received.
const UART_FLAGS: u32 = 0x4000_C018;
const RX_EMPTY: u32 = 1 << 4;
/// How often its flags are read until a character that was sent to it is there.
const LOOKS: usize = 1_000_000;

/// A pin of the board: the letter of its port, and its number there.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Gpio(pub(crate) char, pub(crate) u32);

/// Where the ports A to G have their registers (8.4 of the datasheet).
const PORTS: [u32; 7] =
    [0x4000_4000, 0x4000_5000, 0x4000_6000, 0x4000_7000, 0x4002_4000, 0x4002_5000, 0x4002_6000];

/// The port whose outputs are listened to.
pub(crate) const LISTENED: char = 'B';

impl Gpio {
    /// The number of its port.
    fn port(self) -> usize {
        usize::from(self.0 as u8 - b'A')
    }
}

/// A board under QEMU. It ends with this, and with the thread that started it.
pub(crate) struct Machine {
    qemu: Child,
    gdb: Gdb,
    test: Qtest,
    /// The bus: what UART0 hears and says.
    bus: UnixStream,
    /// What QEMU calls the ports A to G.
    ports: Vec<String>,
    /// Where the image counts milliseconds.
    milliseconds: u32,
    sleeps_at: u32,
    asleep: bool,
    /// It was to stand within a microsecond.
    soon: bool,
}

/// SysTick came twice before it was served once.
#[derive(Debug)]
pub(crate) struct Overslept;

impl Machine {
    /// A board with that image, which stands before its first instruction. An instruction takes 2^`shift` ns.
    pub(crate) fn new(image: &Image, shift: u32) -> Self {
        let (gdb, its_gdb) = UnixStream::pair().expect("a pair of sockets");
        let (bus, its_bus) = UnixStream::pair().expect("a pair of sockets");
        for line in [&gdb, &bus] {
            line.set_read_timeout(Some(PATIENCE)).expect("a time-out");
        }
        let qtest = Address::new();
        let qemu = Command::new("setpriv")
            .args(["--pdeathsig", "KILL", "qemu-system-arm", "-M", "lm3s6965evb", "-nodefaults"])
            .args(["-display", "none", "-icount", &format!("shift={shift},sleep=off"), "-S"])
            .args(["-chardev", "socket,id=gdb,fd=0", "-gdb", "chardev:gdb"])
            .args(["-chardev", "socket,id=bus,fd=1", "-serial", "chardev:bus"])
            .args(["-qtest", &format!("unix:{},server=on,wait=off", qtest.0), "-qtest-log", "none"])
            .arg("-kernel")
            .arg(&image.path)
            .stdin(Stdio::from(OwnedFd::from(its_gdb)))
            .stdout(Stdio::from(OwnedFd::from(its_bus)))
            .stderr(Stdio::null())
            .spawn()
            .expect("qemu-system-arm starts");
        let mut gdb = Gdb::new(gdb);
        gdb.greet();
        let test = UnixStream::connect(&qtest.0).expect("QEMU listens");
        test.set_read_timeout(Some(PATIENCE)).expect("a time-out");
        drop(qtest);
        // The order in which QEMU makes them is the order of their letters.
        let ports: Vec<String> = gdb
            .monitor("qom-list /machine/unattached")
            .lines()
            .filter(|line| line.contains("child<pl061_luminary>"))
            .filter_map(|line| line.split_whitespace().next())
            .map(|name| format!("/machine/unattached/{name}"))
            .collect();
        assert_eq!(ports.len(), 7, "QEMU's board has seven ports");
        gdb.stop_before(image.sleeps_at);
        let mut machine = Self {
            qemu,
            gdb,
            test: Qtest::new(test),
            bus,
            ports,
            milliseconds: image.symbol("MILLISECONDS"),
            sleeps_at: image.sleeps_at,
            asleep: false,
            soon: true,
        };
        let listened = machine.path(Gpio(LISTENED, 0)).to_owned();
        machine.test.listen(&listened);
        machine
    }

    /// The memory of the board, and its registers.
    pub(crate) fn memory(&mut self) -> &mut Qtest {
        &mut self.test
    }

    /// Resets the board: it stands before its first instruction again, and its inputs are as nobody
    /// drives them.
    pub(crate) fn reset(&mut self) {
        let slept_at = self.gdb.pc();
        self.gdb.monitor("system_reset");
        // QEMU resets in its own time.
        let reset = (0..LOOKS).any(|_| self.gdb.pc() != slept_at);
        assert!(reset, "QEMU resets the board");
        self.asleep = false;
        self.test.changes();
    }

    /// Lets the board run until it sleeps, which is at the latest a microsecond after it has done what it
    /// has to; then time has gone on to its next timer.
    pub(crate) fn run(&mut self) {
        // WFI has two bytes.
        self.gdb.run(self.asleep.then_some(self.sleeps_at + 2));
        self.asleep = true;
    }

    /// The time that the board has run since its last reset, in cycles of its clock.
    pub(crate) fn now(&mut self) -> Result<u64, Overslept> {
        let at = self.milliseconds;
        let words = self.test.words(&[at, at + 4, SYST_CVR, ICSR]);
        let [low, high, left, pending] = words.try_into().expect("four words");
        let milliseconds = u64::from(high) << 32 | u64::from(low);
        let soon = std::mem::replace(&mut self.soon, true);
        if !soon && pending & PENDSTSET != 0 && left <= 1 {
            return Err(Overslept);
        }
        // QEMU's SysTick shows 1 where it is about to wrap, and also where it just has.
        let cycles = match (pending & PENDSTSET != 0, u64::from(left)) {
            (false, left) => CYCLES_PER_MS.saturating_sub(left),
            (true, 0 | 1) => CYCLES_PER_MS,
            (true, left) => 2 * CYCLES_PER_MS - left,
        };
        Ok(milliseconds * CYCLES_PER_MS + cycles)
    }

    /// Lets the board stand `cycles` from now at the latest, and from then on every microsecond.
    pub(crate) fn stand_in(&mut self, cycles: u64) {
        let cycles = u32::try_from(cycles.max(1)).unwrap_or(u32::MAX);
        let tick = CYCLES_PER_US as u32;
        self.soon = cycles <= tick;
        self.test.write([(CTL, 0), (CFG, 0), (TAMR, PERIODIC), (TAILR, cycles), (CTL, 1), (TAILR, tick)]);
    }

    /// A character reaches UART0.
    pub(crate) fn hear(&mut self, byte: u8) {
        self.bus.write_all(&[byte]).expect("QEMU listens");
        let heard = (0..LOOKS).any(|_| self.test.word(UART_FLAGS) & RX_EMPTY == 0);
        assert!(heard, "UART0 receives what is sent to it");
    }

    /// What UART0 has sent since the last time.
    pub(crate) fn said(&mut self) -> Vec<u8> {
        let mut said = vec![0; 4096];
        self.bus.set_nonblocking(true).expect("a socket");
        let n = match self.bus.read(&mut said) {
            Ok(n) => n,
            Err(error) if error.kind() == ErrorKind::WouldBlock => 0,
            Err(error) => panic!("QEMU is gone: {error}"),
        };
        self.bus.set_nonblocking(false).expect("a socket");
        said.truncate(n);
        said
    }

    /// Drives an input of the board.
    pub(crate) fn drive(&mut self, gpio: Gpio, high: bool) {
        let path = self.path(gpio).to_owned();
        self.test.drive(&path, gpio.1, high);
    }

    /// Whether outputs are high, or let go.
    pub(crate) fn levels(&mut self, gpios: &[Gpio]) -> Vec<bool> {
        /// The data register of all eight pins, and the register of directions.
        const REGISTERS: [u32; 2] = [0x3FC, 0x400];
        let addresses: Vec<u32> =
            PORTS.iter().flat_map(|base| REGISTERS.map(|register| base + register)).collect();
        let words = self.test.words(&addresses);
        let level = |gpio: &Gpio| match words.chunks_exact(2).nth(gpio.port()) {
            Some([data, driven]) => driven >> gpio.1 & 1 == 0 || data >> gpio.1 & 1 != 0,
            _ => unreachable!("two words of each port"),
        };
        gpios.iter().map(level).collect()
    }

    /// Changes of the outputs of port B since the last time.
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

/// A socket's place in the file system, which nobody needs once both ends have it.
struct Address(String);

impl Address {
    fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("standin-qtest-{}-{number}", process::id());
        Self(env::temp_dir().join(name).to_str().expect("a path in UTF-8").to_owned())
    }
}

impl Drop for Address {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}
