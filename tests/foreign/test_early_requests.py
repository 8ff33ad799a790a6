"""Masters on a line of two drives at 19,200 baud, in real time: a master that sends 0.1 ms after the reply of the other
drive fails on a real line. It is warned about and counted, and on a strict line its request is lost (HOST-23). A master
that waits t3.5 is not."""

import itertools
import signal
import threading
import time

import minimalmodbus
import pytest
import serial
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from conftest import PATIENCE, host_and_port
from modbus import frame

pytestmark = pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning", "ignore:setName:DeprecationWarning")

T3_5 = 35 / 19_200
"""3.5 characters of 10 bits in seconds: an MDROBOT has 19,200 8N1."""

PLACES = ["pty", "tcp", "rfc2217"]


class Line:
    """A line of two MDROBOTs with addresses 1 and 2."""

    def __init__(self, run, tmp_path, strict=False):
        file = tmp_path / "line.toml"
        file.write_text(
            f"""
            bus = [{{ name = "line", drives = ["a", "b"], strict = {str(strict).lower()},
                     listen = ["pty:", "tcp:127.0.0.1:0", "rfc2217:127.0.0.1:0"] }}]
            drive = [{{ name = "a", kind = "mdrobot", address = 1 }}, {{ name = "b", kind = "mdrobot", address = 2 }}]
            """
        )
        self.drivetwin = run("--fast-boot", kind=file)
        (bus,) = self.drivetwin.call("GET", "/api/bench")["buses"]
        self.places = {scheme: address for scheme, address in (uri.split(":", 1) for uri in bus["listen"])}

    def early(self):
        """Number of requests that were too early."""
        (bus,) = self.drivetwin.call("GET", "/api/bench")["buses"]
        return bus["early_requests"]

    def port(self, place, timeout=PATIENCE):
        """A port of pyserial."""
        schemes = {"pty": "", "tcp": "socket://", "rfc2217": "rfc2217://"}
        return serial.serial_for_url(schemes[place] + self.places[place], 19_200, timeout=timeout)


def poll(port, number, pause):
    """Reads a register of one drive after a pause, of the other drive the next time. Returns whether it answers within
    the time-out of the port."""
    address = 1 + number % 2
    port.write(frame(address, 3, 0, 1, 0, 1))
    # VERSION is 81.
    replied = read(port, frame(address, 3, 2, 0, 81))
    until = time.perf_counter() + pause
    while time.perf_counter() < until:
        pass
    return replied


def read(port, expected):
    """Reads a reply. Returns whether it has come within the time-out of the port, at least in part."""
    reply = port.read(len(expected))
    while 0 < len(reply) < len(expected):
        reply += port.read(len(expected) - len(reply))
    assert reply in (b"", expected)
    return bool(reply)


@pytest.mark.parametrize("place", PLACES)
def test_a_request_soon_after_another_drives_reply_is_warned_about(run, tmp_path, place):
    line = Line(run, tmp_path)
    with line.port(place) as port:
        # If this process or the drive is held up for longer than t3.5, the request is not early.
        number = 0
        while line.early() == 0:
            assert all(poll(port, number + n, 0.000_1) for n in range(10))
            number += 10
        assert number < 1_000
    assert "line: a drive may ignore this request on a real line: sent " in line.drivetwin.said()
    assert "; t3.5 is 1.8 ms" in line.drivetwin.said()
    # The journal says which requests were early, beside their verdicts.
    received = [one for name in "ab" for one in line.drivetwin.call("GET", f"/api/drives/{name}/received")["requests"]]
    early = [one for one in received if one["reason"] and one["reason"].endswith("; t3.5 is 1.8 ms")]
    assert len(early) == line.early()
    assert all(one["verdict"] == "done" and one["outcome"] == f"VERSION = 81; {one['reason']}" for one in early)


