//! The longest interrupts of images, and their deepest stacks, counted in emulation. Meanwhile the drive
//! answers requests, saves, moves, and receives edges.

use std::io::{BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use drivetwin_firmware::device::Spec;
use drivetwin_protocol::modbus::{Expect, Scan, rtu};
use xshell::{Shell, cmd};

use crate::board::{LM3S6965, RP2040, spec};
use crate::counted::Counting;
use crate::image::Image;
use crate::qemu;

/// Longest wait for an answer before the request is repeated.
const PATIENCE: Duration = Duration::from_secs(1);

const BUS: &str = "bus's interrupt";
const NETWORK: &str = "network's interrupt";
const CLOCK: &str = "clock's interrupt";
const STEPS: &str = "step's interrupt, with the wait for its pulse";
const PINS: &str = "pins' interrupt";

/// Interrupts of the lm3s6965 and their purposes: for a drive with a serial port, and for a drive on a
/// network. The step timer's interrupt is not measured, because QEMU calls it late, and then one call makes
/// several steps.
const HANDLERS: [(&str, &str); 2] = [("UART0", BUS), ("SysTick", CLOCK)];
const ON_NETWORK: [(&str, &str); 2] = [("ETHERNET", NETWORK), ("SysTick", CLOCK)];

/// Exceptions of the rp2040 and their purposes. The number is 16 plus that of the interrupt (RP2040
/// Datasheet, 2.3.2).
const EXCEPTIONS: [(u32, &str); 3] = [(16, STEPS), (16 + 13, PINS), (16 + 20, BUS)];

/// Work of a drive while it is measured.
pub(crate) struct Work {
    /// The kind of drive.
    pub(crate) kind: &'static str,
    /// Commands to the drive; the last one starts a move.
    orders: fn() -> Vec<Vec<u8>>,
    /// Request that is repeated until the move has ended.
    question: fn() -> Vec<u8>,
    /// Removes a complete answer from the received bytes and returns it; `None` if the answer is incomplete.
    answer: fn(&mut Vec<u8>) -> Option<Vec<u8>>,
    /// Returns whether an answer shows that the move has ended.
    is_over: fn(&[u8]) -> bool,
    /// True if the move makes step pulses.
    steps: bool,
    /// Changes of pins of the Pico during the move.
    edges: &'static [(u8, &'static str)],
}

/// MotionControl of an MD3 (7.15).
const MD3_MOTION: u16 = 0x11;

/// Takes a complete Modbus frame from the received bytes.
fn frame(heard: &mut Vec<u8>) -> Option<Vec<u8>> {
    let whole = rtu::scan(heard, Expect::Replies) == Scan::Complete(heard.len());
    whole.then(|| std::mem::take(heard))
}

/// Request that writes a line of an RS 434544's program to the buffer: function 16 on WRITE_CMD and CMD_W
/// (6.6).
fn line(place: u16, command: u16, data: u16) -> Vec<u8> {
    let mut pdu = vec![16, 0x60, 0, 0, 3, 6];
    pdu.extend([place, command, data].iter().flat_map(|word| word.to_be_bytes()));
    rtu::frame(1, &pdu).to_vec()
}

