//! The files that options name for what happens.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

use standin_sim::bench::Bench;
use standin_sim::trace::TraceKeep;

use super::memory::Memory;
use crate::cli;
use crate::output::Output;
use crate::waveforms::Waveforms;

/// The files that options name, opened and as they were.
pub(super) struct Files {
    record: Option<Output>,
    waves: Option<Output>,
}

impl Files {
    /// Opens them; no two may be the same, nor one that keeps a memory.
    ///
    /// # Errors
    /// One sentence: which one cannot be used, and why.
    pub(super) fn open(options: &cli::Run, memories: &[Memory]) -> Result<Self, String> {
        let record = open("--record", options.record.as_deref(), memories)?;
        let waves = open("--vcd", options.vcd.as_deref(), memories)?;
        let all: Vec<&Output> = [&record, &waves].into_iter().flatten().collect();
        for (n, output) in all.iter().enumerate() {
            for other in &all[..n] {
                if output.is(other)? {
                    let (one, two, path) = (output.option(), other.option(), output.path().display());
                    return Err(format!("{one} and {two} are the same file, {path}; use two"));
                }
            }
        }
        Ok(Self { record, waves })
    }

    /// How much of what happens they need.
    pub(super) fn keep(&self) -> TraceKeep {
        if self.record.is_some() { TraceKeep::All } else { TraceKeep::default() }
    }

    /// Begins them anew; those that follow the bench, and the one that is written at its end.
    ///
    /// # Errors
    /// One sentence: which one cannot be written, and why.
    pub(super) fn begin(self, bench: &Bench) -> Result<(Option<Output>, Option<Waveforms>), String> {
        self.record.as_ref().map_or(Ok(()), Output::begin)?;
        let waveforms = self.waves.map(|output| Waveforms::begin(output, bench)).transpose()?;
        Ok((self.record, waveforms))
    }
}

/// Writes the trace of a bench.
///
/// # Errors
/// Of the file system.
pub(super) fn write_trace(bench: &Bench, file: &File) -> io::Result<()> {
    let mut writer = BufWriter::new(file);
    bench.trace().write(&mut writer)?;
    writer.into_inner()?.sync_all()
}

fn open(option: &'static str, path: Option<&Path>, memories: &[Memory]) -> Result<Option<Output>, String> {
    let Some(path) = path else { return Ok(None) };
    let output = Output::open(option, path)?;
    let file = output.metadata()?;
    for memory in memories {
        if output.fails(memory.is_in(&file))? {
            return Err(format!("{option} {} keeps the memory of a drive; use another file", path.display()));
        }
    }
    Ok(Some(output))
}
