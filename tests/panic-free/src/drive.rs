// Calls every method of one drive. Each program of a drive includes this file.

use core::sync::atomic::AtomicU8;

use drivetwin_firmware::device::{Axis, Boot, Device, Input, Instant, Output, Port, Context, advance};
use panic_free::{opaque, perhaps_panic};

/// A context that is opaque to the compiler.
struct World;

impl Context for World {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        opaque((at, output));
    }

    fn memory(&self) -> &[u8] {
        opaque(&[])
    }
}

/// Calls every method of a drive, in any order, with any arguments.
fn exercise<D: Device>(make: fn() -> D) -> ! {
    let mut device = make();
    let device: &mut dyn Device = opaque(&mut device);
    let mut world = World;
    let out: &mut dyn Context = opaque(&mut world);
    loop {
        let at: Instant = opaque(Instant::ZERO);
        let input = opaque(Input::Bytes { port: Port(0), bytes: &[] });
        opaque(device.spec());
        device.power_on(at, opaque(Boot::default()), out);
        device.input(at, input, out);
        opaque(device.deadline());
        device.timeout(at, out);
        opaque(device.peek(at, opaque(0)));
        let _ = opaque(device.poke(at, opaque(0), opaque(0), out));
        opaque(advance(device, at, opaque(&[(at, input)]).iter().copied(), out));
        opaque(device.shaft(at, opaque(Axis(0))));
        perhaps_panic(opaque(&[]), opaque(0));
    }
}

/// Size in bytes of the drive that a function makes.
const fn size_of_made<D>(_: &fn() -> D) -> usize {
    size_of::<D>()
}

/// Defines a program from the function that makes a drive.
macro_rules! program {
    ($make:path) => {
        /// As many bytes as the drive takes in RAM, so that they count in the size of the program.
        #[used]
        static STATE: [AtomicU8; size_of_made(&($make as fn() -> _))] = [const { AtomicU8::new(0) }; _];

        /// Entry point for the linker.
        #[unsafe(no_mangle)]
        extern "C" fn start() -> ! {
            exercise($make)
        }
    };
}
