"""The QSB from a terminal and from programs: pyserial on the pty, a plain socket over TCP.

Commands and replies are those of the QSB Command List 1.28 and the QSB Application Examples 1.5. In manual
time the clock goes to the end of the reply of what is sent, so each reply is there when it is looked for.
"""

import contextlib
import os
import pty
import re
import select
import subprocess
import sys
import time
import urllib.request

import pytest
from serial import Serial

from conftest import PATIENCE, receive


class Terminal(Serial):
    """A program on the pty; each reply is a line."""

    def __init__(self, drivetwin, baudrate=230_400):
        self.drivetwin = drivetwin
        drivetwin.notice()
        super().__init__(drivetwin.pty, baudrate=baudrate, timeout=PATIENCE)

    def line(self):
        """The next line of the device."""
        line = self.read_until(b"!\r\n")
        assert line.endswith(b"!\r\n"), f"only {line!r} came"
        return line[:-2].decode()

    def silent(self):
        """Whether nothing more has come by now."""
        self.drivetwin.notice()
        return self.in_waiting == 0

    def ask(self, command):
        """The reply to a command."""
        self.write(command.encode() + b"\r")
        return self.line()


@pytest.fixture
def opened(run):
    """A QSB in manual time whose banner has been read, and a terminal on its pty."""
    with contextlib.ExitStack() as terminals:

        def start(*options, kind="qsb-m"):
            drivetwin = run("--time", "manual", *options, kind=kind)
            terminal = terminals.enter_context(Terminal(drivetwin))
            drivetwin.advance(0.06)
            assert terminal.line() == f"QSB-{kind[-1].upper()}  0E!"
            return drivetwin, terminal

        yield start


def reply(letter, register, data):
    """A reply with the factory's EOR, 0B: spaces, CR, LF."""
    return f"{letter} {register:02X} {data:08X} !"


# The commands of the application examples in their order, section by section, and what each returns. What a
# section sets is the next one's beginning.
EXAMPLES = [
    ("1.1", "W0000", reply("w", 0x00, 0)),
    ("1.2", "W04000", reply("w", 0x04, 0)),
    ("1.2", "W04100", reply("w", 0x04, 0x100)),
    ("1.3", "W0363", reply("w", 0x03, 0x63)),
    ("1.4", "W034F", reply("w", 0x03, 0x4F)),
    ("1.5", "W081F3", reply("w", 0x08, 499)),
    ("1.6", "R0E", reply("r", 0x0E, 0)),
    ("2.1", "W0002", reply("w", 0x00, 2)),
    ("3.1", "W0001", reply("w", 0x00, 1)),
    ("3.2", "R0E", reply("r", 0x0E, 0)),
    ("3.3", "R00", reply("r", 0x00, 1)),
    ("1.1", "W0000", reply("w", 0x00, 0)),
    ("4.1", "S0E", reply("s", 0x0E, 0)),
    ("1.6", "R0E", reply("r", 0x0E, 0)),
    ("4.2", "W0B0001", reply("w", 0x0B, 1)),
    ("4.3", "W0C0005", reply("w", 0x0C, 5)),
    ("5.1", "W02011", reply("w", 0x02, 0x11)),
    ("5.2", "W04010", reply("w", 0x04, 0x10)),
    ("5.3", "R05", reply("r", 0x05, 0)),
    ("6.1", "W02000", reply("w", 0x02, 0)),
    ("6.3", "R01", reply("r", 0x01, 0xF)),
    ("6.2", "W02F00", reply("w", 0x02, 0xF00)),
    ("6.4", "W01A", reply("w", 0x01, 0xA)),
    ("6.3", "R01", reply("r", 0x01, 0xA)),
    ("6.5", "S01", reply("s", 0x01, 0xA)),
    ("8.1", "W0F3E8", reply("w", 0x0F, 1000)),
    ("8.2", "W10186A0", reply("w", 0x10, 100_000)),
    ("8.3", "W117D0", reply("w", 0x11, 2000)),
    ("8.4", "W123E8", reply("w", 0x12, 1000)),
    ("6.3", "R01", reply("r", 0x01, 0xA)),
    ("7.1", "W162", reply("w", 0x16, 2)),
    ("7.2", "W169", reply("w", 0x16, 9)),
    ("7.4", "W160", reply("w", 0x16, 0)),
    ("7.1", "W162", reply("w", 0x16, 2)),
    ("7.3", "W168", reply("w", 0x16, 8)),
    ("7.4", "W160", reply("w", 0x16, 0)),
    ("9", "W163", reply("w", 0x16, 3)),
    ("10.1", "W1660A", reply("w", 0x16, 0x60A)),
    ("11.1", "W04010", reply("w", 0x04, 0x10)),
    ("11.1", "W0800000064", reply("w", 0x08, 100)),
    ("11.1", "W0A0", reply("w", 0x0A, 0)),
    ("11.1", "W08000001F3", reply("w", 0x08, 499)),
    ("11.1", "W04110", reply("w", 0x04, 0x110)),
    ("1.6", "R0E", reply("r", 0x0E, 100)),
]


