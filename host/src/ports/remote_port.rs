//! A remote master that controls a serial port of a line over a TCP connection (RFC 2217, HOST-24).

use std::net::SocketAddr;

use drivetwin_sim::bench::{Bench, Bus, Client};
use drivetwin_sim::line::{PortParity, Sender};
use tracing::{info, warn};

use super::com_port::{ComPort, Event};
use super::tcp_listener::Site;
use super::unread::Unread;

/// The serial port of one connection, on a line.
pub(super) struct RemotePort {
    com_port: ComPort,
    bus: Bus,
    client: Client,
    peer: SocketAddr,
    settings: Sender,
    /// True while the drives know that DTR is on.
    dtr: bool,
    /// Characters that the drives sent and that the peer does not want yet.
    held: Vec<u8>,
}

/// A warning about a remote port.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Warning {
    /// A peer speaks no Telnet.
    NoTelnet,
    /// A peer does not control the port.
    Refused,
    /// A peer has settings that differ from those of the drive's line.
    Settings(Sender),
}

impl RemotePort {
    /// The port of a new connection.
    pub(super) fn new(bus: Bus, client: Client, peer: SocketAddr) -> Self {
        let settings = Sender::default();
        Self { com_port: ComPort::new(), bus, client, peer, settings, dtr: false, held: Vec::new() }
    }

    /// Number of characters that the peer does not want yet.
    pub(super) fn held(&self) -> usize {
        self.held.len()
    }

    /// Handles bytes of the peer, and adds the answers to `unread`. Returns whether the bytes have an effect on the
    /// drives.
    pub(super) fn take(&mut self, bench: &mut Bench, bytes: &[u8], site: &Site, unread: &mut Unread) -> bool {
        let mut answers = Vec::new();
        let events = self.com_port.receive(bytes, bench.line(self.bus), &mut answers);
        unread.extend(&answers);
        let mut has_effect = false;
        for event in events {
            has_effect |= self.handle(bench, event, site);
        }
        has_effect
    }

    /// Handles an event. Returns whether it has an effect on the drives.
    fn handle(&mut self, bench: &mut Bench, event: Event, site: &Site) -> bool {
        let (peer, uri) = (self.peer, site.uri());
        match event {
            Event::Data(bytes) => {
                self.send(bench, &bytes, site);
                true
            }
            Event::Open => {
                info!("{peer} controls the serial port {uri}");
                self.set_dtr(bench, true)
            }
            Event::NoTelnet => {
                if site.is_new(Warning::NoTelnet) {
                    warn!(
                        "{peer} does not speak RFC 2217 at {uri}: its bytes pass as they are, its serial settings are unknown"
                    );
                }
                false
            }
            Event::Refuse => {
                if site.is_new(Warning::Refused) {
                    warn!(
                        "{peer} refuses COM port control (RFC 2217) at {uri}: its bytes pass, its serial settings are unknown"
                    );
                }
                self.set_settings(bench, Sender::default());
                self.hang_up(bench)
            }
            Event::Settings(settings) => {
                let is_known = settings.baud.is_some()
                    && settings.data.is_some()
                    && settings.parity != PortParity::Unknown
                    && settings.stop.is_some();
                if is_known {
                    info!("{peer} sets {uri} to {}", settings.or(bench.line(self.bus)));
                }
                self.set_settings(bench, settings);
                false
            }
            Event::Dtr(on) => {
                info!("{peer} switches DTR of {uri} {}", if on { "on" } else { "off" });
                self.set_dtr(bench, on)
            }
            Event::DropReceived => {
                bench.receive(self.client, &mut self.held);
                self.held.clear();
                false
            }
            Event::DropUnsent => {
                bench.drop_backlog(self.client);
                true
            }
        }
    }

    fn send(&mut self, bench: &mut Bench, bytes: &[u8], site: &Site) {
        let line = bench.line(self.bus);
        let settings = self.settings;
        if !settings.fits(line) && site.is_new(Warning::Settings(settings)) {
            warn!(
                "{} sends with {} at {}; the drive's line is {line}",
                self.peer,
                settings.or(line),
                site.uri()
            );
        }
        let data_bits = 0xFF >> (8 - settings.or(line).data.min(8));
        let characters: Vec<u8> = bytes.iter().map(|byte| byte & data_bits).collect();
        bench.send_from(self.client, &characters, settings);
    }

    /// Changes the settings of the port.
    fn set_settings(&mut self, bench: &mut Bench, settings: Sender) {
        self.settings = settings;
        bench.set_receiver(self.client, settings);
    }

