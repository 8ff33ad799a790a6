//! The calls of the control API.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use drivetwin_firmware::device::{Duration, Encoder, Fault, Pin, PinSpec, PresetError, Role};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{DriveId, ENCODER_HZ, PULSE_HZ, PinStimulus};
use drivetwin_sim::config::preset::{self, Preset};
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::line::faults::Party;
use tokio::sync::oneshot;

use super::faults::Faults;
use super::guard::Body;
use super::problem::Problem;
use super::schema::{
    Advance, Bench, Bus, Drive, Driven, Mode, NewValue, PinLevel, Power, Pulses, Time, Turn,
};
use super::{Api, stopping};
use crate::event_loop::EventLoop;
use drivetwin_sim::suggest;

/// Longest advance of the clock per call, in seconds.
const MAX_ADVANCE: f64 = 86_400.0;

/// The bench: drives, lines, motors, time.
#[utoipa::path(get, path = "/api/bench", responses((status = 200, body = Bench)))]
pub(super) async fn bench(State(api): State<Api>) -> Result<Json<Bench>, Problem> {
    let places = api.places.clone();
    Ok(Json(api.call(move |event_loop| Bench::of(event_loop, &places)).await?))
}

/// A drive: registers, pins, lights, motion, ports.
#[utoipa::path(get, path = "/api/drives/{name}", responses(
    (status = 200, body = Drive),
))]
pub(super) async fn drive(State(api): State<Api>, Path(name): Path<String>) -> Result<Json<Drive>, Problem> {
    let places = api.places.clone();
    api.call(move |event_loop| {
        Ok(Json(Drive::of(&event_loop.bench, find_drive(event_loop, &name)?, &places)))
    })
    .await?
}

/// Drives an input pin from outside. While the drive itself drives the pin, the drive's output has
/// precedence; the stimulus takes effect when the drive releases the pin.
#[utoipa::path(put, path = "/api/drives/{name}/pins/{pin}", request_body = PinLevel, responses(
    (status = 204),
))]
pub(super) async fn drive_pin(
    State(api): State<Api>,
    Path((name, pin)): Path<(String, String)>,
    Body(level): Body<PinLevel>,
) -> Result<StatusCode, Problem> {
    api.call(move |event_loop| {
        let id = find_drive(event_loop, &name)?;
        let pin = input(event_loop, id, &pin)?;
        let stimulus = pin_stimulus(&level, pin_spec(event_loop, id, pin))?;
        event_loop.bench.set_pin(id, pin, stimulus);
        event_loop.begin_idle_run();
        Ok(StatusCode::NO_CONTENT)
    })
    .await?
}

/// Sends a train of pulses into an input pin.
#[utoipa::path(post, path = "/api/drives/{name}/pins/{pin}/pulses", request_body = Pulses, responses(
    (status = 204, description = "The train has begun."),
    (status = 409, description = "A pulse train or an encoder drives that pin already.", body = Problem, content_type = "application/problem+json"),
))]
pub(super) async fn pulse_pin(
    State(api): State<Api>,
    Path((name, pin)): Path<(String, String)>,
    Body(pulses): Body<Pulses>,
) -> Result<StatusCode, Problem> {
    api.call(move |event_loop| {
        let id = find_drive(event_loop, &name)?;
        let pin = input(event_loop, id, &pin)?;
        if pulses.count == 0 || !PULSE_HZ.contains(&pulses.hz) {
            let (least, most) = (PULSE_HZ.start(), PULSE_HZ.end());
            return Err(Problem::refused(format!(
                "a train has at least 1 pulse, and {least} to {most} of them a second"
            )));
        }
        let duty = pulses.duty.unwrap_or(0.5);
        if !(duty > 0.0 && duty < 1.0) {
            return Err(Problem::refused("the duty of a pulse is between 0 and 1"));
        }
        if role(event_loop, id, pin) == Some(Role::Analogue) {
            return Err(Problem::refused("an analogue input takes no pulses"));
        }
        let begun = event_loop.bench.pulse_width(id, pin, pulses.count, pulses.hz, duty);
        begun.map_err(|busy| Problem::conflict(busy.to_string()))?;
        Ok(StatusCode::NO_CONTENT)
    })
    .await?
}

