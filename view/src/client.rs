//! The client of a control API: calls, and the stream of the live state, on a thread of its own.
//!
//! News go into a bounded channel. While the terminal is slow the client reads nothing more, and the
//! server makes its next update from the state of that time.

use std::sync::mpsc::SyncSender;
use std::thread;
use std::time::Duration;

use http_body_util::{BodyExt as _, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1;
use hyper::header::{ACCEPT, CONTENT_TYPE, HOST};
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use serde_json::Value;
use tokio::net::TcpStream;
use tokio::runtime::Builder;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

use crate::address::Address;
use crate::events::{self, Events};

/// Longest wait for a connection.
const CONNECTING: Duration = Duration::from_secs(5);

/// Longest wait for an answer, except that of an advance, which takes as long as the bench does.
const ANSWERING: Duration = Duration::from_secs(15);

/// Longest silence of the stream; the server sends a comment every 15 s.
const SILENCE: Duration = Duration::from_secs(40);

/// First and last wait before the next try to connect.
pub(crate) const RETRIES: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(2)];

/// Maximum length of an answer in bytes.
const LONGEST: usize = 16 << 20;

/// A request to the client.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Ask {
    /// Follows the live state, with all of this drive, instead of what was followed before.
    Follow {
        /// Number of this request, which its news have.
        number: u64,
        drive: Option<String>,
    },
    /// Makes a call. Calls are made one after the other, except those of the clock.
    Call(Call),
    /// Asks for the description of a kind of drive.
    Kind(String),
}

/// A call that changes something.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Call {
    pub(crate) method: Method,
    /// Path, from `/api` on.
    pub(crate) path: String,
    pub(crate) body: Option<Value>,
    /// Returned with the answer.
    pub(crate) tag: u64,
}

impl Call {
    /// Returns whether the call waits until the bench has reached a time.
    fn is_advance(&self) -> bool {
        self.path == "/api/time/advance"
    }
}

/// News for the view.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum News {
    /// News of the live state that a request follows.
    Live { number: u64, live: Live },
    /// The answer of a call: the sentence of an error.
    Answer { tag: u64, result: Result<(), String> },
    /// The description of a kind; `None` if the server has none.
    Kind { kind: String, description: Option<Value> },
}

/// News of the live state.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Live {
    /// The stream is open; its first update is whole.
    Open,
    /// An update: an object.
    Update(Value),
    /// The stream is lost for this reason, in one sentence; the client tries again.
    Lost(String),
    /// The server does not have the followed drive, says this sentence; the client tries again.
    Gone(String),
}

/// The client. Its thread ends when the client is dropped.
pub(crate) struct Client {
    asks: UnboundedSender<Ask>,
}

impl Client {
    /// Starts a client whose news go to `news`, until its other end is gone. `retries` are the first and the last wait
    /// before it connects again.
    ///
    /// # Errors
    /// One sentence: the system gives no thread or no sockets.
    pub(crate) fn start(
        address: Address,
        news: SyncSender<News>,
        retries: [Duration; 2],
    ) -> Result<Self, String> {
        let runtime = Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|error| format!("the view has no sockets: {error}"))?;
        let (asks, asked) = unbounded_channel();
        let work = move || runtime.block_on(serve(address, asked, news, retries));
        let thread = thread::Builder::new().name("client".into()).spawn(work);
        thread.map_err(|error| format!("the view has no thread: {error}"))?;
        Ok(Self { asks })
    }

    /// Asks for something. The answer is news.
    pub(crate) fn ask(&self, ask: Ask) {
        // The thread ends only with the view.
        let _ = self.asks.send(ask);
    }
}

async fn serve(
    address: Address,
    mut asks: UnboundedReceiver<Ask>,
    news: SyncSender<News>,
    retries: [Duration; 2],
) {
    let mut tasks = JoinSet::new();
    let [calls, advances] = [(); 2].map(|()| {
        let (calls, asked) = unbounded_channel();
        tasks.spawn(make_calls(address.clone(), asked, news.clone()));
        calls
    });
    // Dropping the set ends what it does.
    let mut followed = JoinSet::new();
    while let Some(ask) = asks.recv().await {
        match ask {
            Ask::Follow { number, drive } => {
                followed = JoinSet::new();
                followed.spawn(follow(address.clone(), number, drive, news.clone(), retries));
            }
            Ask::Call(call) => {
                let lane = if call.is_advance() { &advances } else { &calls };
                let _ = lane.send(call);
            }
            Ask::Kind(kind) => {
                tasks.spawn(describe(address.clone(), kind, news.clone()));
            }
        }
    }
    drop(followed);
}

