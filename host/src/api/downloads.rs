//! `GET /api/trace`: the recorded events, in one of several formats.
//!
//! The trace is copied in pieces, so that the bench continues meanwhile. A thread of its own writes the copy
//! and waits for the reader, because the waveforms of a short trace may contain days of step pulses.

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
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use utoipa::ToSchema;

use super::guard::QueryParameters;
use super::problem::Problem;
use super::{Api, too_many};

/// Maximum number of events per piece.
const PIECE: usize = 4_096;

/// Maximum number of bytes that are copied: the whole ring, or the end of an unbounded trace.
const RECENT: usize = Retention::RING;

/// Size of a chunk of the response, and the number of chunks that may wait for the reader.
const CHUNK: usize = 64 << 10;
const CHUNKS: usize = 4;

/// Longest wait for a reader that takes nothing.
const STALL: Duration = Duration::from_secs(30);

/// Parameters of the call.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TraceParameters {
    #[serde(default)]
    format: Format,
}

/// Format of a download.
#[derive(Clone, Copy, Default, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum Format {
    /// Text for `drivetwin replay`.
    #[default]
    Trace,
    /// Waveforms of pins, motion and messages.
    Vcd,
    /// Frames of the lines.
    Pcapng,
}

/// Function that writes a trace.
type TraceWriter = Box<dyn FnOnce(&mut dyn Write) -> io::Result<()> + Send>;

/// The recording of the last events, as far as the ring reaches: up to 64 MiB.
#[utoipa::path(get, path = "/api/trace",
    params(("format" = Option<Format>, Query, description = "`trace` if not given")),
    responses((status = 200, description = "To be replayed, or for a viewer of waveforms or of frames.", content(
        (String = "text/plain"),
        (Vec<u8> = "application/x-pcapng"),
    ))),
)]
pub(super) async fn trace(
    State(api): State<Api>,
    QueryParameters(parameters): QueryParameters<TraceParameters>,
) -> Result<Response, Problem> {
    let permit = api.exports.clone().try_acquire_owned();
    let permit = permit.map_err(|_| too_many("download a trace"))?;
    let (media, writer): (_, TraceWriter) = match parameters.format {
        Format::Trace => {
            let trace = events(&api).await?;
            ("text/plain; charset=utf-8", Box::new(move |out| trace.write(out)))
        }
        Format::Vcd => {
            let mut trace = events(&api).await?;
            let outcomes = api.query(Bench::outcomes).await?;
            trace.add_outcomes(outcomes);
            ("text/plain; charset=utf-8", Box::new(move |out| vcd::write(&trace, out)))
        }
        Format::Pcapng => {
            let frames =
                copy_in_pieces(&api, pcapng::Snapshot::begin, |copy, bench| copy.go_on(bench, PIECE)).await?;
            ("application/x-pcapng", Box::new(move |out| frames.write(out)))
        }
    };
    let (pipe, body) = pipe();
    tokio::task::spawn_blocking(move || {
        // After an error the body ends early, which is the only report of the error.
        let _ = pipe.fill(writer, permit);
    });
    Ok(([(header::CONTENT_TYPE, media)], body).into_response())
}

/// A copy of the trace at this moment.
async fn events(api: &Api) -> Result<Trace, Problem> {
    let begin = |bench: &Bench| bench.trace().outline();
    copy_in_pieces(api, begin, |copy, bench| copy.copy_back(bench.trace(), RECENT, PIECE)).await
}

/// Copies the present state of something. One query begins the copy; further queries continue it until it is
/// complete.
async fn copy_in_pieces<T: Send + 'static>(
    api: &Api,
    begin: fn(&Bench) -> T,
    go_on: fn(&mut T, &Bench) -> bool,
) -> Result<T, Problem> {
    let mut copy = api.query(begin).await?;
    loop {
        let piece = api.query(move |bench| {
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

/// A response body that is being written.
struct Pipe {
    /// Chunks of the body. An empty chunk marks the end; a body without that mark is incomplete.
    pieces: mpsc::Sender<Bytes>,
    runtime: Handle,
}

/// A pipe, and the response body at its other end.
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
    /// Calls `write` to fill the body. The calling thread may have to wait. The permit is given back before the body ends,
    /// so that a client that asks again at once is not refused.
    fn fill(
        self,
        write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
        permit: OwnedSemaphorePermit,
    ) -> io::Result<()> {
        let mut out = BufWriter::with_capacity(CHUNK, self);
        write(&mut out)?;
        let pipe = out.into_inner()?;
        drop(permit);
        pipe.send(Bytes::new())
    }

    /// Waits until the reader takes the chunk. Fails if it does not within [`STALL`], or has left.
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tokio::runtime::Builder;
    use tokio::sync::Semaphore;

    use super::*;

    #[test]
    fn a_permit_is_free_before_the_body_ends() {
        let runtime = Builder::new_current_thread().enable_time().build().unwrap();
        runtime.block_on(async {
            let room = Arc::new(Semaphore::new(1));
            let permit = Arc::clone(&room).try_acquire_owned().unwrap();
            // With room for one chunk, the mark of the end waits until the chunk is taken.
            let (pieces, mut taken) = mpsc::channel(1);
            let pipe = Pipe { pieces, runtime: Handle::current() };
            let filled = tokio::task::spawn_blocking(move || pipe.fill(|out| out.write_all(b"x"), permit));
            let _free = room.acquire().await.unwrap();
            assert_eq!(taken.recv().await.unwrap(), "x");
            assert!(taken.recv().await.unwrap().is_empty());
            filled.await.unwrap().unwrap();
        });
    }
}