    /// Switches DTR. Returns whether it was switched.
    fn set_dtr(&mut self, bench: &mut Bench, on: bool) -> bool {
        let has_changed = std::mem::replace(&mut self.dtr, on) != on;
        if has_changed {
            bench.attach(self.bus, on);
        }
        has_changed
    }

    /// Passes the characters that have reached the port to the peer, if the peer wants characters now.
    pub(super) fn receive(&mut self, bench: &mut Bench, unread: &mut Unread) {
        bench.receive(self.client, &mut self.held);
        if !self.com_port.is_suspended() && !self.held.is_empty() {
            let mut written = Vec::new();
            self.com_port.write(&self.held, &mut written);
            unread.extend(&written);
            self.held.clear();
        }
    }

    /// Handles the end of the peer's bytes. Returns whether it has an effect on the drives.
    pub(super) fn end(&mut self, bench: &mut Bench) -> bool {
        let rest = self.com_port.end();
        bench.send(self.client, &rest);
        !rest.is_empty()
    }

    /// Switches DTR off, if it is on. Returns whether it was on.
    pub(super) fn hang_up(&mut self, bench: &mut Bench) -> bool {
        self.set_dtr(bench, false)
    }
}

#[cfg(test)]
mod tests {
    use drivetwin_firmware::device::{Duration, Instant, Port};
    use drivetwin_protocol::modbus::rtu;
    use drivetwin_sim::bench::{DriveId, Setup};
    use drivetwin_sim::catalog;

    use super::*;

    /// `IAC WILL COM-PORT-OPTION`: opens the port.
    const OPEN: [u8; 3] = [255, 251, 44];

    const NOTHING: [u8; 0] = [];

    struct Rig {
        bench: Bench,
        drive: DriveId,
        port: RemotePort,
        site: Site,
        unread: Unread,
    }

    impl Rig {
        /// A drive that is ready, and a connection.
        fn new(kind: &str) -> Self {
            Self::with(kind, &[])
        }

        /// A drive that is ready, and a connection. `saved` are registers that were saved before power-on.
        fn with(kind: &str, saved: &[(&str, i64)]) -> Self {
            let mut bench = Bench::new();
            let device = catalog::make(kind).unwrap();
            let rows = device.spec().registers.rows;
            let row = |name| rows.iter().position(|row| row.name == name).unwrap();
            let presets = saved.iter().map(|&(name, value)| (row(name), value)).collect();
            let setup = Setup { boot_fast: true, presets, ..Setup::default() };
            let drive = bench.add_with(kind, device, setup).unwrap();
            bench.run_until(Instant::ZERO + Duration::secs(1));
            let bus = bench.bus(drive, Port(0)).unwrap();
            let client = bench.connect(bus);
            let port = RemotePort::new(bus, client, "127.0.0.1:1".parse().unwrap());
            let site = Site::new("rfc2217:127.0.0.1:2".into());
            Self { bench, drive, port, site, unread: Unread::default() }
        }

        /// Sends bytes as the peer does, and lets a second pass. Returns what the peer gets.
        fn say(&mut self, bytes: &[u8]) -> Vec<u8> {
            self.port.take(&mut self.bench, bytes, &self.site, &mut self.unread);
            self.bench.run_until(self.bench.now() + Duration::secs(1));
            self.port.receive(&mut self.bench, &mut self.unread);
            self.unread.take()
        }

        /// Executes a command without an interest in its answer.
        fn set(&mut self, command: &[u8]) {
            let _ = self.say(&[&[255, 250, 44], command, &[255, 240]].concat());
        }
    }

    #[test]
    fn a_setting_that_differs_gets_no_answer() {
        let request = rtu::read(1, 0x15, 1);
        let reply = rtu::frame(1, &[3, 2, 0x13, 0x88]);
        // 9,600 baud, 8 data bits, even parity, 1 stop bit are those of an MD3.
        for (command, wrong, right) in [
            (1, &[0, 0, 0x4B, 0][..], &[0, 0, 0x25, 0x80][..]),
            (2, &[7], &[8]),
            (3, &[1], &[3]),
            (3, &[2], &[3]),
            (4, &[2], &[1]),
        ] {
            let mut rig = Rig::new("md3");
            rig.say(&OPEN);
            assert_eq!(rig.say(&request), reply[..]);
            rig.set(&[&[command], wrong].concat());
            assert_eq!(rig.say(&request), NOTHING, "{command} {wrong:?}");
            rig.set(&[&[command], right].concat());
            assert_eq!(rig.say(&request), reply[..]);
            assert_eq!(rig.bench.statistics(rig.drive, Port(0)).spoiled, 1);
        }
    }

