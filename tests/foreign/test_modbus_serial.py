"""modbus-serial, of npm, with an MDrive: `node/mdrive.mjs` has its requests and the expected answers, `node/faults.mjs`
reads a register twice."""

import pathlib
import subprocess

import pytest

from conftest import PATIENCE
from mdrive import MT

NODE = pathlib.Path(__file__).parent / "node"


def test_mdrive(run):
    drivetwin = run("--time", "real", "--fast-boot", kind="mdrive")
    host, port = drivetwin.ports["modbus"]
    done = subprocess.run(["node", NODE / "mdrive.mjs", host, str(port)], capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("faults", "expected"),
    [
        ({"exception": {"code": 6, "count": 1}}, "exception 6"),
        ({"drop": {"count": 1, "direction": "request"}}, "ETIMEDOUT"),
        ({"mute": {"count": 1}}, "ETIMEDOUT"),
        ({"wrong_transaction": {"count": 1}}, "ETIMEDOUT"),
    ],
)
def test_a_fault_of_the_first_request(run, faults, expected):
    drivetwin = run("--time", "manual", "--fast-boot", kind="mdrive")
    drivetwin.advance(1)
    drivetwin.call("PUT", "/api/buses/modbus/faults", faults)
    host, port = drivetwin.ports["modbus"]
    done = subprocess.run(
        ["node", NODE / "faults.mjs", host, str(port), str(MT)], capture_output=True, text=True, timeout=PATIENCE
    )
    assert (done.stdout, done.stderr) == (f"{expected}\n0\n", "")
