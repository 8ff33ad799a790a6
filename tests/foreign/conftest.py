"""The running binary, as masters and users see it.

`DRIVETWIN` is the path of the binary; `cargo xtask test` sets it. Nothing here asserts how fast this
machine is: instants come from the bench's own clock, and `PATIENCE` only ends a test that hangs.
"""

import json
import os
import pathlib
import select
import signal
import socket
import subprocess
import tempfile
import urllib.request

import pytest

pytest_plugins = ["modbus"]

PATIENCE = 30.0
"""Seconds of wall time after which something hangs."""


class Drivetwin:
    """A `drivetwin run` that is ready: of a drive, or of a bench file. `program` is another one with the same commands,
    built beside it."""

    def __init__(self, *options, kind="md3", program=None):
        self.kind = kind
        self.log = tempfile.TemporaryFile()
        place = pathlib.Path(os.environ["DRIVETWIN"])
        place = place.with_name(program or place.name)
        self.process = subprocess.Popen(
            [str(place), "run", kind, "--json", *map(str, options)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self.log,
        )
        try:
            ready = json.loads(self._line())
        except BaseException:
            self.kill()
            raise
        self.control = ready["control"]
        self.drives = {device["name"]: tcp_ports(device) for device in ready["devices"]}
        if str(kind).endswith(".toml"):
            return
        (device,) = ready["devices"]
        assert (device["name"], device["kind"]) == (kind, kind)
        self.ports = self.drives[kind]
        self.tcp = next(iter(self.ports.values()), None)
        *_, uris = device["ports"].values()
        places = dict(uri.split(":", 1) for uri in uris)
        self.pty = places.get("pty")
        self.remote = host_and_port(places["rfc2217"]) if "rfc2217" in places else None

    def _line(self):
        """The one line with the addresses of all ports."""
        readable, _, _ = select.select([self.process.stdout], [], [], PATIENCE)
        line = self.process.stdout.readline() if readable else b""
        assert line, f"drivetwin did not start: {self.said()}"
        return line

    def said(self):
        """What it wrote to stderr."""
        self.log.seek(0)
        return self.log.read().decode()

    def call(self, method, path, body=None):
        """A call of the control API."""
        request = urllib.request.Request(
            self.control + path,
            method=method,
            data=None if body is None else json.dumps(body).encode(),
            headers={"Content-Type": "application/json"},
        )
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            text = answer.read()
        return json.loads(text) if text else None

    def seconds(self):
        """The time of the bench."""
        return self.call("GET", "/api/bench")["time"]["seconds"]

    def drive(self):
        """The state of the drive."""
        return self.call("GET", f"/api/drives/{self.kind}")

    def advance(self, seconds):
        """Moves the standing clock, after what was sent so far."""
        self.notice()
        self.call("POST", "/api/time/advance", {"seconds": seconds})

    def socket(self, port=None, drive=None):
        """A client of its own on the line, or on a port by its name, where drives are several of that drive."""
        if port is None:
            address = self.tcp
        else:
            address = (self.drives[drive] if drive else self.ports)[port]
        return socket.create_connection(address, timeout=PATIENCE)

    def notice(self):
        """Returns when it has seen what was sent so far, and that a pty was left: before that, the pty
        cannot be opened with parity. Each call is served after all ports were looked at once; the
        first may be served ahead of that, and a new connection takes a look of its own."""
        for _ in range(3):
            self.seconds()

    def stop(self):
        """Stops it as a user would, and returns its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE)

    def kill(self):
        """Kills it: SIGKILL."""
        self.process.kill()
        self.process.wait(PATIENCE)
        self.process.stdout.close()
        self.log.close()


def tcp_ports(device):
    """Where the ports of a device listen, by their names."""
    ports = {}
    for name, uris in device["ports"].items():
        for uri in uris:
            scheme, address = uri.split(":", 1)
            if scheme == "tcp":
                ports[name] = host_and_port(address)
    return ports


def host_and_port(address):
    host, port = address.rsplit(":", 1)
    return (host, int(port))


@pytest.fixture
def run():
    """Starts drives, and ends them with the test."""
    running = []

    def start(*options, kind="md3", program=None):
        running.append(Drivetwin(*options, kind=kind, program=program))
        return running[-1]

    yield start
    for drivetwin in running:
        drivetwin.kill()


def receive(sock, length):
    """Exactly that many bytes."""
    got = b""
    while len(got) < length:
        piece = sock.recv(length - len(got))
        assert piece, f"the connection was closed after {got.hex(' ')}"
        got += piece
    return got


def ask(sock, request, length):
    """The reply of that many bytes to a request."""
    sock.sendall(request)
    return receive(sock, length)


def pytest_terminal_summary(terminalreporter):
    """Prints how many commands of the documents were run, and which blocks were not, with the reason."""
    properties = [entry for report in terminalreporter.getreports("passed") for entry in report.user_properties]
    ran = sum(value for name, value in properties if name == "ran")
    marked = [entry for name, value in properties if name == "marked" for entry in value]
    if ran:
        terminalreporter.write_line(f"commands in documents: {ran} run; {len(marked)} blocks shown and not run")
        for place, reason in marked:
            terminalreporter.write_line(f"  {place}: {reason}")
