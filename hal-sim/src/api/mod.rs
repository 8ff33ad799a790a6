//! The control API: HTTP and JSON, described by itself at `/openapi.json`.
//!
//! It runs on a thread of its own. Each call becomes one piece of work for the thread that owns the
//! bench, which does them one at a time.

mod calls;
mod guard;
mod model;
mod problem;

use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{StatusCode, header};
use axum::middleware::{from_fn_with_state, map_response};
use axum::routing::get;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::sync::{Semaphore, oneshot};
use tracing::{debug, warn};
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::realtime::{Door, Host};
pub(crate) use model::Places;
use problem::Problem;

/// Connections served at once; the next one waits.
const MAX_CONNECTIONS: usize = 64;

/// What every call needs.
#[derive(Clone)]
struct Api {
    door: Door,
    places: Arc<Places>,
    /// Free while nobody advances the clock.
    advancing: Arc<Semaphore>,
}

impl Api {
    /// Does something with the bench, on its thread.
    async fn call<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Host) -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let (done, answer) = oneshot::channel();
        self.door.hand_in(|host| {
            // Nobody may wait for it any more.
            let _ = done.send(work(host));
        });
        answer.await.map_err(|_| stopping())
    }
}

fn stopping() -> Problem {
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "the bench is stopping")
}

#[derive(OpenApi)]
#[openapi(info(
    title = "standin",
    description = "Control of a bench of emulated drives. Errors are RFC 9457 problem documents."
))]
struct Description;

/// Serves the API on `listener`, on a thread of its own, until the process ends.
///
/// # Errors
/// The system gives no thread, or does not let it wait.
pub(crate) fn serve(listener: TcpListener, door: Door, places: Places) -> io::Result<()> {
    let here = listener.local_addr()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let listener = {
        let _inside = runtime.enter();
        tokio::net::TcpListener::from_std(listener)?
    };
    let api = Api { door, places: Arc::new(places), advancing: Arc::new(Semaphore::new(1)) };
    let router = router(api, here);
    std::thread::Builder::new().name("control".into()).spawn(move || {
        runtime.block_on(accept(listener, router));
    })?;
    Ok(())
}

fn router(api: Api, here: SocketAddr) -> Router {
    let (router, description) = OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(calls::bench))
        .routes(routes!(calls::drive))
        .routes(routes!(calls::drive_pin))
        .routes(routes!(calls::pulse_pin))
        .routes(routes!(calls::preset))
        .routes(routes!(calls::fault, calls::heal))
        .routes(routes!(calls::power))
        .routes(routes!(calls::pace))
        .routes(routes!(calls::advance))
        .routes(routes!(calls::trace))
        .split_for_parts();
    let description = description.to_pretty_json().unwrap_or_default();
    let description = move || async { ([(header::CONTENT_TYPE, "application/json")], description) };
    router
        .route("/openapi.json", get(description))
        .layer(DefaultBodyLimit::max(guard::BODY_BYTES))
        .layer(from_fn_with_state(here, guard::check))
        .layer(map_response(problem::of_framework))
        .with_state(api)
}

/// Takes connections as long as there is room for one more.
async fn accept(listener: tokio::net::TcpListener, router: Router) {
    let room = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    while let Ok(place) = Arc::clone(&room).acquire_owned().await {
        let (stream, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                warn!("the control API cannot take a connection: {error}");
                // There may be no descriptor left for it; wait until somebody leaves.
                tokio::time::sleep(std::time::Duration::from_secs(1)).await;
                continue;
            }
        };
        let service = TowerToHyperService::new(router.clone());
        tokio::spawn(async move {
            // With a timer, a connection that sends no request is closed in 30 s.
            let mut server = hyper::server::conn::http1::Builder::new();
            server.timer(TokioTimer::new());
            if let Err(error) = server.serve_connection(TokioIo::new(stream), service).await {
                debug!("control API, {peer}: {error}");
            }
            drop(place);
        });
    }
}
