//! The control API: HTTP and JSON, and the page of the panel. `/openapi.json` describes the API to programs.
//!
//! The API runs on a thread of its own. Each call becomes one job for the thread that owns the bench. That
//! thread executes one job at a time. Long data, such as a trace, is copied from the bench in pieces.

mod board_state;
mod boards;
mod calls;
mod downloads;
mod event_stream;
mod guard;
mod kinds;
mod live;
mod openapi;
mod page;
mod problem;
mod received;
mod terminals;

use std::collections::BTreeMap;
use std::io;
use std::net::TcpListener;
use std::pin::pin;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{StatusCode, header};
use axum::middleware::{from_fn, from_fn_with_state, map_response};
use axum::routing::get;
use drivetwin_sim::bench::Bench;
use drivetwin_sim::commands::{Drive, OnBench};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::sync::{Notify, Semaphore, oneshot};
use tracing::{debug, warn};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::board::Board;
use crate::event_loop::{BenchHandle, EventLoop};
pub(crate) use drivetwin_panel::schema::Places;
use guard::Hosts;
use problem::Problem;

/// Maximum number of connections. A further connection makes the API close all idle ones.
const MAX_CONNECTIONS: usize = 64;

/// Maximum number of connections that stream events.
const MAX_READERS: usize = 16;

/// Maximum number of simultaneous downloads of a trace. Each download has its own copy of the trace.
const MAX_EXPORTS: usize = 2;

/// Longest wait for the head of a request. An idle connection is closed after the same time.
const HEAD_TIME: Duration = Duration::from_secs(5);

/// State that every call needs.
#[derive(Clone)]
struct Api {
    handle: BenchHandle,
    places: Arc<Places>,
    /// Boards, by the names of their drives.
    boards: Boards,
    /// Has one permit, which a call takes while it advances the clock.
    advancing: Arc<Semaphore>,
    /// Permits for readers of event streams.
    readers: Arc<Semaphore>,
    /// Permits for downloads of a trace.
    exports: Arc<Semaphore>,
    /// The latest answers of the boards.
    polls: live::Polls,
    terminals: terminals::Terminals,
}

/// Boards, by the names of their drives. On the bench each has a drive of the same name that is elsewhere.
pub(crate) type Boards = Arc<BTreeMap<String, Board>>;

impl Api {
    /// Acts on a drive of the bench, on the thread of the bench, or on the drive of a board, on a thread of its own.
    /// With `settles`, in manual time the action has its whole effect before the next call.
    async fn act<T: Send + 'static>(
        &self,
        name: String,
        settles: bool,
        act: impl FnOnce(&mut dyn Drive) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        if self.boards.contains_key(&name) {
            return self.on_board(name, move |board| act(&mut board.drive()?)).await;
        }
        self.call(move |event_loop| {
            let id = calls::find_drive(event_loop, &name)?;
            let done = act(&mut OnBench::new(&mut event_loop.bench, id))?;
            if settles {
                event_loop.begin_idle_run();
            }
            Ok(done)
        })
        .await?
    }

    /// Acts on the board with a drive of that name, on a thread of its own, because its answers take time.
    async fn on_board<T: Send + 'static>(
        &self,
        name: String,
        act: impl FnOnce(&Board) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        let boards = Arc::clone(&self.boards);
        let done = tokio::task::spawn_blocking(move || {
            let board = boards.get(&name).ok_or_else(|| Problem::not_found(format!("{name} is no board")))?;
            act(board)
        });
        done.await.map_err(|_| stopping())?
    }

    /// Refuses what a bench with a board cannot do.
    fn refuse_with_boards(&self, reason: &str) -> Result<(), Problem> {
        if self.boards.is_empty() { Ok(()) } else { Err(Problem::conflict(reason)) }
    }

    /// Executes a job on the thread of the bench.
    async fn call<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut EventLoop) -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let (done, answer) = oneshot::channel();
        // If the client leaves, this call is dropped, and `caller` with it.
        let caller = Arc::new(());
        self.handle.submit(Arc::downgrade(&caller), |event_loop| {
            let result = work(event_loop);
            // The client may have left.
            || drop(done.send(result))
        });
        answer.await.map_err(|_| stopping())
    }

    /// Executes a query on the thread of the bench, without waiting for pending jobs.
    async fn query<T: Send + 'static>(
        &self,
        query: impl FnOnce(&Bench) -> T + Send + 'static,
    ) -> Result<T, Problem> {
        self.see(|event_loop| query(&event_loop.bench)).await
    }

    /// Executes a query of the bench and its clock, like [`query`](Self::query).
    async fn see<T: Send + 'static>(
        &self,
        query: impl FnOnce(&EventLoop) -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let (done, answer) = oneshot::channel();
        let caller = Arc::new(());
        self.handle.query(Arc::downgrade(&caller), |event_loop| {
            // The client may have left.
            let _ = done.send(query(event_loop));
        });
        answer.await.map_err(|_| stopping())
    }
}

fn stopping() -> Problem {
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "the bench is stopping")
}

