//! The command line.

use std::path::PathBuf;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{ArgAction, Args, CommandFactory as _, Parser, Subcommand, ValueEnum};

use drivetwin_host::options::{Assignment, AttachOptions, BoardPlace, Control, RunOptions};
use drivetwin_sim::config::listen::{Listen, Uri};
use drivetwin_sim::config::preset::Number;
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::export::plot;
use drivetwin_sim::line::LineMode;
use drivetwin_view::Address;

/// Emulated motion drives on ptys, TCP ports and serial ports, as their manuals describe them.
#[derive(Parser)]
#[command(name = "drivetwin", version, disable_help_subcommand = true, arg_required_else_help = false)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Log more; twice: log everything
    #[arg(short, long, global = true, action = ArgAction::Count)]
    pub(crate) verbose: u8,
    /// Log errors only
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub(crate) quiet: bool,
}

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Run a drive, or a bench of several drives
    Run(Box<Run>),
    /// Attach a board: serve the control API for it, and record what it does
    Attach(Box<Attach>),
    /// Show a bench in this terminal: drives, lights, registers, motion, messages; ? shows the keys
    View {
        /// Address of its control API, as `drivetwin run` prints it
        #[arg(value_name = "URL")]
        url: Option<Address>,
    },
    /// Check a bench file without running it; warnings are printed to stderr
    Check {
        /// Bench file, whose name ends in .toml, or - for standard input
        #[arg(value_name = "BENCH.toml")]
        file: String,
    },
    /// List the kinds of drive
    List {
        /// As JSON
        #[arg(long)]
        json: bool,
    },
    /// Show the ports, pins and registers of a kind of drive, and what is not modelled
    Describe {
        /// Kind of drive (see `drivetwin list`), or several
        #[arg(required = true, value_name = "KIND")]
        kinds: Vec<String>,
        /// As JSON, a line for each kind
        #[arg(long, conflicts_with = "markdown")]
        json: bool,
        /// As Markdown, like docs/reference; several kinds on one page, with a table of what differs
        #[arg(long)]
        markdown: bool,
    },
    /// Replay a trace; on a difference print the first one and exit with code 1
    Replay {
        /// Trace file (see `drivetwin run --record`), or - for standard input
        #[arg(value_name = "FILE.trace")]
        file: String,
    },
    /// Draw a trace: motion, pins and messages of each drive over time
    Plot(Plot),
    /// Assemble a user program of an RS drive
    Asm(Asm),
    /// Disassemble a user program of an RS drive to text that assembles to the same bytes
    Disasm {
        /// File of an assembled program (see `drivetwin asm`)
        file: PathBuf,
    },
    /// Copy an image of every kind of drive to a board, whose boot loader is started, or say what to press
    Flash(Flash),
    /// Print docs/reference/cli.md
    #[command(hide = true)]
    Reference,
}

#[derive(Args)]
pub(crate) struct Plot {
    /// Trace file (see `drivetwin run --record`), or - for standard input
    #[arg(value_name = "FILE.trace")]
    pub(crate) file: String,
    /// Output file; to stdout, as SVG, without -o. PNG needs the feature `png` of the program
    #[arg(short, long, value_name = "FILE.svg|FILE.png")]
    pub(crate) output: Option<PathBuf>,
    /// Begin of the time axis [default: the beginning of the trace]
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true, value_parser = seconds)]
    pub(crate) from: Option<f64>,
    /// End of the time axis [default: the end of the trace]
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true, value_parser = seconds)]
    pub(crate) to: Option<f64>,
    /// Drive to draw, by its name; may repeat [default: all]
    #[arg(long, value_name = "NAME")]
    pub(crate) drive: Vec<String>,
}

#[derive(Args)]
pub(crate) struct Asm {
    /// File of the program as text
    pub(crate) source: PathBuf,
    /// Output file: the lines of the program as 32-bit words, low byte first
    #[arg(short, long, value_name = "FILE", required_unless_present = "hex")]
    pub(crate) output: Option<PathBuf>,
    /// Output eight hexadecimal digits for each line of the program; to stdout without -o
    #[arg(long)]
    pub(crate) hex: bool,
}

#[derive(Args)]
pub(crate) struct Flash {
    /// Board
    #[arg(value_enum)]
    pub(crate) board: Board,
    /// Image for the board [default: drivetwin-pico.uf2 or drivetwin-pico2.uf2 that came with the program]
    #[arg(long, value_name = "FILE.uf2")]
    pub(crate) image: Option<PathBuf>,
    /// Board that runs a drive and shall start its boot loader: the path of its control port, usb:SERIAL for a USB serial
    /// number, or tcp:HOST:PORT [default: the only board that is plugged in, if none is in its boot loader]
    #[arg(long = "board", value_name = "DEVICE")]
    pub(crate) device: Option<BoardPlace>,
}

/// Boards that `drivetwin flash` knows.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(crate) enum Board {
    /// Raspberry Pi Pico
    Pico,
    /// Raspberry Pi Pico 2
    Pico2,
}