def test_every_example(opened):
    _, terminal = opened()
    for section, command, expected in EXAMPLES:
        assert (section, command, terminal.ask(command)) == (section, command, expected)
    # 9.1: the time stamp is the one field that time decides.
    assert re.fullmatch(r"w 15 0000000F [0-9A-F]{8} !", terminal.ask("W15F"))


def test_a_session_at_a_terminal(opened):
    """A command grows character by character, and the clock with it."""
    drivetwin, terminal = opened()
    began = drivetwin.seconds()
    for key in b"R08":
        terminal.write(bytes([key]))
    assert terminal.silent(), "nothing is answered before the command ends"
    terminal.write(b"\r")
    assert terminal.line() == reply("r", 0x08, 499)
    assert 5 * 10 / 230_400 <= drivetwin.seconds() - began < 1
    # Any of CR and LF, or both; both are one end.
    for end in (b"\n", b"\r\n", b"\n\r", b"\r"):
        terminal.write(b"R08" + end)
        assert terminal.line() == reply("r", 0x08, 499)
    # A backspace erases what there is of a command.
    terminal.write(b"W08999\bR08\r")
    assert terminal.line() == reply("r", 0x08, 499)
    assert terminal.ask("Q08") == reply("x", 0x08, 0)
    assert terminal.ask("hello") == reply("x", 0x00, 0)
    assert terminal.ask("W1510") == reply("e", 0x15, 0x10)
    assert terminal.ask("R08") == reply("r", 0x08, 499)
    assert terminal.silent()


def test_many_commands_in_one_write(opened):
    _, terminal = opened()
    values = range(0, 50_000, 500)
    terminal.write(b"".join(b"W08%X\rR08\r" % value for value in values))
    for value in values:
        assert terminal.line() == reply("w", 0x08, value)
        assert terminal.line() == reply("r", 0x08, value)


@pytest.mark.parametrize("options", [(), ("--time", "x10"), ("--line", "fast"), ("--time", "manual")])
def test_a_flood_loses_nothing(run, options):
    """More than the line takes in a second, from one client; another one receives the same."""
    drivetwin = run("--fast-boot", *options, kind="qsb-m")
    count = 3_000
    expected = b"".join(b"w 08 %08X !\r\n" % n for n in range(count))
    with drivetwin.socket() as flooding, drivetwin.socket() as other:
        drivetwin.notice()
        writer = subprocess.Popen(
            [sys.executable, "-c", f"import sys\nfor n in range({count}): sys.stdout.write(f'W08{{n:X}}\\r')"],
            stdout=flooding,
        )
        got = {flooding: b"", other: b""}
        for client in got:
            client.settimeout(PATIENCE)
        while any(len(said) < len(expected) for said in got.values()):
            for client, said in got.items():
                if len(said) < len(expected):
                    got[client] += client.recv(4096)
        assert writer.wait(PATIENCE) == 0
        assert got[flooding] == expected
        assert got[other] == expected


def test_opening_the_pty_resets_and_nothing_else_does(run):
    drivetwin = run("--time", "manual", kind="qsb-m")
    drivetwin.advance(0.06)
    with drivetwin.socket() as client:
        written = reply("w", 0x08, 0x123).encode() + b"\r\n"
        client.sendall(b"W08123\r")
        assert receive(client, len(written)) == written
    with Terminal(drivetwin) as first:
        # The banner begins 50 ms after the opening.
        drivetwin.advance(0.049)
        assert first.silent()
        drivetwin.advance(0.005)
        assert first.line() == "QSB-M  0E!"
        assert first.ask("R08") == reply("r", 0x08, 499)
        assert first.ask("W0877") == reply("w", 0x08, 0x77)
        # Another program opens it, and another one connects by TCP: DTR is high already.
        with Terminal(drivetwin) as second, drivetwin.socket():
            drivetwin.advance(0.1)
            second.write(b"R08\r")
            assert first.line() == reply("r", 0x08, 0x77)
        assert first.ask("R08") == reply("r", 0x08, 0x77)
    with Terminal(drivetwin) as again:
        drivetwin.advance(0.06)
        assert again.line() == "QSB-M  0E!"
        assert again.ask("R08") == reply("r", 0x08, 499)