/// Makes calls, one after the other.
async fn make_calls(address: Address, mut calls: UnboundedReceiver<Call>, news: SyncSender<News>) {
    while let Some(Call { method, path, body, tag }) = calls.recv().await {
        let result = call(&address, method, &path, body).await;
        if news.send(News::Answer { tag, result: result.map(|_| ()) }).is_err() {
            return;
        }
    }
}

async fn describe(address: Address, kind: String, news: SyncSender<News>) {
    let path = format!("/api/kinds/{}", segment(&kind));
    let body = call(&address, Method::GET, &path, None).await;
    let description = body.ok().and_then(|body| serde_json::from_slice(&body).ok());
    let _ = news.send(News::Kind { kind, description });
}

/// Makes a call. Returns the body of its answer.
async fn call(address: &Address, method: Method, path: &str, body: Option<Value>) -> Result<Bytes, String> {
    let answer = async {
        let exchange = exchange(address, method, path, body).await?;
        let status = exchange.response.status();
        let body = exchange.body().await?;
        if status.is_success() { Ok(body) } else { Err(problem(status, &body)) }
    };
    if path == "/api/time/advance" {
        return answer.await;
    }
    timeout(ANSWERING, answer).await.unwrap_or_else(|_| Err(format!("{address} does not answer")))
}

/// Follows the live state, and connects again whenever the stream is lost.
async fn follow(
    address: Address,
    number: u64,
    drive: Option<String>,
    news: SyncSender<News>,
    [first, last]: [Duration; 2],
) {
    let query = drive.as_deref().map(|drive| format!("?drive={}", segment(drive))).unwrap_or_default();
    let path = format!("/api/live{query}");
    let mut wait = first;
    loop {
        let mut has_updates = false;
        let mut tell = |live| {
            has_updates |= matches!(live, Live::Update(_));
            news.send(News::Live { number, live }).is_ok()
        };
        let Err((status, reason)) = follow_once(&address, &path, &mut tell).await else { return };
        if has_updates {
            wait = first;
        }
        // The control API answers 422 to a name in a query that it does not have.
        let is_gone = drive.is_some() && status.is_some_and(|status| status.is_client_error());
        let live = if is_gone { Live::Gone(reason) } else { Live::Lost(reason) };
        if news.send(News::Live { number, live }).is_err() {
            return;
        }
        sleep(wait).await;
        wait = last.min(wait * 2);
    }
}

/// Follows one stream to its end. Returns without an error if nobody hears the news any more.
///
/// # Errors
/// The reason in one sentence, with the status if the server refuses the stream.
async fn follow_once(
    address: &Address,
    path: &str,
    tell: &mut impl FnMut(Live) -> bool,
) -> Result<(), (Option<StatusCode>, String)> {
    let lost = |reason| (None, reason);
    let exchange = timeout(ANSWERING, exchange(address, Method::GET, path, None)).await;
    let exchange = exchange.unwrap_or_else(|_| Err(format!("{address} does not answer")));
    let mut exchange = exchange.map_err(lost)?;
    let status = exchange.response.status();
    if status != StatusCode::OK {
        let body = timeout(ANSWERING, exchange.body()).await;
        let body = body.unwrap_or_else(|_| Ok(Bytes::new())).map_err(lost)?;
        return Err((Some(status), problem(status, &body)));
    }
    let media = exchange.response.headers().get(CONTENT_TYPE);
    if !media.is_some_and(|media| media.as_bytes().starts_with(b"text/event-stream")) {
        return Err(lost(format!("{address} is not the control address of a drivetwin")));
    }
    if !tell(Live::Open) {
        return Ok(());
    }
    let mut events = Events::new(events::LONGEST);
    loop {
        let Some(piece) = next_piece(address, &mut exchange).await.map_err(lost)? else { continue };
        for event in events.push(&piece).map_err(lost)? {
            if event.name != "update" {
                continue;
            }
            let update = serde_json::from_slice(&event.data).ok().filter(Value::is_object);
            let update = update.ok_or_else(|| lost(format!("{address} sent an update that is not JSON")))?;
            if !tell(Live::Update(update)) {
                return Ok(());
            }
        }
    }
}