@pytest.mark.parametrize("place", PLACES)
def test_on_a_strict_line_that_request_is_lost(run, tmp_path, place):
    line = Line(run, tmp_path, strict=True)
    with line.port(place, timeout=0.2) as port:
        lost = answered = number = 0
        while lost < 3:
            if poll(port, number, 0.000_1):
                answered += 1
            elif line.early() > lost:
                lost += 1
            else:
                # The reply is late.
                while not read(port, frame(1 + number % 2, 3, 2, 0, 81)):
                    pass
            number += 1
            assert number < 1_000
    assert answered > 0 and line.early() == lost
    # Each is in the journal of the drive that it was for.
    received = {name: line.drivetwin.call("GET", f"/api/drives/{name}/received")["requests"] for name in "ab"}
    early = {name: [one for one in ones if one["verdict"] == "too early"] for name, ones in received.items()}
    assert all(one["address"] == address for address, name in enumerate("ab", 1) for one in early[name])
    assert sum(map(len, early.values())) == lost
    assert "line: dropped a request that was too early: sent " in line.drivetwin.said()


@pytest.mark.parametrize("place", PLACES)
def test_a_master_that_waits_is_never_early(run, tmp_path, place):
    line = Line(run, tmp_path, strict=True)
    with line.port(place) as port:
        assert all(poll(port, number, T3_5) for number in range(200))
    assert line.early() == 0


@pytest.mark.parametrize("place", PLACES)
def test_a_process_that_is_held_up_blames_nobody(run, tmp_path, place):
    line = Line(run, tmp_path, strict=True)
    over = threading.Event()

    def hold_up():
        pauses = itertools.cycle([0.0003, 0.002, 0.006, 0.015])
        while not over.is_set():
            line.drivetwin.process.send_signal(signal.SIGSTOP)
            time.sleep(next(pauses))
            line.drivetwin.process.send_signal(signal.SIGCONT)
            time.sleep(0.003)

    with line.port(place) as port:
        holder = threading.Thread(target=hold_up)
        holder.start()
        try:
            assert all(poll(port, number, T3_5) for number in range(200))
        finally:
            over.set()
            holder.join()
    assert line.early() == 0


@pytest.mark.parametrize("place", PLACES)
def test_minimalmodbus_waits(run, tmp_path, place):
    line = Line(run, tmp_path, strict=True)
    with line.port(place) as port:
        masters = [minimalmodbus.Instrument(port, address) for address in (1, 2)]
        # With RFC 2217, pyserial takes a tenth of a second for each of two purges before a request.
        polls = 4 if place == "rfc2217" else 40
        assert all(master.read_register(1) == 81 for _ in range(polls) for master in masters)
    assert line.early() == 0


def test_pymodbus_on_a_pty_waits(run, tmp_path):
    line = Line(run, tmp_path, strict=True)
    with ModbusSerialClient(line.places["pty"], baudrate=19_200, timeout=PATIENCE, retries=0) as client:
        for number in range(80):
            assert client.read_holding_registers(1, device_id=1 + number % 2).registers == [81]
    assert line.early() == 0


def test_pymodbus_with_rtu_over_tcp_does_not_wait(run, tmp_path):
    line = Line(run, tmp_path)
    host, port = host_and_port(line.places["tcp"])
    with ModbusTcpClient(host, port=port, framer=FramerType.RTU, timeout=PATIENCE, retries=0) as client:
        number = 0
        while line.early() == 0:
            for number in range(number + 1, number + 11):
                assert client.read_holding_registers(1, device_id=1 + number % 2).registers == [81]
            assert number < 1_000


@pytest.mark.parametrize("place", PLACES)
def test_a_broadcast_and_its_turnaround_delay(run, tmp_path, place):
    """A master that counts the turnaround delay from its write, and not from the end on the line, is right as well."""
    line = Line(run, tmp_path, strict=True)
    with line.port(place) as port:
        for number in range(20):
            # PID 10 (command) 0: nothing happens.
            port.write(frame(0, 6, 0, 10, 0, 0))
            time.sleep(0.1)
            assert poll(port, number, T3_5)
    assert line.early() == 0
