"""A board at this computer: `drivetwin attach` in a thread of this process."""

import atexit
import re
import socket
import time

from ._errors import Error
from ._native import Bench, end_runs
from ._run import arguments

_ANSWER = 0.5
"""Seconds that an answer may take to begin; drives answer within some hundredths."""
_SILENCE = 0.05
"""Seconds without a byte after which an answer is whole."""

# A board whose recordings are not complete when the interpreter ends gets them completed.
atexit.register(end_runs)


def attach(device=None, **options):
    """Attaches a board: `attach("/dev/ttyACM1")`, `attach("usb:E66138935F3A6C2B")`, `attach("tcp:127.0.0.1:5000", bus=...)`,
    or without `device` the only board that is plugged in.

    Returns a `Bench` with one drive, whose name is "board" and whose methods are those of an emulated one: registers, pins,
    lights, motion, pulses, encoder, faults, power, recordings. What a board cannot do raises `NotOnBoard`: its time is real,
    its line has no faults to order, its wires and its motor are real. `options` are those of `drivetwin attach`, by their
    names. `with attach() as bench:` ends it; the drive goes on.
    """
    return Bench._attach(arguments(device, options, "attach"))


def url(uri):
    """The address of a port for `serial.serial_for_url`."""
    scheme, _, rest = uri.partition(":")
    return {"serial": rest, "tcp": f"socket://{rest}", "rfc2217": f"drivetwin_rfc2217://{rest}"}.get(scheme, uri)


def ask(uri, line, frame):
    """Sends a frame to a port, and returns the answer; b"" is silence."""
    with _open(uri, line) as port:
        port.send(frame)
        answer, until = b"", time.monotonic() + _ANSWER
        while (now := time.monotonic()) < until:
            part = port.receive(until - now)
            if part:
                answer += part
                until = time.monotonic() + _SILENCE
        return answer


def _open(uri, line):
    scheme, _, rest = uri.partition(":")
    if scheme == "tcp":
        return _Socket(rest)
    try:
        import serial
    except ImportError as error:
        raise Error("to ask a drive on a board needs pyserial: pip install pyserial") from error
    baud, data, parity, stop = re.fullmatch(r"(\d+) (\d)([NEO])(\d)", line).groups()
    settings = {"baudrate": int(baud), "bytesize": int(data), "parity": parity, "stopbits": int(stop)}
    return _Serial(serial.serial_for_url(url(uri), **settings))


class _Socket:
    """A port behind a server."""

    def __init__(self, address):
        host, _, port = address.rpartition(":")
        self._socket = socket.create_connection((host.strip("[]"), int(port)), timeout=_ANSWER)

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        self._socket.close()

    def send(self, frame):
        self._socket.sendall(frame)

    def receive(self, seconds):
        self._socket.settimeout(max(seconds, 0.001))
        try:
            return self._socket.recv(4096)
        except TimeoutError:
            return b""


class _Serial:
    """A serial port of this computer."""

    def __init__(self, port):
        self._port = port

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        self._port.close()

    def send(self, frame):
        self._port.reset_input_buffer()
        self._port.write(frame)

    def receive(self, seconds):
        self._port.timeout = max(seconds, 0.001)
        return self._port.read(max(1, self._port.in_waiting))
