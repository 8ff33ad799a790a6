"""mbpoll, with the command that the README names."""

import os
import pty
import re
import select
import subprocess

from conftest import PATIENCE
from md3 import DEFAULTS
from rs434 import SLAVE_ADDRESS_MODBUS


def poll(drivetwin, baud, first, count):
    """Holding registers that mbpoll lists."""
    # It counts them from 1.
    reference = first + 1
    command = f"mbpoll -m rtu -a 1 -b {baud} -P even -t 4:hex -r {reference} -c {count}".split()
    # It polls until it is ended, and buffers what it prints unless a terminal reads it.
    terminal, its_end = pty.openpty()
    mbpoll = subprocess.Popen([*command, drivetwin.pty], stdin=subprocess.DEVNULL, stdout=its_end, stderr=its_end)
    os.close(its_end)
    try:
        registers, printed = {}, ""
        while len(registers) < count:
            readable, _, _ = select.select([terminal], [], [], PATIENCE)
            assert readable, f"mbpoll is silent after: {printed}"
            try:
                printed += os.read(terminal, 4096).decode()
            except OSError:
                raise AssertionError(f"mbpoll gave up: {printed}") from None
            rows = re.findall(r"^\[(\d+)\]:\s+0x([0-9A-F]{4})\r?$", printed, re.MULTILINE)
            registers = {int(reference): int(value, 16) for reference, value in rows}
    finally:
        mbpoll.kill()
        mbpoll.wait(PATIENCE)
        os.close(terminal)
    return [registers[place] for place in range(reference, reference + count)]


TWO_DRIVES = """
bus = [{ name = "line", drives = ["a", "b"], listen = ["pty:"], strict = STRICT }]
drive = [{ name = "a", kind = "mdrobot", address = 1 }, { name = "b", kind = "mdrobot", address = 2 }]
"""


def both(run, tmp_path, strict):
    """Polls two drives of a line, the second one right after the reply of the first one, until such a request was
    proven to be too early. Returns the outputs of mbpoll, and the drives."""
    file = tmp_path / "line.toml"
    file.write_text(TWO_DRIVES.replace("STRICT", strict))
    drivetwin = run("--fast-boot", kind=file)
    printed = []
    while True:
        (bus,) = drivetwin.call("GET", "/api/bench")["buses"]
        if bus["early_requests"]:
            return printed, drivetwin
        drivetwin.notice()
        pty = next(uri.split(":", 1)[1] for uri in bus["listen"])
        command = f"mbpoll -m rtu -a 1,2 -b 19200 -P none -0 -t 4 -r 1 -1 {pty}".split()
        printed.append(subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE))
        assert len(printed) < 100


def test_leaves_no_silence_between_two_drives(run, tmp_path):
    printed, drivetwin = both(run, tmp_path, "false")
    assert all(mbpoll.stdout.count("[1]: \t81") == 2 for mbpoll in printed)
    assert "line: a drive may ignore this request on a real line: sent " in drivetwin.said()


def test_loses_a_request_on_a_strict_line(run, tmp_path):
    *printed, last = both(run, tmp_path, "true")[0]
    assert all(mbpoll.stdout.count("[1]: \t81") == 2 for mbpoll in printed)
    assert last.stdout.count("[1]: \t81") == 1 and "timed out" in last.stdout + last.stderr


def test_lists_the_defaults_of_chapter_7(run):
    assert poll(run("--fast-boot"), 9_600, 0, 32) == DEFAULTS


def test_lists_the_settings_of_an_rs434(run):
    drivetwin = run("--fast-boot", kind="rs434546")
    # Address 1, RTU with even parity, 115,200 baud (6).
    assert poll(drivetwin, 115_200, SLAVE_ADDRESS_MODBUS, 0x27)[:3] == [1, 3, 9]
