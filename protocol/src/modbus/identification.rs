//! Read device identification: function 43 with MEI type 14 (application 6.21).

use super::Reply;
use super::pdu::{ENCAPSULATED_INTERFACE, Exception, PDU_BYTES};

/// MEI type, the byte after the function code.
const READ_DEVICE_IDENTIFICATION: u8 = 14;

/// Bit of the conformity level: the device also answers requests for single objects.
pub const SINGLE_OBJECTS: u8 = 0x80;

/// An object: its identifier and its value of at most 244 bytes. A longer value is truncated.
pub type Object<'a> = (u8, &'a [u8]);

/// Conformity level: basic and regular objects, streamed.
pub const REGULAR: u8 = 2;

/// Codes of a request: 1 to 3 stream the objects of a category and of the categories below it, 4 reads a
/// single object.
const BASIC: u8 = 1;
const SINGLE: u8 = 4;

/// Value of the field "more follows": the device has more objects than fit into this reply.
const MORE_FOLLOWS: u8 = 0xFF;

/// Bytes of the fields "more follows", "next object" and "number of objects". They are known after the
/// objects are written.
const OUTCOME_BYTES: usize = 3;

/// Bytes before the objects: function, type, code and conformity, then the outcome fields.
const HEAD_BYTES: usize = 4 + OUTCOME_BYTES;

/// Longest value. A reply does not divide an object, so an object must fit with its identifier and its
/// length.
const VALUE_BYTES: usize = PDU_BYTES - HEAD_BYTES - 2;

