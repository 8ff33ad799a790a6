//! `GET /api/drives/{name}/received`: the messages that a drive has received.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::{Path, State};
use drivetwin_firmware::device::{Framing, Instant, Port};
use drivetwin_panel::schema::ValueSchema;
use drivetwin_panel::units::{hex, seconds};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{self, Bench, DriveId, ReceivedMessage, RequestStatistics};
use drivetwin_sim::decode::{Exchange, Verdict};
use drivetwin_sim::suggest;
use drivetwin_sim::value::Value;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::Api;
use super::calls::find_drive;
use super::guard::QueryParameters;
use super::problem::Problem;
use crate::board::reasons;

/// Parameters of the call.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ReceivedParameters {
    since: Option<f64>,
    function: Option<u8>,
    register: Option<String>,
}

/// The latest messages that a drive has received, in the order in which their outcomes became known, and those of its
/// shared line that were for no drive or corrupt.
#[derive(Serialize, ToSchema)]
pub(super) struct Received {
    requests: Vec<ReceivedRequest>,
    /// Number of earlier messages that are not kept. 10,000 messages of each drive and of each line are kept.
    lost: u64,
    counts: Counts,
    statistics: ReceivedStatistics,
}

/// Statistics of all requests so far, whatever is selected.
#[derive(Serialize, ToSchema)]
struct ReceivedStatistics {
    /// Number of requests to the drive while it was starting, so that it did not receive them.
    starting: u64,
    /// Modbus lines and Modbus/TCP ports, by the port of the drive.
    lines: BTreeMap<&'static str, LineStatistics>,
}

/// Statistics of the requests on a Modbus line, to all its drives, or on a Modbus/TCP port.
#[derive(Serialize, ToSchema)]
struct LineStatistics {
    requests: u64,
    /// Number of requests that were too early: without a silence of t3.5 before them.
    early: u64,
    /// Number of requests that repeat the request before them, which had no answer.
    retries: u64,
    /// Shortest silence between a reply and the next request, in seconds; null if it is not known, as in manual time
    /// or on a TCP port.
    #[schema(example = 0.0052)]
    shortest_silence: Option<f64>,
}

impl ReceivedStatistics {
    fn of(bench: &Bench, drive: DriveId) -> Self {
        let ports = (0..).map(Port).zip(bench.spec(drive).ports);
        let modbus = ports.filter(|(_, port)| matches!(port.framing, Framing::Silence | Framing::Mbap));
        let lines = modbus.map(|(number, port)| {
            let RequestStatistics { requests, early, retries, shortest_silence } =
                bench.request_statistics(bench.outlet(drive, number));
            let shortest_silence =
                shortest_silence.map(|silence| silence.ticks() as f64 / TICKS_PER_SECOND as f64);
            (port.name, LineStatistics { requests, early, retries, shortest_silence })
        });
        Self { starting: bench.starting_requests(drive).count, lines: lines.collect() }
    }
}

/// Numbers of the requests in this response.
#[derive(Serialize, ToSchema)]
struct Counts {
    /// By Modbus function.
    #[schema(example = json!({"3": 12, "6": 1}))]
    functions: BTreeMap<u8, u64>,
    /// By register.
    registers: BTreeMap<String, Accesses>,
}

/// Numbers of the requests that read and that write a register, whatever their outcomes.
#[derive(Serialize, ToSchema)]
struct Accesses {
    read: u64,
    written: u64,
}

/// A message that a drive has received: a Modbus request, or a line of text.
#[derive(Serialize, ToSchema)]
pub(super) struct ReceivedRequest {
    /// Bench time of its end, in seconds.
    #[schema(example = 2.513176875)]
    at: f64,
    /// The port of the drive.
    #[schema(example = "rs485")]
    port: &'static str,
    /// Its bytes in hexadecimal, without characters that had an error; at most 1,024 bytes.
    #[schema(example = "0106001500C899CE")]
    bytes: String,
    /// The request in the names of the manual.
    #[schema(example = "write SpeedLow = 200")]
    text: String,
    /// The bytes of the answer; null if there was none.
    #[schema(example = "0106001500C899CE")]
    answer: Option<String>,
    /// Outcome of the message.
    verdict: VerdictSchema,
    /// Reason of the verdict, or the limit of its effect; null if there is no more to say.
    #[schema(example = "0x000B Reserved is read only (02)")]
    reason: Option<String>,
    /// The outcome in one clause.
    #[schema(example = "done")]
    outcome: String,
    /// Address of the request; null on a port for text.
    address: Option<u8>,
    /// Modbus function; null on a port for text.
    #[schema(example = 6)]
    function: Option<u8>,
    /// Registers of the request, in its order.
    registers: Vec<ReceivedRegister>,
}

/// A register in a request.
#[derive(Serialize, ToSchema)]
struct ReceivedRegister {
    /// The manual's name; one word of a register of two ends in `High` or `Low`.
    #[schema(example = "SpeedLow")]
    name: String,
    /// The value that is written, or that the answer to a read has; null if there is none.
    #[schema(value_type = Option<ValueSchema>)]
    value: Option<Value>,
    /// True if the request writes the register.
    written: bool,
}

