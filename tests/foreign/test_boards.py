"""pymodbus and the firmware of the boards, each under its emulator, as `cargo xtask` starts them."""

import os
import re
import select
import signal
import subprocess
import time

import pytest
from conftest import DEFAULTS, MOTION_CONTROL, USER_REGISTER
from pymodbus import FramerType
from pymodbus.client import ModbusTcpClient

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


@pytest.fixture(params=["qemu", "pico"])
def client(request):
    """pymodbus, connected to an MD3 on an emulated board."""
    command = ["cargo", "xtask", request.param, "md3"]
    board = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, start_new_session=True)
    try:
        host, port = address(board)
        client = ModbusTcpClient(host, port=port, framer=FramerType.RTU, timeout=3, retries=TRIES)
        assert client.connect()
        yield client
        client.close()
    finally:
        os.killpg(board.pid, signal.SIGTERM)
        board.wait(PATIENCE)
        board.stdout.close()


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
