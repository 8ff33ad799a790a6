//! A blocking Modbus master of another crate (rmodbus) homes an MD3 onto a switch, on virtual time.

use std::io::{Read, Write};

use drivetwin::{Bench, Instant, Level, Span as _, md3::pin};
use embedded_hal::delay::DelayNs;
use rmodbus::client::ModbusRequest;
use rmodbus::{ModbusProto, guess_response_frame_len};

/// Bits of MotionControl (7.15).
const HOME: u16 = 1 << 2;

/// A master as one writes it for a serial port: any port, any delay.
struct Master<P, D> {
    port: P,
    delay: D,
}

impl<P: Read + Write, D: DelayNs> Master<P, D> {
    fn exchange(&mut self, request: &[u8]) -> Vec<u8> {
        self.port.write_all(request).unwrap();
        let mut reply = vec![0; 6];
        self.port.read_exact(&mut reply).unwrap();
        let length = guess_response_frame_len(&reply, ModbusProto::Rtu).unwrap();
        reply.resize(length.into(), 0);
        self.port.read_exact(&mut reply[6..]).unwrap();
        // t3.5 at 9,600 bit/s.
        self.delay.delay_us(4_011);
        reply
    }

    fn read(&mut self, register: u16, count: u16) -> Vec<u16> {
        let (mut master, mut request) = (ModbusRequest::new(1, ModbusProto::Rtu), Vec::new());
        master.generate_get_holdings(register, count, &mut request).unwrap();
        let (reply, mut words) = (self.exchange(&request), Vec::new());
        master.parse_u16(&reply, &mut words).unwrap();
        words
    }

    fn write(&mut self, register: u16, value: u16) {
        let (mut master, mut request) = (ModbusRequest::new(1, ModbusProto::Rtu), Vec::new());
        master.generate_set_holding(register, value, &mut request).unwrap();
        let reply = self.exchange(&request);
        master.parse_ok(&reply).unwrap();
    }
}

#[test]
fn a_master_of_another_crate_homes_an_md3() {
    let bench = Bench::from_toml(
        "
        [[drive]]
        name = 'x'
        kind = 'md3'
        [[motor]]
        name = 'm'
        drive = 'x'
        [[switch]]
        motor = 'm'
        closed = { below_rev = -2.0 }
        to = 'x.J2.2'
        ",
    )
    .unwrap();
    let x = bench.drive("x").unwrap();
    // A drive accepts requests with the silence of t3.5 alone.
    bench.set_strict("rs485", true).unwrap();
    let mut master = Master { port: x.port("rs485").unwrap(), delay: bench.delay() };
    master.delay.delay_ms(2_500); // start-up
    master.write(0x04, 1 << 4); // HomingConfiguration: backward, stop at once
    master.write(0x11, HOME); // MotionControl
    let mut polls = 0;
    while master.read(0x11, 1) != [0] {
        master.delay.delay_ms(10);
        polls += 1;
    }
    // The ramp takes 0.5 s for 1,250 steps; 1,950 steps more at 5,000 a second take 0.39 s.
    assert!((20..40).contains(&polls), "{polls}");
    assert_eq!(x.motion().position, -3_200);
    assert_eq!(x.pin(pin::J2_2).unwrap(), Level::High);
    assert!(bench.now() > Instant::from(3_390.millis()) && bench.now() < Instant::from(3_500.millis()));
    assert_eq!(x.early_requests().count, 0);
}
