//! Functions 1, 2, 3, 5, 16 and 43 as in FB 4, with its examples.

use super::*;

#[test]
fn examples_of_the_manual() {
    let mut dut = Dut::plus();
    // FB 4.2.4 and 4.2.5 print 8Ah for VM, but VM is at 8Bh. 768,000 is 000BB800h, 600,000 is 000927C0h.
    assert_eq!(dut.ask(&[3, 0, 0x8B, 0, 2]), [3, 4, 0x00, 0x0B, 0xB8, 0x00]);
    assert_eq!(dut.ask(&[16, 0, 0x8B, 0, 2, 4, 0x00, 0x09, 0x27, 0xC0]), [16, 0, 0x8B, 0, 2]);
    assert_eq!(dut.get(Reg::VM), 600_000);
    assert_eq!(dut.ask(&[3, 0, 0x8A, 0, 2]), [3, 4, 0x03, 0xE8, 0x00, 0x09], "halves of VI and VM");
}

#[test]
fn inputs_as_bits() {
    let mut dut = Dut::plus();
    // FB 4.2.1: I1, I2 and I4 are active, which means low (MC 5-64).
    for (n, low) in [(1, true), (2, true), (3, false), (4, true)] {
        dut.drive(n, !low);
    }
    assert_eq!(dut.ask(&[2, 0x00, 0x2D, 0x00, 0x04]), [2, 1, 0x0B]);
    assert_eq!(dut.ask(&[2, 0x00, 0x2E, 0x00, 0x02]), [2, 1, 0b01]);
    assert_eq!(dut.ask(&[3, 0x00, 0x2D, 0x00, 0x04]), [3, 8, 0, 1, 0, 1, 0, 0, 0, 1]);
    assert_eq!((dut.read(0x3A, 1), dut.read(0x3B, 1)), (0b0100, 0b0100), "levels");
    for (first, count, exception) in
        [(0x2D, 0, 3), (0x2D, 5, 3), (0x2E, 4, 2), (0x31, 1, 2), (0x2C, 1, 2), (0x4B, 1, 2)]
    {
        dut.refused(&[2, 0, first, 0, count], exception, 0);
    }
}

#[test]
fn outputs_as_bits() {
    let mut dut = Dut::plus();
    for reg in [Reg::S1, Reg::S2, Reg::S3, Reg::S4] {
        dut.set(reg, 16 << 32 | 1 << 16);
    }
    // FB 4.2.3 switches O3 on. FB 4.2.2 reads O1 and O3 as on.
    assert_eq!(dut.ask(&[5, 0x00, 0x4D, 0xFF, 0x00]), [5, 0x00, 0x4D, 0xFF, 0x00]);
    dut.write(0x4B, 1, 1);
    assert_eq!(dut.ask(&[1, 0x00, 0x4B, 0x00, 0x04]), [1, 1, 0x05]);
    assert_eq!(dut.ask(&[5, 0x00, 0x4B, 0x00, 0x00]), [5, 0x00, 0x4B, 0x00, 0x00]);
    assert_eq!(dut.ask(&[3, 0x00, 0x4B, 0x00, 0x04]), [3, 8, 0, 0, 0, 0, 0, 1, 0, 0]);
    dut.write(0x55, 1, 0b1010);
    assert_eq!(dut.ask(&[1, 0x00, 0x4B, 0x00, 0x04]), [1, 1, 0b1010]);
    dut.write(0x56, 1, 0b0101);
    assert_eq!(dut.ask(&[1, 0x00, 0x4B, 0x00, 0x04]), [1, 1, 0b0101]);
    assert_eq!(dut.ask(&[16, 0, 0x4B, 0, 4, 8, 0, 1, 0, 1, 0, 1, 0, 0]), [16, 0, 0x4B, 0, 4]);
    assert_eq!(dut.ask(&[1, 0x00, 0x4B, 0x00, 0x04]), [1, 1, 0b0111]);
    for value in [[0xFF, 0x01], [0x00, 0x01], [0x01, 0x00], [0xFF, 0xFF]] {
        dut.refused(&[5, 0, 0x4B, value[0], value[1]], 3, 0);
    }
    dut.refused(&[5, 0, 0x2D, 0xFF, 0], 2, 0);
    dut.refused(&[5, 0, 0x09, 0xFF, 0], 2, 0);
    dut.refused(&[1, 0, 0x4B, 0, 5], 3, 0);
    dut.refused(&[1, 0, 0x2D, 0, 1], 2, 0);
}

