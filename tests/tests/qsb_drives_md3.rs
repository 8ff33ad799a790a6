//! The motor drive of a QSB-M, wired to the step and direction inputs of an MD3. The MD3 must make every step
//! that the QSB counts.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Axis, Duration, Instant, Level, Pin, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_firmware::qsb::Qsb;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, Client, DriveId, Settings, Setup};
use drivetwin_sim::record::trace::Retention;
use drivetwin_sim::signals::pulses::Pulse;

const AXIS: Axis = Axis(0);

/// Values of MD STATUS while the motor drive is active.
const READY: u32 = 0x11;
const MOVING: u32 = 0x12;
const PAUSED: u32 = 0x14;
const JOGGING: u32 = 0x18;

/// A QSB-M whose DIO1 and DIO2 are step and direction of an MD3, and a client at the QSB's port.
struct Fixture {
    bench: Bench,
    qsb: DriveId,
    md3: DriveId,
    client: Client,
    /// Position of the MD3 when the position of the QSB was 0.
    offset: i32,
}

impl Fixture {
    /// A fixture with an active motor drive.
    fn new() -> Self {
        let mut bench = Bench::with(Settings { trace: Retention::All, ..Settings::default() });
        let setup = || Setup { boot_fast: true, ..Setup::default() };
        let qsb = bench.add_with("qsb", Box::new(Qsb::m()), setup()).unwrap();
        let md3 = bench.add_with("md3", Box::new(Md3::new()), setup()).unwrap();
        bench.run_until(10.millis());
        let wires = [("DIO1", "J2.4"), ("DIO2", "J2.5")];
        for (from, to) in wires {
            let (from, to) = (pin(&bench, qsb, from), pin(&bench, md3, to));
            bench.wire((qsb, from), (md3, to));
        }
        let client = bench.connect(bench.bus(qsb, Port(0)).unwrap());
        bench.run_until(20.millis());
        let mut banner = Vec::new();
        bench.receive(client, &mut banner);
        let mut fixture = Self { bench, qsb, md3, client, offset: 0 };
        assert_eq!(fixture.stepped(), 0, "the lines are released, and the MD3 pulls both up");
        fixture.ask("W162");
        // The MD3 steps when J2.4 falls, which it does at activation. J2.5 was still high, which is forward.
        assert_eq!(fixture.stepped(), 1);
        fixture.offset = 1;
        fixture
    }

    /// Sends a command and returns the data of the reply.
    #[track_caller]
    fn ask(&mut self, command: &str) -> u32 {
        self.bench.send(self.client, format!("{command}\r").as_bytes());
        self.bench.run_until(self.bench.now() + 5.millis());
        let mut reply = Vec::new();
        self.bench.receive(self.client, &mut reply);
        let reply = String::from_utf8(reply).unwrap();
        let (letter, register) = (command[..1].to_lowercase(), &command[1..3]);
        let data = reply
            .strip_prefix(&format!("{letter} {register} "))
            .and_then(|reply| reply.strip_suffix(" !\r\n"))
            .unwrap_or_else(|| panic!("{reply:?} to {command:?}"));
        u32::from_str_radix(data, 16).unwrap()
    }

    /// Sets rate, acceleration and number of steps.
    fn set(&mut self, rate: u16, acceleration: u32, steps: i32) {
        self.ask(&format!("W0F{rate:X}"));
        self.ask(&format!("W10{acceleration:X}"));
        self.ask(&format!("W11{steps:08X}"));
    }

    /// Starts a jog at this rate.
    fn jog(&mut self, rate: i32) {
        self.ask(&format!("W12{rate:08X}"));
        self.ask("W169");
        assert_eq!(self.ask("R13"), JOGGING);
    }

    fn wait(&mut self, span: Duration) {
        self.bench.run_until(self.bench.now() + span);
    }

    /// Waits until MD STATUS has this value, for at most a minute.
    #[track_caller]
    fn until(&mut self, status: u32) {
        let end = self.bench.now() + 60.secs();
        while self.ask("R13") != status {
            assert!(self.bench.now() < end, "MD STATUS never becomes {status:02X}");
        }
    }

    /// Steps that the MD3 has made since the motor drive was activated.
    fn stepped(&self) -> i32 {
        self.bench.motion(self.md3, AXIS).position - self.offset
    }

    /// Asserts that both drives are at this position.
    #[track_caller]
    fn both_stand_at(&mut self, position: i32) {
        // The MD3 steps at the end of a pulse.
        self.wait(10.micros());
        assert_eq!((self.bench.motion(self.qsb, AXIS).position, self.stepped()), (position, position));
    }

    fn pulses(&self) -> Vec<Pulse> {
        self.bench.pulses(self.qsb.step()).collect()
    }

    fn level(&self, name: &str) -> Level {
        self.bench.level(self.qsb, pin(&self.bench, self.qsb, name))
    }
}

fn pin(bench: &Bench, seat: DriveId, name: &str) -> Pin {
    let mut names = bench.spec(seat).pins.iter().map(|pin| pin.name);
    Pin(names.position(|pin| pin == name).expect("the manual has that pin") as u8)
}