#[derive(Args)]
pub(crate) struct Run {
    /// Kind of drive (see `drivetwin list`), or a bench file of several drives, whose name ends in .toml, or - for a
    /// bench file on standard input
    #[arg(value_name = "KIND|BENCH.toml")]
    pub(crate) what: String,
    /// Listening address of a port of the drive, by default its first port: pty:, pty:LINK, tcp:HOST:PORT,
    /// rfc2217:HOST:PORT, serial:DEVICE or stdio:; for a TCP port only tcp:; may repeat [default for each port: a free
    /// loopback TCP port, for a serial port also a pty]
    #[arg(long, value_name = "[PORT=]URI", help_heading = ONE_DRIVE)]
    pub(crate) listen: Vec<Listen>,
    /// Listening address of the control API, HOST:PORT, or off
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:0")]
    pub(crate) control: Control,
    /// Additional host name that requests to the control API may use, besides localhost and its own address; may
    /// repeat
    #[arg(long, value_name = "NAME")]
    pub(crate) allow_host: Vec<String>,
    /// Time mode: real, xN (N times faster) or manual (stopped, except for requests and the control API) [default:
    /// real]
    #[arg(long, value_name = "real|xN|manual")]
    pub(crate) time: Option<TimeMode>,
    /// Whether characters take time on serial lines [default: timed]
    #[arg(long, value_enum)]
    pub(crate) line: Option<Line>,
    /// Bus address, as if saved before power-on
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = number, help_heading = ONE_DRIVE)]
    pub(crate) address: Option<Number>,
    /// Store the non-volatile memory in FILE
    #[arg(long, value_name = "FILE", help_heading = ONE_DRIVE)]
    pub(crate) nv: Option<PathBuf>,
    /// Preset a register by its name; may repeat
    #[arg(long, value_name = "REG=VALUE", help_heading = ONE_DRIVE)]
    pub(crate) set: Vec<Assignment>,
    /// Assemble a user program and load it into the memory before power-on, as if saved (rs434544, rs434546)
    #[arg(long, value_name = "FILE.rsasm", help_heading = ONE_DRIVE)]
    pub(crate) program: Option<PathBuf>,
    /// Skip the start-up delay of emulated drives
    #[arg(long)]
    pub(crate) fast_boot: bool,
    /// Drop requests that are too early on Modbus lines, as drives do: without a silence of t3.5 before them
    #[arg(long)]
    pub(crate) strict: bool,
    /// Seed of every random choice [default: 1]
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = seed)]
    pub(crate) seed: Option<u64>,
    /// Record a trace to FILE while it runs, for `drivetwin replay`
    #[arg(long, value_name = "FILE.trace")]
    pub(crate) record: Option<PathBuf>,
    /// Write waveforms of pins, motion and messages to FILE while it runs (VCD, for GTKWave); a slow disk or a slow reader of a pipe
    /// delays the bench
    #[arg(long, value_name = "FILE.vcd")]
    pub(crate) vcd: Option<PathBuf>,
    /// Write the frames of the lines to FILE while it runs (pcapng, for Wireshark); a slow reader delays the bench
    #[arg(long, value_name = "FILE.pcapng")]
    pub(crate) pcap: Option<PathBuf>,
    /// Print one line of JSON to stdout when ready, and nothing else
    #[arg(long)]
    pub(crate) json: bool,
    /// Show the bench in this terminal, like `drivetwin view`; the banner and the log are in its log pane, and q ends the
    /// bench
    #[arg(long, conflicts_with = "json")]
    pub(crate) view: bool,
}

#[derive(Args)]
pub(crate) struct Attach {
    /// Control port of the board: the path of its serial port, usb:SERIAL for a USB serial number, or tcp:HOST:PORT for a
    /// port behind a server [default: the only board that is plugged in]
    #[arg(value_name = "DEVICE")]
    pub(crate) device: Option<BoardPlace>,
    /// Listening address of the control API, HOST:PORT, or off
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:0")]
    pub(crate) control: Control,
    /// Additional host name that requests to the control API may use, besides localhost and its own address; may
    /// repeat
    #[arg(long, value_name = "NAME")]
    pub(crate) allow_host: Vec<String>,
    /// Address of the drive's bus, for the banner and for programs: serial:DEVICE, tcp:HOST:PORT or rfc2217:HOST:PORT
    /// [default: the other port of the board's USB cable]
    #[arg(long, value_name = "URI")]
    pub(crate) bus: Option<Uri>,
    /// Record a trace to FILE while it runs
    #[arg(long, value_name = "FILE.trace")]
    pub(crate) record: Option<PathBuf>,
    /// Write waveforms of pins, motion and messages to FILE while it runs (VCD, for GTKWave); a slow disk or a slow
    /// reader of a pipe delays the control API
    #[arg(long, value_name = "FILE.vcd")]
    pub(crate) vcd: Option<PathBuf>,
    /// Write the frames of the bus to FILE while it runs (pcapng, for Wireshark); a slow reader delays the control API
    #[arg(long, value_name = "FILE.pcapng")]
    pub(crate) pcap: Option<PathBuf>,
    /// Print one line of JSON to stdout when ready, and nothing else
    #[arg(long)]
    pub(crate) json: bool,
}

