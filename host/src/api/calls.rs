//! The calls of the control API.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use drivetwin_firmware::device::Instant;
use drivetwin_panel::faults::Faults;
use drivetwin_panel::requests::{Advance, Mode, NewValue, PinLevel, Power, Pulses, Scenario, Turn};
use drivetwin_panel::schema::{Bench, Bus, Drive, Time};
use drivetwin_sim::bench::DriveId;
use drivetwin_sim::commands;
use drivetwin_sim::config::time_mode::TimeMode;
use futures_util::future::join_all;
use tokio::sync::oneshot;

use super::board_state::{board_view, drive_of_board};
use super::guard::Body;
use super::problem::Problem;
use super::{Api, stopping};
use crate::board::{Board, reasons};
use crate::event_loop::EventLoop;

/// The bench: drives, lines, motors, time.
#[utoipa::path(get, path = "/api/bench", responses((status = 200, body = Bench)))]
pub(super) async fn bench(State(api): State<Api>) -> Result<Json<Bench>, Problem> {
    let places = api.places.clone();
    let bench = api.call(move |event_loop| {
        let bench = Bench::of(&event_loop.bench, event_loop.time_mode(), &places);
        (bench, event_loop.follows_board())
    });
    let (mut bench, follows_board) = bench.await?;
    let views = api.boards.keys().map(|name| api.on_board(name.clone(), |board| Ok(board_view(board))));
    for view in join_all(views).await {
        let (board, now) = view?;
        bench.add(board, now.is_some_and(|(powered, _)| powered));
        if let Some((_, at)) = now.filter(|_| follows_board) {
            bench.reach(at);
        }
    }
    Ok(Json(bench))
}

/// A drive: registers, pins, lights, motion, ports.
#[utoipa::path(get, path = "/api/drives/{name}", responses(
    (status = 200, body = Drive),
))]
pub(super) async fn drive(State(api): State<Api>, Path(name): Path<String>) -> Result<Json<Drive>, Problem> {
    if api.boards.contains_key(&name) {
        let seen = |board: &Board| Ok(Json(drive_of_board(&mut board.drive()?)?));
        return api.on_board(name, seen).await;
    }
    let places = api.places.clone();
    api.call(move |event_loop| {
        let id = find_drive(event_loop, &name)?;
        Ok(Json(Drive::of_bench(&event_loop.bench, id, &places)))
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
    api.act(name, true, move |drive| Ok(commands::drive_pin(drive, &pin, level.into())?)).await?;
    Ok(StatusCode::NO_CONTENT)
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
    let duty = pulses.duty.unwrap_or(0.5);
    let begin = move |drive: &mut dyn commands::Drive| {
        Ok(commands::pulse_pin(drive, &pin, pulses.count, pulses.hz, duty)?)
    };
    api.act(name, false, begin).await?;
    Ok(StatusCode::NO_CONTENT)
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
    api.act(name, false, move |drive| Ok(commands::encoder(drive, turn.counts, turn.hz)?)).await?;
    Ok(StatusCode::NO_CONTENT)
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
    let value = commands::NewValue::Number(value.value.into());
    api.act(name, true, move |drive| Ok(commands::preset(drive, &register, &value)?)).await?;
    Ok(StatusCode::NO_CONTENT)
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
    api.act(name, true, move |drive| Ok(commands::fault(drive, &fault, on)?)).await?;
    Ok(StatusCode::NO_CONTENT)
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
    api.act(name, true, move |drive| Ok(drive.power(power.action.into())?)).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// The serial lines and TCP ports, and their faults.
#[utoipa::path(get, path = "/api/buses", responses((status = 200, body = Vec<Bus>)))]
pub(super) async fn buses(State(api): State<Api>) -> Result<Json<Vec<Bus>>, Problem> {
    let places = api.places.clone();
    Ok(Json(api.call(move |event_loop| Bus::all(&event_loop.bench, &places)).await?))
}

/// Sets the faults of a line or TCP port, from its next frame on. A fault that the request does not name is off.
#[utoipa::path(put, path = "/api/buses/{name}/faults", request_body = Faults, responses(
    (status = 204),
    (status = 409, description = "The line is that of a board.", body = Problem, content_type = "application/problem+json"),
))]
pub(super) async fn disturb(
    State(api): State<Api>,
    Path(name): Path<String>,
    Body(faults): Body<Faults>,
) -> Result<StatusCode, Problem> {
    api.call(move |event_loop| {
        let bench = &mut event_loop.bench;
        let outlet = commands::outlet(bench, &name)?;
        if bench.drives_at(outlet).iter().any(|&id| bench.is_elsewhere(id)) {
            return Err(Problem::conflict(reasons::NO_LINE_FAULTS));
        }
        faults.set_on(bench, outlet).map_err(Problem::refused)?;
        event_loop.begin_idle_run();
        Ok(StatusCode::NO_CONTENT)
    })
    .await?
}