def stamped(line, letter):
    """The time stamp of a line with EOR 0F."""
    found = re.fullmatch(letter + r" [0-9A-F]{2} [0-9A-F]{8} ([0-9A-F]{8}) !", line)
    assert found, line
    return int(found[1], 16)


def stream(terminal):
    """Begins a stream of 512 records a second with time stamps."""
    assert terminal.ask("W15F").endswith("!")
    assert terminal.ask("W0C1").startswith("w 0C 00000001 ")
    return stamped(terminal.ask("S0E"), "s")


def test_a_second_of_a_stream(opened):
    drivetwin, terminal = opened()
    first = stream(terminal)
    drivetwin.advance(1.0)
    stamps = [stamped(terminal.line(), "s") for _ in range(511)]
    assert stamps == list(range(first + 1, first + 512))
    # A read ends it.
    terminal.write(b"R0E\r")
    while (line := terminal.line())[0] == "s":
        pass
    stamped(line, "r")
    drivetwin.advance(0.1)
    assert terminal.silent()


def test_a_second_of_a_stream_in_real_time(run):
    drivetwin = run(kind="qsb-d")
    with Terminal(drivetwin) as terminal:
        assert terminal.line() == "QSB-D  0E!"
        began = drivetwin.seconds()
        first = stream(terminal)
        stamps = [stamped(terminal.line(), "s") for _ in range(512)]
        assert stamps == list(range(first + 1, first + 513))
        # The first interval began with a tick, at most one of them before the stream.
        assert drivetwin.seconds() - began >= 511 / 512


def test_noise_and_half_lines_in_a_stream(opened):
    """Every octet once: 09 LF, 0B 0C CR and the rest, too long, are three lines that are not understood."""
    drivetwin, terminal = opened()
    first = stream(terminal)
    terminal.write(bytes(range(256)) + b"\rW0C")
    drivetwin.advance(0.5)
    terminal.write(b"\bR08\r")
    drivetwin.advance(0.5)
    lines = []
    while len([line for line in lines if line[0] == "s"]) < 511:
        lines.append(terminal.line())
    stamps = [stamped(line, "s") for line in lines if line[0] == "s"]
    assert stamps == list(range(first + 1, first + 512))
    others = [line[:13] for line in lines if line[0] != "s"]
    assert others == ["x 00 00000000"] * 3 + ["r 08 000001F3"]


def test_it_streams_what_the_encoder_does(opened):
    drivetwin, terminal = opened()
    assert terminal.ask("W0C5") == reply("w", 0x0C, 5)
    assert terminal.ask("W0B1") == reply("w", 0x0B, 1)
    assert terminal.ask("S0E") == reply("s", 0x0E, 0)
    drivetwin.advance(0.5)
    assert terminal.silent(), "it stands, and the threshold is 1"
    drivetwin.call("POST", "/api/drives/qsb-m/encoder", {"counts": 400, "hz": 400})
    drivetwin.advance(1.1)
    counts = []
    while not counts or counts[-1] != 400:
        line = terminal.line()
        assert line.startswith("s 0E ")
        counts.append(int(line[5:13], 16))
    # About four edges in five ticks of 1/512 s, each record further on than the one before.
    assert counts == sorted(set(counts)) and 95 <= len(counts) <= 105
    drivetwin.call("POST", "/api/drives/qsb-m/encoder", {"counts": -401, "hz": 100_000})
    drivetwin.advance(0.1)
    # The factory's MDR0 counts modulo DTR + 1, which is 500.
    while (line := terminal.line()) != reply("s", 0x0E, 499):
        assert line.startswith("s 0E ")


def test_analogue_and_digital_at_one_contact(opened):
    """Bits 9:0 of the packet: the voltage, of which 5 V would be 1024. The first digits are its time."""
    drivetwin, terminal = opened(kind="qsb-s")
    pin = "/api/drives/qsb-s/pins/A"
    drivetwin.call("PUT", pin, {"level": "low"})
    # With B high a falling A is a step forward.
    assert terminal.ask("R0E") == reply("r", 0x0E, 1)
    assert terminal.ask("W0002") == reply("w", 0x00, 2)
    for volts, value in ((2.5, 512), (5, 1023), (7, 1023), (0, 0), (1.22, 249)):
        drivetwin.call("PUT", pin, {"volts": volts})
        assert int(terminal.ask("R0E")[5:13], 16) & 0xFFF == value


