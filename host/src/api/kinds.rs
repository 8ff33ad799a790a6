//! `GET /api/kinds/{kind}`: the description of a kind of drive.

use axum::extract::Path;
use axum::http::header;
use axum::response::IntoResponse;
use drivetwin_sim::catalog;

use super::problem::Problem;
use crate::describe;

/// A kind of drive: its ports, pins, registers and faults, and what of it is not modelled. `drivetwin describe KIND
/// --json` prints the same.
#[utoipa::path(get, path = "/api/kinds/{kind}", responses((status = 200, body = describe::Kind)))]
pub(super) async fn kind(Path(kind): Path<String>) -> Result<impl IntoResponse, Problem> {
    let device = catalog::make(&kind).map_err(Problem::not_found)?;
    Ok(([(header::CONTENT_TYPE, "application/json")], describe::json(device.spec())))
}
