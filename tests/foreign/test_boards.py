"""pymodbus, pyserial and the firmware of the boards, each under its emulator, as `cargo xtask` starts them."""

import os
import re
import select
import signal
import subprocess
import time
from contextlib import contextmanager

import pytest
import serial
from pymodbus import FramerType
from pymodbus.client import ModbusTcpClient

from md3 import DEFAULTS, MOTION_CONTROL, USER_REGISTER

START = 300.0
"""Seconds of wall time in which a board is built, if it must be, and started."""
PATIENCE = 30.0
"""Seconds of wall time after which something hangs: an emulator may be slower than the board."""
TRIES = 20
"""How often a master asks that hears nothing. For two and a half seconds the drive hears nothing either,
and an emulated line may pause within a frame."""

MOVE = 1 << 0
STOP = 1 << 3
"""Bits of MotionControl (7.15)."""
SPEED = 0x14
"""Speed, a pair (7.17)."""
ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))


def address(board):
    """Where it can be reached, as it says itself."""
    deadline = time.monotonic() + START
    said = b""
    while time.monotonic() < deadline:
        readable, _, _ = select.select([board.stdout], [], [], deadline - time.monotonic())
        piece = os.read(board.stdout.fileno(), 4096) if readable else b""
        assert piece, f"the board did not start: {said.decode()}"
        said += piece
        if found := re.search(rb"127\.0\.0\.1:(\d+)\D", said):
            return "127.0.0.1", int(found[1])
    raise AssertionError(f"the board does not say where it is: {said.decode()}")


@contextmanager
def running(board, kind):
    """Where a kind of drive can be reached on an emulated board."""
    command = ["cargo", "xtask", board, kind]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, start_new_session=True)
    try:
        yield address(process)
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(PATIENCE)
        process.stdout.close()


@pytest.fixture(params=["qemu", "pico"])
def client(request):
    """pymodbus, connected to an MD3 on an emulated board."""
    with running(request.param, "md3") as (host, port):
        client = ModbusTcpClient(host, port=port, framer=FramerType.RTU, timeout=3, retries=TRIES)
        assert client.connect()
        yield client
        client.close()


@pytest.fixture(params=["qemu", "pico"])
def line(request):
    """pyserial, connected to a QSB-M on an emulated board."""
    with running(request.param, "qsb-m") as (host, port):
        with serial.serial_for_url(f"socket://{host}:{port}", timeout=PATIENCE) as line:
            yield line


def test_pymodbus_and_a_board(client):
    registers = client.read_holding_registers(0, count=32).registers
    assert registers == DEFAULTS
    assert not client.write_register(USER_REGISTER, 0x1234).isError()
    assert client.read_holding_registers(USER_REGISTER).registers == [0x1234]
    # 6.1: what does not exist is an illegal address.
    assert client.read_holding_registers(0x100).exception_code == 2
    # 7.15, 7.17: a move of 10,000 steps at 100 steps/s would run for 100 s, and a stop ends it.
    assert not client.write_register(SPEED + 1, 100).isError()
    assert not client.write_register(MOTION_CONTROL, MOVE).isError()
    assert client.read_holding_registers(MOTION_CONTROL).registers == [MOVE]
    assert not client.write_register(MOTION_CONTROL, STOP).isError()
    assert client.read_holding_registers(MOTION_CONTROL).registers == [0]


def test_pyserial_and_a_board(line):
    def ask(command):
        line.write(command + b"\r")
        return line.read_until(b"\n")

    # Until it has started it hears nothing, and then it says its banner. What is answered to an order comes
    # behind all of that.
    line.timeout = 3
    while ask(b"R14") != b"r 14 0000110E !\r\n":
        pass
    line.timeout = PATIENCE
    said = ask(b"W0B1234")
    while said != b"w 0B 00001234 !\r\n":
        assert said, "the board does not answer"
        said = line.read_until(b"\n")
    assert ask(b"R0E") == b"r 0E 00000000 !\r\n"
    assert ask(b"W081F4") == b"w 08 000001F4 !\r\n"
    assert ask(b"R08") == b"r 08 000001F4 !\r\n"
    # What does not exist, and a value that is out of range.
    assert ask(b"R17") == b"x 17 00000000 !\r\n"
    assert ask(b"W155F") == b"e 15 0000005F !\r\n"
    # Two at once are answered one after the other.
    line.write(b"R08\rR14\r")
    assert [line.read_until(b"\n") for _ in range(2)] == [b"r 08 000001F4 !\r\n", b"r 14 0000110E !\r\n"]
