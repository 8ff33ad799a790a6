//! The shell of a board, with a drive and a board about which the compiler can assume nothing.
#![no_std]
#![no_main]

use core::convert::Infallible;

use drivetwin_firmware::device::{
    Axis, Boot, Context, Device, Duration, Input, Instant, Line, Link, Output, Pin, Plan, Port, PresetError,
    Spec,
};
use drivetwin_firmware::md3::Reg;
use drivetwin_firmware::shell::{BoardEvent, Inputs, LinkEvent, Links, Outputs, Shell, TX_ONE_REPLY};
use drivetwin_protocol::modbus::tcp::Adu;
use drivetwin_protocol::registers::Register;
use embedded_hal::digital::{self, OutputPin};
use embedded_io::{Write, WriteReady};
use embedded_storage::{ReadStorage, Storage};
use panic_free::{opaque, perhaps_panic};

/// Any drive on any board.
struct Anything;

/// Entry point for the linker.
#[unsafe(no_mangle)]
extern "C" fn start() -> ! {
    let mut shell = Shell::<_, _, _, TX_ONE_REPLY>::new(Anything, Anything, Anything);
    shell.power_on(opaque(Instant::ZERO), opaque(Boot::default()));
    loop {
        let shell = opaque(&mut shell);
        let _ = opaque(shell.poll());
        opaque((shell.deadline(), shell.failures()));
        opaque(shell.device());
        perhaps_panic(opaque(&[]), opaque(0));
    }
}

static SPEC: Spec = Spec { registers: Reg::TABLE, ..Spec::EMPTY };

impl Device for Anything {
    fn spec(&self) -> &'static Spec {
        opaque(&SPEC)
    }

    fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        opaque(boot);
        self.timeout(at, out);
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        opaque(input);
        self.timeout(at, out);
    }

    fn deadline(&self) -> Instant {
        opaque(Instant::NEVER)
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        opaque(out.memory());
        out.put(opaque(at), opaque(Output::Bytes { port: Port(0), bytes: &[] }));
    }

    fn peek(&self, _at: Instant, _row: usize) -> i64 {
        opaque(0)
    }

    fn poke(
        &mut self,
        _at: Instant,
        _row: usize,
        _value: i64,
        _out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        opaque(Ok(()))
    }
}

impl Inputs for Anything {
    fn now(&self) -> Instant {
        opaque(Instant::ZERO)
    }

    fn next_event(&mut self, _until: Instant) -> Option<(Instant, BoardEvent)> {
        opaque(None)
    }
}

impl Outputs for Anything {
    type Serial = Self;
    type Pin = Self;
    type Memory = Self;
    type Links = Self;

    fn serial(&mut self, _port: Port) -> Option<&mut Self> {
        opaque(Some(self))
    }

    fn set_line(&mut self, _port: Port, line: Line) {
        opaque(line);
    }

    fn links(&mut self) -> Option<&mut Self> {
        opaque(Some(self))
    }

    fn pin(&mut self, _pin: Pin) -> Option<&mut Self> {
        opaque(Some(self))
    }

    fn memory(&mut self) -> &mut Self {
        self
    }

    fn stored(&self) -> &[u8] {
        opaque(&[])
    }

    fn plan(&mut self, _axis: Axis, plan: &Plan) -> Duration {
        opaque(plan);
        opaque(Duration::ZERO)
    }
}

impl Links for Anything {
    fn next(
        &mut self,
        now: Instant,
        device: &dyn Device,
        message: &mut Adu,
    ) -> Result<(Instant, Port, Link, LinkEvent), Instant> {
        opaque((message, device.accepts(Port(0)), device.takes(Port(0))));
        opaque(Err(now))
    }

    fn send(&mut self, _port: Port, _link: Link, bytes: &[u8]) -> bool {
        opaque(bytes);
        opaque(true)
    }

    fn close(&mut self, port: Port, link: Link) {
        opaque((port, link));
    }
}

impl digital::ErrorType for Anything {
    type Error = Infallible;
}

impl OutputPin for Anything {
    fn set_low(&mut self) -> Result<(), Infallible> {
        opaque(Ok(()))
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        opaque(Ok(()))
    }
}

impl embedded_io::ErrorType for Anything {
    type Error = embedded_io::ErrorKind;
}

impl WriteReady for Anything {
    fn write_ready(&mut self) -> Result<bool, embedded_io::ErrorKind> {
        opaque(Ok(true))
    }
}

impl Write for Anything {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, embedded_io::ErrorKind> {
        opaque(Ok(bytes.len()))
    }

    fn flush(&mut self) -> Result<(), embedded_io::ErrorKind> {
        opaque(Ok(()))
    }
}

impl ReadStorage for Anything {
    type Error = Infallible;

    fn read(&mut self, _offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        opaque(bytes);
        opaque(Ok(()))
    }

    fn capacity(&self) -> usize {
        opaque(0)
    }
}

impl Storage for Anything {
    fn write(&mut self, _offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        opaque(bytes);
        opaque(Ok(()))
    }
}