    #[test]
    fn a_peer_with_other_settings_reads_what_its_uart_reads() {
        let mut rig = Rig::new("qsb-d");
        rig.say(&OPEN);
        assert_eq!(rig.say(b"R0E\r"), b"r 0E 00000000 !\r\n");
        rig.set(&[1, 0, 1, 0xC2, 0]);
        let other = rig.bench.connect(rig.port.bus);
        rig.bench.send(other, b"R0E\r");
        let misread = rig.say(&[]);
        assert!((1..=9).contains(&misread.len()) && !misread.starts_with(b"r"), "{misread:?}");
    }

    #[test]
    fn of_seven_data_bits_the_eighth_is_not_sent() {
        // TYPE_MODBUS 1 is Modbus ASCII, 7E1 (6.4).
        let mut rig = Rig::with("rs434544", &[("TYPE_MODBUS", 1)]);
        assert_eq!(rig.bench.line(rig.port.bus).to_string(), "115200 7E1");
        rig.say(&OPEN);
        // Reads TYPE_MODBUS. The LRC of 01 03 50 01 00 01 is AA, and that of the reply 01 03 02 00 01 is F9.
        let request = b":010350010001AA\r\n".map(|byte| byte | 0x80);
        assert_eq!(rig.say(&request), b":0103020001F9\r\n");
    }

    #[test]
    fn dtr_resets_a_qsb() {
        let mut rig = Rig::new("qsb-d");
        // A second after the opening the banner is there; the answers to the opening are before it.
        assert!(rig.say(&OPEN).ends_with(b"QSB-D  0E!\r\n"));
        rig.set(&[5, 8]);
        rig.set(&[5, 9]);
        let came = rig.say(&[255, 250, 44, 5, 8, 255, 240]);
        assert_eq!(came, [&[255, 250, 44, 105, 8, 255, 240][..], b"QSB-D  0E!\r\n"].concat());
        assert!(rig.port.hang_up(&mut rig.bench));
        assert!(!rig.port.hang_up(&mut rig.bench));
        // Without Telnet, nothing is reset.
        let mut rig = Rig::new("qsb-d");
        assert_eq!(rig.say(b"R0E\r"), b"r 0E 00000000 !\r\n");
        assert!(!rig.port.hang_up(&mut rig.bench));
    }

    #[test]
    fn a_suspended_port_holds_characters_and_a_purge_drops_them() {
        let mut rig = Rig::new("qsb-d");
        rig.say(&OPEN);
        rig.set(&[8]);
        assert_eq!(rig.say(b"R0E\r"), NOTHING);
        assert_eq!(rig.port.held(), 17);
        assert_eq!(rig.say(&[255, 250, 44, 9, 255, 240]), b"r 0E 00000000 !\r\n");
        rig.set(&[8]);
        assert_eq!(rig.say(b"R0E\r"), NOTHING);
        // The characters are dropped, and the answer follows at once.
        assert_eq!(rig.say(&[255, 250, 44, 12, 1, 255, 240]), [255, 250, 44, 112, 1, 255, 240]);
        assert_eq!(rig.port.held(), 0);
        // A peer that has sent everything cannot resume.
        assert_eq!(rig.say(b"R0E\r"), NOTHING);
        assert!(!rig.port.end(&mut rig.bench));
        assert_eq!(rig.say(&[]), b"r 0E 00000000 !\r\n");
    }

    #[test]
    fn a_purge_drops_half_a_frame() {
        let mut rig = Rig::new("md3");
        rig.say(&OPEN);
        let request = rtu::read(1, 0x15, 1);
        let purge = [255, 250, 44, 12, 2, 255, 240];
        let came = rig.say(&[&request[..5], &purge, &request].concat());
        assert_eq!(
            came,
            [&[255, 250, 44, 112, 2, 255, 240][..], &rtu::frame(1, &[3, 2, 0x13, 0x88])].concat()
        );
    }

    #[test]
    fn bytes_of_255_are_sent_twice_with_telnet_only() {
        // UserRegister (7.28) holds any value.
        let request = rtu::write(1, 0x1D, 0xFFFF);
        let doubled: Vec<u8> =
            request.iter().flat_map(|&byte| vec![byte; if byte == 255 { 2 } else { 1 }]).collect();
        assert!(doubled.len() >= request.len() + 2);
        let mut rig = Rig::new("md3");
        rig.say(&OPEN);
        assert_eq!(rig.say(&doubled), doubled);
        let mut rig = Rig::new("md3");
        assert_eq!(rig.say(&request), request[..]);
    }
}
