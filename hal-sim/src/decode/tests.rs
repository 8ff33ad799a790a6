use drivetwin_firmware::device::Device as _;
use drivetwin_firmware::device::{Framing, Spec};
use drivetwin_firmware::{md3::Md3, mdrive::Mdrive, mdrobot::Mdrobot, qsb::Qsb, rs434::Rs434};
use drivetwin_protocol::modbus::{ascii, rtu, tcp};
use proptest::prelude::*;

use super::*;
use crate::record::journal::Draft;

fn md3() -> &'static Spec {
    Md3::new().spec()
}

fn mdrive() -> &'static Spec {
    Mdrive::plus().spec()
}

/// An RTU frame of slave 1.
fn frame(pdu: &[u8]) -> Vec<u8> {
    rtu::frame(1, pdu).to_vec()
}

fn rtu_message(bytes: &[u8]) -> Message<'_> {
    Message { framing: Framing::Silence, ascii: false, bytes }
}

/// The words of a request to slave 1.
fn asked(spec: &Spec, pdu: &[u8]) -> String {
    rtu_message(&frame(pdu)).request(spec).text
}

/// The words of the answer.
fn told(spec: &Spec, pdu: &[u8], answer: &[u8]) -> String {
    let (request, answer) = (frame(pdu), frame(answer));
    reply(spec, Some(&rtu_message(&request)), &rtu_message(&answer))
}

fn text(spec: &Spec, framing: Framing, line: &[u8], outcome: Outcome, answer: &[u8]) -> (String, String) {
    let port = spec.ports.iter().position(|port| port.framing == framing).unwrap();
    let mut draft = Draft::default();
    draft.begin(line);
    draft.answer(answer);
    let entry = draft.entry(Default::default(), drivetwin_firmware::device::Port(port as u8), outcome);
    let exchange = exchange(spec, &entry);
    (exchange.request.text, exchange.outcome)
}

#[test]
fn requests_to_an_md3_in_the_names_of_its_manual() {
    // MD3 chapter 7: Speed is 0x14 and 0x15, high word first; MoveSteps 0x12 and 0x13; Reserved 0x0B.
    for (pdu, words) in [
        (&[6, 0, 0x11, 0, 1][..], "write MotionControl = 1"),
        (&[16, 0, 0x14, 0, 2, 4, 0, 0, 0x23, 0x28], "write Speed = 9000"),
        (&[16, 0, 0x14, 0, 2, 4, 0xFF, 0xFF, 0xFF, 0xFE], "write Speed = -2"),
        (&[6, 0, 0x15, 0x23, 0x28], "write SpeedLow = 9000"),
        (&[6, 0, 0x14, 0, 0], "write SpeedHigh = 0"),
        (&[16, 0, 0x12, 0, 4, 8, 0, 0, 0, 5, 0, 0, 0, 6], "write MoveSteps = 5, Speed = 6"),
        (&[3, 0, 0x14, 0, 2], "read Speed"),
        (&[3, 0, 0x13, 0, 2], "read MoveStepsLow, SpeedHigh"),
        (&[3, 0, 0, 0, 31], "read 31 registers from DeviceAddress to SerialNumberHigh"),
        (&[3, 0, 0, 0, 126], "read 126 registers from DeviceAddress to 0x007D"),
        (&[3, 0x01, 0x00, 0, 2], "read 0x0100 to 0x0101"),
        (&[3, 0, 0x1E, 0, 4], "read SerialNumber, 0x0020 to 0x0021"),
        (&[5, 0, 0x0B, 0xFF, 0], "write coil 0x000B = on"),
        (&[5, 0, 0, 0, 0], "write coil 0x0000 = off"),
        (&[15, 0, 0, 0, 3, 1, 0b101], "write coils 0x0000 to 0x0002 = on, off, on"),
        (&[1, 0, 7, 0, 1], "read coil 0x0007"),
        (&[2, 0, 0, 0, 8], "read discrete inputs 0x0000 to 0x0007"),
        (&[3, 0, 0], "function 3, 2 bytes 00 00"),
        (&[7], "read the exception status"),
        (&[43, 14, 1, 0], "read the identification"),
        (&[65, 1, 2], "function 65, 2 bytes 01 02"),
        (&[3, 0, 0x14, 0, 0], "read nothing at 0x0014"),
    ] {
        assert_eq!(asked(md3(), pdu), words, "{pdu:02X?}");
    }
}