/// The next piece of a stream; `None` if it is not data.
async fn next_piece(address: &Address, exchange: &mut Exchange) -> Result<Option<Bytes>, String> {
    let frame = timeout(SILENCE, exchange.response.body_mut().frame()).await;
    let frame = frame.map_err(|_| format!("{address} has been silent for {} s", SILENCE.as_secs()))?;
    let frame = frame.ok_or_else(|| format!("{address} has ended the connection"))?;
    Ok(frame.map_err(|error| broken(address, &error))?.into_data().ok())
}

/// A response, and the connection that it comes from. Dropping it closes the connection.
struct Exchange {
    address: String,
    response: Response<Incoming>,
    _connection: JoinSet<()>,
}

impl Exchange {
    /// The body of the response.
    async fn body(self) -> Result<Bytes, String> {
        let body = Limited::new(self.response.into_body(), LONGEST).collect().await;
        Ok(body.map_err(|error| format!("{}: {error}", self.address))?.to_bytes())
    }
}

/// Sends a request on a connection of its own.
async fn exchange(
    address: &Address,
    method: Method,
    path: &str,
    body: Option<Value>,
) -> Result<Exchange, String> {
    let socket = timeout(CONNECTING, TcpStream::connect(address.authority())).await;
    let socket = socket.map_err(|_| format!("{address} does not answer"))?;
    let socket = socket.map_err(|error| format!("{address} cannot be reached: {error}"))?;
    let _ = socket.set_nodelay(true);
    let handshake = http1::handshake(TokioIo::new(socket)).await;
    let (mut sender, served) = handshake.map_err(|error| broken(address, &error))?;
    let mut connection = JoinSet::new();
    connection.spawn(async {
        // The response has the error, too.
        let _ = served.await;
    });
    let request =
        Request::builder().method(&method).uri(address.path(path)).header(HOST, address.authority());
    let request = match method {
        Method::GET => request.header(ACCEPT, "application/json, text/event-stream"),
        _ => request.header(CONTENT_TYPE, "application/json"),
    };
    let body = body.map(|body| body.to_string()).unwrap_or_default();
    let request = request.body(Full::new(Bytes::from(body))).map_err(|error| format!("{path}: {error}"))?;
    let response = sender.send_request(request).await.map_err(|error| broken(address, &error))?;
    Ok(Exchange { address: address.to_string(), response, _connection: connection })
}

fn broken(address: &Address, error: &hyper::Error) -> String {
    if error.is_parse() {
        return format!("{address} does not speak HTTP");
    }
    format!("{address} has broken the connection")
}

/// The sentence of an error of the control API.
fn problem(status: StatusCode, body: &[u8]) -> String {
    let problem: Value = serde_json::from_slice(body).unwrap_or_default();
    match problem["detail"].as_str() {
        Some(detail) => detail.to_owned(),
        None => format!("the server answers {status}"),
    }
}

/// A name as a segment of a path, or as a value in a query.
pub(crate) fn segment(name: &str) -> String {
    let mut text = String::new();
    for byte in name.bytes() {
        match byte {
            b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' => text.push(byte.into()),
            _ => text.push_str(&format!("%{byte:02X}")),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_paths() {
        assert_eq!(segment("J2.3"), "J2.3");
        assert_eq!(segment("Prüfstand 1/α"), "Pr%C3%BCfstand%201%2F%CE%B1");
    }

    #[test]
    fn errors_are_the_sentences_of_the_server() {
        let problem_of = |body: &str| problem(StatusCode::NOT_FOUND, body.as_bytes());
        assert_eq!(problem_of("{\"detail\":\"there is no drive 'b'\"}"), "there is no drive 'b'");
        assert_eq!(problem_of("<html>"), "the server answers 404 Not Found");
    }
}