/// Work of an MD3, of the QSB with the most functions, of an RS 434544, of an MDROBOT, and of an MDrive.
pub(crate) const WORKS: [Work; 5] = [
    Work {
        kind: "md3",
        // 40,000 steps/s (7.17), 500,000 steps/s² (7.19), 4,000 steps (7.16), a save (7.20), a move (7.15).
        orders: || {
            let writes = [
                (0x14, 0),
                (0x15, 40_000),
                (0x18, 7),
                (0x19, 41_248),
                (0x12, 0),
                (0x13, 4_000),
                (0x1a, 1),
                (MD3_MOTION, 1),
            ];
            writes.map(|(register, value)| rtu::write(1, register, value).to_vec()).to_vec()
        },
        question: || rtu::read(1, MD3_MOTION, 1).to_vec(),
        answer: frame,
        is_over: |answer| answer.get(3..5) == Some(&[0, 0]),
        steps: true,
        // Pins J2.4 and J2.5.
        edges: &[(7, "low"), (8, "low"), (7, "high"), (8, "high")],
    },
    Work {
        kind: "qsb-m",
        // A save; a stream at the highest rate; the motor drive with 13,000 steps/s, 360,000 steps/s² and
        // 4,000 steps.
        orders: || {
            let lines =
                ["W163\r", "W0C0\r", "S0E\r", "W162\r", "W0F32C8\r", "W1057E40\r", "W11FA0\r", "W168\r"];
            lines.map(|line| line.as_bytes().to_vec()).to_vec()
        },
        question: || b"R13\r".to_vec(),
        answer: |heard| {
            let end = heard.iter().position(|byte| *byte == b'\n')? + 1;
            let line: Vec<u8> = heard.drain(..end).collect();
            // Records of the stream may arrive before the answer, and are skipped.
            (line.first() != Some(&b's')).then_some(line)
        },
        // MD STATUS: enabled and ready.
        is_over: |answer| answer.starts_with(b"r 13 00000011"),
        steps: true,
        // Pins A, B and I.
        edges: &[(5, "low"), (6, "low"), (7, "high"), (5, "high"), (6, "high"), (7, "low")],
    },
    Work {
        kind: "rs434544",
        // START (2000h), 500 ms, STOP (2001h), 100 ms, END. The settings and the program are saved; the
        // program starts (6.5).
        orders: || {
            let mut orders = vec![
                line(0, 0x100E, 0x2000),
                line(1, 1, 0),
                line(2, 0x04, 500),
                line(3, 0x100E, 0x2001),
                line(4, 1, 0),
                line(5, 0x04, 100),
                line(6, 0, 0),
            ];
            let keys = [(0x5024, 0x37FA), (0x5025, 0x8426), (0x5005, 2)];
            orders.extend(keys.map(|(register, value)| rtu::write(1, register, value).to_vec()));
            orders
        },
        // Reads STATUS_USER_PROGRAM.
        question: || rtu::frame(1, &[4, 0x30, 0x09, 0, 1]).to_vec(),
        answer: frame,
        is_over: |answer| answer.get(3..5) == Some(&[0, 5]),
        steps: false,
        // Pins IN1 and IN2.
        edges: &[(5, "low"), (6, "low"), (5, "high"), (6, "high")],
    },
    Work {
        kind: "mdrobot",
        // SLOW_START of 15 s, which is saved (p. 13); UI_COM, START_STOP and VEL_CMD (p. 7, 12) make the
        // motor turn.
        orders: || {
            let writes = [(153, 1_023), (78, 1), (100, 1), (130, 500)];
            writes.map(|(pid, value)| rtu::write(1, pid, value).to_vec()).to_vec()
        },
        // Reads RPM_DATA, until the motor has half of its speed.
        question: || rtu::read(1, 138, 1).to_vec(),
        answer: frame,
        is_over: |answer| answer.get(3) == Some(&1),
        steps: false,
        // Pins INT_SPEED and ENC_A.
        edges: &[(5, "low"), (10, "low"), (5, "high"), (10, "high")],
    },
    Work {
        kind: "mdrive",
        // A program and its listing; a save; a move of one turn (MC 5-55, 5-43, 5-62, 5-48).
        orders: || {
            let lines = [
                "PG 1\r",
                "LB AA\r",
                "PR \"A\",P\r",
                "H 10\r",
                "BR AA\r",
                "E\r",
                "PG\r",
                "L\r",
                "S\r",
                "EX AA\r",
            ];
            let lines = lines.into_iter().chain(["MR 51200\r"]);
            lines.map(|line| line.as_bytes().to_vec()).collect()
        },
        question: || b"PR MV\r".to_vec(),
        // An answer ends with a prompt. It may contain what the running program prints.
        answer: |heard| {
            let end = heard.iter().position(|byte| b">?".contains(byte))? + 1;
            Some(heard.drain(..end).collect())
        },
        is_over: |answer| answer.windows(5).any(|line| line == b"\r\n0\r\n"),
        steps: false,
        // The Pico has no image of this drive.
        edges: &[],
    },
];

