"""pymodbus, pyserial and the firmware of the boards, each under its emulator, as `cargo xtask` starts them."""

import os
import re
import select
import signal
import socket
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
"""Number of requests of a master without an answer. For two and a half seconds the drive receives nothing,
and an emulated line may pause within a frame."""

MOVE = 1 << 0
STOP = 1 << 3
"""Bits of MotionControl (7.15)."""
SPEED = 0x14
"""Speed, a pair (7.17)."""
ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))


def addresses(board, ports):
    """Addresses of its ports, from its own output."""
    deadline = time.monotonic() + START
    said = b""
    while time.monotonic() < deadline:
        readable, _, _ = select.select([board.stdout], [], [], deadline - time.monotonic())
        piece = os.read(board.stdout.fileno(), 4096) if readable else b""
        assert piece, f"the board did not start: {said.decode()}"
        said += piece
        found = re.findall(rb"127\.0\.0\.1:(\d+)\D", said)
        if len(found) >= ports:
            return [("127.0.0.1", int(port)) for port in found[:ports]]
    raise AssertionError(f"the board does not say where it is: {said.decode()}")


@contextmanager
def running(board, kind, ports=1):
    """Where the ports of a kind of drive can be reached on an emulated board."""
    command = ["cargo", "xtask", board, kind]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, start_new_session=True)
    try:
        yield addresses(process, ports)
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(PATIENCE)
        process.stdout.close()


@pytest.fixture(params=["qemu", "pico"])
def client(request):
    """pymodbus, connected to an MD3 on an emulated board."""
    with running(request.param, "md3") as [(host, port)]:
        client = ModbusTcpClient(host, port=port, framer=FramerType.RTU, timeout=3, retries=TRIES)
        assert client.connect()
        yield client
        client.close()


@pytest.fixture(params=["qemu", "pico"])
def line(request):
    """pyserial, connected to a QSB-M on an emulated board."""
    with running(request.param, "qsb-m") as [(host, port)]:
        with serial.serial_for_url(f"socket://{host}:{port}", timeout=PATIENCE) as line:
            yield line


LINKS = 4
"""Connections that each TCP port of a board takes."""
VM = 0x8B
"""The highest velocity of an MDrive, 768,000 steps/s on a new one, high word first (FB 4.2.4)."""
FACTORY_VM = [768_000 >> 16, 768_000 & 0xFFFF]
READ_VM = bytes([0x12, 0x34, 0, 0, 0, 6, 5, 3, 0, VM, 0, 2])
"""The request in transaction 1234h, for unit 5."""
VM_READ = bytes([0x12, 0x34, 0, 0, 0, 7, 5, 3, 4, 0x00, 0x0B, 0xB8, 0x00])


@pytest.fixture(params=["mdrive", "mdrive-hybrid"])
def mdrive(request):
    """Where Modbus and MCode of an MDrive on an emulated board are."""
    with running("qemu", request.param, ports=2) as ports:
        yield ports


class Line:
    """A client of MCode, as in interactive use."""

    def __init__(self, address):
        self.stream = socket.create_connection(address, timeout=PATIENCE)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stream.close()

    def ask(self, command):
        """What the drive prints; a new one echoes first and has a prompt behind it (MC 5-22, EM 0)."""
        self.stream.sendall(command + b"\r")
        said = b""
        # A command that is refused has another prompt.
        while not said.endswith((b">", b"?")):
            piece = self.stream.recv(4096)
            assert piece, f"it was closed behind {said}"
            said += piece
        assert said.endswith(b">"), f"{command} is refused: {said}"
        echo, *lines = said.removesuffix(b">").split(b"\r\n")
        assert echo == command
        return [line for line in lines if line]


def is_closed(stream):
    """Returns whether the other side closes without further data."""
    try:
        return stream.recv(4096) == b""
    except ConnectionResetError:
        return True


def read_all(stream, count):
    """That many bytes."""
    said = b""
    while len(said) < count:
        piece = stream.recv(count - len(said))
        assert piece, f"it was closed behind {said}"
        said += piece
    return said


def test_pymodbus_and_the_network_of_a_board(mdrive):
    modbus, _ = mdrive
    clients = [ModbusTcpClient(modbus[0], port=modbus[1], timeout=PATIENCE) for _ in range(LINKS)]
    try:
        assert all(client.connect() for client in clients)
        # All of them at once, and again.
        for client in clients + clients:
            assert client.read_holding_registers(VM, count=2).registers == FACTORY_VM
        # FB 4.2.4: what does not exist is an illegal address, and more than four are an illegal value.
        assert clients[0].read_holding_registers(0x1000, count=1).exception_code == 2
        assert clients[1].read_holding_registers(VM, count=5).exception_code == 3
        # What one writes the others read.
        assert not clients[2].write_registers(VM, [1, 0]).isError()
        assert clients[3].read_holding_registers(VM, count=2).registers == [1, 0]
    finally:
        for client in clients:
            client.close()


def test_lines_and_the_network_of_a_board(mdrive):
    modbus, mcode = mdrive
    with Line(mcode) as one, Line(mcode) as two:
        assert one.ask(b"PR VM") == [b"768000"]
        assert two.ask(b'PR "hello"') == [b"hello"]
        # Both ports are of one drive.
        client = ModbusTcpClient(modbus[0], port=modbus[1], timeout=PATIENCE)
        assert client.connect()
        assert not client.write_registers(VM, [1, 0]).isError()
        client.close()
        assert one.ask(b"PR VM") == two.ask(b"PR VM") == [b"65536"]
        # What is typed while a line is executed waits, on both, and nothing is lost.
        for line in (one, two):
            line.stream.sendall(b"IC R1\r\n" * 200)
        for line in (one, two):
            assert read_all(line.stream, 1_600) == b"IC R1\r\n>" * 200
        assert one.ask(b"PR R1") == [b"400"]


def test_a_wrong_header_and_one_connection_too_many_close(mdrive):
    modbus, mcode = mdrive
    with socket.create_connection(modbus, timeout=PATIENCE) as right:
        with socket.create_connection(modbus, timeout=PATIENCE) as wrong:
            # A request in two pieces, and behind it a header of another protocol.
            wrong.sendall(READ_VM[:5])
            wrong.sendall(READ_VM[5:] + bytes([0, 1, 0, 7]))
            assert read_all(wrong, len(VM_READ)) == VM_READ
            assert is_closed(wrong)
        # The others are served: a hundred requests at once, each in its turn.
        right.sendall(READ_VM * 100)
        assert read_all(right, 100 * len(VM_READ)) == VM_READ * 100
    lines = [Line(mcode) for _ in range(LINKS)]
    try:
        assert all(line.ask(b"PR VM") == [b"768000"] for line in lines)
        with socket.create_connection(mcode, timeout=PATIENCE) as fifth:
            assert is_closed(fifth)
    finally:
        for line in lines:
            line.stream.close()


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

    # Until it has started it receives nothing, and then it sends its banner. The answer to a command comes after
    # that.
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
