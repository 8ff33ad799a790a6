"""Faults on demand, as masters see them that we did not write: each fault on each transport, and a few on each kind.

In manual time an answer is there as soon as its request is complete. So a master waits for `SILENCE` only where no answer
comes, and it may be short. After each fault the next request has its usual answer.
"""

import os
import subprocess

import pytest
from minimalmodbus import (
    MODE_ASCII,
    Instrument,
    InvalidResponseError,
    NoResponseError,
    SlaveDeviceBusyError,
)
from pymodbus import FramerType
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusIOException
from serial import SerialException, serial_for_url

import md3
import mdrive
import mdrobot
import rs434
from conftest import PATIENCE, Drivetwin, ask
from modbus import frame, serial_port

SILENCE = 0.15
"""Seconds after which a master gives up."""

BUSY = 6
"""The exception that the faults are asked for: server device busy."""

REQUEST = {"count": 1, "direction": "request"}
REPLY = {"count": 1, "direction": "reply"}

FAULTS = {
    "drop a request": {"drop": REQUEST},
    "drop a reply": {"drop": REPLY},
    "say nothing": {"mute": True},
    "corrupt a request": {"corrupt": REQUEST},
    "corrupt a reply": {"corrupt": REPLY},
    "truncate a request": {"truncate": REQUEST},
    "truncate a reply": {"truncate": REPLY},
    "duplicate a reply": {"duplicate": REPLY},
    "noise beside a reply": {"noise": REPLY},
    "junk before a reply": {"noise": {"before": True, **REPLY}},
    "delay a reply": {"delay_ms": {"ms": 1500, "spread_ms": 500, "count": 1}},
    "exception": {"exception": {"code": BUSY, "count": 1}},
    "another unit": {"wrong_address": {"count": 1}},
    "another transaction": {"wrong_transaction": {"count": 1}},
    "close in a request": {"close": REQUEST},
    "close in a reply": {"close": REPLY},
}
"""The faults, as the control API takes them."""

LINE = {
    "drop a request": "silence",
    "drop a reply": "silence",
    "say nothing": "silence",
    "corrupt a request": "silence",
    "corrupt a reply": "bad frame",
    "truncate a request": "silence",
    "truncate a reply": "bad frame",
    "duplicate a reply": "usual",
    "noise beside a reply": "usual",
    "junk before a reply": "bad frame",
    "delay a reply": "late",
    "exception": "exception",
    "another unit": "another unit",
}
"""What minimalmodbus sees on a serial line. It reads as many bytes as it expects, and forgets the rest."""

TEXT = {
    "drop a request": "silence",
    "drop a reply": "silence",
    "say nothing": "silence",
    "corrupt a reply": "other text",
    "truncate a reply": "other text",
    "duplicate a reply": "other text",
    "noise beside a reply": "other text",
    "junk before a reply": "other text",
    "delay a reply": "late",
}
"""What a terminal sees. A reply is all that a line causes, with its echo."""

SEEN = {
    "rtu on a pty": LINE,
    # pymodbus looks for a good frame in what it has read, and drops the rest. If there is junk, it may find one or not.
    "rtu over tcp": {fault: seen for fault, seen in LINE.items() if fault != "junk before a reply"}
    | {"corrupt a reply": "silence", "truncate a reply": "silence"},
    "ascii on a pty": LINE,
    "modbus/tcp": {
        "drop a request": "silence",
        "drop a reply": "silence",
        "say nothing": "silence",
        "truncate a request": "silence",
        "truncate a reply": "silence",
        "duplicate a reply": "usual",
        "delay a reply": "late",
        "exception": "exception",
        "another unit": "another unit",
        "another transaction": "another transaction",
        "close in a request": "closed",
        "close in a reply": "closed",
    },
    "commands of a qsb": TEXT,
    "mcode": TEXT | {"close in a request": "closed", "close in a reply": "closed"},
}