#[test]
fn some_outputs() {
    let mut dut = Dut::plus();
    dut.set(Reg::S3, 16 << 32);
    // A point that is not an output refuses 1 and ignores 0.
    dut.refused(&[16, 0, 0x55, 0, 1, 2, 0, 0b0110], 4, 9);
    assert_eq!(dut.read(0x4D, 1), 0);
    dut.write(0x55, 1, 0b0100);
    assert_eq!(dut.read(0x4D, 1), 1);
    dut.refused(&[16, 0, 0x4C, 0, 2, 4, 0, 1, 0, 0], 4, 9);
    assert_eq!(dut.read(0x4D, 1), 1, "all or nothing");
}

#[test]
fn one_to_four_registers() {
    let mut dut = Dut::plus();
    assert_eq!(dut.ask(&[3, 0, 0x5F, 0, 4]), [3, 8, 0, 0, 0, 0, 0, 0, 0, 0]);
    dut.refused(&[3, 0, 0x5F, 0, 0], 3, 0);
    dut.refused(&[3, 0, 0x5F, 0, 5], 3, 0);
    dut.refused(&[3, 0, 0x5F, 1, 0], 3, 0);
    assert_eq!(dut.ask(&[16, 0, 0x5F, 0, 4, 8, 0, 0, 0, 1, 0xFF, 0xFF, 0xFF, 0xFF]), [16, 0, 0x5F, 0, 4]);
    assert_eq!((dut.get(Reg::R1), dut.get(Reg::R2)), (1, -1));
    dut.refused(&[16, 0, 0x5F, 0, 5, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0], 3, 0);
    dut.refused(&[16, 0, 0x5F, 0, 0, 0], 3, 0);
    dut.refused(&[16, 0, 0x5F, 0, 2, 2, 0, 0], 3, 0);
    dut.refused(&[16, 0, 0x5F, 0, 1, 2, 0, 0], 3, 0);
    dut.refused(&[16, 0, 0x60, 0, 2, 4, 0, 0, 0, 0], 3, 0);
    assert_eq!((dut.get(Reg::R1), dut.get(Reg::R2)), (1, -1), "half of a value is not written");
}

#[test]
fn functions_that_are_not_there() {
    let mut dut = Dut::plus();
    for function in (0..=127).filter(|function| ![1, 2, 3, 5, 16, 43, 65, 66].contains(function)) {
        dut.refused(&[function, 0, 0, 0, 1], 1, 0);
    }
}

#[test]
fn several_values_are_judged_on_their_outcome() {
    let mut dut = Dut::plus();
    let both = |vi: u16, vm: u32| {
        let ([a, b], [c, d, e, f]) = (vi.to_be_bytes(), vm.to_be_bytes());
        [16, 0, 0x89, 0, 4, 8, 0, 0, a, b, c, d, e, f]
    };
    // Neither value alone would be accepted: VM is below the old VI, or VI above the old VM.
    assert_eq!(dut.ask(&both(100, 500)), [16, 0, 0x89, 0, 4]);
    assert_eq!(dut.ask(&both(800, 900)), [16, 0, 0x89, 0, 4]);
    dut.refused(&both(900, 900), 3, 22);
    dut.refused(&both(0, 900), 3, 21);
    assert_eq!((dut.get(Reg::VI), dut.get(Reg::VM)), (800, 900));
    // D1, D2 and D3 in one request; the value of D3 is illegal.
    dut.refused(&[16, 0, 0x0F, 0, 3, 6, 0, 7, 0, 7, 1, 0], 3, 21);
    assert_eq!((dut.get(Reg::D1), dut.get(Reg::D2)), (0, 0));
}

#[test]
fn what_is_counted_beside_it() {
    let mut dut = Dut::plus();
    let three = |db: u8, counted: u8, de: u8| [16, 0, 0x1A, 0, 3, 6, 0, db, 0, counted, 0, de];
    // The request writes DB, then DC with the address of DB, then DE.
    assert_eq!(dut.ask(&three(50, 0x1A, 1)), [16, 0, 0x1A, 0, 3]);
    assert_eq!((dut.read(0x1A, 1), dut.read(0x1B, 1)), (49, 0));
    // 0 cannot be counted down, whatever value DB had before.
    dut.refused(&three(0, 0x1A, 0), 3, 21);
    assert_eq!((dut.read(0x1A, 1), dut.read(0x1C, 1)), (49, 1), "all or nothing");
    // TE = 8 enables TT alone. Counted down to 7 it would enable trips that are not defined.
    dut.connect(CLIENT);
    dut.type_in(CLIENT, "PG 1\rLB K1\rRT\rPG\rTT=100,K1\rTE=8\r");
    dut.refused(&three(7, 0x7D, 0), 4, 27);
    assert_eq!((dut.read(0x1A, 1), dut.read(0x7D, 1), dut.read(0x1C, 1)), (49, 8, 1));
    dut.type_in(CLIENT, "TE=0\r");
    // DC counts DE down while DE is still 0. Only after that DE becomes 1.
    dut.write(0x1C, 1, 0);
    dut.refused(&three(7, 0x1C, 1), 3, 21);
    assert_eq!(dut.read(0x1A, 1), 49);
}

