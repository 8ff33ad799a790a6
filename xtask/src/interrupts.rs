//! The longest interrupts of the lm3s6965's image, and its deepest stack: counted while it is asked and
//! moves at 40,000 steps/s.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result, ensure};
use standin_protocol::modbus::rtu;
use xshell::{Shell, cmd};

use crate::board::{BOARDS, PROFILE};
use crate::checks::target_dir;
use crate::counted;

/// Interrupts of the board, and what they are for. The step timer's is not among them: QEMU brings it late,
/// and then one call makes several steps.
const HANDLERS: [(&str, &str); 2] = [("UART0", "bus's interrupt"), ("SysTick", "clock's interrupt")];

/// What is written to an MD3: 40,000 steps/s (7.18), 500,000 steps/s² (7.19), 4,000 steps (7.16), a move
/// (7.15).
const WRITES: [(u16, u16); 7] =
    [(0x14, 0), (0x15, 40_000), (0x18, 7), (0x19, 41_248), (0x12, 0), (0x13, 4_000), (0x11, 1)];
const MOTION: u16 = 0x11;

/// What was counted: each interrupt's purpose with its most instructions, and bytes of the stack.
pub(crate) struct Worst {
    pub(crate) interrupts: Vec<(&'static str, u64)>,
    pub(crate) stack: u64,
}

/// Runs an MD3 on the lm3s6965 under QEMU.
pub(crate) fn worst(sh: &Shell) -> Result<Worst> {
    let [board, _] = &BOARDS;
    let image = board.image(sh, "md3")?;
    let path = target_dir(sh).join(board.target).join(PROFILE).join("md3");
    let mut plugin = counted::plugin(sh)?.display().to_string();
    for (handler, _) in HANDLERS {
        plugin += &format!(",handler={handler}:{:#x}", image.symbol(handler)?);
    }
    let [bottom, top] = [image.symbol("_stack_end")?, image.symbol("_stack_start")?];
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
    let number = |begin: &str, word: &str| {
        let line = log.lines().find(|line| line.starts_with(begin));
        let number = line.and_then(|line| line.split(' ').skip_while(|part| *part != word).nth(1));
        number.and_then(|number| number.parse().ok()).with_context(|| format!("nothing counted: {begin}"))
    };
    let mut interrupts = Vec::new();
    for (handler, purpose) in HANDLERS {
        let begin = format!("handler {handler} ");
        ensure!(number(&begin, "calls")? > 0, "{handler} never came");
        interrupts.push((purpose, number(&begin, "most")?));
    }
    Ok(Worst { interrupts, stack: number("stack ", "stack")? })
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