class Minimal:
    """minimalmodbus on the pty. It tells apart what is wrong with an answer."""

    bus = "rs485"

    def __init__(self, kind, address, *options, ascii=False):
        self.drivetwin = Drivetwin("--time", "manual", "--fast-boot", *options, kind=kind)
        self.drivetwin.advance(1)
        # Without parity, because the settings of a pty with parity cannot be changed, and each timeout is a change.
        self.port = serial_port(self.drivetwin, parity="N")
        self.master = Instrument(self.port, 1, *([MODE_ASCII] if ascii else []))
        self.address = address

    def ask(self, patience=PATIENCE):
        self.port.timeout = patience
        try:
            return self.master.read_register(self.address)
        except NoResponseError:
            return "silence"
        except SlaveDeviceBusyError:
            return "exception"
        except InvalidResponseError as error:
            return "another unit" if "slave address" in str(error) else "bad frame"
        except TypeError:
            # A character of Modbus ASCII that is not a hexadecimal digit.
            return "bad frame"

    def recover(self):
        """Forgets what is on the line."""
        self.drivetwin.advance(1)
        self.port.reset_input_buffer()

    def close(self):
        self.port.close()
        self.drivetwin.kill()


SKIPPED = {"another unit": "ask for id=1 but got id=2", "another transaction": "ask for transaction_id="}
"""What pymodbus logs of an answer that is not for it."""


class Pymodbus:
    """pymodbus over TCP, with RTU frames or with those of Modbus/TCP."""

    def __init__(self, kind, bus, address, framer):
        self.drivetwin = Drivetwin("--time", "manual", "--fast-boot", kind=kind)
        self.drivetwin.advance(1)
        host, port = self.drivetwin.ports[bus]
        self.client = ModbusTcpClient(host, port=port, framer=framer, timeout=PATIENCE, retries=0)
        self.bus, self.address = bus, address

    def ask(self, patience=PATIENCE):
        assert self.client.connect()
        self.client.comm_params.timeout_connect = patience
        try:
            answer = self.client.read_holding_registers(self.address, count=1)
        except ConnectionException:
            return "closed"
        except ModbusIOException:
            # It skips answers that are not for it, with a line in its log.
            return next((seen for seen, words in SKIPPED.items() if words in self.log.text), "silence")
        if answer.isError():
            return "exception" if answer.exception_code == BUSY else str(answer)
        return answer.registers[0]

    def recover(self):
        """Connects anew, because the stream of the old connection may be broken."""
        self.client.close()
        self.drivetwin.advance(1)

    def close(self):
        self.client.close()
        self.drivetwin.kill()


class Terminal:
    """pyserial on a TCP port with lines of text."""

    def __init__(self, kind, bus, question, answer):
        self.drivetwin = Drivetwin("--time", "manual", "--fast-boot", kind=kind)
        self.bus, self.question, self.answer = bus, question, answer
        self.port = None
        self.drivetwin.advance(5)
        self.recover()

    def ask(self, patience=PATIENCE):
        self.port.timeout = patience
        usual = patience == PATIENCE
        try:
            self.port.write(self.question)
            # MCode answers later than it echoes.
            self.drivetwin.advance(0.1)
            text = self.port.read_until(self.answer) if usual else self.port.read(1000)
        except (SerialException, ConnectionError):
            return "closed"
        if text == self.answer or not text:
            return "usual" if text else "silence"
        return "other text"

    def recover(self):
        """Connects anew, without what came too late."""
        if self.port:
            self.port.close()
        host, port = self.drivetwin.ports[self.bus]
        self.port = serial_for_url(f"socket://{host}:{port}")
        self.drivetwin.advance(1)

    def close(self):
        self.port.close()
        self.drivetwin.kill()


