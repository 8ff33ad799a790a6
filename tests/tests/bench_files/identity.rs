//! The identification of drives can be preset and is read over the protocol. Each kind has a firmware
//! version, and some have a serial number.

use drivetwin_firmware::device::Port;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::modbus::tcp::{Header, frame};
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, DriveId, PowerAction};
use drivetwin_sim::config::bench_file;

use super::{ask, built, seat};

/// A bench of one drive with presets.
fn drive(kind: &str, set: &str) -> (Bench, DriveId) {
    let bench =
        built(&format!("[[drive]]\nname = 'x'\nkind = '{kind}'\nfast_boot = true\nset = {{ {set} }}\n"))
            .bench;
    let x = seat(&bench, "x");
    (bench, x)
}

/// Switches power off and on.
fn cycle(bench: &mut Bench, seat: DriveId) {
    bench.power(seat, PowerAction::Off);
    bench.run_until(bench.now() + 1.secs());
    bench.power(seat, PowerAction::On);
    bench.run_until(bench.now() + 10.millis());
}

/// Sends a request on the drive's serial line and returns the reply.
fn on_line(bench: &mut Bench, seat: DriveId, request: &[u8]) -> Vec<u8> {
    let client = bench.connect(bench.bus(seat, Port(0)).unwrap());
    ask(bench, client, request)
}

/// Asserts the reply to a request, before and after a power cycle.
#[track_caller]
fn always(kind: &str, set: &str, request: &[u8], reply: &[u8]) {
    let (mut bench, seat) = drive(kind, set);
    bench.run_until(bench.now() + 10.millis());
    for _ in 0..2 {
        assert_eq!(on_line(&mut bench, seat, request), reply, "{kind} {set}");
        cycle(&mut bench, seat);
    }
}

/// Register 1Bh has the version in its low byte; 1Eh and 1Fh are the serial number (MD3 7.21, 7.24).
#[test]
fn an_md3() {
    for (kind, product) in [("md3", 0xBD), ("md3-low", 0x3D)] {
        let set = format!("ProductInformation = 0x{product:02X}07, SerialNumber = 305419896");
        always(kind, &set, &rtu::read(1, 0x1B, 1), &rtu::frame(1, &[3, 2, product, 0x07]));
        always(kind, &set, &rtu::read(1, 0x1E, 2), &rtu::frame(1, &[3, 4, 0x12, 0x34, 0x56, 0x78]));
    }
}

/// VERSION: "the first five most significant digits are the serial number, the next digit is the product type
/// and the last two digits are the firmware version".
#[test]
fn a_qsb() {
    for (kind, digit) in [("qsb-d", '0'), ("qsb-m", '1'), ("qsb-s", '2')] {
        let reply = format!("r 14 54321{digit}11 !\r\n");
        always(kind, "SerialNumber = 54321, Firmware = 0x11", b"R14\r", reply.as_bytes());
    }
}

/// Input registers 8002h to 8004h (RS 6.8). A restart over the bus (6.5: 95AFh in FLAG_RESTART) keeps them.
#[test]
fn an_rs_drive() {
    for (kind, model) in [("rs434544", 1_001_u16), ("rs434546", 1_002)] {
        let request = rtu::frame(1, &[4, 0x80, 0x01, 0, 4]);
        let [high, low] = model.to_be_bytes();
        let reply = rtu::frame(1, &[4, 8, high, low, 0, 3, 0x12, 0x34, 0xFF, 0xFF]);
        let set = "HW_MINOR = 3, FW_MAJOR = 0x1234, FW_MINOR = 65535";
        always(kind, set, &request, &reply);
        let (mut bench, seat) = drive(kind, set);
        on_line(&mut bench, seat, &rtu::write(1, 0x5026, 0x95AF));
        bench.run_until(bench.now() + 10.secs());
        assert_eq!(on_line(&mut bench, seat, &request), reply[..], "restarted");
    }
}

/// PID_VERSION: "VER 1.3 -> DL = 13" (MDROBOT p. 6).
#[test]
fn an_mdrobot() {
    always("mdrobot", "VERSION = 13", &rtu::read(1, 1, 1), &rtu::frame(1, &[3, 2, 0, 13]));
}

