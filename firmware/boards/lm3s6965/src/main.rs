//! An MD3 on the Stellaris LM3S6965 evaluation board (`lm3s6965evb` in QEMU).
//!
//! UART0 is the drive's bus; behind a transceiver that turns itself around it is RS-485. UART1
//! says one line when the drive has power. The lights and open drains are pins of ports B and F:
//!
//! | MD3 | pin |
//! |---|---|
//! | D6, green | PF0, the board's light |
//! | D5, red | PB0 |
//! | J3.7, BUSY | PB1, open drain |
//! | J3.8 | PB2, open drain |
//!
//! Inputs and step pulses are not wired. The saved registers live in RAM: a reset makes a new drive.
//!
//! Datasheet: *Stellaris LM3S6965 Microcontroller*, DS-LM3S6965; its sections stand beside the code.
//! Built in the release profile only: there the linker proves that nothing can panic.
#![no_std]
#![no_main]

mod clock;
mod gpio;
mod registers;
mod uart;

use core::convert::Infallible;
use core::panic::PanicInfo;

use cortex_m::Peripherals;
use cortex_m_rt::entry;
use embedded_storage::{ReadStorage, Storage};
use standin_firmware::device::{Boot, Device, Instant, Line, Pin, Port, Spec};
use standin_firmware::md3::{Md3, Reg};
use standin_firmware::memory;
use standin_firmware::shell::{Caught, Inputs, Outputs, Shell};

use self::gpio::{Output, PORT_B, PORT_F};
use self::uart::Sender;

/// Bytes of the MD3's EEPROM.
const MEMORY: usize = memory::bytes(Reg::SAVED_WORDS) as usize;

unsafe extern "C" {
    /// Never defined: an image that can panic does not link.
    safe fn a_panic_can_happen() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    a_panic_can_happen()
}

#[entry]
fn main() -> ! {
    if let Some(mut core) = Peripherals::take() {
        clock::start(&mut core.SYST);
        uart::start();
    }
    let md3 = Md3::new();
    let wired = |name, output| (place(md3.spec(), name), output);
    let outputs = Board {
        bus: Sender,
        pins: [
            wired("D6", Output::push_pull(PORT_F, 0)),
            wired("D5", Output::push_pull(PORT_B, 0)),
            wired("J3.7", Output::open_drain(PORT_B, 1)),
            wired("J3.8", Output::open_drain(PORT_B, 2)),
        ],
        memory: Ram([0xFF; MEMORY]),
    };
    let mut shell = Shell::<_, _, _, MEMORY>::new(md3, Ears, outputs, Boot::default());
    uart::say(b"standin: md3 has power\r\n");
    loop {
        if shell.turn().is_err() {
            clock::sleep_until(shell.deadline());
        }
    }
}

/// The pin of that name.
fn place(spec: &Spec, name: &str) -> Option<Pin> {
    let place = spec.pins.iter().position(|pin| pin.name == name)?;
    u8::try_from(place).ok().map(Pin)
}

/// What the board hears.
struct Ears;

impl Inputs for Ears {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn caught(&mut self, until: Instant) -> Option<(Instant, Caught)> {
        uart::caught(until)
    }
}

/// What the board does.
struct Board {
    bus: Sender,
    pins: [(Option<Pin>, Output); 4],
    memory: Ram,
}

impl Outputs for Board {
    type Serial = Sender;
    type Pin = Output;
    type Memory = Ram;

    fn serial(&mut self, _port: Port) -> Option<&mut Sender> {
        Some(&mut self.bus)
    }

    fn set_line(&mut self, _port: Port, line: Line) {
        self.bus.set_line(line);
    }

    fn pin(&mut self, pin: Pin) -> Option<&mut Output> {
        self.pins.iter_mut().find(|(wired, _)| *wired == Some(pin)).map(|(_, output)| output)
    }

    fn memory(&mut self) -> &mut Ram {
        &mut self.memory
    }
}

/// Saved registers that do not survive a reset: QEMU's flash can only be read.
struct Ram([u8; MEMORY]);

impl ReadStorage for Ram {
    type Error = Infallible;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        if let Some(stored) = self.0.get(offset as usize..) {
            for (byte, stored) in bytes.iter_mut().zip(stored) {
                *byte = *stored;
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        MEMORY
    }
}

impl Storage for Ram {
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        if let Some(stored) = self.0.get_mut(offset as usize..) {
            for (stored, byte) in stored.iter_mut().zip(bytes) {
                *stored = *byte;
            }
        }
        Ok(())
    }
}
