"""A board: the same methods as of an emulated drive. The board is the program `virtual-board`, which `VIRTUAL_BOARD` names."""

import json
import os
import socket
import subprocess
import time
import urllib.request
from pathlib import Path

import pytest
from modbus import write

import drivetwin

PROGRAM = os.environ.get("VIRTUAL_BOARD")
EXAMPLES = Path(__file__).parent.parent.parent / "examples" / "pytest"

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.skipif(PROGRAM is None, reason="VIRTUAL_BOARD names no program")


class VirtualBoard:
    """A board in memory: the places of its two ports."""

    def __init__(self, kind):
        self._process = subprocess.Popen(
            [PROGRAM, kind, "fast"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        _, control, _, bus = self._process.stdout.readline().split()
        self.control, self.bus = f"tcp:{control}", f"tcp:{bus}"

    def attach(self, **options):
        return drivetwin.attach(self.control, bus=self.bus, **options)

    def end(self):
        self._process.stdin.close()
        self._process.wait(30)
        self._process.stdout.close()


@pytest.fixture
def virtual():
    made = []

    def virtual(kind="md3"):
        made.append(VirtualBoard(kind))
        return made[-1]

    yield virtual
    for board in made:
        board.end()


def test_registers_pins_and_power(virtual):
    with virtual().attach() as bench:
        assert (len(bench), list(bench), bench.time) == (1, ["board"], "real")
        assert bench.board.startswith("tcp:127.0.0.1:")
        x = bench["board"]
        assert (x.kind, x.powered, x.ports) == ("md3", True, ["rs485"])
        x.registers["Speed"] = 9_000
        x.registers["SpeedLow"] = 9_001
        assert (x.registers["Speed"], x.registers["SpeedLow"]) == (9_001, 9_001)
        assert dict(x.registers.items())["Speed"] == 9_001
        x.pins["J2.2"] = "low"
        assert (x.pins["J2.2"], dict(x.pins.items())["J2.2"]) == ("low", "low")
        x.pins["J2.2"] = "open"
        assert x.pins["J2.2"] == "high"
        x.fault("over_temperature")
        assert x.faults == {"over_temperature": True, "over_current": False}
        x.clear("over_temperature")
        x.power("cycle")
        bench.wait(0.1)
        assert x.registers["Speed"] == 5_000
        assert set(x.leds) == {"D5", "D6"}


def test_a_move_and_its_pulses(virtual):
    with virtual().attach() as bench:
        x = bench["board"]
        x.power("cycle")
        bench.wait(0.1)
        x.registers["MoveSteps"] = 100
        begin = bench.now
        request = write(1, 0x11, 1)
        assert x.ask(request) == request
        while x.motion.moving or x.motion.position != 100:
            assert bench.now < begin + 30
        assert len(x.pulses()) == 100
        assert x.motion.position == 100
        at, position, _ = bench.history(x)[-1]
        assert position == 100 and at > begin
        assert "> rx 01 06 00 11 00 01 18 0F\n" in bench.trace()
        assert b"write MotionControl" in bench.pcapng() and b"$enddefinitions" in bench.vcd()


def test_names_and_values_have_the_sentences_of_a_bench(virtual):
    def sentences(x):
        for act in (
            lambda: x.registers["Sped"],
            lambda: x.registers.__setitem__("DeviceAddress", 300),
            lambda: x.registers.__setitem__("ProductInformation", 1),
            lambda: x.pins.__setitem__("J2.22", "low"),
            lambda: x.pins.__setitem__("D5", "low"),
            lambda: x.pins.__setitem__("J2.2", 2.5),
            lambda: x.pins["J2.22"],
            lambda: x.pulse("J2.2", 0, 10),
            lambda: x.encoder(0, 10),
            lambda: x.fault("over_temprature"),
            lambda: x.power("up"),
            lambda: x.line("usb"),
        ):
            with pytest.raises(drivetwin.Error) as raised:
                act()
            yield type(raised.value), str(raised.value)

    emulated = drivetwin.Bench().add("md3", name="board", fast_boot=True)
    with virtual().attach() as bench:
        assert list(sentences(bench["board"])) == list(sentences(emulated))


def test_what_a_board_cannot_do(virtual):
    with virtual().attach(control="127.0.0.1:0") as bench:
        x = bench["board"]
        for act, sentence in (
            (lambda: bench.advance(1), "a board has no virtual time"),
            (lambda: bench.run_until(1), "a board has no virtual time"),
            (lambda: setattr(bench, "time", "manual"), "a board has no virtual time"),
            (lambda: bench.add("md3"), "a board is one drive"),
            (lambda: bench.motor("board", steps_per_rev=200), "a board is one drive"),
            (lambda: bench.switch("m", closed={"below_rev": 1}, to="board.J2.2"), "a board is one drive"),
            (lambda: bench.scenario([{"at_ms": 1, "drive": "board", "power": "cut"}]), "a scenario is played by a bench"),
            (lambda: x.line(), "the line of a board is a real one"),
            (lambda: x.received(), "a board does not report the outcomes"),
            (lambda: x.port("rs485"), "the port of a board is a real one"),
        ):
            with pytest.raises(drivetwin.NotOnBoard, match=sentence):
                act()
        # The control API says the same.
        request = urllib.request.Request(
            f"{bench.control}/api/time/advance",
            data=b'{"seconds": 1}',
            headers={"Content-Type": "application/json"},
        )
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(request)
        with pytest.raises(drivetwin.NotOnBoard) as raised:
            bench.advance(1)
        assert json.loads(refused.value.read())["detail"] == str(raised.value)


def test_a_master_has_the_port_of_the_bus(virtual):
    serial = pytest.importorskip("serial")
    board = virtual("qsb-d")
    with board.attach() as bench:
        x = bench["board"]
        place = board.bus.removeprefix("tcp:")
        host, number = place.split(":")
        assert (x.uri(), x.url()) == (board.bus, f"socket://{place}")
        with pytest.raises(drivetwin.Error, match="has no pty"):
            x.pty
        # As with its real USB, opening the port resets a QSB, which then sends its version. pySerial drops characters
        # that are there when it has opened a port, so a plain socket reads these.
        with socket.create_connection((host, int(number)), timeout=60) as port, port.makefile("rb") as received:
            assert received.readline() == b"QSB-D  0E!\r\n"
        with serial.serial_for_url(x.url(), timeout=1) as port:
            # The QSB takes no commands until it has sent its version.
            deadline = time.monotonic() + 60
            reply = b""
            while reply != b"r 0E 00000000 !\r\n":
                assert time.monotonic() < deadline, "the QSB does not answer"
                port.write(b"R0E\r")
                reply = port.read_until(b"\n")


def test_no_board():
    with pytest.raises(drivetwin.Error, match="^/dev/nothing cannot be opened: No such file or directory"):
        drivetwin.attach("/dev/nothing")
    with pytest.raises(TypeError, match="attach has no argument 'json'"):
        drivetwin.attach("/dev/nothing", json=True)


TESTS = """
import pytest

@pytest.fixture
def x(twin):
    return twin("md3", name="x", fast_boot=True, address=7, set={"Speed": 9000, "UserRegister": 5})

def test_registers(x):
    assert (x.registers["DeviceAddress"], x.registers["Speed"], x.registers["UserRegister"]) == (7, 9000, 5)
    x.registers["Speed"] = 100
    x.fault("over_temperature")
    x.pins["J2.2"] = "low"

def test_is_anew(x):
    assert (x.registers["Speed"], x.faults["over_temperature"], x.pins["J2.2"]) == (9000, False, "high")
    x.registers["EEPROMControl"] = 1
    x.bench.wait(0.1)

def test_the_memory_is_erased(twin):
    x = twin("md3", fast_boot=True)
    assert (x.registers["DeviceAddress"], x.registers["Speed"]) == (1, 5000)

def test_time(x):
    x.bench.advance(1)
    assert x.bench.now >= 1

def test_two(twin):
    twin("md3", name="x")
    twin("md3", name="y")

def test_fails(x):
    assert x.registers["Speed"] == 1
"""


def test_the_same_tests_on_both(virtual, pytester):
    pytester.makepyfile(test_it=TESTS)
    pytester.runpytest_subprocess().assert_outcomes(passed=5, failed=1)
    board = virtual()
    options = ["--drivetwin-board", board.control, "--drivetwin-bus", board.bus]
    result = pytester.runpytest_subprocess(*options, "--drivetwin-artifacts", "kept", "-rs")
    result.assert_outcomes(passed=3, failed=1, skipped=2)
    result.stdout.fnmatch_lines(["*not on a board: a board has no virtual time*"])
    result.stdout.fnmatch_lines(["*not on a board: a board is one drive*"])
    assert (pytester.path / "kept" / "test_it.py-test_fails.trace").exists()


def test_the_examples_on_both(virtual, pytester):
    pytest.importorskip("pymodbus")
    pytester.runpytest_subprocess(EXAMPLES).assert_outcomes(passed=4)
    board = virtual()
    result = pytester.runpytest_subprocess(
        EXAMPLES, "--drivetwin-board", board.control, "--drivetwin-bus", board.bus, "-rs"
    )
    result.assert_outcomes(passed=1, skipped=3)


def test_another_kind_is_skipped_with_its_reason(virtual, pytester):
    pytester.makepyfile("def test_it(twin):\n    twin('qsb-d')\n")
    board = virtual()
    result = pytester.runpytest_subprocess("--drivetwin-board", board.control, "-rs")
    result.assert_outcomes(skipped=1)
    result.stdout.fnmatch_lines(["*the image of this board is one kind only, md3*"])


@pytest.fixture
def rig_file(virtual, tmp_path):
    """A bench file with two boards and two emulated drives, with the boards."""
    boards = {"a": virtual("md3"), "b": virtual("qsb-d")}
    text = ["[[drive]]\nname = 'x'\nkind = 'md3'\nfast_boot = true", "[[drive]]\nname = 'q'\nkind = 'qsb-m'"]
    text += [
        f"[[drive]]\nname = '{name}'\nboard = '{board.control}'\nbus = '{board.bus}'" for name, board in boards.items()
    ]
    text.append("[[wire]]\nfrom = 'x.J3.7'\nto = 'q.DIO1'")
    file = tmp_path / "rig.toml"
    file.write_text("\n".join([*text, ""]))
    return file, boards


def test_a_rack_of_boards_and_emulated_drives(rig_file):
    file, boards = rig_file
    with drivetwin.run(file, control=False) as rack:
        assert [(name, rack[name].kind) for name in sorted(rack)] == [("a", "md3"), ("b", "qsb-d"), ("q", "qsb-m"), ("x", "md3")]
        assert (rack.board, rack["x"].board, rack["a"].board) == (None, None, boards["a"].control)
        for name in "ax":
            drive = rack[name]
            # The pulses of a board are known from its next power-on.
            drive.power("cycle")
            drive.registers["Speed"] = 8_000
            drive.pins["J2.9"] = "low"
            assert (drive.registers["Speed"], drive.pins["J2.9"]) == (8_000, "low")
            # Function 6 writes MotionControl (0x11): Move, 10,000 steps.
            assert drive.ask(write(1, 0x11, 1)) == write(1, 0x11, 1)
        rack.wait(3)
        for name in "ax":
            assert (rack[name].motion.position, len(rack[name].pulses())) == (10_000, 10_000)
        assert rack["x"].received()[0].verdict == "done"
        assert rack["a"].uri() == boards["a"].bus
        # One recording has all drives, in the order of time.
        lines = [line for line in rack.trace().splitlines() if line[:1].isdigit()]
        times = [float(line.split()[0]) for line in lines]
        assert times == sorted(times)
        requests = [line.split()[1] for line in lines if line.endswith(write(1, 0x11, 1).hex(" ").upper()) and " > rx " in line]
        assert requests == ["a", "x"]
        assert rack.vcd() and rack.pcapng()


def test_what_a_rack_cannot_do(rig_file):
    with drivetwin.run(rig_file[0], control=False) as rack:
        for act, sentence in (
            (lambda: rack.advance(1), "a board has no virtual time"),
            (lambda: rack.run_until(1e6), "a board has no virtual time"),
            (lambda: setattr(rack, "time", "x10"), "a board has no virtual time"),
            (lambda: rack["a"].line(), "the line of a board is a real one"),
            (lambda: rack.line("a.rs485"), "the line of a board is a real one"),
            (lambda: rack["a"].received(), "a board does not report the outcomes"),
            (lambda: rack["a"].port("rs485"), "the port of a board is a real one"),
        ):
            with pytest.raises(drivetwin.NotOnBoard, match=sentence):
                act()
        for act, sentence in (
            (lambda: rack.wire("a.J3.7", "x.J2.2"), "'a' is on a board: the pins of a board are real"),
            (lambda: rack.motor("a", "m"), "'a' is on a board: a board turns a real motor"),
            (
                lambda: rack.scenario([{"after_ms": 1, "drive": "a", "power": "cut"}]),
                "'a' is on a board: a scenario is played by a bench",
            ),
        ):
            with pytest.raises(drivetwin.Error, match=sentence):
                act()
        # The emulated drives have all of it.
        rack["x"].line().faults(drop=1)
        rack["q"].port("usb").write(b"")
        rack.scenario([{"after_ms": 1, "drive": "x", "power": "off"}])
        rack.wait(0.1)
        assert (rack["x"].powered, rack["a"].powered) == (False, True)
    with pytest.raises(drivetwin.Error, match="'a' is on a board, which only a run attaches"):
        drivetwin.Bench.load(rig_file[0])


def test_the_fixture_runs_a_rack(rig_file, pytester):
    pytester.makepyfile(
        f"""
        def test_rack(twin):
            rack = twin.run({str(rig_file[0])!r})
            rack["a"].pins["J2.2"] = "low"
            rack["x"].pins["J2.2"] = "low"
            assert rack["a"].pins["J2.2"] == rack["x"].pins["J2.2"] == "low"
            assert False, "so that the recording is kept"
        """
    )
    result = pytester.runpytest_subprocess("--drivetwin-artifacts", "kept")
    result.assert_outcomes(failed=1)
    (trace,) = pytester.path.glob("kept/*.trace")
    edges = [line.split()[1] for line in trace.read_text().splitlines() if line.endswith("> pin J2.2 low")]
    assert edges == ["a", "x"]