/// PR PN, SN and VR (MC 5-56, 5-69, 5-80), and the objects of the device identification (FB 4.1.1). Ctrl-C
/// and FD do not change them.
#[test]
fn an_mdrive() {
    for (kind, hardware, family) in [("mdrive", "", "MDI "), ("mdrive-hybrid", ", 2.1", "ASI ")] {
        let mut set = String::from(
            "PartNumber = 'MDI4MRQ17C4-EQ-X', SerialNumber = '075091234', FirmwareVersion = '3.013', EthernetVersion = '1.2'",
        );
        if !hardware.is_empty() {
            set += ", HardwareVersion = '2.1'";
        }
        let (mut bench, seat) = drive(kind, &set);
        bench.run_until(bench.now() + 10.millis());
        for how in ["power", "Ctrl-C", "FD"] {
            let mcode = bench.connect_to(seat, Port(1)).unwrap();
            let bus = bench.connect_to(seat, Port(0)).unwrap();
            let say = |bench: &mut Bench, line: &str| {
                let mut text = ask(bench, mcode, line.as_bytes());
                bench.run_until(bench.now() + 100.millis());
                bench.receive(mcode, &mut text);
                String::from_utf8(text).unwrap()
            };
            say(&mut bench, "EM=2\r");
            assert_eq!(say(&mut bench, "PR PN\r"), "MDI4MRQ17C4-EQ-X\r\n", "{how}");
            assert_eq!(say(&mut bench, "PR SN\r"), "075091234\r\n");
            assert_eq!(say(&mut bench, "PR VR\r"), format!("3.013{hardware}\r\n"));
            for (object, text) in [
                (1, "MDI4MRQ17C4-EQ-X".to_owned()),
                (2, "1.2".into()),
                (5, "075091234".into()),
                (6, format!("{family}3.013")),
            ] {
                let request = frame(Header { transaction: 1, unit: 1 }, &[0x2B, 0x0E, 4, object]);
                let reply = ask(&mut bench, bus, &request);
                let length = u8::try_from(text.len()).unwrap();
                let value = [&[object, length][..], text.as_bytes()].concat();
                assert!(reply.ends_with(&value), "{how}: {object}: {reply:?}");
            }
            match how {
                "power" => drop(say(&mut bench, "\x03")),
                _ => drop(say(&mut bench, "FD\r")),
            }
        }
        cycle(&mut bench, seat);
        let mcode = bench.connect_to(seat, Port(1)).unwrap();
        let said = String::from_utf8(ask(&mut bench, mcode, b"PR SN\r")).unwrap();
        assert!(said.contains("075091234\r\n"), "{said:?}");
    }
}

/// Each error message is one sentence.
#[test]
fn invalid_identifications_are_refused() {
    for (kind, set, sentence) in [
        ("md3", "ProductInformation = 0x3D02", "ProductInformation takes 48384 to 48639, not 15618"),
        ("md3-low", "ProductInformation = 0xBD02", "ProductInformation takes 15616 to 15871, not 48386"),
        ("md3", "SerialNumber = 4294967296", "SerialNumber takes 0 to 4294967295, not 4294967296"),
        ("qsb-s", "Firmware = 256", "Firmware takes 0 to 255, not 256"),
        ("qsb-d", "SerialNumber = 100000", "SerialNumber takes 0 to 99999, not 100000"),
        ("rs434544", "FW_MINOR = 65536", "FW_MINOR takes 0 to 65535, not 65536"),
        ("mdrobot", "VERSION = 256", "VERSION takes 0 to 255, not 256"),
        (
            "mdrive",
            "PartNumber = 'MDI3CRL23A7-EQ-123'",
            "PartNumber takes 1 to 16 printable characters of ASCII, not 'MDI3CRL23A7-EQ-123'",
        ),
        ("mdrive", "SerialNumber = ''", "SerialNumber takes 1 to 16 printable characters of ASCII, not ''"),
        (
            "mdrive",
            "FirmwareVersion = '3\u{e4}'",
            "FirmwareVersion takes 1 to 16 printable characters of ASCII, not '3\u{e4}'",
        ),
        (
            "mdrive",
            "EthernetVersion = '1.0.0.200'",
            "EthernetVersion takes 1 to 8 printable characters of ASCII, not '1.0.0.200'",
        ),
        ("mdrive", "SerialNumber = 5", "SerialNumber takes a string, not 5"),
        (
            "mdrive",
            "HardwareVersion = '2'",
            "HardwareVersion is a register of other variants; mdrive does not have it",
        ),
    ] {
        let text = format!("[[drive]]\nname = 'x'\nkind = '{kind}'\nset = {{ {set} }}\n");
        let told = bench_file::parse(&text).err().unwrap_or_else(|| panic!("{set} is taken")).to_string();
        assert!(told.ends_with(sentence), "{told}");
    }
}
