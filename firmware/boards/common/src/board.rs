//! A board, and the loop that runs a drive on it.

use core::marker::PhantomData;

use drivetwin_control::Refused;
use drivetwin_firmware::device::{Boot, Device, Duration, Instant, Spec};
use drivetwin_firmware::motion::PlanLoader;
use drivetwin_firmware::shell::{BoardEvent, Inputs, Links, Shell};
use embedded_storage::Storage;

use crate::axis::{Axis, Timer};
use crate::board_outputs::{BoardOutputs, Release};
use crate::bus::{Sender, Uart};
use crate::cable::Cable;
use crate::slips;
use crate::station::{Station, TRACE};
use crate::tap::Tap;
use crate::wire::{AxisPins, End, is_full_duplex};

/// A function that ends this image: it starts the board again, or its boot loader.
pub type Leave = fn() -> !;

/// A board with one bus, one axis, and pins that are wired to those of a drive.
pub trait Board {
    /// A wire: a pin of the board, and the name of the drive's pin or fault that it belongs to.
    type Wire;
    /// The board's end of a wire, as an output that the drive drives.
    type Pin: Release;
    /// The UART of the bus.
    type Uart: Uart;
    /// The step timer.
    type Timer: Timer + 'static;
    /// The USB cable; [`NoCable`](crate::NoCable) on a board without one.
    type Cable: Cable;

    /// Name of the board, as `drivetwin flash` has it.
    const NAME: &'static str;

    /// The axis.
    fn axis() -> &'static Axis<Self::Timer>;

    /// Starts the clocks, the timers and the watchdog, and checks whether the FAST pin is tied to ground.
    fn start() -> Boot;

    /// Wires the pins and faults of `spec` by the names in `wires`. All output pins are released at first.
    /// Inputs that do not have their idle level are reported to the drive with the time of power-on.
    fn wire<const N: usize>(spec: &Spec, wires: &[Self::Wire; N]) -> [(Option<End>, Self::Pin); N];

    /// Enables interrupts. They timestamp events and queue them.
    fn unmask();

    /// Logs that a drive of this kind has power.
    fn log(kind: &str, boot: Boot);

    /// The instant up to which all events are queued. Events after this call have later times.
    fn past() -> Instant;

    /// Takes the oldest queued event if it is not after `until`.
    fn next_event(until: Instant) -> Option<(Instant, BoardEvent)>;

    /// Number of events that were lost because the queue was full, as far as the board counts them; it wraps.
    fn lost_inputs() -> u32 {
        0
    }

    /// Returns `true` if no event is queued.
    fn is_quiet() -> bool;

    /// Reports levels that were not reported because the queue was full.
    fn tell_missed();

    /// Feeds the watchdog.
    fn feed();

    /// The cable. Called once, after [`start`](Self::start).
    fn cable() -> Self::Cable;

    /// Name of a kind of drive that the board can be, by its number from 0 on; `None` behind the last one.
    fn kind(_number: u8) -> Option<&'static str> {
        None
    }

    /// Stores that the board is a drive of this kind, one of [`kind`](Self::kind), from its next start on. Returns the
    /// function that starts the board again.
    ///
    /// # Errors
    /// The board cannot be a drive of another kind, or the flash does not take the choice.
    fn choose(_kind: &str) -> Result<Leave, Refused> {
        Err(Refused::NotHere)
    }

    /// The function that starts the boot loader, which takes a new image.
    ///
    /// # Errors
    /// The board has none that it can start.
    fn boot_loader() -> Result<Leave, Refused> {
        Err(Refused::NotHere)
    }

    /// Sleeps until an event is queued, the bus has room again, or `deadline` has [passed](Self::past).
    fn sleep_until(deadline: Instant);
}

/// The inputs of a board.
pub(crate) struct BoardInputs<B>(pub(crate) PhantomData<B>);

impl<B: Board> Inputs for BoardInputs<B> {
    fn now(&self) -> Instant {
        B::past()
    }

    fn next_event(&mut self, until: Instant) -> Option<(Instant, BoardEvent)> {
        let first = B::next_event(until);
        if first.is_none() && B::is_quiet() {
            B::tell_missed();
        }
        first.or_else(|| slips::untold().map(|slipped| (until, slipped)))
    }
}

/// The outputs of a board.
pub(crate) type OutputsOf<B, M, L, const WIRES: usize> =
    BoardOutputs<Sender<<B as Board>::Uart>, <B as Board>::Pin, M, <B as Board>::Timer, WIRES, L>;

/// Makes a drive in a function of its own, so that the stack that `make` needs beside the drive itself is
/// free again when it returns.
#[inline(never)]
pub fn made<D>(make: fn() -> D) -> D {
    make()
}

