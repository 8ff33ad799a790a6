"""Modbus: RTU frames by hand, and pymodbus over TCP and on the pty, in RTU or ASCII."""

import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from serial import Serial

from conftest import PATIENCE


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


@pytest.fixture
def tcp(run):
    """pymodbus over TCP."""
    clients = []

    def connect(drivetwin, framer=FramerType.RTU):
        host, port = drivetwin.tcp
        client = ModbusTcpClient(host, port=port, framer=framer, timeout=PATIENCE, retries=0)
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

    def connect(drivetwin, framer=FramerType.RTU, baudrate=9600):
        drivetwin.notice()
        client = ModbusSerialClient(
            drivetwin.pty, framer=framer, baudrate=baudrate, parity="N", stopbits=1, timeout=PATIENCE, retries=0
        )
        assert client.connect()
        clients.append(client)
        return client

    yield connect
    for client in clients:
        client.close()


def serial_port(drivetwin, baudrate=9600, bytesize=8, parity="E", stopbits=1, timeout=PATIENCE):
    """The pty, opened with all its settings at once; see `serial` for why they cannot change later."""
    drivetwin.notice()
    return Serial(drivetwin.pty, baudrate, bytesize, parity, stopbits, timeout)
