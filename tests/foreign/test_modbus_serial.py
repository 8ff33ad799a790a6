"""modbus-serial, of npm, speaks with an MDrive: `node/mdrive.mjs` says what it asks and expects."""

import pathlib
import subprocess

from conftest import PATIENCE

SCRIPT = pathlib.Path(__file__).parent / "node" / "mdrive.mjs"


def test_mdrive(run):
    drivetwin = run("--time", "real", "--fast-boot", kind="mdrive")
    host, port = drivetwin.ports["modbus"]
    done = subprocess.run(["node", SCRIPT, host, str(port)], capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