/// Plays a scenario from now on, beside those that are played already.
#[utoipa::path(post, path = "/api/scenario", request_body = Scenario, responses(
    (status = 204),
    (status = 409, description = "The bench plays 1,000 scenarios already, or has no emulated drive.", body = Problem,
        content_type = "application/problem+json"),
))]
pub(super) async fn play(
    State(api): State<Api>,
    Body(scenario): Body<Scenario>,
) -> Result<StatusCode, Problem> {
    api.call(move |event_loop| {
        let bench = &mut event_loop.bench;
        if bench.drives().all(|drive| bench.is_elsewhere(drive)) {
            return Err(Problem::conflict(reasons::NO_SCENARIO));
        }
        let scenarios = scenario.on(bench).map_err(Problem::refused)?;
        bench.play_all(scenarios).map_err(Problem::conflict)?;
        event_loop.begin_idle_run();
        Ok(StatusCode::NO_CONTENT)
    })
    .await?
}

/// Sets the time mode.
#[utoipa::path(put, path = "/api/time", request_body = Mode, responses(
    (status = 200, body = Time),
    (status = 409, description = "A board has its own clock.", body = Problem, content_type = "application/problem+json"),
))]
pub(super) async fn pace(State(api): State<Api>, Body(mode): Body<Mode>) -> Result<Json<Time>, Problem> {
    let time_mode: TimeMode =
        mode.mode.parse().map_err(|sentence| Problem::refused(format!("mode: {sentence}")))?;
    if time_mode != TimeMode::Times(1) {
        api.refuse_with_boards(reasons::NO_TIME)?;
    }
    api.call(move |event_loop| event_loop.set_time_mode(time_mode)).await?;
    Ok(Json(api.call(|event_loop| time(event_loop)).await?))
}

/// Advances the clock in manual time. The response comes when the bench has reached that time.
#[utoipa::path(post, path = "/api/time/advance", request_body = Advance, responses(
    (status = 200, body = Time),
    (status = 409, description = "Another call advances the clock, the time mode is not manual, no event will come, or a board has its own clock.", body = Problem,
        content_type = "application/problem+json"),
))]
pub(super) async fn advance(
    State(api): State<Api>,
    Body(advance): Body<Advance>,
) -> Result<Json<Time>, Problem> {
    let span = advance.span().map_err(Problem::refused)?;
    api.refuse_with_boards(reasons::NO_TIME)?;
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
        let until = match span {
            Some(span) => event_loop.bench.now() + span,
            None => event_loop.bench.next(),
        };
        if until == Instant::NEVER {
            return Err(Problem::conflict("nothing will happen on this bench before somebody acts"));
        }
        event_loop.advance(until, done);
        Ok(())
    });
    begun.await??;
    there.await.map_err(|_| stopping())?;
    Ok(Json(api.call(|event_loop| time(event_loop)).await?))
}

/// The clock of the bench.
fn time(event_loop: &EventLoop) -> Time {
    Time::new(event_loop.time_mode(), event_loop.bench.now())
}

/// Finds the drive with that name.
pub(super) fn find_drive(event_loop: &EventLoop, name: &str) -> Result<DriveId, Problem> {
    Ok(commands::drive(&event_loop.bench, name)?)
}