MASTERS = {
    "rtu on a pty": lambda: Minimal("md3", md3.USER_REGISTER),
    "rtu over tcp": lambda: Pymodbus("mdrobot", "rs485", mdrobot.MAX_RPM, FramerType.RTU),
    "ascii on a pty": lambda: Minimal(
        "rs434544", rs434.SPEED, "--set", "TYPE_MODBUS=1", "--set", "BITRATE_MODBUS=4", ascii=True
    ),
    "modbus/tcp": lambda: Pymodbus("mdrive", "modbus", mdrive.MT, FramerType.SOCKET),
    "commands of a qsb": lambda: Terminal("qsb-d", "usb", b"R07\r", b"r 07 00000000 !\r\n"),
    "mcode": lambda: Terminal("mdrive", "mcode", b"PR VM\r", b"PR VM\r\n768000\r\n>"),
}
"""A master on each transport."""


@pytest.fixture(scope="module")
def masters():
    """The masters, each made when it is first asked for."""
    made = {}

    def master(transport):
        if transport not in made:
            made[transport] = MASTERS[transport]()
        return made[transport]

    yield master
    for master in made.values():
        master.close()


@pytest.fixture
def disturb():
    """Sets the faults of a master's bus, and ends them with the test."""
    disturbed = []

    def put(master, faults, bus=None):
        disturbed.append((master, bus or master.bus))
        master.drivetwin.call("PUT", f"/api/buses/{bus or master.bus}/faults", faults)

    yield put
    for master, bus in disturbed:
        master.drivetwin.call("PUT", f"/api/buses/{bus}/faults", {})


@pytest.mark.parametrize(("transport", "fault"), [(name, fault) for name, seen in SEEN.items() for fault in seen])
def test_each_fault_on_each_transport(masters, disturb, caplog, transport, fault):
    master = masters(transport)
    master.log = caplog
    usual = master.ask()
    assert not isinstance(usual, str) or usual == "usual"
    disturb(master, FAULTS[fault])
    before = master.drivetwin.seconds()
    seen = master.ask(SILENCE)
    expected = SEEN[transport][fault]
    if expected == "late":
        assert 1.5 <= master.drivetwin.seconds() - before < 2.2
        # A terminal advances the time by itself, and may have given up.
        assert seen in (usual, "silence")
    else:
        assert seen == (usual if expected == "usual" else expected)
    disturb(master, {})
    master.recover()
    assert master.ask() == usual


def bits(one, other):
    """The number of bits in which two texts of the same length differ."""
    return sum((a ^ b).bit_count() for a, b in zip(one, other, strict=True))


BYTES = {
    "corrupt a reply": lambda usual, got: len(got) == len(usual) and bits(got, usual) == 1,
    "truncate a reply": lambda usual, got: 0 < len(got) < len(usual) and usual.startswith(got),
    "duplicate a reply": lambda usual, got: got == usual * 2,
    "junk before a reply": lambda usual, got: len(usual) < len(got) <= len(usual) + 8 and got.endswith(usual),
    "noise beside a reply": lambda usual, got: len(usual) < len(got) <= len(usual) + 8 and usual in got,
}
"""What a socket reads of a disturbed reply."""

QUESTIONS = {
    "rtu over tcp": (frame(1, 3, 0, mdrobot.MAX_RPM, 0, 1), frame(1, 3, 2, 3000 >> 8, 3000 & 0xFF)),
    "modbus/tcp": (bytes([0, 7, 0, 0, 0, 6, 1, 3, 0, mdrive.MT, 0, 1]), bytes([0, 7, 0, 0, 0, 5, 1, 3, 2, 0, 0])),
}


