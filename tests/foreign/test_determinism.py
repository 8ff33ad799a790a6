"""The same bench and the same calls are the same trace and the same capture, byte for byte."""

import json
import os
import socket
import subprocess
import time
import urllib.request

from conftest import PATIENCE
from md3 import EEPROM_CONTROL, MOTION_CONTROL, USER_REGISTER
from modbus import frame, write

BENCH = """
[[bus]]
name = "line1"
listen = ["tcp:127.0.0.1:0"]
drives = ["x", "y"]

[[drive]]
name = "x"
kind = "md3"
address = 1
fast_boot = true

[[drive]]
name = "y"
kind = "md3-low"
address = 2
fast_boot = true

[[fault]]
bus = "line1"
corrupt = 0.2
noise = 0.2
delay_ms = 3
"""


class Played:
    """A bench with requests and time steps, which loses power in a save: its trace and its capture."""

    def __init__(self, tmp_path, seed):
        file, capture = tmp_path / "bench.toml", tmp_path / "lines.pcapng"
        file.write_text(BENCH)
        options = ["--time", "manual", "--seed", str(seed), "--json", "--pcap", capture]
        command = [os.environ["DRIVETWIN"], "run", file, *options]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            try:
                ready = json.loads(process.stdout.readline())
                self.control = ready["control"]
                (uri,) = ready["devices"][0]["ports"]["rs485"]
                _, host, port = uri.split(":")
                with socket.create_connection((host, int(port)), PATIENCE) as line:
                    self.talk(line)
                self.trace = self.call("GET", "/api/trace")
            finally:
                process.terminate()
        self.capture = capture.read_bytes()

    def talk(self, line):
        """The requests do not depend on the answers, since the line is disturbed."""
        for value in range(20):
            for unit in (1, 2):
                self.send(line, write(unit, USER_REGISTER, value))
                self.advance(0.1)
                self.send(line, frame(unit, 3, 0, USER_REGISTER, 0, 1))
                self.advance(0.1)
        self.send(line, write(2, MOTION_CONTROL, 1))
        self.call("POST", "/api/drives/x/power", {"action": "cut"})
        self.send(line, write(1, EEPROM_CONTROL, 1))
        self.advance(1.0)
        self.call("POST", "/api/drives/x/power", {"action": "on"})
        self.advance(1.0)

    def send(self, line, request):
        """Returns when the drive has received the frame, for any address and however disturbed."""
        before = self.heard()
        line.sendall(request)
        until = time.monotonic() + PATIENCE
        while self.heard() == before:
            assert time.monotonic() < until, "it has not come"

    def heard(self):
        """Frames that the drive x has received."""
        seen = json.loads(self.call("GET", "/api/drives/x"))["ports"]["rs485"]
        return seen["requests"] + seen["refused"] + seen["dropped"]

    def advance(self, seconds):
        self.call("POST", "/api/time/advance", {"seconds": seconds})

    def call(self, method, path, body=None):
        """A call of the control API."""
        headers = {"Content-Type": "application/json"}
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.control + path, data, headers, method=method)
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            return answer.read()


def test_a_bench_plays_the_same_again(tmp_path):
    one, again = Played(tmp_path, 1), Played(tmp_path, 1)
    assert one.trace.count(b" rx ") > 80 and one.trace.count(b" tx ") > 20
    assert one.trace == again.trace
    assert one.capture == again.capture


def test_another_seed_is_other_chances(tmp_path):
    one, other = Played(tmp_path, 1), Played(tmp_path, 2)
    assert one.capture != other.capture