def spoil(drivetwin, terminal, text):
    """Writes at the wrong rate, and waits until the drive has received it: the system passes it on some time later,
    and the rate of a pty is that of then."""

    def spoiled():
        with urllib.request.urlopen(drivetwin.control + "/api/trace", timeout=PATIENCE) as trace:
            return trace.read().count(b" > spoiled")

    end = time.monotonic() + PATIENCE
    terminal.write(text)
    while spoiled() < len(text):
        assert time.monotonic() < end, f"{text} is not heard"


def test_another_rate_is_kept_and_needed(opened, run, tmp_path):
    nv = tmp_path / "qsb.nv"
    drivetwin, terminal = opened("--nv", nv)
    # Answered at the old rate.
    assert terminal.ask("W1640A") == reply("w", 0x16, 0x40A)
    spoil(drivetwin, terminal, b"R08\r")
    drivetwin.advance(0.1)
    assert terminal.silent(), "nobody reads 230,400 baud any more"
    terminal.baudrate = 115_200
    # What the drive could not read spoils the line it was in.
    assert terminal.ask("") == reply("x", 0x00, 0)
    assert terminal.ask("R08") == reply("r", 0x08, 499)
    terminal.close()
    with Terminal(drivetwin, baudrate=115_200) as terminal:
        drivetwin.advance(0.06)
        assert terminal.line() == "QSB-M  0E!"
        assert terminal.ask("R08") == reply("r", 0x08, 499)
    drivetwin.kill()
    drivetwin = run("--time", "manual", "--fast-boot", "--nv", nv, kind="qsb-m")
    assert drivetwin.call("GET", "/api/bench")["buses"][0]["line"] == "115200 8N1"


def test_what_is_saved_is_there_after_a_restart(opened, tmp_path):
    nv = tmp_path / "qsb.nv"
    drivetwin, terminal = opened("--nv", nv)
    assert terminal.ask("W0877") == reply("w", 0x08, 0x77)
    assert terminal.ask("W163") == reply("w", 0x16, 3)
    drivetwin.advance(0.1)
    assert terminal.ask("W0C5") == reply("w", 0x0C, 5)
    drivetwin.kill()
    drivetwin, terminal = opened("--nv", nv)
    assert terminal.ask("R08") == reply("r", 0x08, 0x77)
    assert terminal.ask("R0C") == reply("r", 0x0C, 0xFFFF)
    # It wakes up streaming, when it was saved so.
    assert terminal.ask("W0C200") == reply("w", 0x0C, 0x200)
    assert terminal.ask("S0E") == reply("s", 0x0E, 0)
    assert terminal.ask("W163") == reply("w", 0x16, 3)
    drivetwin.advance(0.1)
    drivetwin.kill()
    drivetwin, terminal = opened("--nv", nv)
    drivetwin.advance(1.1)
    assert terminal.line() == reply("s", 0x0E, 0)


def test_a_terminal_program(run):
    """miniterm, as `drivetwin run` proposes it, with input at its keyboard."""
    drivetwin = run(kind="qsb-d")
    keyboard, its_end = pty.openpty()
    command = [sys.executable, "-m", "serial.tools.miniterm", drivetwin.pty, "230400"]
    terminal = subprocess.Popen(command, stdin=its_end, stdout=its_end, stderr=its_end)
    os.close(its_end)
    shown = ""

    def read_until(text):
        nonlocal shown
        while text not in shown:
            readable, _, _ = select.select([keyboard], [], [], PATIENCE)
            assert readable, f"{text} never came after: {shown}"
            shown += os.read(keyboard, 4096).decode()
        shown = shown.split(text, 1)[1]

    try:
        read_until("QSB-D  0E!")
        os.write(keyboard, b"R14\r")
        read_until("r 14 0000100E !")
        os.write(keyboard, b"W08999\bR08\r")
        read_until("r 08 000001F3 !")
        os.write(keyboard, b"\x1d")
        assert terminal.wait(PATIENCE) == 0
    finally:
        terminal.kill()
        terminal.wait(PATIENCE)
        os.close(keyboard)
