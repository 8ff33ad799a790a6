"""The running binary, as masters and people meet it.

`STANDIN` is the path of the binary; `cargo xtask test` sets it. Nothing here asserts how fast this
machine is: instants come from the bench's own clock, and `PATIENCE` only ends a test that hangs.
"""

import json
import os
import select
import signal
import socket
import subprocess
import tempfile
import urllib.request

import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from serial import Serial

PATIENCE = 30.0
"""Seconds of wall time after which something hangs."""

# Chapter 7 of the MD3 User Guide V1.7, typed by hand. 0x0b reads 0, the serial number is 1.
DEFAULTS = [
    0x0001, 0x030A, 0x0000, 0x0000, 0x0000, 0x0000, 0x0000, 0x0000,
    0x0000, 0x0000, 0x000F, 0x0000, 0x0005, 0x0F9F, 0x0000, 0x0000,
    0x0000, 0x0000, 0x0000, 0x2710, 0x0000, 0x1388, 0x0000, 0x09C4,
    0x0000, 0x2710, 0x9A00, 0xBD01, 0x0021, 0x0000, 0x0000, 0x0001,
]  # fmt: skip

USER_REGISTER = 0x1D
EEPROM_CONTROL = 0x1A
MOTION_CONTROL = 0x11
SERIAL_PORT = 0x1C


def crc(body):
    """The CRC of the Modbus serial line specification, 2.5.1.2."""
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc.to_bytes(2, "little")


def frame(*body):
    """An RTU frame of an address and a PDU."""
    return bytes(body) + crc(bytes(body))


def write(unit, address, value):
    """The frame that writes one register."""
    return frame(unit, 6, *address.to_bytes(2, "big"), *value.to_bytes(2, "big"))


class Standin:
    """A `standin run` that is ready."""

    def __init__(self, *options, kind="md3"):
        self.kind = kind
        self.log = tempfile.TemporaryFile()
        self.process = subprocess.Popen(
            [os.environ["STANDIN"], "run", kind, "--json", *map(str, options)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self.log,
        )
        try:
            ready = json.loads(self._line())
        except BaseException:
            self.kill()
            raise
        (device,) = ready["devices"]
        assert (device["name"], device["kind"]) == (kind, kind)
        (uris,) = device["ports"].values()
        addresses = dict(uri.split(":", 1) for uri in uris)
        host, port = addresses["tcp"].rsplit(":", 1)
        self.tcp = (host, int(port))
        self.pty = addresses["pty"]
        self.control = ready["control"]

    def _line(self):
        """The one line that says where everything is."""
        readable, _, _ = select.select([self.process.stdout], [], [], PATIENCE)
        line = self.process.stdout.readline() if readable else b""
        assert line, f"standin did not start: {self.said()}"
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

    def socket(self):
        """A client of its own on the line."""
        return socket.create_connection(self.tcp, timeout=PATIENCE)

    def notice(self):
        """Returns when it has seen what was sent so far, and that a pty was left: before that, the pty
        cannot be opened with parity. Each call is served after all ports were looked at once; the
        first may be served ahead of that, and a new connection takes a look of its own."""
        for _ in range(3):
            self.seconds()

    def stop(self):
        """Ends it as a person would, and returns its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE)

    def kill(self):
        """Ends it whatever it does: SIGKILL."""
        self.process.kill()
        self.process.wait(PATIENCE)
        self.process.stdout.close()
        self.log.close()


@pytest.fixture
def run():
    """Starts drives, and ends them with the test."""
    running = []

    def start(*options, kind="md3"):
        running.append(Standin(*options, kind=kind))
        return running[-1]

    yield start
    for standin in running:
        standin.kill()


@pytest.fixture
def tcp(run):
    """pymodbus, RTU over TCP."""
    clients = []

    def connect(standin):
        host, port = standin.tcp
        client = ModbusTcpClient(host, port=port, framer=FramerType.RTU, timeout=PATIENCE, retries=0)
        assert client.connect()
        clients.append(client)
        return client

    yield connect
    for client in clients:
        client.close()


@pytest.fixture
def serial(run):
    """pymodbus on the pty.

    It asks for no parity, which a pty cannot tell from any other: with parity it never gets past its
    own `connect`. It sets the open port up a second time, nothing of that changes a pty, and the C
    library then reports that parity was refused.
    """
    clients = []

    def connect(standin):
        standin.notice()
        client = ModbusSerialClient(
            standin.pty, baudrate=9600, parity="N", stopbits=1, timeout=PATIENCE, retries=0
        )
        assert client.connect()
        clients.append(client)
        return client

    yield connect
    for client in clients:
        client.close()


def serial_port(standin, baudrate=9600, parity="E", stopbits=1, timeout=PATIENCE):
    """The pty, opened with all its settings at once; see `serial` for why they cannot change later."""
    standin.notice()
    return Serial(standin.pty, baudrate=baudrate, parity=parity, stopbits=stopbits, timeout=timeout)


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
