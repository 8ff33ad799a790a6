//! Tests of the source of commands and of the orders to the motor, as the manual and the decisions define
//! them.
//!
//! There is no motor, and no test calls the servo's timeout: the tests compare the orders that the servo
//! gets.

mod bus;
mod connectors;
mod functions;
mod limits;
mod speed_input;

use drivetwin_protocol::time::Span;

use super::Drive;
use crate::device::{Boot, Duration, Input, Instant, NullContext, Pin};
use crate::mdrobot::registers::Pid;
use crate::mdrobot::servo::Order;
use crate::mdrobot::{
    ALARM_RESET, DIR, ENC_A, ENC_B, HU, HV, HW, INT_SPEED, OVER_VOLTAGE, PULSE_IN, RUN_BRAKE, SPEED_IN,
    START_STOP,
};

/// A drive without a motor, and the present time.
struct Dut {
    drive: Drive,
    now: Instant,
    /// Count of the Hall edges so far, positive forward.
    counts: i32,
}

impl Dut {
    /// A new drive that is ready at 0, with nothing wired to it.
    fn ready() -> Self {
        let mut dut = Self::starting(true);
        dut.start();
        dut
    }

    /// A new drive that was powered on at 0.
    fn starting(fast: bool) -> Self {
        let mut dut = Self { drive: Drive::new(), now: Instant::ZERO, counts: 0 };
        dut.drive.power_on(Instant::ZERO, Boot { fast, ..Boot::default() }, &mut NullContext);
        dut.halls();
        dut
    }

    /// Ends the start-up.
    fn start(&mut self) {
        self.now = self.drive.startup.deadline();
        self.drive.timeout(self.now, &mut NullContext);
    }

    /// A drive with the bus as source of commands, which may move the motor.
    fn armed() -> Self {
        let mut dut = Self::ready();
        dut.set(Pid::UI_COM, 1);
        dut.set(Pid::START_STOP, 1);
        dut
    }

    /// A drive with the connectors as source of commands and RUN/BRAKE closed.
    fn connected() -> Self {
        let mut dut = Self::ready();
        dut.close(RUN_BRAKE);
        dut
    }

    /// Advances the time. Deadlines of inputs and functions are handled in time.
    fn wait(&mut self, span: Duration) {
        let end = self.now + span;
        while self.sources_due() <= end {
            let due = self.sources_due();
            self.drive.sources_timeout(due, &mut NullContext);
            assert!(self.sources_due() > due, "it wants to be woken for ever");
        }
        self.now = end;
    }

    fn sources_due(&self) -> Instant {
        self.drive.inputs.deadline().min(self.drive.reference.deadline())
    }

    fn input(&mut self, input: Input<'_>) {
        self.drive.input(self.now, &input, &mut NullContext);
    }

    /// Begins or ends an alarm.
    fn alarm(&mut self, on: bool) {
        self.input(Input::Fault { fault: OVER_VOLTAGE, on });
    }

    /// Writes a value that the bus may write.
    fn set(&mut self, pid: Pid, value: i64) {
        self.drive.poke(self.now, pid, value, &mut NullContext).unwrap();
    }

    fn get(&self, pid: Pid) -> i64 {
        self.drive.value(self.now, pid)
    }

    fn edge(&mut self, pin: Pin, high: bool) {
        self.input(Input::Edge { pin, high });
    }

    /// Closes a contact to ground.
    fn close(&mut self, pin: Pin) {
        self.edge(pin, false);
    }

    /// Opens a contact.
    fn open(&mut self, pin: Pin) {
        self.edge(pin, true);
    }

    /// Removes a wire.
    fn unwire(&mut self, pin: Pin) {
        self.input(Input::Open { pin });
    }

    fn volts(&mut self, mv: i32) {
        self.input(Input::Millivolts { pin: SPEED_IN, mv });
    }

    /// Puts successive pulses of a width at a pin.
    fn pulses(&mut self, pin: Pin, count: u32, width: Duration, period: Duration) {
        for _ in 0..count {
            self.edge(pin, true);
            self.wait(width);
            self.edge(pin, false);
            self.wait(period - width);
        }
    }

    /// Turns the shaft by a number of counts, 1 ms for each.
    fn turn(&mut self, counts: i32) {
        for _ in 0..counts.unsigned_abs() {
            self.counts += counts.signum();
            self.wait(1.millis());
            self.halls();
        }
    }

    /// Sets the three Hall sensors to the code of the present count. `FORWARD` lists the codes in forward
    /// order.
    fn halls(&mut self) {
        const FORWARD: [[bool; 3]; 6] = [
            [true, false, true],
            [true, false, false],
            [true, true, false],
            [false, true, false],
            [false, true, true],
            [false, false, true],
        ];
        let levels = FORWARD[self.counts.rem_euclid(6) as usize];
        for (pin, high) in [HU, HV, HW].into_iter().zip(levels) {
            self.edge(pin, high);
        }
    }

    /// The last order to the servo.
    fn order(&self) -> Order {
        self.drive.servo.ordered()
    }
}
