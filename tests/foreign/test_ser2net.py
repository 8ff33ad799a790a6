"""ser2net as the client of a remote serial port (RFC 2217, HOST-24): the port of a device server is a drive."""

import contextlib
import socket
import subprocess

import pytest
import serial
from minimalmodbus import Instrument, NoResponseError

from conftest import PATIENCE, ask
from md3 import DEFAULTS
from modbus import frame

pytestmark = pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning", "ignore:setName:DeprecationWarning")

LISTEN = ("--fast-boot", "--listen", "rfc2217:127.0.0.1:0")


@pytest.fixture
def ser2net(tmp_path):
    """Starts ser2net in front of a drive. Returns the addresses of its port with RFC 2217, and of a raw one."""
    with contextlib.ExitStack() as running:

        def start(drivetwin):
            with socket.create_server(("127.0.0.1", 0)) as one, socket.create_server(("127.0.0.1", 0)) as two:
                ports = [server.getsockname()[1] for server in (one, two)]
            host, port = drivetwin.remote
            connector = f"telnet(rfc2217=true),tcp,{host},{port}"
            file = tmp_path / "ser2net.yaml"
            file.write_text(
                f"connection: &remote\n"
                f"  accepter: telnet(rfc2217=true),tcp,127.0.0.1,{ports[0]}\n"
                f"  connector: {connector}\n"
                f"connection: &raw\n"
                f"  accepter: tcp,127.0.0.1,{ports[1]}\n"
                f"  connector: {connector}\n"
            )
            process = subprocess.Popen(
                ["ser2net", "-n", "-d", "-u", "-P", tmp_path / "pid", "-c", file],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            running.callback(process.wait, PATIENCE)
            running.callback(process.kill)
            return [("127.0.0.1", port) for port in ports]

        yield start


def connect(address, what):
    """Calls `what` until ser2net listens."""
    while True:
        try:
            return what(address)
        except (ConnectionRefusedError, serial.SerialException):
            pass


def open_port(address, baudrate, parity, timeout=PATIENCE):
    host, port = address
    return connect(
        address,
        lambda _: serial.serial_for_url(f"rfc2217://{host}:{port}", baudrate, parity=parity, timeout=timeout),
    )


def test_settings_of_the_master_behind_ser2net(run, ser2net):
    drivetwin = run(*LISTEN)
    remote, _ = ser2net(drivetwin)
    with open_port(remote, 9_600, "N", timeout=0.2) as port:
        with pytest.raises(NoResponseError):
            Instrument(port, 1).read_register(0)
        while not drivetwin.drive()["ports"]["rs485"]["spoiled"]:
            pass
        port.parity = "E"
        port.timeout = PATIENCE
        assert Instrument(port, 1).read_registers(0, 32) == DEFAULTS


def test_raw_bytes_behind_ser2net(run, ser2net):
    drivetwin = run(*LISTEN)
    _, raw = ser2net(drivetwin)
    with connect(raw, lambda address: socket.create_connection(address, PATIENCE)) as master:
        assert ask(master, frame(1, 3, 0, 0, 0, 1), 7) == frame(1, 3, 2, 0, 1)


def test_dtr_behind_ser2net(run, ser2net):
    drivetwin = run(*LISTEN, kind="qsb-d")
    remote, _ = ser2net(drivetwin)
    with open_port(remote, 230_400, "N") as port:
        port.write(b"W0001\r")
        assert port.read_until(b"w 00 00000001 !\r\n").endswith(b"w 00 00000001 !\r\n")
        port.dtr = False
        port.dtr = True
        assert port.read_until(b"!\r\n") == b"QSB-D  0E!\r\n"
