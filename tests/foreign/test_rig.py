"""A bench file with boards: two boards in memory and two emulated drives, with one control address and one recording."""

import json
import os
import re
import select
import signal
import socket
import subprocess
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from conftest import PATIENCE, Drivetwin, ask, host_and_port

READ = bytes.fromhex("01 03 00 00 00 01 84 0A")
"""Function 3: DeviceAddress (0x00), which is 1 (7.1)."""
READ_REPLY = bytes.fromhex("01 03 02 00 01 79 84")

EXACT = 0.1
"""Seconds that the time of an event of a board is wrong at most. It is wrong by a millisecond or less, but a busy computer may
hold up the first question to a board."""


class VirtualBoard:
    """A board in memory, which can be switched off and on again."""

    def __init__(self, kind):
        self.control = None
        self.switch_on(kind)

    def switch_on(self, kind):
        program = Path(os.environ["DRIVETWIN"]).with_name("virtual-board")
        place = [self.control] if self.control else []
        self.process = subprocess.Popen([program, kind, "fast", *place], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        readable, _, _ = select.select([self.process.stdout], [], [], PATIENCE)
        assert readable, "the board did not start"
        _, self.control, _, self.bus = self.process.stdout.readline().split()

    def switch_off(self):
        self.process.kill()
        self.process.wait(PATIENCE)
        self.process.stdin.close()
        self.process.stdout.close()


@pytest.fixture
def boards():
    boards = [VirtualBoard("md3"), VirtualBoard("md3")]
    yield boards
    for board in boards:
        board.switch_off()


def rig_file(folder, boards, more=""):
    """A bench file with the boards `a` and `b`, and the emulated drives `x` and `y`."""
    text = ["[defaults.drive]", "kind = 'md3'", "fast_boot = true"]
    text += [f"[[drive]]\nname = '{name}'" for name in "xy"]
    for name, board in zip("ab", boards):
        text.append(f"[[drive]]\nname = '{name}'\nboard = 'tcp:{board.control}'\nbus = 'tcp:{board.bus}'")
    file = folder / "rig.toml"
    file.write_text("\n".join([*text, more, ""]))
    return file


@pytest.fixture
def rack(boards, tmp_path):
    """Runs the bench file of the boards."""
    racks = []

    def rack(*options):
        racks.append(Drivetwin("--control", "127.0.0.1:0", *options, kind=rig_file(tmp_path, boards)))
        return racks[-1]

    yield rack
    for one in racks:
        one.kill()


def refusal(rack, method, path, body=None):
    """Status and sentence of a call that is refused."""
    with pytest.raises(urllib.error.HTTPError) as raised:
        rack.call(method, path, body)
    return raised.value.code, json.loads(raised.value.read())["detail"]


def until(what, why):
    """Waits until a function returns something."""
    end = time.monotonic() + PATIENCE
    while not (found := what()):
        assert time.monotonic() < end, why
    return found


def set_pin(rack, drive, level, pin="J2.2"):
    rack.call("PUT", f"/api/drives/{drive}/pins/{pin}", {"level": level})


def trace(rack):
    """The recorded text, complete until now."""
    now = rack.seconds()

    def text():
        with urllib.request.urlopen(rack.control + "/api/trace", timeout=PATIENCE) as answer:
            text = answer.read().decode()
        return text if times(text)[-1] >= now else None

    return until(text, "the recording does not go on")


def times(text):
    """The times of the lines of a trace in seconds, with that of its end."""
    return [float(line.split()[0]) / 1e3 for line in text.splitlines() if line[:1].isdigit()]


def edges(text, pin="J2.2"):
    """Time, drive and level of the changes at an input."""
    found = re.finditer(rf"^(\d+\.\d+) (\w) > pin {pin} (low|high)$", text, re.M)
    return [(float(edge[1]) / 1e3, edge[2], edge[3]) for edge in found]


def test_boards_and_emulated_drives_have_one_control_address(rack, boards):
    rack = rack()
    bench = rack.call("GET", "/api/bench")
    assert sorted((drive["name"], drive["kind"], drive["powered"]) for drive in bench["drives"]) == [
        (name, "md3", True) for name in "abxy"
    ]
    assert [(board["drive"], board["place"], board["away"]) for board in bench["boards"]] == [
        (name, f"tcp:{board.control}", None) for name, board in zip("ab", boards)
    ]
    for name in "abxy":
        rack.call("PUT", f"/api/drives/{name}/registers/Speed", {"value": 9_000})
        set_pin(rack, name, "low")
        state = rack.call("GET", f"/api/drives/{name}")
        assert (state["name"], state["registers"]["Speed"], state["pins"]["J2.2"]) == (name, 9_000, "low")
    # Masters have a port of each.
    places = [host_and_port(boards[0].bus), rack.drives["x"]["rs485"]]
    for place in places:
        with socket.create_connection(place, timeout=PATIENCE) as line:
            assert ask(line, READ, len(READ_REPLY)) == READ_REPLY
    assert rack.call("GET", "/api/drives/x/received")["requests"][0]["verdict"] == "done"


def test_each_drive_refuses_only_what_it_cannot_do(rack):
    rack = rack()
    no_time = "a board has no virtual time: its clock goes on by itself"
    assert refusal(rack, "PUT", "/api/time", {"mode": "x10"}) == (409, no_time)
    assert refusal(rack, "POST", "/api/time/advance", {"seconds": 1}) == (409, no_time)
    rack.call("PUT", "/api/time", {"mode": "real"})
    rack.call("PUT", "/api/buses/x.rs485/faults", {"drop": 1})
    status, sentence = refusal(rack, "PUT", "/api/buses/a.rs485/faults", {"drop": 1})
    assert (status, sentence.split(",")[0]) == (409, "the line of a board is a real one")
    step = {"after_ms": 1, "power": "cycle"}
    rack.call("POST", "/api/scenario", {"steps": [{**step, "drive": "x"}]})
    status, sentence = refusal(rack, "POST", "/api/scenario", {"steps": [{**step, "drive": "a"}]})
    assert (status, sentence.split(";")[0]) == (422, "step 1: 'a' is on a board: a scenario is played by a bench, and not on a board")
    assert rack.call("GET", "/api/drives/y/received")["requests"] == []
    assert refusal(rack, "GET", "/api/drives/a/received")[0] == 409
    status, sentence = refusal(rack, "PUT", "/api/drives/a/kind", {"kind": "qsb-d"})
    assert (status, sentence.split(";")[0]) == (409, "a stays of the kind md3 while its bench runs")
    # Each is an MD3 already.
    for name in "ax":
        assert rack.call("PUT", f"/api/drives/{name}/kind", {"kind": "md3"}) == {"kind": "md3", "kinds": ["md3"]}


def test_one_recording_has_the_events_of_all_drives_in_order(rack, tmp_path):
    files = [tmp_path / name for name in ("rig.trace", "rig.vcd", "rig.pcapng")]
    rack = rack("--record", files[0], "--vcd", files[1], "--pcap", files[2])
    done = []
    for turn in range(16):
        name, level = "axby"[turn % 4], ("low", "high")[turn // 4 % 2]
        before = rack.seconds()
        until(lambda: rack.seconds() > before + EXACT, "the clock of the bench stands")
        before = rack.seconds()
        set_pin(rack, name, level)
        done.append((before, name, level, rack.seconds()))
    text = trace(rack)
    found = edges(text)
    assert [edge[1:] for edge in found] == [(name, level) for _, name, level, _ in done]
    for (at, *_), (before, *_, after) in zip(found, done):
        assert before - EXACT <= at <= after + EXACT
    assert times(text) == sorted(times(text))
    # The files are complete, and in order, too.
    place = rack.drives["x"]["rs485"]
    with socket.create_connection(place, timeout=PATIENCE) as line:
        assert ask(line, READ, len(READ_REPLY)) == READ_REPLY
    set_pin(rack, "a", "low", "J2.3")
    assert rack.stop() == 0, rack.said()
    text = files[0].read_text()
    assert times(text) == sorted(times(text)) and text.endswith(" end\n")
    assert [edge[1:] for edge in edges(text)] == [edge[1:] for edge in found]
    assert re.search(r" a > pin J2.3 low$", text, re.M) and " x < tx 01 03 02 00 01 79 84\n" in text
    replayed = subprocess.run([os.environ["DRIVETWIN"], "replay", files[0]], capture_output=True, text=True, timeout=PATIENCE)
    assert replayed.stdout == f"{files[0]}: as expected\n", replayed
    stamps = [int(line[1:]) for line in files[1].read_text().splitlines() if re.fullmatch(r"#\d+", line)]
    assert len(stamps) > 16 and stamps == sorted(stamps)
    assert b"read DeviceAddress" in files[2].read_bytes()


def test_a_board_goes_away_and_comes_back_while_the_bench_goes_on(rack, boards):
    rack = rack()

    def away(name="a"):
        return next(board["away"] for board in rack.call("GET", "/api/bench")["boards"] if board["drive"] == name)

    set_pin(rack, "a", "low")
    boards[0].switch_off()
    place = f"tcp:{boards[0].control}"
    assert place in until(away, "the board is not missed")
    status, sentence = refusal(rack, "GET", "/api/drives/a")
    assert status == 503 and place in sentence
    # The others go on.
    assert away("b") is None
    for name in "bxy":
        set_pin(rack, name, "low")
    assert [name for _, name, _ in edges(trace(rack))] == ["a", "b", "x", "y"]

    # A drive of another kind is not the drive of the bench file.
    boards[0].switch_on("qsb-d")
    other = "is a drive of the kind qsb-d, and not md3"
    until(lambda: other in (away() or ""), "the other kind is not refused")
    boards[0].switch_off()
    boards[0].switch_on("md3")
    until(lambda: away() is None, "the board does not come back")
    set_pin(rack, "x", "high")
    before = rack.seconds()
    until(lambda: rack.seconds() > before + EXACT, "the clock of the bench stands")
    set_pin(rack, "a", "low")
    text = trace(rack)
    assert [name for _, name, _ in edges(text)] == ["a", "b", "x", "y", "x", "a"]
    assert before - EXACT <= edges(text)[-1][0] <= rack.seconds()
    # From each first session on; for `a` also when it goes away and is back.
    assert sorted(missing(text)) == ["a", "a", "a", "b"]
    assert times(text) == sorted(times(text))


def missing(text):
    """The drives whose events may be missing, in the order of the recording."""
    return re.findall(r"^# [0-9.]+ (\w): events may be missing here$", text, re.M)


def test_a_recording_that_ends_without_a_board_says_so(rack, boards, tmp_path):
    file = tmp_path / "away.trace"
    rack = rack("--record", file)
    boards[0].switch_off()
    until(lambda: rack.call("GET", "/api/bench")["boards"][0]["away"], "the board is not missed")
    # A board that is silent is not missed yet.
    boards[1].process.send_signal(signal.SIGSTOP)
    assert rack.stop() == 0, rack.said()
    assert sorted(missing(file.read_text())) == ["a", "a", "b", "b"]


def test_a_board_that_another_program_uses_is_in_use(rack, boards, tmp_path):
    rack()
    file = tmp_path / "second.toml"
    place = f"tcp:{boards[0].control}"
    file.write_text(f"[[drive]]\nname = 'c'\nboard = '{place}'\n")
    said = f"{file}: board of c: the board at {place} is in use by another program, or there is none: it does not answer"
    assert run_wrong(file) == said


def test_live_events_are_those_of_all_drives(rack):
    rack = rack()
    request = urllib.request.Request(rack.control + "/api/events")
    seen, order = [], []
    with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
        for name in "abxy":
            set_pin(rack, name, "low")
        with socket.create_connection(rack.drives["x"]["rs485"], timeout=PATIENCE) as line:
            assert ask(line, READ, len(READ_REPLY)) == READ_REPLY
        while "message" not in order:
            line = answer.readline().decode()
            if line.startswith("data: "):
                event = json.loads(line.removeprefix("data: "))
                if event.get("words") == "pin J2.2 low":
                    seen.append((event["seconds"], event["drive"]))
                if event.get("words", "").startswith("rx 01 03"):
                    order.append("characters")
                if event.get("text") == "read DeviceAddress":
                    order.append("message")
    assert sorted(name for _, name in seen) == ["a", "b", "x", "y"]
    assert seen == sorted(seen)
    # A message is behind its characters.
    assert order == ["characters", "message"]


def live(rack, query=""):
    """The first update of the panel, which is the whole state."""
    with urllib.request.urlopen(rack.control + "/api/live" + query, timeout=PATIENCE) as answer:
        while not (line := answer.readline().decode()).startswith("data: "):
            assert line
        return json.loads(line.removeprefix("data: "))["state"]


def test_the_panel_shows_all_drives_and_greys_only_what_a_drive_cannot_do(rack, boards):
    rack = rack()
    state = live(rack)
    assert set(state["drives"]) == set("abxy")
    assert {name for name, drive in state["drives"].items() if drive.get("board")} == {"a", "b"}
    assert set(state["cannot"]) == set(live(rack, "?drive=x")["cannot"]) == {"time", "advance"}
    of_board = live(rack, "?drive=a")["cannot"]
    assert set(of_board) == {"time", "advance", "line_faults", "scenario", "traffic"}
    boards[0].switch_off()
    until(lambda: live(rack)["drives"]["a"]["board"].get("away"), "the board is not missed")


def run_wrong(file, *options):
    """The sentence of a run that does not begin."""
    command = [os.environ["DRIVETWIN"], "run", file, *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stdout) == (2, ""), done
    return done.stderr.removeprefix("drivetwin: ").strip()


def test_errors_say_what_is_wrong_and_change_no_file(boards, tmp_path):
    old = tmp_path / "old.trace"
    old.write_text("old")
    record = ["--record", old]
    board = f"[[drive]]\nname = 'c'\nboard = 'tcp:{boards[0].control}'\n"
    file = tmp_path / "rig.toml"
    file.write_text(board + "kind = 'qsb-d'\n")
    place = f"{file}: board of c: the board at tcp:{boards[0].control}"
    kind = "change kind in the file, or the kind of the board: drivetwin attach, PUT /api/drives/board/kind"
    assert run_wrong(file, *record) == f"{place} is a drive of the kind md3, and not qsb-d; {kind}"
    file.write_text(board)
    no_time = "time cannot be 'manual', because 'c' is on a board: a board has no virtual time: its clock goes on by itself"
    assert run_wrong(file, "--time", "manual") == f"--time: {no_time}"
    file.write_text(board + board.replace("'c'", "'d'"))
    twice = f"tcp:{boards[0].control} is already the board of 'c'; a board is one drive"
    assert run_wrong(file, *record) == f"{file}: line 6, column 9: {twice}"
    # The same board by another name of its place.
    other = boards[0].control.replace("127.0.0.1", "localhost")
    file.write_text(f"{board}[[drive]]\nname = 'd'\nboard = 'tcp:{other}'\n")
    assert run_wrong(file, *record) == f"{file}: board of d: tcp:{other} is the board of c, too; a board is one drive"
    link = tmp_path / "link"
    link.symlink_to("/dev/null")
    file.write_text(f"[[drive]]\nname = 'c'\nboard = '{link}'\n")
    assert run_wrong(file, *record) == f"{file}: board of c: {link} cannot be opened: not a serial port"
    boards[0].switch_off()
    file.write_text(board)
    assert re.fullmatch(
        rf"{re.escape(str(file))}: board of c: tcp:{boards[0].control} cannot be opened: Connection refused .*",
        run_wrong(file, *record),
    )
    boards[0].switch_on("md3")
    assert old.read_text() == "old"


def test_a_file_is_checked_without_its_boards(tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text("[[drive]]\nname = 'a'\nboard = 'usb:E661'\n[[drive]]\nname = 'x'\nkind = 'md3'\n")
    done = subprocess.run([os.environ["DRIVETWIN"], "check", file], capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{file}: 2 drives, 1 board\n", "")
