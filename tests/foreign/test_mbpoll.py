"""mbpoll, with the command that the README names."""

import os
import pty
import re
import select
import subprocess

from conftest import PATIENCE
from md3 import DEFAULTS


def test_lists_the_defaults_of_chapter_7(run):
    standin = run("--fast-boot")
    command = "mbpoll -m rtu -a 1 -b 9600 -P even -t 4:hex -r 1 -c 32".split()
    # It polls until it is ended, and buffers what it prints unless a terminal reads it.
    terminal, its_end = pty.openpty()
    mbpoll = subprocess.Popen([*command, standin.pty], stdin=subprocess.DEVNULL, stdout=its_end, stderr=its_end)
    os.close(its_end)
    try:
        registers, printed = {}, ""
        while len(registers) < 32:
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
    assert [registers[reference] for reference in range(1, 33)] == DEFAULTS