#[test]
fn answers_of_an_md3() {
    for (pdu, answer, words) in [
        (&[3, 0, 0x14, 0, 2][..], &[3, 4, 0, 0, 0x13, 0x88][..], "Speed = 5000"),
        (&[3, 0, 0x10, 0, 2], &[3, 4, 0, 7, 0, 1], "QuadratureEncoderCount = 7, MotionControl = 1"),
        (&[6, 0, 0x11, 0, 1], &[6, 0, 0x11, 0, 1], "done"),
        (&[6, 0, 0x0B, 0, 5], &[0x86, 2], "refused: 0x000B Reserved is read only (02)"),
        (&[6, 0, 0x20, 0, 5], &[0x86, 2], "refused: there is no register at 0x0020 (02)"),
        (&[3, 0, 0x1E, 0, 4], &[0x83, 2], "refused: there is no register at 0x0020 (02)"),
        (
            &[6, 0, 0, 0, 248],
            &[0x86, 3],
            "refused: 0x0000 DeviceAddress = 248 is not allowed, it takes 1 to 247 (03)",
        ),
        (&[5, 0, 0x0B, 0xFF, 0], &[0x85, 1], "refused: the drive has no function 5 (01)"),
        (&[3, 0, 0x14, 0, 0], &[0x83, 3], "refused: a quantity of 0 is not allowed (03)"),
        (
            &[3, 0, 0, 0, 33],
            &[0x83, 2],
            "refused: a quantity of 33 is not allowed, a request reads at most 32 registers (02)",
        ),
        (&[0x90, 2], &[0x90, 1], "refused: the drive has no function 0x90, a code of answers (01)"),
        (&[6, 0, 0x11, 0, 1], &[0x86, 4], "refused: the drive cannot execute it now (04)"),
        // Too short for its quantity.
        (&[3, 0, 0x14, 0, 2], &[3, 2, 0, 0], "Speed"),
    ] {
        assert_eq!(told(md3(), pdu, answer), words, "{pdu:02X?}");
    }
}

#[test]
fn a_coil_is_on_or_off() {
    let rs = Rs434::rs434544();
    // RS 434544 6.2: START_bit is coil 0x2000. A coil takes 0x0000 or 0xFF00 (application 6.5).
    let pdu = [5, 0x20, 0, 0x12, 0];
    assert_eq!(asked(rs.spec(), &pdu), "write START_bit = 0x1200");
    assert_eq!(told(rs.spec(), &pdu, &[0x85, 3]), "refused: a coil takes 0x0000 or 0xFF00, not 0x1200 (03)");
    assert_eq!(asked(rs.spec(), &[5, 0x20, 0, 0xFF, 0]), "write START_bit = on");
    assert_eq!(asked(rs.spec(), &[5, 0x20, 0, 0, 0]), "write START_bit = off");
}

#[test]
fn exceptions_of_a_drive_that_exist_have_its_reasons() {
    // FB 4.2.4: a request has up to four registers. MC 9: error 73.
    let refused = |pdu: &[u8], code, error| modbus::refusal(mdrive(), pdu, code, error);
    assert_eq!(
        refused(&[3, 0, 0x57, 0, 5], 3, Some(73)),
        "a quantity of 5 is not allowed, a request reads at most 4 registers (03)"
    );
    // VM is 0x8B and 0x8C.
    let write = [16, 0, 0x8B, 0, 2, 4, 0, 0, 3, 0xE8];
    assert_eq!(refused(&write, 3, Some(23)), "VM is set less than or equal to VI (error 23) (03)");
    assert_eq!(refused(&write, 4, Some(73)), "tried to save while moving (error 73) (04)");
    // RS434-28
    let rs = Rs434::rs434544();
    let save = [6, 0x80, 0x06, 0, 1];
    assert_eq!(
        modbus::refusal(rs.spec(), &save, 4, None),
        "a user program is running, so no program can be saved (04)"
    );
}

#[test]
fn a_refusal_blames_the_register_that_is_its_cause() {
    // RS 434544 6.4, 6.5: TYPE_MODBUS 0x5001 takes 1 to 5, BITRATE_MODBUS 0x5002 takes 0 to 10; SPEED 0x500B, ACC 0x500C.
    // MD3 chapter 7: Reserved is 0x0B.
    let blamed = |spec: &Spec, pdu: &[u8], code| {
        let registers = modbus::request(spec, pdu).registers;
        let rows = modbus::blamed(spec, pdu, code, &registers);
        rows.into_iter().map(|row| spec.registers.rows[row].name).collect::<Vec<_>>()
    };
    let rs = Rs434::rs434544();
    let both = [16, 0x50, 0x01, 0, 2, 4, 0, 3, 0, 11];
    assert_eq!(blamed(rs.spec(), &both, 3), ["BITRATE_MODBUS"]);
    assert_eq!(blamed(md3(), &[6, 0, 0x0B, 0, 5], 2), ["Reserved"]);
    // Only the drive knows why.
    assert_eq!(blamed(rs.spec(), &[16, 0x50, 0x0B, 0, 2, 4, 0, 100, 0, 100], 4), ["SPEED", "ACC"]);
    // No function, no register, too many registers.
    assert!(blamed(rs.spec(), &both, 1).is_empty());
    assert!(blamed(md3(), &[3, 0, 0x1E, 0, 4], 2).is_empty());
    assert!(blamed(md3(), &[3, 0, 0, 0, 33], 2).is_empty());
}

