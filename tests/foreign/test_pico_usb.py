"""An emulated Pico at its USB cable: a master on the port of the bus, and `drivetwin attach` on the control port.

The images and the UF2 are in the folder in which cargo builds; the check "emulated Pico at its USB cable" brings them.
"""

import contextlib
import json
import os
import random
import re
import select
import socket
import subprocess
import time
from pathlib import Path

import pytest
import serial
from minimalmodbus import Instrument, ModbusException, NoResponseError

from conftest import PATIENCE, host_and_port
from md3 import DEFAULTS, EEPROM_CONTROL, MOTION_CONTROL, USER_REGISTER
from test_attach import Program

pytestmark = pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning", "ignore:setName:DeprecationWarning")

ROOT = Path(__file__).parents[2]
TARGET = Path(os.environ.get("DRIVETWIN", "target/debug/drivetwin")).parents[1]
IMAGES = TARGET / "thumbv6m-none-eabi" / "firmware"
UF2 = TARGET / "drivetwin-pico.uf2"

D = "/api/drives/board"
PIN_FUNCTION = 0x09
MOVE_STEPS = 0x12
SPEED = 0x14
"""PinFunctionAndPolarity, MoveSteps and Speed, pairs with the high word first (7.8, 7.16, 7.17)."""
MOVE = 1 << 0
FAULT = 1 << 15
"""Bits of MotionControl (7.15)."""
MOVE_BY_PIN = 0b0001 << 4
INHIBIT_BY_PIN = 2 << 8
"""J2.4 going low starts a move, and while J2.3 is low no motion from Modbus runs (7.8)."""
SAVE = 1
PASSED, FAILED = 0x9A00, 0xF100
"""EEPROMControl: save all, and the status of the check sum (7.20)."""