/// Problem: the maximum number of clients that do `what` is reached.
fn too_many(what: &str) -> Problem {
    let detail = format!("the maximum number of clients that {what} is reached; wait until one disconnects");
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, detail)
}

/// The thread that serves the API. It ends when this value is dropped.
pub(crate) struct Server {
    /// Tells the thread to end; `None` when it has been told.
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            // A thread that has panicked has ended, too.
            let _ = thread.join();
        }
    }
}

/// Longest wait for downloads in progress when the API ends.
const END_TIME: Duration = Duration::from_millis(100);

/// Serves the API on `listener`, on a thread of its own. It answers requests that name this machine or one of the
/// `allowed` hosts.
///
/// # Errors
/// The system gives no thread, or the runtime cannot be set up.
pub(crate) fn serve(
    listener: TcpListener,
    allowed: &[String],
    handle: BenchHandle,
    places: Places,
    boards: Boards,
) -> io::Result<Server> {
    let hosts = Hosts { here: listener.local_addr()?, allowed: allowed.into() };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let listener = {
        let _inside = runtime.enter();
        tokio::net::TcpListener::from_std(listener)?
    };
    let room = |most| Arc::new(Semaphore::new(most));
    let (advancing, readers, exports) = (room(1), room(MAX_READERS), room(MAX_EXPORTS));
    let (polls, terminals) = (live::Polls::default(), terminals::Terminals::default());
    let places = Arc::new(places);
    let api = Api { handle, places, boards, advancing, readers, exports, polls, terminals };
    let router = router(api, hosts);
    let (end, ended) = oneshot::channel();
    let thread = std::thread::Builder::new().name("control".into()).spawn(move || {
        runtime.block_on(async {
            tokio::select! {
                () = accept(listener, router) => {}
                // The sender is dropped.
                _ = ended => {}
            }
        });
        runtime.shutdown_timeout(END_TIME);
    })?;
    Ok(Server { end: Some(end), thread: Some(thread) })
}

fn router(api: Api, hosts: Hosts) -> Router {
    let (router, description) = calls().split_for_parts();
    let description = openapi::complete(description).to_pretty_json().unwrap_or_default();
    let description = move || async { ([(header::CONTENT_TYPE, "application/json")], description) };
    router
        .route("/openapi.json", get(description))
        .route("/", get(page::first))
        .route("/panel/{file}", get(page::named))
        .layer(DefaultBodyLimit::max(guard::BODY_BYTES))
        .layer(from_fn_with_state(hosts, guard::check))
        .layer(map_response(problem::of_framework))
        .with_state(api)
}

/// All calls with their OpenAPI descriptions.
fn calls() -> OpenApiRouter<Api> {
    OpenApiRouter::with_openapi(openapi::begin())
        .routes(routes!(calls::bench))
        .routes(routes!(calls::drive))
        .routes(routes!(kinds::kind))
        .routes(routes!(calls::drive_pin))
        .routes(routes!(calls::pulse_pin))
        .routes(routes!(calls::encoder))
        .routes(routes!(calls::preset))
        .routes(routes!(calls::fault, calls::heal))
        .routes(routes!(calls::power))
        .routes(routes!(boards::kind))
        .routes(routes!(boards::memory, boards::set_memory))
        .routes(routes!(calls::buses))
        .routes(routes!(calls::disturb))
        .routes(routes!(calls::play))
        .routes(routes!(calls::pace))
        .routes(routes!(calls::advance))
        .routes(routes!(terminals::terminal))
        .routes(routes!(terminals::typed))
        .layer(from_fn(guard::no_query))
        .routes(routes!(downloads::trace))
        .routes(routes!(received::received))
        .routes(routes!(event_stream::events))
        .routes(routes!(live::live))
}

/// Accepts connections. When the maximum is reached, each existing connection ends: at once if it is idle,
/// otherwise after the response in progress.
async fn accept(listener: tokio::net::TcpListener, router: Router) {
    let room = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    let crowded = Arc::new(Notify::new());
    loop {
        let (stream, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                warn!("the control API cannot take a connection: {error}");
                // The process may have no file descriptor left, so wait until a connection ends.
                crowded.notify_waiters();
                tokio::time::sleep(Duration::from_secs(1)).await;
                continue;
            }
        };
        if room.available_permits() == 0 {
            crowded.notify_waiters();
        }
        let Ok(permit) = Arc::clone(&room).acquire_owned().await else { return };
        let service = TowerToHyperService::new(router.clone());
        // Created here, not in the task, so that no notification is missed before the task first runs.
        let leave = Arc::clone(&crowded).notified_owned();
        tokio::spawn(async move {
            let mut server = hyper::server::conn::http1::Builder::new();
            server.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME);
            let mut connection = pin!(server.serve_connection(TokioIo::new(stream), service));
            let ended = tokio::select! {
                ended = connection.as_mut() => ended,
                () = leave => {
                    connection.as_mut().graceful_shutdown();
                    connection.await
                }
            };
            if let Err(error) = ended {
                debug!("control API, {peer}: {error}");
            }
            drop(permit);
        });
    }
}
