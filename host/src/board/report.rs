//! Events of a board as entries of a trace.

use drivetwin_control::{self as control, Course, Level as BoardLevel, Line as BoardLine};
use drivetwin_firmware::device::{
    Axis, Duration, Encoder, Fault, Instant, Level, Line, Pin, Plan, Port, Spec,
};
use drivetwin_firmware::motion::Segment;
use drivetwin_protocol::line::Parity;
use drivetwin_sim::line::faults::BAUDS;
use drivetwin_sim::record::trace::{Event, InputRecord, OutputRecord, Power};

/// Number of events between the event with number `expected` and that with number `got`, which wrap.
pub(super) fn missing(expected: u32, got: u32) -> u64 {
    got.wrapping_sub(expected).into()
}

/// The entry of a trace for an event; [`Event::Missing`] for one that this kind of drive does not have.
/// `start` is the time at which the board began to count.
pub(super) fn entry(spec: &Spec, start: Instant, event: control::Event<'_>) -> Event {
    known(spec, start, event).unwrap_or(Event::Missing { events: Some(1) })
}

fn known(spec: &Spec, start: Instant, event: control::Event<'_>) -> Option<Event> {
    use control::Event as Reported;
    let port = |port: u8| spec.ports.get(usize::from(port)).map(|_| Port(port));
    let pin = |pin: u8| spec.pins.get(usize::from(pin)).map(|_| Pin(pin));
    let axis = |axis: u8| spec.axes.get(usize::from(axis)).map(|_| Axis(axis));
    let input = match event {
        Reported::Lost(count) => return Some(Event::Missing { events: Some(count.into()) }),
        Reported::Power(on) => InputRecord::Power(if on { Power::On } else { Power::Off }),
        Reported::Received(number, byte) => InputRecord::Bytes { port: port(number)?, bytes: [byte].into() },
        Reported::RxError(number) => InputRecord::RxError { port: port(number)? },
        Reported::Idle(number) => InputRecord::Idle { port: port(number)? },
        Reported::Present(number, here) => InputRecord::HostPresence { port: port(number)?, here },
        Reported::Edge(number, high) => InputRecord::Edge { pin: pin(number)?, high },
        Reported::Open(number) => InputRecord::Open { pin: pin(number)? },
        Reported::Millivolts(number, mv) => InputRecord::Millivolts { pin: pin(number)?, mv },
        Reported::Count(number, steps, a, b) => {
            spec.encoders.get(usize::from(number))?;
            InputRecord::Count { encoder: Encoder(number), steps, a, b }
        }
        Reported::Fault(number, on) => {
            spec.faults.get(usize::from(number))?;
            InputRecord::Fault { fault: Fault(number), on }
        }
        Reported::Preset(row, value) => {
            let row = usize::from(row);
            spec.registers.rows.get(row)?;
            InputRecord::Poke { row, value }
        }
        Reported::Slipped(number, steps) => InputRecord::StepsCorrection { axis: axis(number)?, steps },
        Reported::Cut(_) => return Some(Event::Output(OutputRecord::PowerOff)),
        Reported::Sent(number, bytes) => {
            let (port, bytes) = (port(number)?, bytes.to_vec());
            return Some(Event::Output(OutputRecord::Bytes { port, bytes }));
        }
        Reported::Line(number, settings) => {
            let (port, line) = (port(number)?, line(settings)?);
            return Some(Event::Output(OutputRecord::Line { port, line }));
        }
        Reported::Level(number, to) => {
            return Some(Event::Output(OutputRecord::Level { pin: pin(number)?, level: level(to) }));
        }
        Reported::Wave { pin: number, period, high } => {
            let (period, high) = (Duration::from_ticks(period), Duration::from_ticks(high));
            if period == Duration::ZERO || high > period {
                return None;
            }
            return Some(Event::Output(OutputRecord::Wave { pin: pin(number)?, period, high }));
        }
        Reported::Plan(number, course) => {
            let (axis, plan) = (axis(number)?, Box::new(plan(start, course)?));
            return Some(Event::Output(OutputRecord::Plan { axis, plan }));
        }
        Reported::Step(number, steps) => {
            return Some(Event::Output(OutputRecord::Step { axis: axis(number)?, steps }));
        }
        Reported::CurrentLimit(number, ma) => {
            return Some(Event::Output(OutputRecord::CurrentLimit { axis: axis(number)?, ma }));
        }
        Reported::Duty(number, duty) => {
            return Some(Event::Output(OutputRecord::Duty { axis: axis(number)?, duty }));
        }
        Reported::Store(offset, bytes) => {
            return Some(Event::Output(OutputRecord::Store { offset, bytes: bytes.to_vec() }));
        }
    };
    Some(Event::Input(input))
}