class Pico:
    """An emulated Pico, with a computer at its cable."""

    def __init__(self, image):
        command = ["node", ROOT / "tests/pico/serve.mjs", image, "--usb"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        said, deadline = b"", time.monotonic() + PATIENCE
        while not (found := re.search(rb"bus rfc2217://(\S+), control (\S+)\n", said)):
            readable, _, _ = select.select([self.process.stdout], [], [], deadline - time.monotonic())
            piece = os.read(self.process.stdout.fileno(), 4096) if readable else b""
            assert piece, f"the board did not start: {said.decode()}"
            said += piece
        self.bus, self.control = (place.decode() for place in found.groups())

    def world(self, event):
        """An event of tests/pico/script.mjs that happens now."""
        self.process.stdin.write(event.encode() + b"\n")
        self.process.stdin.flush()

    def port(self, baudrate=9600, parity="E", timeout=PATIENCE):
        """The port of the bus, as a program opens it."""
        return serial.serial_for_url(f"rfc2217://{self.bus}", baudrate, parity=parity, timeout=timeout)

    def end(self):
        self.process.stdin.close()
        self.process.wait(PATIENCE)
        self.process.stdout.close()


class Attached(Program):
    """`drivetwin attach` of a Pico."""

    def __init__(self, pico, *options):
        super().__init__("attach", f"tcp:{pico.control}", "--bus", f"rfc2217:{pico.bus}", *options)

    def drive(self):
        return self.get(D)

    def do(self, method, path, body=None):
        status, answer = self.call(method, D + path, body)
        assert status == 204, answer

    def until(self, is_so):
        """The state of the drive, as soon as it is such."""
        deadline = time.monotonic() + PATIENCE
        while not is_so(state := self.drive()):
            assert time.monotonic() < deadline, state
        return state


class Master(Instrument):
    """minimalmodbus on the port of the bus."""

    def ready(self):
        """Waits until the drive answers: it has a start-up of 2.5 s, and of 7.5 s if its memory is bad (2, 7.20)."""
        self.serial.timeout, deadline = 1, time.monotonic() + PATIENCE
        while True:
            # An emulator that is slow may pause within a reply.
            with contextlib.suppress(ModbusException):
                self.read_register(0)
                break
            assert time.monotonic() < deadline, "the drive does not answer"
        self.serial.timeout = PATIENCE
        return self

    def write(self, register, value):
        self.write_register(register, value, functioncode=6)

    def write_pair(self, register, value):
        self.write(register, value >> 16)
        self.write(register + 1, value & 0xFFFF)

    def is_silent(self):
        self.serial.timeout = 0.5
        try:
            self.read_register(0)
        except NoResponseError:
            return True
        finally:
            self.serial.timeout = PATIENCE
        return False


@pytest.fixture
def things():
    """What ends with the test, the last one first."""
    with contextlib.ExitStack() as things:
        yield things


@pytest.fixture
def start(things):
    """Starts a Pico with an image, and attaches it."""

    def start(image, *options):
        pico = Pico(image)
        things.callback(pico.end)
        attached = Attached(pico, *options)
        things.callback(lambda: attached.process.returncode is None and attached.end())
        return pico, attached

    return start


@pytest.fixture
def md3(start, things):
    """An MD3 that answers, its API, and a master."""
    pico, attached = start(IMAGES / "md3")
    return pico, attached, Master(things.enter_context(pico.port()), 1).ready()


def test_registers_are_the_same_on_the_bus_and_by_name(md3):
    _, attached, master = md3
    assert master.read_registers(0, 32) == DEFAULTS
    registers = attached.drive()["registers"]
    assert (registers["DeviceAddress"], registers["MoveSteps"], registers["Speed"]) == (1, 10_000, 5_000)
    master.write_pair(SPEED, 0x2345)
    master.write(USER_REGISTER, 0xFFFF)
    registers = attached.drive()["registers"]
    assert (registers["Speed"], registers["UserRegister"]) == (0x2345, 0xFFFF)
    attached.do("PUT", "/registers/UserRegister", {"value": 0x1234})
    attached.do("PUT", "/registers/Speed", {"value": 7_000})
    assert master.read_register(USER_REGISTER) == 0x1234
    assert master.read_registers(SPEED, 2) == [0, 7_000]


def test_pins_start_and_stop_a_move_as_a_wire_does(md3):
    _, attached, master = md3
    master.write(PIN_FUNCTION, MOVE_BY_PIN | INHIBIT_BY_PIN)
    master.write_pair(SPEED, 500)
    master.write_pair(MOVE_STEPS, 1_000_000)
    attached.do("PUT", "/pins/J2.4", {"level": "low"})
    attached.until(lambda state: state["motion"]["moving"] and state["motion"]["position"] > 0)
    assert master.read_register(MOTION_CONTROL) == MOVE
    attached.do("PUT", "/pins/J2.3", {"level": "low"})
    state = attached.until(lambda state: not state["motion"]["moving"])
    assert 0 < state["motion"]["position"] < 1_000_000
    assert (state["pins"]["J2.3"], state["pins"]["J2.4"]) == ("low", "low")
    assert master.read_register(MOTION_CONTROL) == 0
    # Nothing pulls them low any more.
    for pin in ("J2.3", "J2.4"):
        attached.do("PUT", f"/pins/{pin}", {"level": "open"})
    pins = attached.drive()["pins"]
    assert (pins["J2.3"], pins["J2.4"]) == ("high", "high")


def test_a_rack_has_the_board_beside_an_emulated_drive(things, tmp_path):
    pico = Pico(IMAGES / "md3")
    things.callback(pico.end)
    file, record = tmp_path / "rig.toml", tmp_path / "rig.trace"
    file.write_text(
        f"[[drive]]\nname = 'pico'\nboard = 'tcp:{pico.control}'\nbus = 'rfc2217:{pico.bus}'\nkind = 'md3'\n"
        "[[drive]]\nname = 'x'\nkind = 'md3'\n"
    )
    rack = Program("run", file, "--control", "127.0.0.1:0", "--record", record)
    things.callback(lambda: rack.process.returncode is None and rack.end())
    for name in ("pico", "x"):
        assert rack.call("PUT", f"/api/drives/{name}/pins/J2.2", {"level": "low"})[0] == 204
        assert rack.get(f"/api/drives/{name}")["pins"]["J2.2"] == "low"
    master = Master(things.enter_context(pico.port()), 1).ready()
    # IOPortData (0x0A, 7.9) has the low input.
    registers = master.read_registers(0, 32)
    assert [n for n in range(32) if registers[n] != DEFAULTS[n]] == [0x0A]
    # A board without power reports nothing: its events have to arrive before. Its serial port may split the request,
    # but it sends the reply at once.
    reply = "< tx 01 03 40 "
    deadline = time.monotonic() + PATIENCE
    while reply.encode() not in rack.call("GET", "/api/trace")[1]:
        assert time.monotonic() < deadline, "the board does not report the reply"
    # The board loses its power while the bench runs, and is back.
    pico.world("power off")
    pico.world("power on")
    deadline = time.monotonic() + PATIENCE
    while rack.call("PUT", "/api/drives/pico/registers/UserRegister", {"value": 7})[0] != 204:
        assert rack.get("/api/drives/x")["pins"]["J2.2"] == "low"
        assert time.monotonic() < deadline, "the board does not come back"
    assert rack.end() == 0
    lines = [line.split(maxsplit=2) for line in record.read_text().splitlines() if line[:1].isdigit()]
    times = [float(line[0]) for line in lines]
    assert times == sorted(times)
    assert [line[1] for line in lines if line[-1] == "> pin J2.2 low"] == ["pico", "x"]
    assert any(line[1] == "pico" and line[-1].startswith(reply) for line in lines)


def test_a_fault_ends_a_move(md3):
    _, attached, master = md3
    master.write_pair(SPEED, 500)
    master.write(MOTION_CONTROL, MOVE)
    attached.until(lambda state: state["motion"]["moving"])
    attached.do("PUT", "/faults/over_temperature")
    state = attached.until(lambda state: not state["motion"]["moving"])
    assert state["faults"] == {"over_temperature": True, "over_current": False}
    assert master.read_register(MOTION_CONTROL) == FAULT
    attached.do("DELETE", "/faults/over_temperature")
    # 7.15: writing 1 to the bit clears the fault.
    master.write(MOTION_CONTROL, FAULT)
    assert master.read_register(MOTION_CONTROL) == 0


def test_what_is_not_saved_is_lost_with_the_power(md3):
    _, attached, master = md3
    master.write(USER_REGISTER, 0x1111)
    master.write(EEPROM_CONTROL, SAVE)
    master.write(USER_REGISTER, 0x2222)
    attached.do("POST", "/power", {"action": "off"})
    assert attached.drive()["powered"] is False
    assert master.is_silent()
    attached.do("POST", "/power", {"action": "on"})
    assert master.ready().read_register(USER_REGISTER) == 0x1111
    master.write(USER_REGISTER, 0x3333)
    attached.do("POST", "/power", {"action": "cycle"})
    assert master.ready().read_register(USER_REGISTER) == 0x1111
    assert master.read_register(EEPROM_CONTROL) == PASSED


def test_power_that_is_cut_in_a_save(md3):
    _, attached, master = md3
    master.write(USER_REGISTER, 0x1111)
    master.write(EEPROM_CONTROL, SAVE)
    master.write(USER_REGISTER, 0x2222)
    attached.do("POST", "/power", {"action": "cut"})
    assert attached.drive()["powered"] is True
    master.serial.timeout = 0.5
    # The power may fail in the reply.
    with contextlib.suppress(ModbusException):
        master.write(EEPROM_CONTROL, SAVE)
    attached.until(lambda state: not state["powered"])
    attached.do("POST", "/power", {"action": "on"})
    master.ready()
    user, status = master.read_register(USER_REGISTER), master.read_register(EEPROM_CONTROL)
    assert (user, status) in [(0x1111, PASSED), (0x2222, PASSED), (0, FAILED)]
    assert attached.drive()["registers"]["UserRegister"] == user


def test_the_position_and_the_pulses_are_those_of_the_move(md3):
    _, attached, master = md3
    master.write_pair(MOVE_STEPS, 1_500)
    master.write(MOTION_CONTROL, MOVE)
    attached.until(lambda state: state["motion"]["position"] == 1_500 and not state["motion"]["moving"])
    # The recording is complete until half a second before now.
    until = time.monotonic() + PATIENCE
    while (rises := step_pulses(attached.call("GET", "/api/trace?format=vcd")[1].decode())) < 1_500:
        assert time.monotonic() < until, rises
    assert rises == 1_500
    (board,) = attached.get("/api/bench")["boards"]
    assert {name: board["image"][name] for name in ("lost_inputs", "lost_events", "failures")} == {
        "lost_inputs": 0,
        "lost_events": 0,
        "failures": 0,
    }


def step_pulses(vcd):
    """Number of rising edges of STEP in waveforms."""
    (code,) = re.findall(r"\$var wire 1 (\S+) STEP \$end", vcd)
    return len(re.findall(rf"^1{re.escape(code)}$", vcd, re.M))


def test_a_wrong_rate_gets_no_answer(md3):
    _, attached, master = md3
    spoiled = attached.drive()["ports"]["rs485"]["spoiled"]
    master.serial.baudrate = 19_200
    assert master.is_silent()
    assert attached.until(lambda state: state["ports"]["rs485"]["spoiled"] > spoiled)
    master.serial.baudrate = 9_600
    assert master.ready().read_register(0) == 1


def test_dtr_resets_a_qsb(start, things):
    pico, attached = start(IMAGES / "qsb-d")
    port = things.enter_context(pico.port(230_400, "N"))

    def say(command):
        port.write(command + b"\r")
        return port.read_until(b"!\r\n")

    # The banner after the opening is purged by pyserial, or comes first.
    port.timeout, until = 0.5, time.monotonic() + PATIENCE
    while not say(b"W0001").endswith(b"w 00 00000001 !\r\n"):
        assert time.monotonic() < until, "the drive does not answer"
    port.timeout = PATIENCE
    assert port.read(port.in_waiting) == b""
    assert say(b"R00") == b"r 00 00000001 !\r\n"
    assert attached.drive()["registers"]["Mode"] == 1
    port.dtr = False
    port.dtr = True
    assert port.read_until(b"!\r\n") == b"QSB-D  0E!\r\n"
    assert say(b"R00") == b"r 00 00000000 !\r\n"


def test_the_files_have_the_frames(start, things, tmp_path):
    files = [tmp_path / name for name in ("x.trace", "x.vcd", "x.pcapng")]
    options = [word for pair in zip(("--record", "--vcd", "--pcap"), files) for word in pair]
    pico, attached = start(IMAGES / "md3", *options)
    assert attached.ready["devices"][0]["ports"] == {"rs485": [f"rfc2217:{pico.bus}"]}
    Master(things.enter_context(pico.port()), 1).ready()
    # Function 3, DeviceAddress, which is 1 (7.1).
    request, reply = "> rx 01 03 00 00 00 01 84 0A\n", "< tx 01 03 02 00 01 79 84\n"
    until = time.monotonic() + PATIENCE
    while reply.encode() not in attached.call("GET", "/api/trace")[1]:
        assert time.monotonic() < until, "the reply is not in the trace"
    assert attached.end() == 0
    text = files[0].read_text()
    assert request in text and reply in text and text.endswith(" end\n")
    assert b"read\\x20DeviceAddress" in files[1].read_bytes()
    assert b"read DeviceAddress" in files[2].read_bytes()


def test_a_board_becomes_another_kind_and_remains_it(start, things):
    pico, attached = start(UF2)
    with pico.port() as port:
        assert Master(port, 1).ready().read_registers(0, 32) == DEFAULTS
    status, answer = attached.call("PUT", f"{D}/kind", {"kind": "qsb-m"})
    assert status == 200, answer
    assert attached.drive()["kind"] == "qsb-m"
    (bus,) = attached.get("/api/bench")["buses"]
    assert (bus["name"], bus["line"], bus["listen"]) == ("usb", "230400 8N1", [f"rfc2217:{pico.bus}"])
    says_who_it_is(pico)
    # It is kept when the board has no power.
    pico.world("power off")
    away(attached)
    pico.world("power on")
    assert back(attached)["kind"] == "qsb-m"
    says_who_it_is(pico)
    status, answer = attached.call("PUT", f"{D}/kind", {"kind": "md3"})
    assert status == 200, answer
    with pico.port() as port:
        assert Master(port, 1).ready().read_registers(0, 32) == DEFAULTS


def test_an_image_of_one_kind_remains_it(start):
    _, attached = start(IMAGES / "md3")
    status, answer = attached.call("PUT", f"{D}/kind", {"kind": "qsb-d"})
    sentence = "the image of this board is one kind only, md3; flash another image"
    assert (status, json.loads(answer)["detail"]) == (409, sentence)
    assert attached.drive()["kind"] == "md3"


def test_a_computer_that_sleeps_and_a_board_that_starts_again_are_said_in_a_sentence(start):
    pico, attached = start(IMAGES / "md3")
    attached.do("PUT", "/registers/UserRegister", {"value": 1_234})
    for event, user in [("suspend", 1_234), ("unplug", 1_234)]:
        pico.world(f"usb {event}")
        assert f"the board at tcp:{pico.control} cannot be reached" in away(attached)
        pico.world("usb resume" if event == "suspend" else "usb plug")
        assert back(attached)["registers"]["UserRegister"] == user
    # The watchdog starts it, and what was not saved is lost.
    pico.world("hang")
    assert f"the board at tcp:{pico.control} cannot be reached" in away(attached)
    assert back(attached)["registers"]["UserRegister"] == 0


def away(attached):
    """The reason why the board cannot be reached, as soon as it cannot be."""
    deadline = time.monotonic() + PATIENCE
    while (call := attached.call("GET", D))[0] == 200:
        assert time.monotonic() < deadline, "it is there"
    problem = json.loads(call[1])
    assert problem["status"] == 503, problem
    return problem["detail"]


def back(attached):
    """The state of the drive, as soon as the board is back."""
    deadline = time.monotonic() + PATIENCE
    while (call := attached.call("GET", D))[0] != 200:
        assert time.monotonic() < deadline, call
    return json.loads(call[1])


def says_who_it_is(pico):
    """A QSB-M says its version, hardware 11h and firmware 0Eh."""
    with pico.port(230_400, "N", timeout=0.5) as port:
        until = time.monotonic() + PATIENCE
        while True:
            port.write(b"R14\r")
            if port.read_until(b"!\r\n").endswith(b"r 14 0000110E !\r\n"):
                return
            assert time.monotonic() < until, "the drive does not answer"


def test_garbage_on_both_ports_does_no_harm(start, things):
    pico = Pico(IMAGES / "md3")
    things.callback(pico.end)
    chance = random.Random(26)
    for _ in range(3):
        with socket.create_connection(host_and_port(pico.control), PATIENCE) as stranger:
            stranger.sendall(chance.randbytes(5_000))
    attached = Attached(pico)
    things.callback(lambda: attached.process.returncode is None and attached.end())
    with pico.port() as port:
        port.write(chance.randbytes(2_000))
        pico.world("usb garbage")
        assert Master(port, 1).ready().read_registers(0, 32) == DEFAULTS
        # A second program takes the control port, and says what is no message; then it goes away.
        with socket.create_connection(host_and_port(pico.control), PATIENCE) as stranger:
            stranger.sendall(chance.randbytes(5_000))
        assert back(attached)["registers"]["MoveSteps"] == 10_000
        # The cable is pulled while the drive moves: the drive goes on.
        master = Master(port, 1).ready()
        master.write_pair(MOVE_STEPS, 1_000_000)
        master.write(MOTION_CONTROL, MOVE)
    before = attached.until(lambda state: state["motion"]["position"] > 0)["motion"]["position"]
    pico.world("usb unplug")
    away(attached)
    pico.world("usb plug")
    motion = back(attached)["motion"]
    assert motion["moving"] and motion["position"] > before


BOTH = """
def test_a_move_and_its_pulses(twin):
    x = twin("md3", fast_boot=True, set={"MoveSteps": 1_500})
    assert x.ask(bytes.fromhex("01 06 00 11 00 01 18 0F")) == bytes.fromhex("01 06 00 11 00 01 18 0F")
    while x.motion.moving or not x.motion.position:
        twin.bench.wait(0.25)
    assert (x.motion.position, len(x.pulses())) == (1_500, 1_500)


def test_a_pin_starts_a_move(twin):
    x = twin("md3", fast_boot=True, set={"PinFunctionAndPolarity": 0b0001 << 4})
    assert (x.pins["J2.4"], x.motion.moving) == ("high", False)
    x.pins["J2.4"] = "low"
    while not x.motion.position:
        twin.bench.wait(0.25)
    assert x.motion.moving


def test_a_cut_in_a_save(twin):
    x = twin("md3", fast_boot=True)
    x.registers["UserRegister"] = 1234
    x.power("cut")
    x.registers["EEPROMControl"] = 1
    while x.powered:
        twin.bench.wait(0.1)
    x.power("on")
    twin.bench.wait(8.0)
    assert x.registers["UserRegister"] in (0, 1234)


def test_a_qsb_counts(twin):
    x = twin("qsb-d", fast_boot=True)
    assert b"r 14 0000100E !" in x.ask(b"R14\\r")
    x.encoder(400, hz=1_000)
    twin.bench.wait(1.0)
    assert abs(x.registers["ReadEncoder"]) == 400
"""
"""Tests that need nothing that a board cannot do."""


def test_tests_with_the_package_on_a_process_and_on_a_board(things, tmp_path):
    """The same tests, side by side: what a board cannot do is skipped, with the reason."""
    pico = Pico(UF2)
    things.callback(pico.end)
    (tmp_path / "test_both.py").write_text(BOTH)
    board = ["--drivetwin-board", f"tcp:{pico.control}", "--drivetwin-bus", f"rfc2217:{pico.bus}"]

    def outcomes(*options):
        """Names of the tests, by what became of them."""
        files = ["examples/pytest", tmp_path / "test_both.py"]
        command = [os.environ["DRIVETWIN_PYTEST"], "-p", "no:cacheprovider", "-vrs", *files, *options]
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=10 * PATIENCE)
        assert done.returncode == 0, done.stdout + done.stderr
        found = {"PASSED": set(), "SKIPPED": set()}
        for name, outcome in re.findall(r"::(test_\w+) (PASSED|SKIPPED)", done.stdout):
            found[outcome].add(name)
        return found["PASSED"], found["SKIPPED"], done.stdout

    names = set(re.findall(r"^def (test_\w+)", BOTH, re.M))
    need_a_bench = {"test_homing_finds_the_switch", "test_a_power_cut_in_a_save", "test_a_move_takes_its_time"}
    passed, skipped, _ = outcomes()
    assert (passed, skipped) == (names | {"test_speed"} | need_a_bench, set())
    passed, skipped, said = outcomes(*board)
    assert (passed, skipped) == (names | {"test_speed"}, need_a_bench)
    assert said.count("not on a board: a board is one drive") == 2, said
    assert "not on a board: drivetwin.run emulates its drives" in said