/// Turns the drive's encoder: quadrature edges on its inputs A and B.
#[utoipa::path(post, path = "/api/drives/{name}/encoder", request_body = Turn, responses(
    (status = 204, description = "The encoder has begun to turn."),
    (status = 409, description = "The encoder turns already, or a pulse train runs on A or B.", body = Problem,
        content_type = "application/problem+json"),
))]
pub(super) async fn encoder(
    State(api): State<Api>,
    Path(name): Path<String>,
    Body(turn): Body<Turn>,
) -> Result<StatusCode, Problem> {
    api.call(move |event_loop| {
        let id = find_drive(event_loop, &name)?;
        if event_loop.bench.spec(id).encoders.is_empty() {
            return Err(Problem::refused(format!("{name} has no encoder input")));
        }
        let counts = i32::try_from(turn.counts).ok().filter(|counts| *counts != 0);
        let counts = counts.filter(|_| ENCODER_HZ.contains(&turn.hz)).ok_or_else(|| {
            let (least, most) = (ENCODER_HZ.start(), ENCODER_HZ.end());
            Problem::refused(format!(
                "an encoder makes 1 to 2147483647 edges, or -1 to -2147483648 the other way, and {least} to {most} of them a second"
            ))
        })?;
        let begun = event_loop.bench.encoder(id, Encoder(0), counts, turn.hz);
        begun.map_err(|busy| Problem::conflict(busy.to_string()))?;
        Ok(StatusCode::NO_CONTENT)
    })
    .await?
}

/// Presets a register directly, not through its bus.
#[utoipa::path(put, path = "/api/drives/{name}/registers/{register}", request_body = NewValue, responses(
    (status = 204),
    (status = 409, description = "The drive has no power.", body = Problem, content_type = "application/problem+json"),
))]
pub(super) async fn preset(
    State(api): State<Api>,
    Path((name, register)): Path<(String, String)>,
    Body(value): Body<NewValue>,
) -> Result<StatusCode, Problem> {
    api.call(move |event_loop| {
        let id = find_drive(event_loop, &name)?;
        let spec = event_loop.bench.spec(id);
        let known = spec.find(&register).is_some();
        let status = if known { StatusCode::UNPROCESSABLE_ENTITY } else { StatusCode::NOT_FOUND };
        let preset = Preset::new(spec, &register, &value.value.into())
            .map_err(|sentence| Problem::new(status, sentence))?;
        if !event_loop.bench.powered(id) {
            return Err(Problem::conflict(format!("{name} has no power")));
        }
        let value = preset.onto(spec, event_loop.bench.peek(id, preset.row));
        event_loop.bench.poke(id, preset.row, value).map_err(|refused: PresetError| {
            Problem::refused(preset::refusal(spec, preset.row, &register, refused))
        })?;
        event_loop.begin_idle_run();
        Ok(StatusCode::NO_CONTENT)
    })
    .await?
}

/// Sets the cause of a fault.
#[utoipa::path(put, path = "/api/drives/{name}/faults/{fault}", responses(
    (status = 204),
))]
pub(super) async fn fault(
    State(api): State<Api>,
    Path((name, fault)): Path<(String, String)>,
) -> Result<StatusCode, Problem> {
    set_fault(&api, name, fault, true).await
}

/// Clears the cause of a fault.
#[utoipa::path(delete, path = "/api/drives/{name}/faults/{fault}", responses(
    (status = 204),
))]
pub(super) async fn heal(
    State(api): State<Api>,
    Path((name, fault)): Path<(String, String)>,
) -> Result<StatusCode, Problem> {
    set_fault(&api, name, fault, false).await
}

async fn set_fault(api: &Api, name: String, fault: String, on: bool) -> Result<StatusCode, Problem> {
    api.call(move |event_loop| {
        let id = find_drive(event_loop, &name)?;
        let faults = event_loop.bench.spec(id).faults;
        let found = (0..).map(Fault).zip(faults).find(|(_, known)| **known == fault);
        let (fault, _) = found
            .ok_or_else(|| Problem::not_found(suggest::unknown("fault", &fault, faults.iter().copied())))?;
        event_loop.bench.fault(id, fault, on);
        event_loop.begin_idle_run();
        Ok(StatusCode::NO_CONTENT)
    })
    .await?
}

