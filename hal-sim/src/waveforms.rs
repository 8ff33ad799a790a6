//! `--vcd`: the file that follows the bench.

use std::fs::File;

use standin_sim::bench::Bench;
use standin_sim::vcd::Waves;
use tracing::error;

use crate::output::Output;

/// Writes the waveforms of the pins while the bench goes on, from what its trace still holds.
pub(crate) struct Waveforms {
    output: Output,
    /// `None` when it has failed.
    waves: Option<Waves<File>>,
}

impl Waveforms {
    /// Begins the file anew.
    pub(crate) fn begin(output: Output, bench: &Bench) -> Result<Self, String> {
        output.begin()?;
        let waves = output.file().try_clone().and_then(|file| Waves::new(bench.trace(), file));
        let waves = Some(output.fails(waves)?);
        Ok(Self { output, waves })
    }

    /// Writes what has happened since the last time. A file that cannot be written is told once, and
    /// the drive goes on without.
    pub(crate) fn follow(&mut self, bench: &Bench) {
        if let Some(waves) = &mut self.waves
            && let Err(sentence) = self.output.fails(waves.follow(bench.trace()))
        {
            error!("{sentence}; the waveforms end here");
            self.waves = None;
        }
    }

    /// Ends the file where the bench has come to.
    pub(crate) fn finish(mut self, bench: &Bench) -> Result<(), String> {
        self.follow(bench);
        match self.waves {
            Some(waves) => self.output.fails(waves.finish()),
            None => Err(format!("{} {} is not complete", self.output.option(), self.output.path().display())),
        }
    }
}
