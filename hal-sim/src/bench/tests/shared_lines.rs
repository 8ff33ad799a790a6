//! One event for all drives of a line makes the trace that an event for each drive makes, and a frame for others the
//! trace that a drive makes which is called.

use drivetwin_firmware::mdrobot::Mdrobot;
use drivetwin_firmware::rs434::{self, Rs434};
use drivetwin_protocol::modbus::pdu;

use super::*;
use crate::bench::{PowerAction, Statistics};

/// Drives with Modbus RTU, all of one kind because they have the same settings of the line.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Md3,
    Rs434,
    Mdrobot,
}

impl Kind {
    fn make(self) -> Box<dyn Device> {
        match self {
            Self::Md3 => Box::new(Md3::new()),
            Self::Rs434 => Box::new(Rs434::rs434544()),
            Self::Mdrobot => Box::new(Mdrobot::md400()),
        }
    }

    /// Requests that read, that begin a motion, that the drive refuses, and that change what follows.
    fn requests(self, address: u8) -> [Vec<u8>; 4] {
        let coil = |coil: [u8; 2]| rtu::frame(address, &[pdu::WRITE_SINGLE_COIL, coil[0], coil[1], 0xFF, 0]);
        let requests = match self {
            // Move, and Move on a falling edge of a pin.
            Self::Md3 => [
                rtu::read(address, 0, 3),
                rtu::write(address, 0x11, 1),
                rtu::read(address, 0x7F, 1),
                rtu::write(address, 0x09, 1 << 4),
            ],
            // START, a speed that is too low, and STOP.
            Self::Rs434 => [
                rtu::read(address, 0x5000, 3),
                coil([0x20, 0]),
                rtu::write(address, 0x500B, 29),
                coil([0x20, 1]),
            ],
            // VEL_CMD, a PID that is not there, and TQ_OFF.
            Self::Mdrobot => [
                rtu::read(address, 133, 1),
                rtu::write(address, 130, 500),
                rtu::write(address, 254, 5),
                rtu::write(address, 5, 1),
            ],
        };
        requests.map(|request| request.to_vec())
    }
}

/// Action on a bench.
#[derive(Clone, Debug)]
enum Act {
    /// A client sends a frame, or its first bytes.
    Send { client: usize, address: u8, request: usize, kept: usize },
    /// The power of a drive changes.
    Power(usize, PowerAction),
    /// The level of pin J2.4 of a drive changes.
    Pin(usize, PinStimulus),
    /// The address of the first drive changes by a preset.
    Address(i64),
}

fn act() -> impl Strategy<Value = (u64, Act)> {
    let kept = prop_oneof![9 => Just(8_usize), 1 => 0..8_usize];
    let send = (0..2_usize, 0..6_u8, 0..4_usize, kept)
        .prop_map(|(client, address, request, kept)| Act::Send { client, address, request, kept });
    let power = prop_oneof![Just(PowerAction::Off), Just(PowerAction::On), Just(PowerAction::Cycle)];
    let level = prop_oneof![Just(PinStimulus::Low), Just(PinStimulus::Open)];
    let act = prop_oneof![
        12 => send,
        1 => (0..5_usize, power).prop_map(|(drive, power)| Act::Power(drive, power)),
        2 => (0..5_usize, level).prop_map(|(drive, level)| Act::Pin(drive, level)),
        1 => (1..6_i64).prop_map(Act::Address),
    ];
    // Many times meet those of the line: after a frame, a silence, a tick.
    let wait = prop_oneof![
        3 => Just(0),
        1 => Just(1),
        1 => Just(EIGHT.ticks()),
        1 => Just((EIGHT + T3_5).ticks()),
        3 => Just(400_000),
        3 => 0..400_000_u64,
    ];
    (wait, act)
}

/// What five drives with these addresses on one line leave behind: the trace, the journals, and the statistics. `delay`
/// is that of the replies of an RS 434, in ms.
fn recorded(
    kind: Kind,
    acts: &[(u64, Act)],
    settings: Settings,
    addresses: [i64; 5],
    delay: i64,
    one_by_one: bool,
) -> (Vec<String>, Vec<Statistics>) {
    let mut bench = Bench::with(settings);
    bench.one_by_one = one_by_one;
    let drives = ["c", "a", "e", "b", "d"].into_iter().zip(addresses);
    let address = kind.make().spec().address.unwrap();
    let drives: Vec<DriveId> = drives
        .map(|(name, own)| {
            let mut presets = vec![(address, own)];
            if let Kind::Rs434 = kind {
                presets.push((rs434::Reg::TIMEOUT_BROADCAST_MODBUS as usize, delay));
            }
            let setup = Setup { boot_fast: true, presets, ..Setup::default() };
            bench.add_with(name, kind.make(), setup).unwrap()
        })
        .collect();
    let ports: Vec<(DriveId, Port)> = drives.iter().map(|&drive| (drive, Port(0))).collect();
    let line = bench.share("line", &ports);
    let clients = [bench.connect(line), bench.connect(line)];
    bench.run_until(start());
    for &(wait, ref act) in acts {
        bench.run_until(bench.now() + Duration::from_ticks(wait));
        match *act {
            Act::Send { client, address, request, kept } => {
                bench.send(clients[client], &kind.requests(address)[request][..kept]);
            }
            Act::Power(drive, power) => bench.power(drives[drive], power),
            Act::Pin(drive, level) => bench.set_pin(drives[drive], Pin(2), level),
            // A drive without power refuses it.
            Act::Address(own) => {
                let _ = bench.poke(drives[0], address, own);
            }
        }
    }
    bench.run_until(bench.now() + 50.millis());
    // The text sorts the events of an instant by their drives; these are in the order of the recording.
    let events = bench.trace().events().map(|event| format!("{event:?}"));
    let received = drives.iter().flat_map(|&drive| bench.received(drive).messages().collect::<Vec<_>>());
    let texts = events.chain(received.map(|message| format!("{message:?}"))).collect();
    (texts, drives.iter().map(|&drive| bench.statistics(drive, Port(0))).collect())
}

proptest! {
    #[test]
    fn one_event_for_a_line_is_as_one_for_each_drive(
        kind in prop_oneof![Just(Kind::Md3), Just(Kind::Rs434), Just(Kind::Mdrobot)],
        acts in proptest::collection::vec(act(), 0..20),
        fast in any::<bool>(),
        (shafts, outcomes, journals) in (any::<bool>(), any::<bool>(), any::<bool>()),
        delay in prop_oneof![Just(0_i64), Just(1), Just(20)],
        // Drives with the same address may answer each other's replies, so at most two have the same.
        other in 1..5_i64,
    ) {
        let line = if fast { LineMode::Fast } else { LineMode::Timed };
        let settings = Settings { line, shafts, outcomes, journals, ..Settings::default() };
        let [one, many] = [true, false]
            .map(|one_by_one| recorded(kind, &acts, settings, [1, 2, 3, 4, other], delay, one_by_one));
        prop_assert_eq!(one, many);
    }
}
