//! Cost of the journals: instructions of a request on a bench with its usual settings, with and without journals. A
//! request reads one register of an MD3, alone or as one of 32 on a line.
//!
//! valgrind counts the instructions.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;

use drivetwin_firmware::device::{Duration, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_protocol::modbus::rtu;
use drivetwin_sim::bench::{Bench, Client, DriveId, Settings, Setup};

use support::{line, took};

/// Numbers of drives on the line.
const DRIVES: [u8; 2] = [1, 32];

/// A line with drives of the addresses from 1 on, and its client.
struct Rig {
    bench: Bench,
    client: Client,
    drives: u8,
    reply: Vec<u8>,
}

impl Rig {
    fn new(drives: u8, journals: bool) -> Self {
        let mut bench = Bench::with(Settings { journals, ..Settings::default() });
        let ports: Vec<(DriveId, Port)> = (1..=drives)
            .map(|address| {
                let presets = vec![(0, address.into())];
                let setup = Setup { boot_fast: true, presets, ..Setup::default() };
                let added = bench.add_with(&format!("d{address}"), Box::new(Md3::new()), setup);
                (added.expect("the name is new"), Port(0))
            })
            .collect();
        let bus = match ports.as_slice() {
            &[(drive, port)] => bench.bus(drive, port).expect("the port has a line"),
            ports => bench.share("line", ports),
        };
        let client = bench.connect(bus);
        Self { bench, client, drives, reply: Vec::new() }
    }

    /// Sends a request to one drive after the other, and checks the replies.
    fn ask(&mut self, requests: u64) {
        for n in 0..requests {
            let address = 1 + (n % u64::from(self.drives)) as u8;
            self.bench.send(self.client, &rtu::read(address, 0, 1));
            self.bench.run_until_idle();
            self.bench.run_until(self.bench.now() + Duration::millis(10));
            self.reply.clear();
            self.bench.receive(self.client, &mut self.reply);
            assert_eq!(self.reply[..], rtu::frame(address, &[3, 2, 0, address])[..], "address {address}");
        }
    }
}

fn main() {
    if let Some((name, requests)) = count::wanted() {
        let (drives, journals) = name.split_once(' ').expect("the name has two words");
        let drives = drives.parse().expect("a number of drives");
        return Rig::new(drives, journals == "journals").ask(requests);
    }
    println!("a request with and without journals");
    let mut all_counted = true;
    for drives in DRIVES {
        // A journal is full after 10,000 requests.
        let (few, many) = if drives == 1 { (12_000, 16_000) } else { (640, 1_920) };
        let counts = ["none", "journals"].map(|journals| {
            let mut rig = Rig::new(drives, journals == "journals");
            rig.ask(few);
            let us = took(|| rig.ask(many)).as_secs_f64() * 1e6 / many as f64;
            let instructions = count::instructions(&format!("{drives} {journals}"), few, many);
            line(
                &format!("{drives} on a line, {journals}"),
                &format!("{us:.1} µs, {}", count::counted(instructions)),
            );
            instructions
        });
        match counts {
            [Some(without), Some(with)] => {
                line("more instructions", &format!("{:+.1} %", (with / without - 1.0) * 100.0));
            }
            _ => all_counted = false,
        }
    }
    count::warn_unless(all_counted);
}
