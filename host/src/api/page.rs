//! `GET /` and `GET /panel/FILE`: the page.

use axum::body::Body;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use drivetwin_panel::page;

use super::problem::Problem;

/// The page.
pub(super) async fn first(headers: HeaderMap) -> Result<Response, Problem> {
    file(page::FIRST, &headers)
}

/// A file that the page names.
pub(super) async fn named(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    file(&name, &headers)
}

/// A file of the page. A browser that has it already gets status 304.
fn file(name: &str, headers: &HeaderMap) -> Result<Response, Problem> {
    let page::File { bytes, media, tag } =
        page::file(name).ok_or_else(|| Problem::not_found(format!("the panel has no file '{name}'")))?;
    let tag = format!("\"{tag}\"");
    let held = headers.get(header::IF_NONE_MATCH).and_then(|held| held.to_str().ok()).unwrap_or("");
    let is_held = held.split(',').any(|held| held.trim().trim_start_matches("W/") == tag);
    let mut response = match is_held {
        true => StatusCode::NOT_MODIFIED.into_response(),
        false => Body::from(bytes.into_owned()).into_response(),
    };
    let mut set = |name, value: &str| {
        if let Ok(value) = HeaderValue::from_str(value) {
            response.headers_mut().insert(name, value);
        }
    };
    set(header::CONTENT_TYPE, &media);
    set(header::ETAG, &tag);
    set(header::CACHE_CONTROL, "no-cache");
    set(header::CONTENT_SECURITY_POLICY, page::POLICY);
    set(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    set(header::REFERRER_POLICY, "no-referrer");
    Ok(response)
}
