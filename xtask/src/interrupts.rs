//! The longest interrupts of an MD3's images, and their deepest stacks: counted in emulation while the drive
//! is asked, saves, and moves at 40,000 steps/s.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result, ensure};
use standin_protocol::modbus::rtu;
use xshell::{Shell, cmd};

use crate::board::{LM3S6965, RP2040};
use crate::counted;
use crate::image::Image;

const BUS: &str = "bus's interrupt";
const CLOCK: &str = "clock's interrupt";
const STEPS: &str = "step's interrupt, with the wait for its pulse";
const PINS: &str = "pins' interrupt";

/// Interrupts of the lm3s6965, and what they are for. The step timer's is not among them: QEMU brings it
/// late, and then one call makes several steps.
const HANDLERS: [(&str, &str); 2] = [("UART0", BUS), ("SysTick", CLOCK)];

/// Exceptions of the rp2040, and what they are for: 16 and the number of the interrupt (RP2040 Datasheet,
/// 2.3.2).
const EXCEPTIONS: [(u32, &str); 3] = [(16, STEPS), (16 + 13, PINS), (16 + 20, BUS)];

/// What is written to an MD3: 40,000 steps/s (7.17), 500,000 steps/s² (7.19), 4,000 steps (7.16), a save
/// (7.20), a move (7.15).
const WRITES: [(u16, u16); 8] =
    [(0x14, 0), (0x15, 40_000), (0x18, 7), (0x19, 41_248), (0x12, 0), (0x13, 4_000), (0x1a, 1), (MOTION, 1)];
const MOTION: u16 = 0x11;

/// What was counted: each interrupt's purpose with its most instructions, and bytes of the stack.
pub(crate) struct Worst {
    pub(crate) interrupts: Vec<(&'static str, u64)>,
    pub(crate) stack: u64,
}

/// On each board, in the order of [`BOARDS`](crate::board::BOARDS).
pub(crate) fn worst(sh: &Shell) -> Result<[Worst; 2]> {
    Ok([lm3s6965(sh)?, rp2040(sh)?])
}

/// Lowest address of the stack, and the one above its highest.
fn stack(image: &Image) -> Result<[u64; 2]> {
    Ok([image.symbol("_stack_end")?, image.symbol("_stack_start")?])
}

/// The number behind `word` in the line of `log` that begins so.
fn number(log: &str, begin: &str, word: &str) -> Result<u64> {
    let line = log.lines().find(|line| line.starts_with(begin));
    let number = line.and_then(|line| line.split(' ').skip_while(|part| *part != word).nth(1));
    number.and_then(|number| number.parse().ok()).with_context(|| format!("nothing counted: {begin}"))
}

/// The Pico, in exact virtual time.
fn rp2040(sh: &Shell) -> Result<Worst> {
    let image = RP2040.image(sh, "md3")?;
    let path = RP2040.images(sh).join("md3");
    let [low, high] = stack(&image)?.map(|address| address.to_string());
    // FAST is low; a request every 100 ms; J2.4 and J2.5 change while it moves.
    let mut script = "0 pin 22 low\n".to_owned();
    let mut at = 100_000;
    for (register, value) in WRITES {
        let request: String =
            rtu::write(1, register, value).iter().map(|byte| format!(" {byte:02x}")).collect();
        script += &format!("{at} rx{request}\n");
        at += 100_000;
    }
    for (pin, level) in [(7, "low"), (8, "low"), (7, "high"), (8, "high")] {
        script += &format!("{at} pin {pin} {level}\n");
        at += 100;
    }
    script += &format!("{} end\n", at + 500_000);
    let play = cmd!(sh, "node tests/pico/play.mjs {path} --stack {low} {high}");
    let log = play.quiet().stdin(script).read()?;
    let mut interrupts = Vec::new();
    for (exception, purpose) in EXCEPTIONS {
        interrupts.push((purpose, number(&log, &format!("stat exception {exception} "), "worst")?));
    }
    Ok(Worst { interrupts, stack: number(&log, "stat stack ", "stack")? })
}

/// The LM3S6965 under QEMU.
fn lm3s6965(sh: &Shell) -> Result<Worst> {
    let image = LM3S6965.image(sh, "md3")?;
    let path = LM3S6965.images(sh).join("md3");
    let mut plugin = counted::plugin(sh)?.display().to_string();
    for (handler, _) in HANDLERS {
        plugin += &format!(",handler={handler}:{:#x}", image.symbol(handler)?);
    }
    let [bottom, top] = stack(&image)?;
    plugin += &format!(",stack={bottom:#x}:{top:#x}");
    let folder = sh.create_temp_dir()?;
    let log = folder.path().join("log");
    let mut qemu = start(&path, &plugin, &log)?;
    let asked = ask(&mut qemu);
    // The plugin speaks when QEMU ends in good order.
    let pid = qemu.id().to_string();
    cmd!(sh, "kill -TERM {pid}").quiet().run()?;
    qemu.wait()?;
    asked?;
    let log = sh.read_file(log)?;
    let mut interrupts = Vec::new();
    for (handler, purpose) in HANDLERS {
        let begin = format!("handler {handler} ");
        ensure!(number(&log, &begin, "calls")? > 0, "{handler} never came");
        interrupts.push((purpose, number(&log, &begin, "most")?));
    }
    Ok(Worst { interrupts, stack: number(&log, "stack ", "stack")? })
}

/// Starts the image. It ends after a minute, whatever becomes of this.
fn start(image: &Path, plugin: &str, log: &Path) -> Result<Child> {
    Command::new("timeout")
        // An instruction takes 16 ns of its time, so that no step is late because the host is.
        .args(["60", "qemu-system-arm", "-M", "lm3s6965evb", "-icount", "shift=4", "-display", "none"])
        .args([
            "-monitor",
            "none",
            "-serial",
            "stdio",
            "-serial",
            "file:/dev/stderr",
            "-plugin",
            plugin,
            "-d",
            "plugin",
            "-D",
        ])
        .arg(log)
        .arg("-kernel")
        .arg(image)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("qemu-system-arm does not start")
}

/// Waits until the drive has power, writes the registers, and asks until the move is over.
fn ask(qemu: &mut Child) -> Result<()> {
    let stderr = qemu.stderr.take().context("it is piped")?;
    let says = BufReader::new(stderr).lines().map_while(Result::ok).any(|line| line.contains("has power"));
    ensure!(says, "the board does not boot");
    let mut bus = (qemu.stdin.take().context("it is piped")?, qemu.stdout.take().context("it is piped")?);
    let mut exchange = |request: &[u8], reply: &mut [u8]| {
        bus.0.write_all(request)?;
        bus.0.flush()?;
        bus.1.read_exact(reply).context("the board does not answer")
    };
    for (register, value) in WRITES {
        exchange(&rtu::write(1, register, value), &mut [0; 8])?;
    }
    let mut reply = [0; 7];
    while reply.get(3..5) != Some(&[0, 0]) || reply[0] == 0 {
        exchange(&rtu::read(1, MOTION, 1), &mut reply)?;
    }
    Ok(())
}