#[test]
fn moves_of_a_qsb_are_moves_of_the_md3() {
    let mut fixture = Fixture::new();
    let mut position = 0;
    let moves = [
        (13_000, 360_000, 26_000),
        (13_000, 360_000, -40_000),
        (32, 64, 5),
        (1_000, 100_000, -1),
        (13_000, 64, 2_000),
        (5_000, 20_000, 0),
    ];
    for (rate, acceleration, steps) in moves {
        fixture.set(rate, acceleration, steps);
        fixture.ask("W168");
        fixture.until(READY);
        position += steps;
        fixture.both_stand_at(position);
    }
    let made: i32 = fixture.pulses().iter().map(|pulse| if pulse.forward { 1 } else { -1 }).sum();
    assert_eq!(made, position);
}

#[test]
fn pauses_lose_no_step() {
    let mut fixture = Fixture::new();
    fixture.set(13_000, 40_000, 30_000);
    fixture.ask("W168");
    // Pauses in the ramp up and in the cruise, and once resumes before the motor is at rest.
    for (ms, stands) in [(100, true), (1_000, true), (700, false)] {
        fixture.wait(ms.millis());
        fixture.ask("W166");
        if stands {
            fixture.until(PAUSED);
            let position = fixture.stepped();
            fixture.wait(500.millis());
            assert_eq!(fixture.stepped(), position);
        }
        fixture.ask("W167");
        assert_eq!(fixture.ask("R13"), MOVING);
    }
    // A pause in the move's own ramp down, which ends on the last step. So nothing is left to resume.
    fixture.wait(1_000.millis());
    assert!((28_000..30_000).contains(&fixture.stepped()), "{}", fixture.stepped());
    fixture.ask("W166");
    fixture.until(PAUSED);
    fixture.both_stand_at(30_000);
    fixture.ask("W167");
    assert_eq!(fixture.ask("R13"), READY);
    assert_eq!(fixture.pulses().len(), 30_000);
}

#[test]
fn a_jog_at_13_000_makes_12_992_steps_a_second() {
    let mut fixture = Fixture::new();
    fixture.set(32, 360_000, 0);
    fixture.jog(13_000);
    fixture.wait(2.secs());
    let pulses = fixture.pulses();
    // The ramp takes 12,992²/720,000 = 234.4 steps.
    let second = pulses[300 + 12_992].rise.since(pulses[300].rise);
    assert!(second.ticks().abs_diff(1.secs().ticks()) <= 1, "{second:?}");
    assert!(pulses.windows(2).all(|pair| pair[0].fall < pair[1].rise));
    // A reversal through standstill, then a pause, a resume, and a stop at once.
    fixture.jog(-13_000);
    fixture.wait(3.secs());
    fixture.ask("W166");
    fixture.until(PAUSED);
    let position = fixture.bench.motion(fixture.qsb, AXIS).position;
    fixture.both_stand_at(position);
    fixture.ask("W167");
    fixture.wait(1.secs());
    fixture.ask("W165");
    assert_eq!(fixture.ask("R13"), READY);
    let position = fixture.bench.motion(fixture.qsb, AXIS).position;
    assert!(position < 0, "{position}");
    fixture.both_stand_at(position);
    let made: i32 = fixture.pulses().iter().map(|pulse| if pulse.forward { 1 } else { -1 }).sum();
    assert_eq!(made, position);
}

#[test]
fn the_digital_port_has_its_lines_back_when_the_motor_drive_ends() {
    let mut fixture = Fixture::new();
    fixture.set(1_000, 100_000, 100);
    fixture.ask("W168");
    fixture.until(READY);
    assert_eq!((fixture.level("DIO1"), fixture.level("DIO2")), (Level::Low, Level::High));
    // Register 01 reads DIO1 low (step) and DIO2 high (forward). The written value takes effect later.
    fixture.ask("W02F00");
    fixture.ask("W019");
    assert_eq!(fixture.ask("R01"), 0xD);
    assert_eq!((fixture.level("DIO1"), fixture.level("DIO2")), (Level::Low, Level::High));
    // The port returns to its saved state: inputs, which the MD3 pulls up. A rising edge is not a step.
    fixture.ask("W160");
    assert_eq!((fixture.level("DIO1"), fixture.level("DIO2")), (Level::High, Level::High));
    assert_eq!(fixture.ask("R13"), 0x01);
    fixture.both_stand_at(100);
    // The digital port sets the direction backward and makes a step.
    fixture.ask("W02F00");
    fixture.ask("W01B");
    fixture.ask("W019");
    assert_eq!(fixture.stepped(), 99);
    // The motor drive takes the pins again. The MD3 sees no falling edge, because DIO1 was already low.
    let at: Instant = fixture.bench.now();
    fixture.ask("W162");
    assert_eq!(fixture.stepped(), 99);
    fixture.ask("W168");
    fixture.until(READY);
    assert_eq!(fixture.stepped(), 199);
    let pulses = fixture.pulses();
    assert_eq!(pulses.iter().filter(|pulse| pulse.rise > at && pulse.forward).count(), 100);
}