/// The level of a pin.
pub(super) fn level(level: BoardLevel) -> Level {
    match level {
        BoardLevel::Low => Level::Low,
        BoardLevel::High => Level::High,
        BoardLevel::Open => Level::Float,
    }
}

/// Settings of a line; `None` if no line has such settings.
pub(super) fn line(BoardLine { baud, data, parity, stop }: BoardLine) -> Option<Line> {
    let parity = match parity {
        0 => Parity::None,
        1 => Parity::Odd,
        2 => Parity::Even,
        _ => return None,
    };
    let is_line = BAUDS.contains(&baud) && (7..=8).contains(&data) && (1..=2).contains(&stop);
    is_line.then(|| Line::new(baud, data, parity, stop))
}

fn plan(began: Instant, Course { start, stretches }: Course) -> Option<Plan> {
    let segment = |stretch: control::Stretch| Segment {
        ticks: stretch.ticks,
        acceleration: stretch.acceleration,
        start_speed: stretch.start_speed,
        base: stretch.base,
        phase_offset: stretch.phase_offset,
        reverse: stretch.reverse,
    };
    let segments: Vec<Segment> = stretches.into_iter().flatten().map(segment).collect();
    Plan::of_segments(Instant::from_ticks(began.ticks().saturating_add(start)), &segments)
}

#[cfg(test)]
mod tests {
    use drivetwin_control::{Event as Reported, Stretch};
    use drivetwin_sim::catalog;

    use super::*;

    #[test]
    fn events_of_another_kind_are_missing_and_not_guessed() {
        let spec = catalog::make("md3").unwrap().spec();
        let stretch = Stretch {
            ticks: 3_200_000,
            acceleration: 10_000,
            start_speed: 0,
            base: 0,
            phase_offset: 0,
            reverse: false,
        };
        let course = |stretch| Course { start: 5, stretches: [Some(stretch), None, None] };
        let wrong = Stretch { start_speed: i64::MAX, ..stretch };
        let settings = BoardLine { baud: 9_600, data: 8, parity: 2, stop: 1 };
        for (event, is_known) in [
            (Reported::Received(0, 1), true),
            (Reported::Received(1, 1), false),
            (Reported::Edge(0, true), true),
            (Reported::Edge(63, true), false),
            (Reported::Fault(200, true), false),
            (Reported::Preset(60_000, 1), false),
            (Reported::Plan(0, course(stretch)), true),
            (Reported::Plan(0, course(wrong)), false),
            (Reported::Plan(9, course(stretch)), false),
            (Reported::Line(0, settings), true),
            (Reported::Line(0, BoardLine { baud: 0, ..settings }), false),
            (Reported::Wave { pin: 0, period: 0, high: 0 }, false),
        ] {
            let entry = entry(spec, Instant::ZERO, event);
            assert_eq!(entry != Event::Missing { events: Some(1) }, is_known, "{event:?}");
        }
        assert_eq!(entry(spec, Instant::ZERO, Reported::Lost(7)), Event::Missing { events: Some(7) });
        assert_eq!(missing(u32::MAX, 2), 3);
    }
}
