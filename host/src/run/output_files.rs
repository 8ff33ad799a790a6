//! Output files of the options `--record`, `--vcd` and `--pcap`.

use std::path::Path;

use drivetwin_sim::bench::Bench;
use drivetwin_sim::record::trace::Retention;

use super::memories::Memory;
use crate::live_file::LiveFile;
use crate::options::RunOptions;
use crate::output_file::OutputFile;

/// The output files, opened without changing their content.
pub(super) struct OutputFiles {
    record: Option<OutputFile>,
    waves: Option<OutputFile>,
    frames: Option<OutputFile>,
}

impl OutputFiles {
    /// Opens the files. No two may be the same file, and none may be a memory file.
    ///
    /// # Errors
    /// One sentence that names the file, and the reason why it cannot be used.
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

    /// Retention of the trace and of the frames: as much as these files need, and for the control API
    /// (if `controlled`) a ring of each.
    pub(super) fn retention(&self, controlled: bool) -> (Retention, Retention) {
        let ring = |wanted| if wanted { Retention::default() } else { Retention::Off };
        let trace = match self.record {
            // The control API serves events from a ring. The file itself needs only the events that are not
            // written yet.
            Some(_) => Retention::Written(if controlled { Retention::RING } else { 0 }),
            None => ring(controlled || self.waves.is_some()),
        };
        (trace, ring(controlled || self.frames.is_some()))
    }

    /// Starts writing the files.
    ///
    /// # Errors
    /// One sentence that names the file, and the reason why it cannot be written.
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
