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


def test_lists_the_defaults_of_chapter_7(run):
    assert poll(run("--fast-boot"), 9_600, 0, 32) == DEFAULTS


def test_lists_the_settings_of_an_rs434(run):
    drivetwin = run("--fast-boot", kind="rs434546")
    # Address 1, RTU with even parity, 115,200 baud (6).
    assert poll(drivetwin, 115_200, SLAVE_ADDRESS_MODBUS, 0x27)[:3] == [1, 3, 9]
