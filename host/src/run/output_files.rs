//! The files that options name for what happens.

use std::path::Path;

use drivetwin_sim::bench::Bench;
use drivetwin_sim::record::trace::Retention;

use super::memories::Memory;
use crate::live_file::LiveFile;
use crate::options::RunOptions;
use crate::output_file::OutputFile;

/// The files that options name, opened and as they were.
pub(super) struct OutputFiles {
    record: Option<OutputFile>,
    waves: Option<OutputFile>,
    frames: Option<OutputFile>,
}

impl OutputFiles {
    /// Opens them; no two may be the same, nor one that keeps a memory.
    ///
    /// # Errors
    /// One sentence: which one cannot be used, and why.
    pub(super) fn open(options: &RunOptions, memories: &[Memory]) -> Result<Self, String> {
        let record = open("--record", options.record.as_deref(), memories)?;
        let waves = open("--vcd", options.vcd.as_deref(), memories)?;
        let frames = open("--pcap", options.pcap.as_deref(), memories)?;
        let all: Vec<&OutputFile> = [&record, &waves, &frames].into_iter().flatten().collect();
        for (n, output) in all.iter().enumerate() {
            for other in &all[..n] {
                if output.is(other)? {
                    let (one, two, path) = (output.option(), other.option(), output.path().display());
                    return Err(format!("{one} and {two} are the same file, {path}; use two"));
                }
            }
        }
        Ok(Self { record, waves, frames })
    }

    /// Retention of the trace and of the frames: for these files, and for the control API if the bench is
    /// `controlled`.
    pub(super) fn keep(&self, controlled: bool) -> (Retention, Retention) {
        let ring = |wanted| if wanted { Retention::default() } else { Retention::Off };
        let trace = match self.record {
            // The control API has what a ring holds; the file itself needs only what is not in it yet.
            Some(_) => Retention::Written(if controlled { Retention::RING } else { 0 }),
            None => ring(controlled || self.waves.is_some()),
        };
        (trace, ring(controlled || self.frames.is_some()))
    }

    /// Begins them anew, to follow the bench.
    ///
    /// # Errors
    /// One sentence: which one cannot be written, and why.
    pub(super) fn begin(self, bench: &Bench) -> Result<Vec<LiveFile>, String> {
        let record = self.record.map(|output| LiveFile::recording(output, bench));
        let waves = self.waves.map(|output| LiveFile::waves(output, bench));
        let frames = self.frames.map(|output| LiveFile::frames(output, bench));
        record.into_iter().chain(waves).chain(frames).collect()
    }
}

fn open(
    option: &'static str,
    path: Option<&Path>,
    memories: &[Memory],
) -> Result<Option<OutputFile>, String> {
    let Some(path) = path else { return Ok(None) };
    let output = OutputFile::open(option, path)?;
    let file = output.metadata()?;
    for memory in memories {
        if output.fails(memory.is_in(&file))? {
            return Err(format!("{option} {} keeps the memory of a drive; use another file", path.display()));
        }
    }
    Ok(Some(output))
}
