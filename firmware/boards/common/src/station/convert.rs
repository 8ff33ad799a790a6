//! Inputs and outputs of a drive as events of the control protocol.

use drivetwin_control::{Course, Event, Level, Line, Stretch};
use drivetwin_firmware::device::{self, Input, Output, Plan};
use drivetwin_firmware::motion::Segment;
use drivetwin_protocol::line::Parity;

/// The event of an input. Characters come one by one. `None` for an input that a board does not have.
pub(crate) fn input<'a>(input: &Input<'a>) -> Option<Event<'a>> {
    Some(match *input {
        Input::Bytes { port, bytes } => Event::Received(port.0, *bytes.first()?),
        Input::RxError { port } => Event::RxError(port.0),
        Input::Idle { port } => Event::Idle(port.0),
        Input::HostPresence { port, here } => Event::Present(port.0, here),
        Input::Edge { pin, high } => Event::Edge(pin.0, high),
        Input::Open { pin } => Event::Open(pin.0),
        Input::Millivolts { pin, mv } => Event::Millivolts(pin.0, mv),
        Input::Count { encoder, steps, a, b } => Event::Count(encoder.0, steps, a, b),
        Input::Fault { fault, on } => Event::Fault(fault.0, on),
        Input::StepsCorrection { axis, steps } => Event::Slipped(axis.0, steps),
        _ => return None,
    })
}

/// The event of an output. `None` for outputs that are several events, and for those that no board has.
pub(crate) fn output<'a>(output: &Output<'a>) -> Option<Event<'a>> {
    Some(match *output {
        Output::Line { port, line: settings } => Event::Line(port.0, line(settings)),
        Output::Level { pin, level: at } => Event::Level(pin.0, level(at)),
        Output::Wave { pin, period, high } => {
            Event::Wave { pin: pin.0, period: period.ticks(), high: high.ticks() }
        }
        Output::Plan { axis, plan } => Event::Plan(axis.0, course(plan)),
        Output::Step { axis, steps } => Event::Step(axis.0, steps),
        Output::CurrentLimit { axis, ma } => Event::CurrentLimit(axis.0, ma),
        Output::Duty { axis, duty } => Event::Duty(axis.0, duty),
        _ => return None,
    })
}

/// Settings of a line.
pub(crate) fn line(line: device::Line) -> Line {
    let parity = match line.parity {
        Parity::None => 0,
        Parity::Odd => 1,
        Parity::Even => 2,
    };
    Line { baud: line.baud, data: line.data, parity, stop: line.stop }
}

/// Level of a pin.
pub(crate) fn level(level: device::Level) -> Level {
    match level {
        device::Level::Low => Level::Low,
        device::Level::High => Level::High,
        device::Level::Float => Level::Open,
    }
}

fn course(plan: &Plan) -> Course {
    let mut stretches = [None; 3];
    for (place, segment) in stretches.iter_mut().zip(plan.segments()) {
        *place = Some(stretch(segment));
    }
    Course { start: plan.start().ticks(), stretches }
}

fn stretch(segment: &Segment) -> Stretch {
    let Segment { ticks, acceleration, start_speed, base, phase_offset, reverse } = *segment;
    Stretch { ticks, acceleration, start_speed, base, phase_offset, reverse }
}