#[test]
fn a_move_and_what_stands_beside_it() {
    let mut dut = Dut::plus();
    // Writes LM and MA, then MR, MS and MT.
    assert_eq!(dut.ask(&[16, 0, 0x42, 0, 3, 6, 0, 2, 0, 0, 0x27, 0x10]), [16, 0, 0x42, 0, 3]);
    assert_eq!((dut.get(Reg::LM), dut.get(Reg::MA)), (2, 10_000));
    dut.refused(&[16, 0, 0x46, 0, 4, 8, 0, 0, 0, 1, 0, 3, 0, 0], 3, 21);
    assert_eq!(dut.get(Reg::MR), 0);
    // On a Hybrid another MS calibrates, and MR cannot move the motor then.
    let mut dut = Dut::hybrid();
    dut.refused(&[16, 0, 0x46, 0, 3, 6, 0, 0, 0, 1, 0, 128], 4, 89);
    assert_eq!((dut.get(Reg::MR), dut.get(Reg::MS), dut.get(Reg::MV)), (0, 256, 0));
    assert_eq!(dut.ask(&[16, 0, 0x46, 0, 3, 6, 0, 0, 0, 1, 1, 0]), [16, 0, 0x46, 0, 3]);
}

#[test]
fn the_identification() {
    for (mut dut, part, firmware) in
        [(Dut::plus(), "MDI3CRL23A7-EQ", "MDI 3.0.0.9"), (Dut::hybrid(), "MAI3CRL23A7-EQ", "ASI 4.0.0.8")]
    {
        let objects =
            ["SEM USA", part, "4.0.0.0", "www.imshome.com", "MDrive Ethernet", "123456789", firmware];
        let stream = |code: u8, count: usize| {
            let mut pdu = vec![43, 14, code, 0x82, 0, 0, count as u8];
            for (n, object) in objects.iter().take(count).enumerate() {
                pdu.extend([n as u8, object.len() as u8]);
                pdu.extend(object.as_bytes());
            }
            pdu
        };
        assert_eq!(dut.ask(&[43, 14, 1, 0]), stream(1, 3));
        assert_eq!(dut.ask(&[43, 14, 2, 0]), stream(2, 7));
        assert_eq!(dut.ask(&[43, 14, 3, 0]), stream(3, 7));
        assert_eq!(dut.ask(&[43, 14, 2, 99]), stream(2, 7));
        let mut single = vec![43, 14, 4, 0x82, 0, 0, 1, 5, 9];
        single.extend(b"123456789");
        assert_eq!(dut.ask(&[43, 14, 4, 5]), single);
        dut.refused(&[43, 14, 4, 7], 2, 0);
        dut.refused(&[43, 14, 5, 0], 3, 0);
        dut.refused(&[43, 13, 1, 0], 1, 0);
    }
}

#[test]
fn any_unit_is_answered() {
    let mut dut = Dut::plus();
    for unit in [0, 1, 17, 255] {
        let before = dut.out.messages.len();
        let request = [0, 9, 0, 0, 0, 6, unit, 3, 0, 9, 0, 1];
        dut.feed(Input::Message { port: MODBUS, link: Link(3), bytes: &request });
        let reply = vec![0, 9, 0, 0, 0, 5, unit, 3, 2, 0, 1];
        assert_eq!(dut.out.messages[before..], [(dut.now, MODBUS, Link(3), reply)]);
    }
    assert_eq!(dut.out.noted().last(), Some(&LogEvent::Request { port: MODBUS, unit: 255, function: 3 }));
}

proptest::proptest! {
    #[test]
    fn any_request_has_one_answer(
        function in proptest::sample::select(vec![1_u8, 2, 3, 5, 16, 43, 65, 66, 4, 99]),
        data in proptest::collection::vec(
            proptest::prop_oneof![proptest::num::u8::ANY, proptest::sample::select(vec![0_u8, 1, 2, 4, 0x20, 0x53, 0x31])],
            0..24,
        ),
    ) {
        for mut dut in [Dut::plus(), Dut::hybrid()] {
            let pdu = [&[function][..], &data].concat();
            let reply = dut.ask(&pdu);
            proptest::prop_assert!(reply[0] & 0x7F == function && reply.len() <= 253);
            let refused = reply[0] & 0x80 != 0;
            proptest::prop_assert!(!refused || reply.len() == 2 && (1..=4).contains(&reply[1]));
            // A request with a wrong structure never sets an error of MCode.
            proptest::prop_assert!(!refused || reply[1] > 2 || dut.get(Reg::ER) == 0);
        }
    }
}
