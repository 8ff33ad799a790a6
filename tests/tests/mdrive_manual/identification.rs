//! Function 43/14 (FB 4.1.1), with the real lengths of its strings.

use crate::rig::{KINDS, Kind, Rig};

/// Conformity level: regular identification, streams and single objects.
const CONFORMITY: u8 = 0x82;

/// Objects of a reply, each with its identifier and text.
fn objects(reply: &[u8]) -> Vec<(u8, String)> {
    let mut rest = &reply[7..];
    let mut all = Vec::new();
    while let [id, length, tail @ ..] = rest {
        let (text, behind) = tail.split_at(usize::from(*length));
        all.push((*id, String::from_utf8(text.to_vec()).expect("text")));
        rest = behind;
    }
    assert_eq!(usize::from(reply[6]), all.len(), "the number of objects");
    all
}

/// Texts of objects 0 to 5. Part number and serial number are those that PR prints; the others are from the
/// manual.
fn expected(rig: &mut Rig) -> Vec<String> {
    let (part, serial) = (rig.show("PN"), rig.show("SN"));
    assert!(!part.is_empty());
    assert!(serial.len() == 9 && serial.bytes().all(|byte| byte.is_ascii_digit()), "{serial:?}");
    let known = ["SEM USA", &part, "4.0.0.0", "www.imshome.com", "MDrive Ethernet", &serial];
    known.map(str::to_owned).to_vec()
}

#[test]
fn basic_identification_is_three_objects() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let expected = expected(&mut rig);
        let reply = rig.ask(&[0x2B, 0x0E, 1, 0]);
        assert_eq!(reply[..6], [0x2B, 0x0E, 1, CONFORMITY, 0, 0]);
        let known: Vec<(u8, String)> = (0..).zip(expected.into_iter().take(3)).collect();
        assert_eq!(objects(&reply), known);
    }
}

#[test]
fn regular_identification_is_seven_objects() {
    for kind in KINDS {
        let mut rig = Rig::new(kind);
        let expected = expected(&mut rig);
        for code in [2, 3] {
            let reply = rig.ask(&[0x2B, 0x0E, code, 0]);
            assert_eq!(reply[..6], [0x2B, 0x0E, code, CONFORMITY, 0, 0]);
            let mut objects = objects(&reply);
            let (six, version) = objects.pop().expect("seven objects");
            assert_eq!(objects, (0..).zip(expected.iter().cloned()).collect::<Vec<_>>());
            assert_eq!(six, 6);
            // On a Hybrid, `PR VR` prints a second value: the version of the hardware (MC 5-80).
            let printed = rig.show("VR");
            let digits = printed.split([' ', ',']).next().expect("a version");
            let name = if kind == Kind::Hybrid { "ASI" } else { "MDI" };
            let major = if kind == Kind::Hybrid { "4." } else { "3." };
            assert_eq!(version, format!("{name} {digits}"));
            assert!(digits.starts_with(major), "{digits}");
        }
    }
}

#[test]
fn one_object_is_read_alone() {
    let mut rig = Rig::plus();
    let mut texts = expected(&mut rig);
    texts.push(format!("MDI {}", rig.show("VR")));
    for (id, text) in (0..).zip(&texts) {
        let mut reply = vec![0x2B, 0x0E, 4, CONFORMITY, 0, 0, 1, id, text.len() as u8];
        reply.extend(text.as_bytes());
        assert_eq!(rig.ask(&[0x2B, 0x0E, 4, id]), reply);
    }
    for id in [7, 0x7F, 0x80, 0xFF] {
        assert_eq!(rig.try_ask(&[0x2B, 0x0E, 4, id]), Err(2), "{id}");
    }
}

/// "If the Object Id does not match any known object, the server responds as if object 0 were pointed out."
#[test]
fn a_stream_begins_at_the_requested_object() {
    let mut rig = Rig::plus();
    let all = objects(&rig.ask(&[0x2B, 0x0E, 2, 0]));
    for from in 0..=6 {
        assert_eq!(objects(&rig.ask(&[0x2B, 0x0E, 2, from])), all[usize::from(from)..], "{from}");
    }
    for from in [7, 0x80, 0xFF] {
        assert_eq!(objects(&rig.ask(&[0x2B, 0x0E, 2, from])), all, "{from}");
        assert_eq!(objects(&rig.ask(&[0x2B, 0x0E, 1, from])), all[..3], "{from}");
    }
}

#[test]
fn other_identification_requests_are_refused() {
    let mut rig = Rig::plus();
    for code in [0, 5, 0xFF] {
        assert_eq!(rig.try_ask(&[0x2B, 0x0E, code, 0]), Err(3), "{code}");
    }
    for pdu in [&[0x2B][..], &[0x2B, 0x0E], &[0x2B, 0x0E, 1], &[0x2B, 0x0E, 1, 0, 0]] {
        assert!(rig.try_ask(pdu).is_err(), "{pdu:02X?}");
    }
    // CANopen (13) and reserved types.
    for mei in [0, 0x0D, 0x0F, 0xFF] {
        assert_eq!(rig.try_ask(&[0x2B, mei, 1, 0]), Err(1), "{mei}");
    }
    rig.assert_no_error();
}