/// Runs the drive, with the given wires, its saved registers and its network. The drive was [made](made())
/// before, because then this function's data is not on the stack yet. `memory` and `links` are called when
/// the clock runs, because they need it. `CHARACTERS` is the number of characters that may wait to be sent.
#[inline(never)]
pub fn run<B: Board, D: Device, M, L, const CHARACTERS: usize, const WIRES: usize>(
    drive: &mut D,
    wires: &[B::Wire; WIRES],
    memory: impl FnOnce(&Spec) -> M,
    links: impl FnOnce(&Spec) -> Option<L>,
) -> !
where
    M: Storage + AsRef<[u8]>,
    L: Links,
{
    let boot = B::start();
    let memory = memory(drive.spec());
    let links = links(drive.spec());
    if B::Cable::IS_THERE {
        let mut ring = [0; TRACE];
        let mut station: Station<'_, B, D, M, L, CHARACTERS, WIRES> =
            Station::new(drive, wires, memory, links, boot, &mut ring);
        station.start();
        loop {
            station.turn();
        }
    }
    let mut shell: Shell<&mut D, BoardInputs<B>, OutputsOf<B, M, L, WIRES>, CHARACTERS> =
        assemble::<B, _, _, _, _, WIRES>(drive, wires, memory, links);
    shell.power_on(Instant::ZERO, boot);
    // Not enabled earlier, because the stack is deepest while the drive is put on the board.
    B::unmask();
    B::log(shell.device().spec().kind, boot);
    loop {
        B::feed();
        B::Uart::bus().look();
        if shell.poll().is_err() {
            B::sleep_until(shell.deadline());
        }
    }
}

/// Puts the drive on the board. The stack that this needs is free again when it returns.
#[inline(never)]
fn assemble<'a, B: Board, D: Device, M, L, const CHARACTERS: usize, const WIRES: usize>(
    drive: &'a mut D,
    wires: &[B::Wire; WIRES],
    memory: M,
    links: Option<L>,
) -> Shell<&'a mut D, BoardInputs<B>, OutputsOf<B, M, L, WIRES>, CHARACTERS>
where
    M: Storage + AsRef<[u8]>,
    L: Links,
{
    let outputs = wire_outputs::<B, M, L, WIRES>(drive.spec(), wires, memory, links);
    Shell::new(drive, BoardInputs(PhantomData), outputs)
}

/// Wires the board for a drive.
pub(crate) fn wire_outputs<B: Board, M, L, const WIRES: usize>(
    spec: &Spec,
    wires: &[B::Wire; WIRES],
    memory: M,
    links: Option<L>,
) -> OutputsOf<B, M, L, WIRES> {
    let axis = B::axis();
    B::Uart::bus().start(is_full_duplex(spec));
    B::Uart::start();
    let pins = B::wire(spec, wires);
    let axis_pins = AxisPins::of(spec, pins.iter().map(|(end, _)| *end));
    if axis_pins == AxisPins::Own {
        B::Timer::start();
    }
    BoardOutputs { bus: Sender::new(), pins, memory, axis, axis_pins, loader: PlanLoader::new(), links }
}

/// Returns `true` if there is work for the loop: an event is queued, the bus has room again, or the cable has work or is to
/// get a character.
#[must_use]
pub fn is_awake<B: Board>() -> bool {
    !B::is_quiet()
        || B::Uart::bus().has_room()
        || B::Cable::is_pending()
        || B::Uart::tap().is_some_and(Tap::has_more)
}

/// Sleeps as [`Board::sleep_until`] does. `set` schedules an interrupt for its argument, and returns `false` if that instant
/// has passed. `doze` sleeps until an interrupt, and returns at once if one has come since it was called last.
#[inline]
pub fn sleep_until<B: Board>(deadline: Instant, set: impl Fn(Instant) -> bool, doze: impl Fn()) {
    /// Longest sleep without feeding the watchdog.
    const NAP: Duration = Duration::millis(250);
    while B::past() < deadline && !is_awake::<B>() {
        B::feed();
        // An interrupt between the check and the sleep ends the sleep (BOARD-6).
        if set(deadline.min(B::past() + NAP)) && !is_awake::<B>() {
            doze();
        }
    }
}

/// Makes an image with a drive. The arguments are the board's crate, the drive's module and constructor, the
/// constant of the shell with the number of characters that may wait, and the constant with the drive's
/// wires. The crate of the board has `run`, `memory!` (which reserves memory for saved registers) and
/// `wires`. A drive `on` a `network` has no buffer for characters.
#[macro_export]
macro_rules! image {
    ($board:ident, $kind:ident::$($make:ident)::+, $characters:ident, $wires:ident) => {
        #[cortex_m_rt::entry]
        fn main() -> ! {
            use drivetwin_firmware::{$kind, shell};
            let memory = $board::memory!($kind::MEMORY);
            $board::run::<_, _, { shell::$characters }, _>($kind::$($make)::+, memory, &$board::wires::$wires)
        }
    };
    ($board:ident on network, $kind:ident::$($make:ident)::+, $wires:ident) => {
        #[cortex_m_rt::entry]
        fn main() -> ! {
            use drivetwin_firmware::$kind;
            let memory = $board::memory!($kind::MEMORY);
            $board::run_on_network($kind::$($make)::+, memory, &$board::wires::$wires)
        }
    };
}