/// Results: the purpose of each interrupt with its highest number of instructions, and the bytes of the
/// stack.
pub(crate) struct Worst {
    pub(crate) interrupts: Vec<(&'static str, u64)>,
    pub(crate) stack: u64,
}

/// Measures the work on the first two of [`BOARDS`](crate::board::BOARDS), which are emulated. A board
/// without an image of the kind is left out. The images must be built.
pub(crate) fn worst(sh: &Shell, counting: &Counting<'_>, work: &Work) -> Result<Vec<Worst>> {
    let mut worst = vec![lm3s6965(sh, counting, work)?];
    if RP2040.carries(work.kind) {
        worst.push(rp2040(sh, work)?);
    }
    Ok(worst)
}

/// Lowest address of the stack, and the address after its highest one.
fn stack(image: &Image) -> Result<[u64; 2]> {
    Ok([image.symbol("_stack_end")?, image.symbol("_stack_start")?])
}

/// The number after `word` in the line of `log` that starts with `begin`.
fn number(log: &str, begin: &str, word: &str) -> Result<u64> {
    let line = log.lines().find(|line| line.starts_with(begin));
    let number = line.and_then(|line| line.split(' ').skip_while(|part| *part != word).nth(1));
    number.and_then(|number| number.parse().ok()).with_context(|| format!("nothing counted: {begin}"))
}

/// Measures on the emulated Pico, in exact virtual time.
fn rp2040(sh: &Shell, work: &Work) -> Result<Worst> {
    let image = RP2040.image(sh, work.kind)?;
    let path = RP2040.images(sh).join(work.kind);
    let [low, high] = stack(&image)?.map(|address| address.to_string());
    // Pin 22, FAST, is low. An order is sent every 100 ms. Pins change during the move.
    let mut script = "0 pin 22 low\n".to_owned();
    let mut at = 100_000;
    for order in (work.orders)() {
        let order: String = order.iter().map(|byte| format!(" {byte:02x}")).collect();
        script += &format!("{at} rx{order}\n");
        at += 100_000;
    }
    for (pin, level) in work.edges {
        script += &format!("{at} pin {pin} {level}\n");
        at += 100;
    }
    script += &format!("{} end\n", at + 500_000);
    let play = cmd!(sh, "node tests/pico/play.mjs {path} --stack {low} {high}");
    let log = play.quiet().stdin(script).read()?;
    let mut interrupts = Vec::new();
    for (exception, purpose) in EXCEPTIONS.into_iter().filter(|(_, purpose)| work.steps || *purpose != STEPS)
    {
        interrupts.push((purpose, number(&log, &format!("stat exception {exception} "), "worst")?));
    }
    Ok(Worst { interrupts, stack: number(&log, "stat stack ", "stack")? })
}

/// Measures on the LM3S6965 under QEMU.
fn lm3s6965(sh: &Shell, counting: &Counting<'_>, work: &Work) -> Result<Worst> {
    let image = LM3S6965.image(sh, work.kind)?;
    let path = LM3S6965.images(sh).join(work.kind);
    let on_network = spec(work.kind).is_some_and(Spec::is_on_network);
    let handlers = if on_network { ON_NETWORK } else { HANDLERS };
    let mut plugin = counting.plugin.clone();
    for (handler, _) in handlers {
        plugin += &format!(",handler={handler}:{:#x}", image.symbol(handler)?);
    }
    let [bottom, top] = stack(&image)?;
    plugin += &format!(",stack={bottom:#x}:{top:#x}");
    let folder = sh.create_temp_dir()?;
    let log = folder.path().join("log");
    let ports = if on_network { qemu::on_network() } else { on_line() };
    let mut qemu = start(&path, &plugin, &log, &ports)?;
    let asked = connect(&mut qemu, on_network).and_then(|line| ask(line, work));
    // The plugin prints its results only when QEMU ends normally.
    let pid = qemu.id().to_string();
    cmd!(sh, "kill -TERM {pid}").quiet().run()?;
    qemu.wait()?;
    asked?;
    let log = sh.read_file(log)?;
    let mut interrupts = Vec::new();
    for (handler, purpose) in handlers {
        let begin = format!("handler {handler} ");
        ensure!(number(&log, &begin, "calls")? > 0, "{handler} never came");
        interrupts.push((purpose, number(&log, &begin, "most")?));
    }
    Ok(Worst { interrupts, stack: number(&log, "stack ", "stack")? })
}

/// Options of QEMU that make its standard input and output the serial port of the drive.
fn on_line() -> Vec<String> {
    ["-monitor", "none", "-serial", "stdio", "-serial", "file:/dev/stderr"].map(str::to_owned).to_vec()
}

/// Starts the image with the options `ports`. QEMU ends after a minute, even if this process has ended.
fn start(image: &Path, plugin: &str, log: &Path, ports: &[String]) -> Result<Child> {
    Command::new("timeout")
        // An instruction takes 16 ns of virtual time, so that a slow host makes no step late.
        .args(["60", "qemu-system-arm", "-M", "lm3s6965evb", "-icount", "shift=4", "-display", "none"])
        .args(ports)
        .args(["-plugin", plugin, "-d", "plugin", "-D"])
        .arg(log)
        .arg("-kernel")
        .arg(image)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("qemu-system-arm does not start")
}

/// The two directions of a connection to a drive.
type Line = (Box<dyn Write>, Box<dyn Read + Send>);

/// Connects to the drive when it has power.
fn connect(qemu: &mut Child, on_network: bool) -> Result<Line> {
    let stderr = qemu.stderr.take().context("it is piped")?;
    qemu::wait_for_power(&mut BufReader::new(stderr))?;
    if on_network {
        let [_, mcode] = qemu::ports(qemu)?;
        let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, mcode))?;
        return Ok((Box::new(stream.try_clone()?), Box::new(stream)));
    }
    let stdin = qemu.stdin.take().context("it is piped")?;
    let stdout = qemu.stdout.take().context("it is piped")?;
    Ok((Box::new(stdin), Box::new(stdout)))
}

/// Sends the commands, and then repeats the request until the move has ended.
fn ask((mut tells, says): Line, work: &Work) -> Result<()> {
    let (said, hears) = mpsc::channel();
    // This thread ends with QEMU.
    thread::spawn(move || {
        BufReader::new(says).bytes().map_while(Result::ok).try_for_each(|byte| said.send(byte))
    });
    let mut heard = Vec::new();
    let mut exchange = |request: &[u8]| loop {
        tells.write_all(request)?;
        tells.flush()?;
        loop {
            if let Some(answer) = (work.answer)(&mut heard) {
                return anyhow::Ok(answer);
            }
            match hears.recv_timeout(PATIENCE) {
                Ok(byte) => heard.push(byte),
                // The request is repeated, because a pause of the host within a request makes it invalid.
                Err(RecvTimeoutError::Timeout) => break,
                Err(RecvTimeoutError::Disconnected) => bail!("the board does not answer"),
            }
        }
        heard.clear();
    };
    for order in (work.orders)() {
        exchange(&order)?;
    }
    while !(work.is_over)(&exchange(&(work.question)())?) {}
    Ok(())
}
