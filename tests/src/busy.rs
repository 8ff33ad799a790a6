//! Busy benches, for benchmarks and for the check "costs of the bench".

use drivetwin_firmware::device::{Device as _, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span as _;
use drivetwin_sim::bench::{Bench, DriveId, Settings, Setup};
use drivetwin_sim::line::LineMode;
use drivetwin_sim::record::trace::Retention;

use crate::toy::Toy;

/// Events of a toy per second of bench time.
const RATE: u64 = 100;

/// A bench of toys whose deadlines are spread evenly. An event is a toy that reaches its deadline and sends two
/// characters on its line.
pub struct Toys {
    bench: Bench,
    seats: u64,
}

impl Toys {
    /// A bench that has run for a second.
    #[must_use]
    pub fn new(seats: u64) -> Self {
        let mut bench = Bench::with(Settings { trace: Retention::Off, ..Settings::default() });
        for seat in 0..seats {
            bench.run_until((seat * 10_000 / seats).micros());
            bench.add::<Toy>(&format!("toy{seat}"));
        }
        bench.run_until(1.secs());
        Self { bench, seats }
    }

    /// Runs the bench for so many events.
    ///
    /// # Panics
    /// If the toys have not sent as many messages, give or take one of each.
    pub fn run(&mut self, events: u64) {
        let span = (events * 1_000_000 / (self.seats * RATE)).micros();
        let before = self.sent();
        self.bench.run_until(self.bench.now() + span);
        assert!((self.sent() - before).abs_diff(events) <= self.seats, "{events} events");
    }

    /// Number of messages that the toys have sent.
    fn sent(&self) -> u64 {
        self.bench.own_messages(0, 0, None).last()
    }
}

/// MD3s with the addresses 1 and up on one line, which have started.
pub struct Party {
    bench: Bench,
    drives: Vec<(u8, DriveId)>,
}

impl Party {
    /// A line of so many MD3s.
    ///
    /// # Panics
    /// Without a drive, or with more than the 247 that have addresses.
    #[must_use]
    pub fn new(drives: u8, mode: LineMode) -> Self {
        let mut bench = Bench::with(Settings { line: mode, ..Settings::default() });
        let drives = (1..=drives).map(|address| {
            let md3 = Box::new(Md3::new());
            let row = md3.spec().find("DeviceAddress").expect("an MD3 has an address").row;
            let setup = Setup { presets: vec![(row, address.into())], boot_fast: true, ..Setup::default() };
            (address, bench.add_with(&format!("x{address}"), md3, setup).expect("the address is valid"))
        });
        let drives: Vec<(u8, DriveId)> = drives.collect();
        let ports: Vec<(DriveId, Port)> = drives.iter().map(|&(_, drive)| (drive, Port(0))).collect();
        if ports.len() > 1 {
            bench.share("line", &ports);
        }
        bench.run_until(1.secs());
        Self { bench, drives }
    }

    /// Sends so many requests to the drives in turn.
    ///
    /// # Panics
    /// If a drive does not answer with a register.
    pub fn ask(&mut self, requests: u64) {
        for (&(address, drive), _) in self.drives.iter().cycle().zip(0..requests) {
            assert_eq!(self.bench.ask(drive, &rtu::read(address, 0, 1)).len(), 7);
        }
    }
}
