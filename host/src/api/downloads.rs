//! `GET /api/trace`: what happened, in the form that is wanted.
//!
//! The trace is copied piece by piece, so that the bench goes on meanwhile, and written by a thread that
//! waits for its reader: waveforms of a short trace may take days of step pulses.

use std::io::{self, BufWriter, Write};
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use drivetwin_sim::bench::Bench;
use drivetwin_sim::export::pcapng;
use drivetwin_sim::export::vcd;
use drivetwin_sim::record::trace::{Retention, Trace};
use futures_util::stream;
use serde::Deserialize;
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use utoipa::ToSchema;

use super::guard::Asked;
use super::problem::Problem;
use super::{Api, nobody_more};

/// Events that are copied at once.
const PIECE: usize = 4_096;

/// Bytes of the trace that are copied at most: all that the ring holds, and of a trace that keeps everything the
/// end, since there is no bound to it.
const RECENT: usize = Retention::RING;

/// Bytes that are sent at once, and how many such pieces may wait for the reader.
const CHUNK: usize = 64 << 10;
const CHUNKS: usize = 4;

/// Longest time for which a reader may take nothing.
const STALL: Duration = Duration::from_secs(30);

/// Parameters of the call.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Wanted {
    #[serde(default)]
    format: Format,
}

/// A form of what happened.
#[derive(Clone, Copy, Default, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum Format {
    /// Text that `drivetwin replay` takes.
    #[default]
    Trace,
    /// Waveforms of the pins.
    Vcd,
    /// Frames of the lines.
    Pcapng,
}

/// Writes a trace.
type Written = Box<dyn FnOnce(&mut dyn Write) -> io::Result<()> + Send>;

/// The recording, as far back as the ring reaches: the last 64 MiB.
#[utoipa::path(get, path = "/api/trace",
    params(("format" = Option<Format>, Query, description = "`trace` if not given")),
    responses((status = 200, description = "To be replayed, or for a viewer of waveforms or of frames.", content(
        (String = "text/plain"),
        (Vec<u8> = "application/x-pcapng"),
    ))),
)]
pub(super) async fn trace(State(api): State<Api>, Asked(wanted): Asked<Wanted>) -> Result<Response, Problem> {
    let place = api.exports.clone().try_acquire_owned();
    let place = place.map_err(|_| nobody_more("be sent a trace"))?;
    let (media, written): (_, Written) = match wanted.format {
        Format::Trace => {
            let trace = events(&api).await?;
            ("text/plain; charset=utf-8", Box::new(move |out| trace.write(out)))
        }
        Format::Vcd => {
            let trace = events(&api).await?;
            ("text/plain; charset=utf-8", Box::new(move |out| vcd::write(&trace, out)))
        }
        Format::Pcapng => {
            let frames =
                copied(&api, pcapng::Snapshot::begin, |copy, bench| copy.go_on(bench, PIECE)).await?;
            ("application/x-pcapng", Box::new(move |out| frames.write(out)))
        }
    };
    let (pipe, body) = pipe();
    tokio::task::spawn_blocking(move || {
        let _place = place;
        // The body ends early; there is nobody else to tell.
        let _ = pipe.fill(written);
    });
    Ok(([(header::CONTENT_TYPE, media)], body).into_response())
}

/// A copy of the trace as it is now.
async fn events(api: &Api) -> Result<Trace, Problem> {
    let begin = |bench: &Bench| bench.trace().outline();
    copied(api, begin, |copy, bench| copy.copy_back(bench.trace(), RECENT, PIECE)).await
}

/// A copy of something as it is now: begun at one look, and gone on with at others while there is more.
async fn copied<T: Send + 'static>(
    api: &Api,
    begin: fn(&Bench) -> T,
    go_on: fn(&mut T, &Bench) -> bool,
) -> Result<T, Problem> {
    let mut copy = api.look(begin).await?;
    loop {
        let piece = api.look(move |bench| {
            let more = go_on(&mut copy, bench);
            (copy, more)
        });
        let more;
        (copy, more) = piece.await?;
        if !more {
            return Ok(copy);
        }
    }
}

/// A body that is being written.
struct Pipe {
    /// An empty piece is the end; a body without it is not complete.
    pieces: mpsc::Sender<Bytes>,
    runtime: Handle,
}

/// A pipe, and the body at its end.
fn pipe() -> (Pipe, Body) {
    let (pieces, taken) = mpsc::channel(CHUNKS);
    let body = stream::unfold(taken, |mut taken: mpsc::Receiver<Bytes>| async {
        match taken.recv().await {
            Some(piece) if piece.is_empty() => None,
            Some(piece) => Some((Ok(piece), taken)),
            None => Some((Err(io::Error::from(io::ErrorKind::UnexpectedEof)), taken)),
        }
    });
    (Pipe { pieces, runtime: Handle::current() }, Body::from_stream(body))
}

impl Pipe {
    /// Has it filled, on a thread that may wait.
    fn fill(self, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
        let mut out = BufWriter::with_capacity(CHUNK, self);
        write(&mut out)?;
        out.into_inner()?.send(Bytes::new())
    }

    /// Waits until the reader takes it; an error if that is never.
    fn send(&self, piece: Bytes) -> io::Result<()> {
        let sent = self.runtime.block_on(self.pieces.send_timeout(piece, STALL));
        sent.map_err(|_| io::ErrorKind::BrokenPipe.into())
    }
}

impl Write for Pipe {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.send(Bytes::copy_from_slice(bytes))?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