impl From<Attach> for AttachOptions {
    fn from(attach: Attach) -> Self {
        Self {
            place: attach.device.unwrap_or_default(),
            bus: attach.bus,
            control: attach.control,
            allow_host: attach.allow_host,
            record: attach.record,
            vcd: attach.vcd,
            pcap: attach.pcap,
            recorded: false,
        }
    }
}

/// Heading of the options that a bench file does not allow, because it has keys for them in each drive.
const ONE_DRIVE: &str = "Options for a single drive (not with a bench file)";

/// Timing of characters on serial lines.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(crate) enum Line {
    /// Each character takes its time at the baud rate
    #[value(alias = "wire")]
    Timed,
    /// Characters take no time, for load tests
    Fast,
}

impl From<Run> for RunOptions {
    fn from(run: Run) -> Self {
        let line = run.line.map(|line| match line {
            Line::Timed => LineMode::Timed,
            Line::Fast => LineMode::Fast,
        });
        Self {
            what: run.what,
            listen: run.listen,
            control: run.control,
            allow_host: run.allow_host,
            time: run.time,
            line,
            address: run.address,
            nv: run.nv,
            set: run.set,
            program: run.program,
            fast_boot: run.fast_boot,
            strict: run.strict,
            seed: run.seed,
            record: run.record,
            vcd: run.vcd,
            pcap: run.pcap,
            recorded: false,
        }
    }
}

fn number(text: &str) -> Result<Number, String> {
    Number::parse(text).ok_or_else(|| format!("'{text}' is not a number; 8000, -5 and 0x1F40 are"))
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|seconds| (0.0..=plot::Options::MOST).contains(seconds));
    seconds.ok_or_else(|| "it takes a number of seconds from 0 on, for instance 2.5".to_owned())
}

fn seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("it takes a whole number from 0 to {}", u64::MAX))
}

/// Converts an error of the command line to one sentence.
pub(crate) fn sentence(mut error: clap::Error) -> String {
    if error.kind() == ErrorKind::MissingSubcommand {
        let cli = Cli::command();
        let commands = cli.get_subcommands().filter(|command| !command.is_hide_set());
        let names: Vec<&str> = commands.map(clap::Command::get_name).collect();
        return format!("a command is missing: {}; see `drivetwin --help`", names.join(", "));
    }
    error.insert(ContextKind::Usage, ContextValue::None);
    let text = error.render().to_string();
    // Clap's text consists of a message, tips, and a reference to the help.
    let parts = text.split("\n\n").filter(|part| !part.trim_start().starts_with("For more information"));
    let words = parts.map(|part| part.split_whitespace().collect::<Vec<_>>().join(" "));
    let parts: Vec<String> = words.filter(|part| !part.is_empty()).collect();
    parts.join("; ").trim_start_matches("error: ").into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(arguments: &[&str]) -> Result<Run, String> {
        let all = ["drivetwin", "run", "md3"].iter().chain(arguments);
        match Cli::try_parse_from(all).map_err(sentence)?.command {
            Command::Run(run) => Ok(*run),
            _ => unreachable!("the arguments begin with `run`"),
        }
    }

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn defaults() {
        let run = run(&[]).unwrap();
        assert_eq!(run.control, Control::At("127.0.0.1:0".into()));
        assert_eq!((run.time, run.line, run.seed), (None, None, None));
    }

    #[test]
    fn paces() {
        assert_eq!(run(&["--time", "x10"]).unwrap().time, Some(TimeMode::Times(10)));
        assert_eq!(run(&["--time", "manual"]).unwrap().time, Some(TimeMode::Manual));
        for wrong in ["x0", "x", "x-1", "x1.5", "fast", "x100000"] {
            assert!(run(&["--time", wrong]).is_err(), "{wrong}");
        }
    }

    #[test]
    fn numbers() {
        assert_eq!((number("-5"), number("0x10")), (Ok(Number::Decimal(-5)), Ok(Number::Bits(16))));
        assert_eq!(number("fast").unwrap_err(), "'fast' is not a number; 8000, -5 and 0x1F40 are");
    }

    #[test]
    fn errors_are_one_sentence() {
        let wrong = run(&["--lisen", "pty:"]).err().unwrap();
        assert_eq!(wrong, "unexpected argument '--lisen' found; tip: a similar argument exists: '--listen'");
        let wrong = run(&["--time", "soon"]).err().unwrap();
        assert_eq!(
            wrong,
            "invalid value 'soon' for '--time <real|xN|manual>': it takes real, xN (N from 1 to 1000) or manual"
        );
    }
}
