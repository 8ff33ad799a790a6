//! A run of a bench, in three steps: configuration, preparation, service.
//!
//! What can be wrong is found before anything listens: names and values, addresses in use, files. An
//! old recording is overwritten last of all.

mod configuration;
mod memories;
mod output_files;
mod reserved_ports;

use std::os::fd::AsFd;

use drivetwin_sim::bench::{Bench, Bus, DriveId, Settings, Setup};
use drivetwin_sim::config::layout::Built;
use drivetwin_sim::config::time_mode::TimeMode;
use tracing::info;

use crate::api;
use crate::banner::Banner;
use crate::event_loop::{self, EventLoop};
use crate::options::Control;
use crate::ports::Bound;
pub use configuration::Configuration;
use memories::Memory;
use output_files::OutputFiles;
use reserved_ports::ReservedPorts;

/// A bench that is built, with its ports reserved and its files open: nothing listens yet.
pub struct Prepared {
    bench: Bench,
    seats: Vec<DriveId>,
    buses: Vec<Bus>,
    pace: TimeMode,
    ports: ReservedPorts,
    control: Option<Bound>,
    allow_host: Vec<String>,
    memories: Vec<Memory>,
    files: OutputFiles,
}

/// A bench that can be reached.
pub struct Running {
    event_loop: EventLoop,
    banner: Banner,
    memories: Vec<Memory>,
}

impl Configuration {
    /// Reserves ports, opens files and builds the bench.
    ///
    /// # Errors
    /// One sentence: what is wrong, and where.
    pub fn prepare(self) -> Result<Prepared, String> {
        let programs = self.programs()?;
        let ports = ReservedPorts::all(&self.layout)?;
        let control = match &self.options.control {
            Control::Off => None,
            Control::At(address) => Some(reserved_ports::reserve_tcp("--control ", address)?),
        };
        let mut memories = Vec::new();
        for (place, program) in programs.iter().enumerate() {
            memories.push(Memory::open(&self, place, program.as_ref())?);
        }
        let files = OutputFiles::open(&self.options, &memories)?;

        let (trace, capture) = files.keep(control.is_some());
        let settings = Settings { trace, capture, ..self.layout.settings() };
        let given =
            |memory: &Memory| Setup { memory: memory.content(), keep: memory.keeper(), ..Setup::default() };
        let given = memories.iter().map(given).collect();
        let built = self.layout.build(settings, given);
        let Built { mut bench, seats, buses, .. } = built.map_err(|sentence| self.wrong(&sentence))?;
        for (memory, program) in memories.iter().zip(&programs) {
            program.as_ref().map_or(Ok(()), |program| memory.hold(program))?;
        }

        // A drive may change its line after it has read its pins.
        bench.run_until(bench.now());
        let pace = self.layout.time.unwrap_or(TimeMode::Times(1));
        let allow_host = self.options.allow_host;
        Ok(Prepared { bench, seats, buses, pace, ports, control, allow_host, memories, files })
    }
}

impl Prepared {
    /// Opens everything: from here on clients may come.
    ///
    /// # Errors
    /// One sentence: what cannot be opened, and why.
    pub fn open(self) -> Result<Running, String> {
        let Self { mut bench, seats, buses, pace, ports, control, allow_host, memories, files } = self;
        let (ports, addresses) = ports.open(&mut bench, &seats, &buses)?;
        let (handle, inbox) =
            event_loop::handle().map_err(|error| format!("the bench cannot be woken: {error}"))?;
        let mut banner = Banner::new(&bench, &seats, addresses);
        if let Some(bound) = control {
            let api = bound.listen().and_then(|listener| {
                let address = listener.local_addr()?;
                api::serve(listener, &allow_host, handle, banner.places())?;
                Ok(address)
            });
            banner.controlled_at(api.map_err(|error| format!("--control cannot listen: {error}"))?);
        }
        let files = files.begin(&bench)?;
        memories.iter().for_each(Memory::warn);
        let event_loop = EventLoop::new(bench, ports, pace, files, inbox);
        Ok(Running { event_loop, banner, memories })
    }
}

impl Running {
    /// The banner, where everything is reached, as one line of JSON.
    ///
    /// # Errors
    /// The banner cannot be written as JSON.
    pub fn json(&self) -> Result<String, String> {
        self.banner.json().map_err(|error| error.to_string())
    }

    /// The banner as text for people.
    #[must_use]
    pub fn text(&self) -> String {
        self.banner.text()
    }

    /// Serves until something can be read from `stop`, or the ports are of no use any more; then ends the files.
    ///
    /// # Errors
    /// One sentence: what was not kept, or why the bench cannot go on.
    pub fn serve(mut self, stop: &impl AsFd) -> Result<(), String> {
        let ended = self.event_loop.run(stop);
        info!("stopping");
        let mut failures: Vec<String> =
            self.memories.iter().filter_map(|memory| memory.sync().err()).collect();
        failures.extend(self.event_loop.end_files());
        failures.extend(ended.err().map(|error| format!("the bench cannot go on: {error}")));
        if failures.is_empty() { Ok(()) } else { Err(failures.join("; ")) }
    }
}
