"""Waveforms, read by pyvcd's reader and by sigrok."""

import subprocess

import pytest
from conftest import PATIENCE
from md3 import MOTION_CONTROL
from vcd.reader import TokenKind, tokenize

MOVE = 1
"""Bit of MotionControl (7.15)."""
NS = 1_000_000_000


def read(file):
    """The changes of each variable by its name, each with its time in ns."""
    names, changes, now = {}, {}, 0
    with open(file, "rb") as stream:
        for token in tokenize(stream):
            match token.kind:
                case TokenKind.TIMESCALE:
                    scale = (int(token.timescale.magnitude), token.timescale.unit.value)
                    assert scale == (1, "ns")
                case TokenKind.VAR:
                    names[token.var.id_code] = token.var.reference
                case TokenKind.CHANGE_TIME:
                    now = token.time_change
                case TokenKind.CHANGE_SCALAR:
                    change = token.scalar_change
                    changes.setdefault(names[change.id_code], []).append((now, change.value))
                case TokenKind.CHANGE_REAL:
                    change = token.real_change
                    changes.setdefault(names[change.id_code], []).append((now, change.value))
                case TokenKind.CHANGE_STRING:
                    change = token.string_change
                    changes.setdefault(names[change.id_code], []).append((now, change.value))
    return changes


@pytest.fixture
def moved(run, tcp, tmp_path):
    """The file that an MD3 leaves after its factory move, of 10 s."""
    file = tmp_path / "move.vcd"
    drivetwin = run("--fast-boot", "--time", "manual", "--vcd", file)
    client = tcp(drivetwin)
    assert not client.write_register(MOTION_CONTROL, MOVE).isError()
    drivetwin.advance(10)
    client.close()
    assert drivetwin.stop() == 0
    return file


def test_the_tracks_are_the_factory_move(moved):
    """10,000 steps at 5,000 steps/s and 10,000 steps/s²: 0.5 s up, 1.5 s, 0.5 s down."""
    changes = read(moved)
    (begin,) = [at for at, value in changes["J3_7"] if value == "0"]
    speed = dict(changes["speed"])
    assert speed[begin + NS // 2] == max(speed.values()) == 5_000
    assert changes["speed"][-1] == (begin + 5 * NS // 2, 0)
    position = changes["position"]
    assert position[-1] == (begin + 5 * NS // 2, 10_000)
    # A sample each millisecond, 2,500 in all.
    assert 2_400 < len(position) < 2_600
    for at, steps in position:
        if begin <= at <= begin + NS // 2:
            assert abs(steps - 5_000 * ((at - begin) / NS) ** 2) <= 1
    assert len([value for _, value in changes["STEP"] if value == "1"]) == 10_000
    words = [value.replace("\\x20", " ") for _, value in changes["rs485_rx"]]
    assert words == [" ", "write MotionControl = 1", " ", "write MotionControl = 1 -> done", " "]


def test_sigrok_loads_it(moved):
    """10 s at a microsecond for each sample. Without `downsample` it would make 10,000,000,000 samples."""
    command = ["sigrok-cli", "-I", "vcd:downsample=1000", "-i", moved, "--show"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    assert "Samplerate: 1000000\n" in done.stdout
    assert "- STEP: logic\n" in done.stdout