/// Switches a drive's power.
#[utoipa::path(post, path = "/api/drives/{name}/power", request_body = Power, responses(
    (status = 204),
))]
pub(super) async fn power(
    State(api): State<Api>,
    Path(name): Path<String>,
    Body(power): Body<Power>,
) -> Result<StatusCode, Problem> {
    api.call(move |event_loop| {
        let id = find_drive(event_loop, &name)?;
        event_loop.bench.power(id, power.action.into());
        event_loop.begin_idle_run();
        Ok(StatusCode::NO_CONTENT)
    })
    .await?
}

/// The serial lines and TCP ports, and their faults.
#[utoipa::path(get, path = "/api/buses", responses((status = 200, body = Vec<Bus>)))]
pub(super) async fn buses(State(api): State<Api>) -> Result<Json<Vec<Bus>>, Problem> {
    let places = api.places.clone();
    Ok(Json(api.call(move |event_loop| Bus::all(&event_loop.bench, &places)).await?))
}

/// Sets the faults of a line or TCP port, from its next frame on. A fault that the request does not name is off.
#[utoipa::path(put, path = "/api/buses/{name}/faults", request_body = Faults, responses((status = 204)))]
pub(super) async fn disturb(
    State(api): State<Api>,
    Path(name): Path<String>,
    Body(faults): Body<Faults>,
) -> Result<StatusCode, Problem> {
    api.call(move |event_loop| {
        let bench = &mut event_loop.bench;
        let outlet = bench.find_outlet(&name).ok_or_else(|| {
            let names: Vec<String> =
                bench.outlets().into_iter().map(|outlet| bench.outlet_name(outlet)).collect();
            Problem::not_found(suggest::unknown("bus", &name, names.iter().map(String::as_str)))
        })?;
        let drives = bench.drives_at(outlet);
        let party = |&id: &DriveId| Party { id, name: bench.name(id), spec: bench.spec(id) };
        let faults = faults.on(&drives.iter().map(party).collect::<Vec<_>>()).map_err(Problem::refused)?;
        if let Some(port) = bench.port_at(outlet) {
            faults.check_for(port).map_err(Problem::refused)?;
        }
        bench.set_faults(outlet, faults);
        event_loop.begin_idle_run();
        Ok(StatusCode::NO_CONTENT)
    })
    .await?
}

/// Sets the time mode.
#[utoipa::path(put, path = "/api/time", request_body = Mode, responses(
    (status = 200, body = Time),
))]
pub(super) async fn pace(State(api): State<Api>, Body(mode): Body<Mode>) -> Result<Json<Time>, Problem> {
    let time_mode: TimeMode =
        mode.mode.parse().map_err(|sentence| Problem::refused(format!("mode: {sentence}")))?;
    api.call(move |event_loop| event_loop.set_time_mode(time_mode)).await?;
    Ok(Json(api.call(|event_loop| Time::of(event_loop)).await?))
}

/// Advances the clock in manual time. The response comes when the bench has reached that time.
#[utoipa::path(post, path = "/api/time/advance", request_body = Advance, responses(
    (status = 200, body = Time),
    (status = 409, description = "Another call advances the clock, or the time mode is not manual.", body = Problem,
        content_type = "application/problem+json"),
))]
pub(super) async fn advance(
    State(api): State<Api>,
    Body(advance): Body<Advance>,
) -> Result<Json<Time>, Problem> {
    if !(0.0..=MAX_ADVANCE).contains(&advance.seconds) {
        return Err(Problem::refused("seconds takes 0 to 86400"));
    }
    // The span is not negative, and far below the maximum of a tick counter.
    let span = Duration::from_ticks((advance.seconds * TICKS_PER_SECOND as f64).round() as u64);
    let Ok(_turn) = api.advancing.try_acquire() else {
        return Err(Problem::conflict("another call advances the clock; wait until it has ended"));
    };
    let (done, there) = oneshot::channel();
    let begun = api.call(move |event_loop| {
        if event_loop.time_mode() != TimeMode::Manual {
            return Err(Problem::conflict(
                "the time mode is not manual; PUT {\"mode\":\"manual\"} to /api/time first",
            ));
        }
        event_loop.advance(span, done);
        Ok(())
    });
    begun.await??;
    there.await.map_err(|_| stopping())?;
    Ok(Json(api.call(|event_loop| Time::of(event_loop)).await?))
}