/// `done`; `refused`; `without effect`: accepted, and without effect; `not for it`: no drive has the address; `bad
/// frame`: corrupt; `too early`: dropped by a strict line; `not listening`: the drive starts, sends or has no power; `lost`: taken by
/// a fault of the line or TCP port.
#[derive(Clone, Copy, Serialize, ToSchema)]
#[schema(as = Verdict)]
enum VerdictSchema {
    #[serde(rename = "done")]
    Done,
    #[serde(rename = "refused")]
    Refused,
    #[serde(rename = "without effect")]
    WithoutEffect,
    #[serde(rename = "not for it")]
    NotForIt,
    #[serde(rename = "bad frame")]
    BadFrame,
    #[serde(rename = "too early")]
    TooEarly,
    #[serde(rename = "not listening")]
    NotListening,
    #[serde(rename = "lost")]
    Lost,
}

impl From<Verdict> for VerdictSchema {
    fn from(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Done => Self::Done,
            Verdict::Refused => Self::Refused,
            Verdict::WithoutEffect => Self::WithoutEffect,
            Verdict::NotForIt => Self::NotForIt,
            Verdict::BadFrame => Self::BadFrame,
            Verdict::TooEarly => Self::TooEarly,
            Verdict::NotListening => Self::NotListening,
            Verdict::Lost => Self::Lost,
        }
    }
}

impl From<ReceivedMessage> for ReceivedRequest {
    fn from(message: ReceivedMessage) -> Self {
        let ReceivedMessage { at, port, bytes, answer, exchange, .. } = message;
        let Exchange { request, verdict, reason, outcome, .. } = exchange;
        let registers = request.registers.into_iter().map(|register| ReceivedRegister {
            name: register.name,
            value: register.value,
            written: register.written,
        });
        Self {
            at: seconds(at),
            port,
            bytes: hex(&bytes),
            text: request.text,
            answer: (!answer.is_empty()).then(|| hex(&answer)),
            verdict: verdict.into(),
            reason,
            outcome,
            address: request.address,
            function: request.function,
            registers: registers.collect(),
        }
    }
}

impl From<bench::Counts> for Counts {
    fn from(counts: bench::Counts) -> Self {
        let accesses = |bench::Accesses { read, written }| Accesses { read, written };
        let registers = counts.registers.into_iter().map(|(name, counts)| (name, accesses(counts)));
        Self { functions: counts.functions, registers: registers.collect() }
    }
}

/// The latest messages that a drive has received, with their outcomes.
#[utoipa::path(get, path = "/api/drives/{name}/received",
    params(
        ("since" = Option<f64>, Query, description = "only messages from the first one that ended at this bench time or later, in seconds"),
        ("function" = Option<u8>, Query, description = "only requests with this Modbus function"),
        ("register" = Option<String>, Query, description = "only requests that read or write this register"),
    ),
    responses(
        (status = 200, body = Received),
        (status = 409, description = "The drive is on a board.", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn received(
    State(api): State<Api>,
    Path(name): Path<String>,
    QueryParameters(parameters): QueryParameters<ReceivedParameters>,
) -> Result<Json<Received>, Problem> {
    let ReceivedParameters { since, function, register } = parameters;
    let since = since.unwrap_or(0.0);
    if !(0.0..=1e9).contains(&since) {
        return Err(Problem::refused("since is a bench time in seconds, 0 to 1000000000"));
    }
    let since = Instant::from_ticks((since * TICKS_PER_SECOND as f64).round() as u64);
    // The bench only copies the messages; this thread makes their texts.
    let received = api.call(move |event_loop| {
        let drive = find_drive(event_loop, &name)?;
        let spec = event_loop.bench.spec(drive);
        let register = register.map(|register| {
            let names = spec.rows().map(|(_, row)| row.name);
            spec.find(&register)
                .ok_or_else(|| Problem::refused(suggest::unknown("register", &register, names)))
        });
        let register = register.transpose()?;
        let bench = &event_loop.bench;
        if bench.is_elsewhere(drive) {
            return Err(Problem::conflict(reasons::NO_JOURNAL));
        }
        let statistics = ReceivedStatistics::of(bench, drive);
        Ok::<_, Problem>((bench.received(drive).since(since), register, statistics))
    });
    let (mut received, register, statistics) = received.await??;
    if let Some(function) = function {
        received = received.of_function(function);
    }
    if let Some(register) = register {
        received = received.of_register(register);
    }
    let mut counts = bench::Counts::default();
    let requests = received.messages().map(|message| {
        counts.add(&message.exchange.request);
        message.into()
    });
    let requests: Vec<ReceivedRequest> = requests.collect();
    Ok(Json(Received { requests, lost: received.lost(), counts: counts.into(), statistics }))
}