/// Answers the request `pdu`: appends the PDU of the reply to `reply`. `objects` are in ascending order of
/// their identifiers; the reply has as many of them as fit.
///
/// `conformity` is 1 for a device with basic objects (0 to 2), [`REGULAR`] with regular objects (to 0x7F), 3
/// with extended objects. [`SINGLE_OBJECTS`] is added if the device answers requests for single objects. A
/// request for a higher category than the device has gets the categories that it has. A stream from an
/// unknown object starts at the first object.
///
/// # Errors
/// [`Exception::IllegalFunction`] for a type other than 14, [`Exception::IllegalDataAddress`] for a single
/// object that the device does not have, [`Exception::IllegalDataValue`] for a wrong length or code.
pub fn answer(
    pdu: &[u8],
    conformity: u8,
    objects: &[Object<'_>],
    reply: &mut Reply,
) -> Result<(), Exception> {
    let (code, object) = match *pdu {
        [_, READ_DEVICE_IDENTIFICATION, code, object] => (code, object),
        [_, READ_DEVICE_IDENTIFICATION, ..] | [] | [_] => return Err(Exception::IllegalDataValue),
        [_, _, ..] => return Err(Exception::IllegalFunction),
    };
    let single = code == SINGLE;
    if !matches!(code, BASIC..=SINGLE) || single && conformity & SINGLE_OBJECTS == 0 {
        return Err(Exception::IllegalDataValue);
    }
    let last = match code.min(conformity & !SINGLE_OBJECTS) {
        _ if single => 0xFF,
        BASIC => 0x02,
        REGULAR => 0x7F,
        _ => 0xFF,
    };
    let count = objects.iter().take_while(|(id, _)| *id <= last).count();
    let category = objects.get(..count).unwrap_or(objects);
    let asked = category.iter().position(|(id, _)| *id == object);
    let chosen = match asked {
        Some(place) if single => category.get(place..=place),
        None if single => return Err(Exception::IllegalDataAddress),
        Some(place) => category.get(place..),
        None => None,
    };
    let head = reply.len();
    let function = [ENCAPSULATED_INTERFACE, READ_DEVICE_IDENTIFICATION, code, conformity];
    let _ = reply.extend_from_slice(&function);
    let _ = reply.extend_from_slice(&[0; OUTCOME_BYTES]);
    let (mut more, mut next, mut number) = (0, 0, 0_u8);
    let mut room = PDU_BYTES - HEAD_BYTES;
    for &(id, value) in chosen.unwrap_or(category) {
        let value = value.get(..VALUE_BYTES).unwrap_or(value);
        let Some(left) = room.checked_sub(2 + value.len()) else {
            (more, next) = (MORE_FOLLOWS, id);
            break;
        };
        let _ = reply.extend_from_slice(&[id, (value.len() & 0xFF) as u8]);
        let _ = reply.extend_from_slice(value);
        (room, number) = (left, number.wrapping_add(1));
    }
    let outcome = reply.get_mut(head + function.len()..).and_then(|rest| rest.first_chunk_mut());
    if let Some(outcome) = outcome {
        *outcome = [more, next, number];
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modbus::Frame;
    use std::vec::Vec;

    const OBJECTS: &[Object<'_>] = &[
        (0, b"SEM USA"),
        (1, b"MDI3CRL23A7-EQ"),
        (2, b"4.0.0.0"),
        (3, b"www.imshome.com"),
        (4, b"MDrive Ethernet"),
        (5, b"123456789"),
        (6, b"MDI 3.0.0.9"),
    ];

    /// Answer to a request, without the byte (7) that the framing wrote into the reply before.
    fn ask(pdu: &[u8], conformity: u8, objects: &[Object<'_>]) -> Result<Vec<u8>, Exception> {
        let mut reply = Frame::from_slice(&[7]).unwrap();
        answer(pdu, conformity, objects, &mut reply)?;
        assert!(reply.len() <= 1 + 253);
        Ok(reply.strip_prefix(&[7]).unwrap().to_vec())
    }

    /// An expected reply: the bytes before the objects, and the objects with their lengths.
    fn reply(head: [u8; 7], objects: &[Object<'_>]) -> Result<Vec<u8>, Exception> {
        let mut reply = head.to_vec();
        for (id, value) in objects {
            reply.extend([*id, value.len() as u8]);
            reply.extend_from_slice(value);
        }
        Ok(reply)
    }

    #[test]
    fn the_example_of_the_specification() {
        let objects: &[Object<'_>] =
            &[(0, b"Company identification"), (1, b"Product code XX"), (2, b"V2.11")];
        let mut expected = Vec::from([0x2B, 0x0E, 1, 1, 0, 0, 3, 0, 0x16]);
        expected.extend(b"Company identification");
        // The specification has length 0Dh here, but its text has 15 characters.
        expected.extend([1, 0x0F]);
        expected.extend(b"Product code XX");
        expected.extend([2, 5]);
        expected.extend(b"V2.11");
        assert_eq!(ask(&[0x2B, 0x0E, 1, 0], 1, objects), Ok(expected));
    }

    #[test]
    fn streams_give_a_category_and_no_more_than_the_device_has() {
        let basic = reply([43, 14, 1, 0x82, 0, 0, 3], &OBJECTS[..3]);
        assert_eq!(ask(&[43, 14, 1, 0], 0x82, OBJECTS), basic);
        assert_eq!(ask(&[43, 14, 2, 0], 0x82, OBJECTS), reply([43, 14, 2, 0x82, 0, 0, 7], OBJECTS));
        assert_eq!(ask(&[43, 14, 3, 0], 0x82, OBJECTS), reply([43, 14, 3, 0x82, 0, 0, 7], OBJECTS));
        assert_eq!(ask(&[43, 14, 2, 5], 0x82, OBJECTS), reply([43, 14, 2, 0x82, 0, 0, 2], &OBJECTS[5..]));
        let private: &[Object<'_>] = &[(0, b"a"), (0x7F, b"b"), (0x80, b"c")];
        assert_eq!(ask(&[43, 14, 2, 0], 3, private), reply([43, 14, 2, 3, 0, 0, 2], &private[..2]));
        assert_eq!(ask(&[43, 14, 3, 0], 3, private), reply([43, 14, 3, 3, 0, 0, 3], private));
        assert_eq!(ask(&[43, 14, 3, 0], 1, private), reply([43, 14, 3, 1, 0, 0, 1], &private[..1]));
    }

    #[test]
    fn a_stream_from_an_unknown_object_starts_at_the_beginning() {
        for object in [7, 0x7F, 0x80, 0xFF] {
            let regular = reply([43, 14, 2, 0x82, 0, 0, 7], OBJECTS);
            assert_eq!(ask(&[43, 14, 2, object], 0x82, OBJECTS), regular, "object {object}");
        }
        let basic = reply([43, 14, 1, 0x82, 0, 0, 3], &OBJECTS[..3]);
        assert_eq!(ask(&[43, 14, 1, 3], 0x82, OBJECTS), basic, "no basic object");
    }

    #[test]
    fn single_objects() {
        for (place, object) in OBJECTS.iter().enumerate() {
            let single = reply([43, 14, 4, 0x82, 0, 0, 1], &OBJECTS[place..=place]);
            assert_eq!(ask(&[43, 14, 4, object.0], 0x82, OBJECTS), single);
        }
        assert_eq!(ask(&[43, 14, 4, 7], 0x82, OBJECTS), Err(Exception::IllegalDataAddress));
        assert_eq!(ask(&[43, 14, 4, 0], 0x02, OBJECTS), Err(Exception::IllegalDataValue), "streams only");
    }

    #[test]
    fn what_is_no_such_request() {
        for code in [0, 5, 0xFF] {
            assert_eq!(
                ask(&[43, 14, code, 0], 0x82, OBJECTS),
                Err(Exception::IllegalDataValue),
                "code {code}"
            );
        }
        for pdu in [&[43][..], &[43, 14], &[43, 14, 1], &[43, 14, 1, 0, 0], &[]] {
            assert_eq!(ask(pdu, 0x82, OBJECTS), Err(Exception::IllegalDataValue), "{pdu:?}");
        }
        for pdu in [&[43, 13][..], &[43, 13, 1, 0], &[43, 0, 1, 0, 0]] {
            assert_eq!(ask(pdu, 0x82, OBJECTS), Err(Exception::IllegalFunction), "{pdu:?}");
        }
    }

    #[test]
    fn what_has_no_room_is_asked_for_next() {
        // 7 + (2 + 120) + (2 + 122) = 253, and one byte more does not fit.
        let long = [b'x'; 255];
        for (second, fits) in [(122, true), (123, false)] {
            let objects: &[Object<'_>] = &[(0, &long[..120]), (1, &long[..second]), (2, b"")];
            let first = ask(&[43, 14, 1, 0], 1, objects);
            if fits {
                assert_eq!(first, reply([43, 14, 1, 1, 0xFF, 2, 2], &objects[..2]));
                assert_eq!(ask(&[43, 14, 1, 2], 1, objects), reply([43, 14, 1, 1, 0, 0, 1], &objects[2..]));
            } else {
                assert_eq!(first, reply([43, 14, 1, 1, 0xFF, 1, 1], &objects[..1]));
                assert_eq!(ask(&[43, 14, 1, 1], 1, objects), reply([43, 14, 1, 1, 0, 0, 2], &objects[1..]));
            }
        }
        // An object that is too long for any reply is truncated. Otherwise a client would ask for it forever.
        let objects: &[Object<'_>] = &[(0, &long), (1, b"a")];
        let cut: &[Object<'_>] = &[(0, &long[..244])];
        assert_eq!(ask(&[43, 14, 1, 0], 1, objects), reply([43, 14, 1, 1, 0xFF, 1, 1], cut));
    }
}