#[test]
fn a_single_byte_is_no_frame() {
    let byte = rtu_message(&[3]);
    assert_eq!(flaw(&byte), "no frame has this length");
    assert_eq!(
        dropped(
            &byte,
            &Draft::default().entry(
                Default::default(),
                drivetwin_firmware::device::Port(0),
                Outcome::NoPower
            ),
            DropReason::Crc
        )
        .1
        .unwrap(),
        "no frame has this length"
    );
}

#[test]
fn maps_with_bits_objects_and_the_low_word_first() {
    let rs = Rs434::rs434544();
    // RS 434544 6.5: OFFSET is 0x5015 and 0x5016, low word first.
    assert_eq!(asked(rs.spec(), &[16, 0x50, 0x15, 0, 2, 4, 0, 5, 0, 1]), "write OFFSET = 65541");
    assert_eq!(asked(rs.spec(), &[6, 0x50, 0x15, 0, 5]), "write OFFSETLow = 5");
    let md400 = Mdrobot::md400();
    // MDROBOT: each address is that of a whole value, and the manual counts in decimal.
    assert_eq!(
        told(md400.spec(), &[6, 0x27, 0x0F, 0, 5], &[0x86, 2]),
        "refused: there is no register at 9999 (02)"
    );
}

#[test]
fn ascii_and_tcp_have_the_same_words() {
    let message = ascii::frame(1, &[6, 0, 0x11, 0, 1]);
    let message = Message { framing: Framing::Silence, ascii: true, bytes: &message };
    assert_eq!(message.request(md3()).text, "write MotionControl = 1");
    assert_eq!(message.address(), Some(1));
    let adu = tcp::frame(tcp::Header { transaction: 7, unit: 255 }, &[3, 0, 0x57, 0, 2]);
    let message = Message { framing: Framing::Mbap, ascii: false, bytes: &adu };
    // MDrive FB: P is 0x57 and 0x58.
    assert_eq!(message.request(mdrive()).text, "read P");
    let all = rtu::write(0, 0x11, 1);
    assert_eq!(rtu_message(&all).request(md3()).text, "to all: write MotionControl = 1");
}

#[test]
fn commands_of_a_qsb() {
    let qsb = Qsb::d();
    let spec = qsb.spec();
    let character =
        |line: &[u8], outcome, answer: &[u8]| text(spec, Framing::Character, line, outcome, answer);
    let pair = |text: &str, outcome: &str| (text.to_owned(), outcome.to_owned());
    // QSB Command List: 0E is READ ENCODER, 15 the end of a response, 14 VERSION.
    assert_eq!(
        character(b"R0E\r", Outcome::Accepted, b"r 0E 00000010 !\r\n"),
        pair("read ReadEncoder", "ReadEncoder = 16")
    );
    assert_eq!(
        character(b"W150F\r\n", Outcome::Accepted, b"w150000000F!\r\n"),
        pair("write Eor = 15", "done")
    );
    assert_eq!(
        character(b"W141\r", Outcome::Refused(b'x'), b"x1400000000!\r\n").1,
        "refused: 14 Version is read only (x)"
    );
    assert_eq!(character(b"R7F\r", Outcome::Refused(b'x'), b"").1, "refused: there is no register 7F (x)");
    assert_eq!(
        character(b"hello\x07\r", Outcome::Refused(b'x'), b""),
        pair("hello\\x07", "refused: this is no command (x)")
    );
}

