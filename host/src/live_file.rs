//! `--record`, `--vcd` and `--pcap`: files that are written while the bench runs.
//!
//! The bench's thread writes these files. Therefore a slow disk, or a slow reader of a pipe, delays the
//! bench, the handling of signals and the control API (HOST-10).

use std::fs::File;
use std::io;
use std::path::Path;

use drivetwin_sim::bench::Bench;
use drivetwin_sim::export::pcapng::Pcapng;
use drivetwin_sim::export::vcd::Waves;
use drivetwin_sim::record::trace::Recording;
use tracing::error;

use crate::output_file::OutputFile;

/// Waits until the content of a file is on the disk.
fn wait_for(file: &File) -> io::Result<()> {
    // A pipe or a device has no disk to wait for.
    if file.metadata()?.is_file() { file.sync_all() } else { Ok(()) }
}

/// Writer of a live file.
trait Writer {
    /// Writes the events that are new since the last call.
    fn update(&mut self, bench: &Bench) -> io::Result<()>;
    /// Completes the file at the present time of the bench.
    fn finish(self: Box<Self>, bench: &Bench) -> io::Result<()>;
}

impl Writer for Recording<File> {
    fn update(&mut self, bench: &Bench) -> io::Result<()> {
        Self::follow(self, bench.trace())
    }

    fn finish(self: Box<Self>, bench: &Bench) -> io::Result<()> {
        Self::finish(*self, bench.trace()).map(|_| ())
    }
}

impl Writer for Waves<File> {
    fn update(&mut self, bench: &Bench) -> io::Result<()> {
        Self::follow(self, bench.trace())
    }

    fn finish(self: Box<Self>, _: &Bench) -> io::Result<()> {
        Self::finish(*self)
    }
}

impl Writer for Pcapng<File> {
    fn update(&mut self, bench: &Bench) -> io::Result<()> {
        Self::follow(self, bench)
    }

    fn finish(self: Box<Self>, bench: &Bench) -> io::Result<()> {
        Self::finish(*self, bench)
    }
}

/// A file that is written while the bench runs, from the events that the bench retains.
pub(crate) struct LiveFile {
    output: OutputFile,
    /// `None` after a failure.
    writer: Option<Box<dyn Writer>>,
}

impl LiveFile {
    /// Starts a recording (HOST-8).
    pub(crate) fn recording(output: OutputFile, bench: &Bench) -> Result<Self, String> {
        Self::begin(output, |file| Ok(Box::new(Recording::new(bench.trace(), file)?)))
    }

    /// Starts a file with the waveforms of the pins.
    pub(crate) fn waves(output: OutputFile, bench: &Bench) -> Result<Self, String> {
        Self::begin(output, |file| Ok(Box::new(Waves::new(bench.trace(), file)?)))
    }

    /// Starts a file with the frames of the lines.
    pub(crate) fn frames(output: OutputFile, bench: &Bench) -> Result<Self, String> {
        Self::begin(output, |file| Ok(Box::new(Pcapng::new(bench, file)?)))
    }

    fn begin(
        output: OutputFile,
        write: impl FnOnce(File) -> io::Result<Box<dyn Writer>>,
    ) -> Result<Self, String> {
        output.begin()?;
        let writer = Some(output.fails(output.file().try_clone().and_then(write))?);
        Ok(Self { output, writer })
    }

    /// Path of the file.
    pub(crate) fn path(&self) -> &Path {
        self.output.path()
    }

    /// Writes the events that are new since the last call. If the file cannot be written, the error is logged
    /// once and the drives continue without the file.
    pub(crate) fn update(&mut self, bench: &Bench) {
        if let Some(writer) = &mut self.writer
            && let Err(sentence) = self.output.fails(writer.update(bench))
        {
            error!("{sentence}; the file ends here");
            self.writer = None;
        }
    }

    /// Completes the file at the present time of the bench.
    pub(crate) fn finish(mut self, bench: &Bench) -> Result<(), String> {
        self.update(bench);
        match self.writer {
            // Some systems report a failed write only when the file is synchronized.
            Some(writer) => {
                self.output.fails(writer.finish(bench).and_then(|()| wait_for(self.output.file())))
            }
            None => Err(format!("{} {} is not complete", self.output.option(), self.output.path().display())),
        }
    }
}
