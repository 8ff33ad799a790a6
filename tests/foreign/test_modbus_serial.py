"""modbus-serial, of npm, with an MDrive: `node/mdrive.mjs` has its requests and the expected answers."""

import pathlib
import subprocess

from conftest import PATIENCE

SCRIPT = pathlib.Path(__file__).parent / "node" / "mdrive.mjs"


def test_mdrive(run):
    drivetwin = run("--time", "real", "--fast-boot", kind="mdrive")
    host, port = drivetwin.ports["modbus"]
    done = subprocess.run(["node", SCRIPT, host, str(port)], capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
