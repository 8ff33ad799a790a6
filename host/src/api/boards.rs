//! The kind of drive, which a board can change, and the saved memory.

use axum::Json;
use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::IntoResponse;
use drivetwin_sim::{catalog, commands};

use super::Api;
use super::calls::find_drive;
use super::guard::{Body, MEMORY};
use super::problem::Problem;
use drivetwin_panel::requests::{Kind, Kinds};

/// Makes a board a drive of another kind, now and after its own power-on. The response comes when the board has started
/// again. A drive that is of this kind already goes on.
#[utoipa::path(put, path = "/api/drives/{name}/kind", request_body = Kind, responses(
    (status = 200, body = Kinds),
    (status = 409, description = "The drive is not on a board and of another kind, the board cannot be a drive of this kind, or its bench has other drives.", body = Problem,
        content_type = "application/problem+json"),
))]
pub(super) async fn kind(
    State(api): State<Api>,
    Path(name): Path<String>,
    Body(Kind { kind }): Body<Kind>,
) -> Result<Json<Kinds>, Problem> {
    if !api.boards.contains_key(&name) {
        return api
            .call(move |event_loop| {
                let drive = find_drive(event_loop, &name)?;
                catalog::make(&kind).map_err(Problem::not_found)?;
                if event_loop.bench.spec(drive).kind == kind {
                    return Ok(Json(Kinds { kinds: vec![kind.clone()], kind }));
                }
                Err(Problem::conflict(format!(
                    "{name} is emulated here, and only a board can become a drive of another kind; run {kind}"
                )))
            })
            .await?;
    }
    let chosen = api.on_board(name, move |board| {
        board.drive()?.choose(&kind)?;
        Ok(Kinds { kind, kinds: board.drive()?.kinds()? })
    });
    Ok(Json(chosen.await?))
}

/// The content of the non-volatile memory, as in a file of `--nv`.
#[utoipa::path(get, path = "/api/drives/{name}/memory", responses(
    (status = 200, description = "The bytes.", body = Vec<u8>, content_type = "application/octet-stream"),
))]
pub(super) async fn memory(
    State(api): State<Api>,
    Path(name): Path<String>,
) -> Result<impl IntoResponse, Problem> {
    let bytes = api.act(name, false, |drive| Ok(drive.memory()?)).await?;
    Ok(([(header::CONTENT_TYPE, HeaderValue::from_static(MEMORY))], bytes))
}

/// Replaces the content of the non-volatile memory of a board, which reads it at the next power-on. The drive must have no
/// power.
#[utoipa::path(put, path = "/api/drives/{name}/memory",
    request_body(content = Vec<u8>, content_type = "application/octet-stream", description = "All bytes of the memory."),
    responses(
        (status = 204),
        (status = 409, description = "The drive has power, or is not on a board.", body = Problem,
            content_type = "application/problem+json"),
    ),
)]
pub(super) async fn set_memory(
    State(api): State<Api>,
    Path(name): Path<String>,
    bytes: Bytes,
) -> Result<StatusCode, Problem> {
    api.act(name, false, move |drive| Ok(commands::set_memory(drive, &bytes)?)).await?;
    Ok(StatusCode::NO_CONTENT)
}
