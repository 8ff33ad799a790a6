"""A serial port over TCP (RFC 2217, HOST-24), with pyserial and a master on it."""

import contextlib
import socket

import pytest
import serial
from minimalmodbus import Instrument, NoResponseError

from conftest import PATIENCE, ask, receive
from md3 import DEFAULTS, SERIAL_PORT, USER_REGISTER
from modbus import frame, write

pytestmark = pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning", "ignore:setName:DeprecationWarning")

LISTEN = ("--fast-boot", "--listen", "rfc2217:127.0.0.1:0")

WILL, WONT, DO, DONT = 251, 252, 253, 254
IAC, COM_PORT = 255, 44


@pytest.fixture
def open_port():
    """Opens the remote port of a drive like a serial port."""
    with contextlib.ExitStack() as ports:

        def start(drivetwin, baudrate=9600, parity="E", timeout=PATIENCE, **settings):
            host, port = drivetwin.remote
            url = f"rfc2217://{host}:{port}"
            return ports.enter_context(
                serial.serial_for_url(url, baudrate, parity=parity, timeout=timeout, **settings)
            )

        yield start


def test_minimalmodbus_reads_and_writes(run, open_port):
    master = Instrument(open_port(run(*LISTEN)), 1)
    assert master.read_registers(0, 32) == DEFAULTS
    # 255 is sent twice in both directions.
    master.write_register(USER_REGISTER, 0xFFFF, functioncode=6)
    assert master.read_register(USER_REGISTER) == 0xFFFF


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ({"parity": "N"}, {"parity": "E"}),
        ({"parity": "O"}, {"parity": "E"}),
        ({"baudrate": 19_200}, {"baudrate": 9_600}),
        ({"bytesize": 7}, {"bytesize": 8}),
        ({"stopbits": 2}, {"stopbits": 1}),
    ],
)
def test_a_setting_that_differs_gets_no_answer(run, open_port, wrong, right):
    """The drive's line is 9600 8E1."""
    drivetwin = run(*LISTEN)
    with open_port(drivetwin, **{"timeout": 0.2, **wrong}) as port:
        master = Instrument(port, 1)
        with pytest.raises(NoResponseError):
            master.read_register(0)
        # It has received eight characters, all with errors.
        while not (spoiled := drivetwin.drive()["ports"]["rs485"]["spoiled"]):
            pass
        assert spoiled == 1 and "; the drive's line is 9600 8E1" in drivetwin.said()
        port.apply_settings(right)
        master.serial.timeout = PATIENCE
        assert master.read_register(0) == 1


def test_the_reply_to_a_change_of_the_line_has_the_old_settings(run, open_port):
    """7.22: 115,200 8E1 from the next frame on."""
    port = open_port(run(*LISTEN))
    master = Instrument(port, 1)
    master.write_register(SERIAL_PORT, 0x25, functioncode=6)
    port.baudrate = 115_200
    assert master.read_register(SERIAL_PORT) == 0x25


def test_mark_parity_is_refused(run, open_port):
    with pytest.raises(ValueError, match="remote rejected value for option 'parity'"):
        open_port(run(*LISTEN), parity="M")


def test_dtr_resets_a_qsb(run, open_port):
    drivetwin = run(*LISTEN, kind="qsb-d")
    port = open_port(drivetwin, 230_400, "N")

    def say(command):
        port.write(command + b"\r")
        return port.read_until(b"!\r\n")

    # The banner after the opening is purged by pyserial, or comes first.
    port.write(b"W0001\r")
    assert port.read_until(b"w 00 00000001 !\r\n").endswith(b"w 00 00000001 !\r\n")
    assert say(b"R00") == b"r 00 00000001 !\r\n"
    port.rts = False
    port.rts = True
    assert say(b"R00") == b"r 00 00000001 !\r\n"
    port.dtr = False
    port.dtr = True
    assert port.read_until(b"!\r\n") == b"QSB-D  0E!\r\n"
    assert say(b"R00") == b"r 00 00000000 !\r\n"
    assert (port.cts, port.dsr, port.cd, port.ri) == (True, True, True, False)


@pytest.mark.parametrize("settings", [{"rtscts": True}, {"xonxoff": True}, {"dsrdtr": True}])
def test_a_port_with_flow_control(run, open_port, settings):
    assert Instrument(open_port(run(*LISTEN), **settings), 1).read_register(0) == 1


def test_a_program_without_telnet_gets_raw_bytes(run):
    drivetwin = run(*LISTEN)
    request = write(1, USER_REGISTER, 0xFFFF)
    with socket.create_connection(drivetwin.remote, PATIENCE) as master:
        for _ in range(2):
            assert ask(master, request, len(request)) == request
        master.shutdown(socket.SHUT_WR)
        assert master.recv(100) == b""
    assert drivetwin.said().count("does not speak RFC 2217") == 1


def test_a_client_that_refuses_gets_bytes(run):
    drivetwin = run(*LISTEN)
    with socket.create_connection(drivetwin.remote, PATIENCE) as master:
        master.sendall(bytes([IAC, WONT, COM_PORT]))
        assert receive(master, 9) == bytes([IAC, DO, COM_PORT, IAC, DO, 0, IAC, WILL, 0])
        master.sendall(bytes([IAC, DONT, 0, IAC, WONT, 0]))
        assert ask(master, frame(1, 3, 0, 0, 0, 1), 7) == frame(1, 3, 2, 0, 1)
    assert "refuses COM port control" in drivetwin.said()


def test_a_browser_is_disconnected(run):
    drivetwin = run(*LISTEN)
    with socket.create_connection(drivetwin.remote, PATIENCE) as browser:
        browser.sendall(b"POST / HTTP/1.1\r\n\r\n" + frame(1, 3, 0, 0, 0, 1))
        with contextlib.suppress(ConnectionResetError):
            assert browser.recv(100) == b""