/// Finds the drive with that name.
pub(super) fn find_drive(event_loop: &EventLoop, name: &str) -> Result<DriveId, Problem> {
    let bench = &event_loop.bench;
    bench.find_drive(name).ok_or_else(|| {
        Problem::not_found(suggest::unknown("drive", name, bench.drives().map(|id| bench.name(id))))
    })
}

/// Finds the pin with that name. The pin must be one that can be driven from outside.
fn input(event_loop: &EventLoop, id: DriveId, name: &str) -> Result<Pin, Problem> {
    let spec = event_loop.bench.spec(id);
    let pin = spec.pin(name).ok_or_else(|| {
        Problem::not_found(suggest::unknown("pin", name, spec.pin_names().map(|(name, _)| name)))
    })?;
    match role(event_loop, id, pin) {
        Some(Role::Output | Role::Led) => Err(Problem::refused(format!("{name} is an output"))),
        _ => Ok(pin),
    }
}

fn role(event_loop: &EventLoop, id: DriveId, pin: Pin) -> Option<Role> {
    pin_spec(event_loop, id, pin).map(|pin| pin.role)
}

fn pin_spec(event_loop: &EventLoop, id: DriveId, pin: Pin) -> Option<&'static PinSpec> {
    event_loop.bench.spec(id).pins.get(usize::from(pin.0))
}

/// Converts the requested level to a stimulus of the pin.
fn pin_stimulus(wanted: &PinLevel, pin: Option<&PinSpec>) -> Result<PinStimulus, Problem> {
    let (role, shunt_ohm) = pin.map_or((None, 0), |pin| (Some(pin.role), pin.shunt_ohm));
    let levels = role != Some(Role::Analogue);
    let voltages = matches!(role, Some(Role::Analogue | Role::AnalogueOrDigital));
    match *wanted {
        PinLevel { level: Some(Driven::Open), volts: None, milliamps: None } => Ok(PinStimulus::Open),
        PinLevel { level: Some(level), volts: None, milliamps: None } if levels => Ok(match level {
            Driven::Low => PinStimulus::Low,
            Driven::High => PinStimulus::High,
            Driven::Open => PinStimulus::Open,
        }),
        PinLevel { level: None, volts: Some(volts), milliamps: None } if voltages => {
            if !(-1_000.0..=1_000.0).contains(&volts) {
                return Err(Problem::refused("volts are -1000 to 1000"));
            }
            Ok(PinStimulus::Millivolts((volts * 1_000.0).round() as i32))
        }
        PinLevel { level: None, volts: None, milliamps: Some(milliamps) } if shunt_ohm > 0 => {
            if !(-1_000.0..=1_000.0).contains(&milliamps) {
                return Err(Problem::refused("milliamps are -1000 to 1000"));
            }
            // The drive receives the voltage across its shunt.
            Ok(PinStimulus::Millivolts((milliamps * f64::from(shunt_ohm)).round() as i32))
        }
        PinLevel { level: None, volts: None, milliamps: Some(_) } => {
            Err(Problem::refused("this pin takes no current; send a level or volts"))
        }
        PinLevel { level: None, volts: None, milliamps: None } => Err(Problem::refused(format!(
            "the body has no level; it takes one of {}",
            match (levels, voltages) {
                (true, true) => {
                    "{\"level\":\"low\"}, {\"level\":\"high\"}, {\"level\":\"open\"} and {\"volts\":2.5}"
                }
                (true, false) => "{\"level\":\"low\"}, {\"level\":\"high\"} and {\"level\":\"open\"}",
                (false, _) if shunt_ohm > 0 => {
                    "{\"volts\":2.5}, {\"milliamps\":12} and {\"level\":\"open\"}"
                }
                (false, _) => "{\"volts\":2.5} and {\"level\":\"open\"}",
            }
        ))),
        _ if levels && voltages => {
            Err(Problem::refused("this input takes a level (low, high or open) or volts, one of them"))
        }
        _ if shunt_ohm > 0 => {
            Err(Problem::refused("this input takes volts, milliamps, or the level open, one of them"))
        }
        _ if voltages => Err(Problem::refused("an analogue input takes volts, or the level open")),
        _ => Err(Problem::refused("a digital input takes a level: low, high or open")),
    }
}
