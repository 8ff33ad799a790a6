"""A drive for your tests: `drivetwin` in a process of its own, with a clock that the test advances."""

import json
import os
import subprocess
import urllib.request

import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusTcpClient


class Drive:
    """A drive whose time stands still until a request or `advance` moves the clock."""

    def __init__(self, kind, *options):
        self.name = kind
        program = os.environ.get("DRIVETWIN", "drivetwin")
        places = ["--listen", "tcp:127.0.0.1:0", "--time", "manual", "--json"]
        command = [program, "run", kind, "--fast-boot", *places, *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        if not line:
            _, said = self.process.communicate()
            pytest.fail(said.strip(), pytrace=False)
        ready = json.loads(line)
        self.control = ready["control"]
        ((self.uri,),) = ready["devices"][0]["ports"].values()

    def master(self):
        """A Modbus master on the drive's RS-485 line."""
        _, host, port = self.uri.split(":")
        return ModbusTcpClient(host, port=int(port), framer=FramerType.RTU, retries=0)

    def advance(self, seconds):
        """Advances the clock by that much, at once."""
        self._call("POST", "/api/time/advance", {"seconds": seconds})

    def motion(self):
        """Position in steps, speed in steps per second, and whether it moves."""
        return self._call("GET", f"/api/drives/{self.name}")["motion"]

    def pin(self, pin, level):
        """Pulls a pin "low" or "high", or releases it: "open"."""
        self._call("PUT", f"/api/drives/{self.name}/pins/{pin}", {"level": level})

    def power_cycle(self):
        """Takes the power away, and gives it back."""
        self._call("POST", f"/api/drives/{self.name}/power", {"action": "cycle"})

    def stop(self):
        """Ends the process."""
        self.process.terminate()
        self.process.communicate()

    def _call(self, method, path, body=None):
        headers = {"Content-Type": "application/json"}
        data = json.dumps(body).encode() if body else None
        request = urllib.request.Request(self.control + path, data, headers, method=method)
        with urllib.request.urlopen(request) as answer:
            return json.loads(answer.read() or "null")


@pytest.fixture
def drive():
    """A factory-new MD3."""
    drive = Drive("md3")
    yield drive
    drive.stop()


@pytest.fixture
def master(drive):
    """A Modbus master that is connected to it."""
    with drive.master() as master:
        yield master