#[test]
fn lines_of_mcode() {
    let line = |line: &[u8], outcome, answer: &[u8]| text(mdrive(), Framing::Return, line, outcome, answer);
    let pair = |text: &str, outcome: &str| (text.to_owned(), outcome.to_owned());
    assert_eq!(line(b"PR P\r\n", Outcome::Accepted, b"\r\n51200\r\n>"), pair("PR P", "51200"));
    assert_eq!(line(b"VM=1000\r", Outcome::Accepted, b"\r\n>"), pair("VM=1000", "done"));
    assert_eq!(
        line(b"H\r", Outcome::Refused(40), b"\r\n?"),
        pair("H", "refused: program not running (error 40)")
    );
    let message = |bytes| Message { framing: Framing::Return, ascii: false, bytes };
    let register = |bytes| message(bytes).request(mdrive()).registers.into_iter().next().unwrap();
    let vm = register(b"vm -1000\r");
    assert_eq!((&*vm.name, vm.value, vm.written), ("VM", Some(Value::Number(-1_000)), true));
    assert_eq!((&*register(b"PR P").name, register(b"PR P").written), ("P", false));
    // MC 5-16, 5-33: DC and IC count a variable.
    for counted in [&b"IC R1"[..], b"dc r1", b"R1 = R2 + 5", b"R1=R1-1"] {
        let register = register(counted);
        assert_eq!((&*register.name, register.value, register.written), ("R1", None, true));
    }
    let named = message(b"R1 = R2 + 5").request(mdrive()).registers.pop().unwrap();
    assert_eq!((&*named.name, named.written), ("R2", false));
    // The command S saves, as a write of the register S does.
    assert_eq!((&*register(b"S\r").name, register(b"S\r").written), ("S", true));
    // MC 3.3.1: texts and comments name no variable.
    for (line, names) in [
        (&b"PR \"P V A\"\r"[..], &[][..]),
        (b"PR \"a\",P\r", &["P"]),
        (b"A=500000 'V comment\r", &["A"]),
        (b"PR A 'MR \"P\"\r", &["A"]),
        (b"PR \"it's P\", V\r", &["V"]),
    ] {
        let registers = message(line).request(mdrive()).registers;
        let found: Vec<&str> = registers.iter().map(|register| &*register.name).collect();
        assert_eq!(found, names, "{}", line.escape_ascii());
    }
}

#[test]
fn a_wrong_checksum_and_a_drive_that_starts() {
    assert_eq!(
        // Serial, appendix B: the CRC of 02 07 is 0x1241, sent as 41 12.
        wrong_sum(&rtu_message(&[2, 7, 0x41, 0x13])),
        "CRC wrong: 41 13 instead of 41 12"
    );
    for (left, words) in [
        (Some(Duration::millis(1_200)), "starting for 1.2 s more"),
        (Some(Duration::millis(1_101)), "starting for 1.2 s more"),
        (Some(Duration::millis(50)), "starting for 50 ms more"),
        (Some(Duration::TICK), "starting for 1 ms more"),
        (Some(Duration::ZERO), "starting"),
        (None, "starting"),
    ] {
        assert_eq!(starting(left), words);
    }
    assert_eq!(ranges(&[1, 2, 3, 7, 9, 10]), "1 to 3, 7, 9, 10");
}

fn specs() -> [&'static Spec; 5] {
    [md3(), mdrive(), Qsb::m().spec(), Rs434::rs434544().spec(), Mdrobot::md400().spec()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn any_bytes_have_words(
        bytes in proptest::collection::vec(any::<u8>(), 0..40),
        answer in proptest::collection::vec(any::<u8>(), 0..40),
        function in 0_u8..=24,
        code in any::<u8>(),
        kind in 0_usize..5,
        sum in any::<bool>(),
        is_ascii in any::<bool>(),
    ) {
        let spec = specs()[kind];
        let pdu = [&[function][..], &bytes].concat();
        let messages = [
            if is_ascii { ascii::frame(1, &pdu).to_vec() } else { frame(&pdu) },
            tcp::frame(tcp::Header { transaction: 1, unit: 1 }, &pdu).to_vec(),
            bytes.clone(),
        ];
        let outcomes = [
            Outcome::Accepted,
            Outcome::Refused(code),
            Outcome::Dropped(if sum { DropReason::Crc } else { DropReason::RxError }),
            Outcome::Dropped(DropReason::Length),
            Outcome::NoDrive,
        ];
        for message in &messages {
            for outcome in outcomes {
                for port in 0..spec.ports.len() as u8 {
                    let mut draft = Draft::default();
                    draft.begin(message);
                    draft.answer(&frame(&[&[function][..], &answer].concat()));
                    draft.reason(drivetwin_firmware::device::Reason(code));
                    let mut entry = draft.entry(Default::default(), drivetwin_firmware::device::Port(port), outcome);
                    entry.ascii = is_ascii;
                    let exchange = exchange(spec, &entry);
                    prop_assert!(exchange.outcome.len() < 2_000 && exchange.request.text.len() < 2_000);
                    prop_assert!(!exchange.outcome.contains('\n') && !exchange.request.text.contains('\r'));
                }
            }
        }
    }
}

#[test]
fn a_line_keeps_its_quotes() {
    assert_eq!(super::text::printable(b"PR \"it's\"\x1b\r\n"), "PR \"it's\"\\x1b");
}