@pytest.mark.parametrize("fault", BYTES)
@pytest.mark.parametrize("transport", QUESTIONS)
def test_the_bytes_of_a_disturbed_reply(masters, disturb, transport, fault):
    master = masters(transport)
    question, usual = QUESTIONS[transport]
    with master.drivetwin.socket(master.bus) as sock:
        assert ask(sock, question, len(usual)) == usual
        disturb(master, FAULTS[fault])
        sock.sendall(question)
        sock.settimeout(SILENCE)
        got = b""
        try:
            while piece := sock.recv(1000):
                got += piece
        except TimeoutError:
            pass
        assert BYTES[fault](usual, got), got.hex(" ")
        # The stream goes on, as that of a peer that failed in the middle of a write would.
        sock.settimeout(PATIENCE)
        assert ask(sock, question, len(usual)) == usual
    # On a line the other master has heard these answers, too.
    master.recover()


def rtu(kind, address):
    return lambda: Pymodbus(kind, "rs485", address, FramerType.RTU)


def modbus_tcp(kind):
    return lambda: Pymodbus(kind, "modbus", mdrive.MT, FramerType.SOCKET)


def qsb(kind):
    return lambda: Terminal(kind, "usb", b"R07\r", b"r 07 00000000 !\r\n")


KINDS = {
    "md3": rtu("md3", md3.USER_REGISTER),
    "md3-low": rtu("md3-low", md3.USER_REGISTER),
    "qsb-d": qsb("qsb-d"),
    "qsb-m": qsb("qsb-m"),
    "qsb-s": qsb("qsb-s"),
    "rs434544": rtu("rs434544", rs434.SPEED),
    "rs434546": rtu("rs434546", rs434.SPEED),
    "mdrobot": rtu("mdrobot", mdrobot.MAX_RPM),
    "mdrive": modbus_tcp("mdrive"),
    "mdrive-hybrid": modbus_tcp("mdrive-hybrid"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_silent_twice_and_then_answers(caplog, kind):
    master = KINDS[kind]()
    try:
        usual = master.ask()
        twice = {"drop": {"count": 2, "drive": kind}, "delay_ms": 250}
        master.log = caplog
        master.drivetwin.call("PUT", f"/api/buses/{master.bus}/faults", twice)
        for left in (1, 0):
            assert master.ask(SILENCE) == "silence"
            (drop,) = [bus["faults"]["drop"] for bus in buses(master) if bus["name"] == master.bus]
            assert drop == {"count": left, "drive": kind}
        before = master.drivetwin.seconds()
        assert master.ask() == usual
        assert master.drivetwin.seconds() - before >= 0.25
        lost = [entry for entry in received(master, kind) if entry["verdict"] == "lost"]
        assert [entry["reason"] for entry in lost] == ["by a fault, the request was dropped"] * 2
    finally:
        master.close()


def buses(master):
    return master.drivetwin.call("GET", "/api/buses")


def received(master, drive):
    """The journal of the drive."""
    return master.drivetwin.call("GET", f"/api/drives/{drive}/received")["requests"]


@pytest.mark.parametrize("transport", ["rtu over tcp", "modbus/tcp"])
def test_a_rule_covers_only_what_it_names(masters, disturb, transport):
    master = masters(transport)
    kind = master.drivetwin.kind
    usual = master.ask()
    name = received(master, kind)[-1]["registers"][0]["name"]
    for covered, rule in [
        (True, {"function": 3, "register": name, "drive": kind, "direction": "request"}),
        (True, {"register": name}),
        (False, {"function": 6}),
        (False, {"register": {"mdrobot": "P_GAIN", "mdrive": "MA"}.get(kind)}),
    ]:
        disturb(master, {"exception": {"code": BUSY, "count": 1, **rule}})
        assert master.ask() == ("exception" if covered else usual), rule
        disturb(master, {})


@pytest.mark.parametrize("fault", ["corrupt a request", "truncate a request"])
@pytest.mark.parametrize("transport", ["rtu on a pty", "rtu over tcp", "ascii on a pty", "modbus/tcp"])
def test_each_request_with_a_fault_is_in_the_journal(masters, disturb, caplog, transport, fault):
    master = masters(transport)
    master.log = caplog
    kind = master.drivetwin.kind
    clause = f"by a fault, the request was {fault.split()[0].removesuffix('e')}ed"

    def told():
        return sum(clause in str(entry["reason"]) for entry in received(master, kind))

    before = told()
    disturb(master, FAULTS[fault])
    master.ask(SILENCE)
    disturb(master, {})
    master.recover()
    assert told() > before
    usual = master.ask()
    assert not isinstance(usual, str) or usual == "usual"
    assert received(master, kind)[-1]["verdict"] == "done"


def test_the_journal_says_why_nothing_came(masters, disturb, caplog):
    master = masters("modbus/tcp")
    master.log = caplog
    for faults, verdict, reason in [
        ({"drop": REQUEST}, "lost", "by a fault, the request was dropped"),
        ({"mute": True}, "done", "by a fault, the reply was not delivered"),
        ({"truncate": REPLY}, "done", "by a fault, the reply was truncated"),
        ({"close": REPLY}, "done", "by a fault, the reply was cut off by the end of the connection"),
        ({"exception": {"count": 1, "code": BUSY}}, "refused", "by a fault (06)"),
    ]:
        disturb(master, faults)
        master.ask(SILENCE)
        last = received(master, "mdrive")[-1]
        assert (last["verdict"], last["reason"], last["text"]) == (verdict, reason, "read MT")
        disturb(master, {})
        master.recover()


SCENARIO = """
[[drive]]
name = "x"
kind = "md3"
fast_boot = true
listen = ["tcp:127.0.0.1:0"]

[[drive]]
name = "m"
kind = "mdrive"
fast_boot = true

[[scenario]]
steps = [
    { when = { drive = "x", register = "UserRegister", value = 7 }, bus = "x.rs485", faults = { drop = { count = 1 } } },
    { after_ms = 500, drive = "x", fault = "over_temperature" },
    { when = { drive = "m", register = "MT" }, bus = "m.modbus", faults = { exception = { code = 6, count = 1 } } },
]
"""


def test_a_scenario_acts_when_a_master_writes(tmp_path):
    """Its trace is replayed without it."""
    file, trace = tmp_path / "bench.toml", tmp_path / "bench.trace"
    file.write_text(SCENARIO)
    drivetwin = Drivetwin("--time", "manual", "--record", trace, kind=file)
    clients = []
    try:
        drivetwin.advance(1)

        def client(drive, port, framer):
            host, number = drivetwin.drives[drive][port]
            clients.append(ModbusTcpClient(host, port=number, framer=framer, timeout=SILENCE, retries=0))
            assert clients[-1].connect()
            return clients[-1]

        x, m = client("x", "rs485", FramerType.RTU), client("m", "modbus", FramerType.SOCKET)
        x.comm_params.timeout_connect = PATIENCE
        for value in (6, 7):
            assert not x.write_register(md3.USER_REGISTER, value).isError()
        x.comm_params.timeout_connect = SILENCE
        with pytest.raises(ModbusIOException):
            x.read_holding_registers(md3.USER_REGISTER)
        x.comm_params.timeout_connect = m.comm_params.timeout_connect = PATIENCE
        assert x.read_holding_registers(md3.USER_REGISTER).registers == [7]
        assert not drivetwin.call("GET", "/api/drives/x")["faults"]["over_temperature"]
        drivetwin.advance(0.6)
        assert drivetwin.call("GET", "/api/drives/x")["faults"]["over_temperature"]
        assert not m.write_registers(mdrive.MT, [5]).isError()
        assert m.read_holding_registers(mdrive.MT).exception_code == BUSY
        assert m.read_holding_registers(mdrive.MT).registers == [5]
    finally:
        for client in clients:
            client.close()
        assert drivetwin.stop() == 0
        drivetwin.kill()
    replay = subprocess.run([os.environ["DRIVETWIN"], "replay", trace], capture_output=True, text=True, timeout=PATIENCE)
    assert (replay.returncode, replay.stderr) == (0, "")
