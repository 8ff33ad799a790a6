"""`drivetwin attach`: a board in memory behind two TCP ports, beside the same drive as a process.

Names, values and sentences of the control API must be the same for both.
"""

import http.client
import json
import os
import re
import select
import signal
import socket
import subprocess
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

import pytest

from conftest import PATIENCE, ask, host_and_port
from live import Live, without_nulls

READ = bytes.fromhex("01 03 00 00 00 01 84 0A")
"""Function 3: DeviceAddress (0x00), which is 1 (7.1)."""
READ_REPLY = bytes.fromhex("01 03 02 00 01 79 84")


class VirtualBoard:
    """A board in memory."""

    def __init__(self, kind="md3"):
        program = Path(os.environ["DRIVETWIN"]).with_name("virtual-board")
        self.process = subprocess.Popen([program, kind, "fast"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        readable, _, _ = select.select([self.process.stdout], [], [], PATIENCE)
        assert readable, "the board did not start"
        _, self.control, _, self.bus = self.process.stdout.readline().split()

    def end(self):
        self.process.stdin.close()
        self.process.wait(PATIENCE)
        self.process.stdout.close()


class Program:
    """A program that serves the control API."""

    def __init__(self, *arguments):
        command = [os.environ["DRIVETWIN"], *map(str, arguments), "--json"]
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        readable, _, _ = select.select([self.process.stdout], [], [], PATIENCE)
        line = self.process.stdout.readline() if readable else b""
        assert line, f"the program did not start: {self.process.stderr.read().decode()}"
        self.ready = json.loads(line)

    def call(self, method, path, body=None, media="application/json"):
        """Status and body of a call."""
        data = body if isinstance(body, (bytes, type(None))) else json.dumps(body).encode()
        request = urllib.request.Request(
            self.ready["control"] + path, method=method, data=data, headers={"Content-Type": media}
        )
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
                return answer.status, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()

    def get(self, path):
        status, body = self.call("GET", path)
        assert status == 200, body
        return json.loads(body)

    def end(self, how=signal.SIGTERM):
        self.process.send_signal(how)
        code = self.process.wait(PATIENCE)
        self.process.stdout.close()
        self.process.stderr.close()
        return code


@pytest.fixture
def board():
    board = VirtualBoard()
    yield board
    board.end()


@pytest.fixture
def attach(board):
    """Attaches the board, and ends that with the test."""
    programs = []

    def attach(*options):
        programs.append(Program("attach", f"tcp:{board.control}", "--bus", f"tcp:{board.bus}", *options))
        return programs[-1]

    yield attach
    for program in programs:
        if program.process.returncode is None:
            program.end(signal.SIGKILL)


@pytest.fixture
def both(attach, tmp_path):
    """A board, and a process with the same drive of the same name."""
    bench = tmp_path / "bench.toml"
    bench.write_text('[[drive]]\nname = "board"\nkind = "md3"\n')
    process = Program("run", bench, "--fast-boot")
    yield attach(), process
    process.end(signal.SIGKILL)


def keys(value):
    """The keys of an object, with those of the objects in it."""
    if isinstance(value, dict):
        return {key: keys(of) for key, of in value.items()}
    return None


D = "/api/drives/board"
WRONG = [
    ("GET", "/api/drives/bord", None),
    ("PUT", "/api/drives/bord/pins/J2.2", {"level": "low"}),
    ("PUT", f"{D}/pins/J2.22", {"level": "low"}),
    ("PUT", f"{D}/pins/J3.7", {"level": "low"}),
    ("PUT", f"{D}/pins/D5", {"level": "low"}),
    ("PUT", f"{D}/pins/J2.2", {"volts": 2.5}),
    ("PUT", f"{D}/pins/J2.2", {"milliamps": 4}),
    ("PUT", f"{D}/pins/J2.2", {}),
    ("PUT", f"{D}/pins/J2.2", {"level": "up"}),
    ("PUT", f"{D}/pins/J2.2", {"level": "low", "volts": 1}),
    ("POST", f"{D}/pins/J2.2/pulses", {"count": 0, "hz": 10}),
    ("POST", f"{D}/pins/J2.2/pulses", {"count": 1, "hz": 0}),
    ("POST", f"{D}/pins/J2.2/pulses", {"count": 1, "hz": 10, "duty": 1}),
    ("POST", f"{D}/pins/J3.7/pulses", {"count": 1, "hz": 10}),
    ("POST", f"{D}/pins/J2.2/pulses", {"count": 1}),
    ("POST", f"{D}/encoder", {"counts": 0, "hz": 10}),
    ("POST", f"{D}/encoder", {"counts": 4, "hz": 1e9}),
    ("PUT", f"{D}/registers/Sped", {"value": 1}),
    ("PUT", f"{D}/registers/DeviceAddress", {"value": 300}),
    ("PUT", f"{D}/registers/Speed", {"value": [1, 2]}),
    ("PUT", f"{D}/registers/Speed", {"value": "fast"}),
    ("PUT", f"{D}/registers/SpeedLow", {"value": 70_000}),
    ("PUT", f"{D}/registers/ProductInformation", {"value": 5}),
    ("PUT", f"{D}/faults/over_temprature", None),
    ("DELETE", f"{D}/faults/stall", None),
    ("POST", f"{D}/power", {"action": "up"}),
    ("GET", f"{D}/received?register=Sped", None),
    ("GET", f"{D}/received?since=-1", None),
    ("PUT", f"{D}/kind", {"kind": "mdd3"}),
    ("PUT", f"{D}/memory", b"\xff"),
    ("PUT", "/api/buses/x/faults", {"drop": 2}),
    ("POST", "/api/time/advance", {"seconds": -1}),
    ("PUT", "/api/time", {"mode": "soon"}),
    ("POST", "/api/scenario", {}),
    ("GET", "/api/trace?format=csv", None),
]


def test_a_board_and_a_process_have_the_same_names_and_sentences(both):
    attached, process = both
    state, of_process = attached.get(D), process.get(D)
    assert keys(state) == keys(of_process)
    assert state["registers"] == of_process["registers"]
    assert keys(attached.get("/api/bench")) == keys(process.get("/api/bench"))
    assert attached.get("/openapi.json") == process.get("/openapi.json")
    for method, path, body in WRONG:
        media = "application/octet-stream" if path.endswith("/memory") else "application/json"
        of_board, of_process = (program.call(method, path, body, media) for program in both)
        # The names of the lines differ.
        if path.startswith("/api/buses"):
            of_board, of_process = of_board[:1], of_process[:1]
        assert of_board == of_process, (method, path, body)
        assert of_board[0] in (400, 404, 422), (method, path, body, of_board)


def test_pins_registers_faults_and_power(both):
    for program in both:

        def do(method, path, body=None):
            status, answer = program.call(method, D + path, body)
            assert status == 204, answer

        do("PUT", "/pins/J2.2", {"level": "low"})
        do("PUT", "/registers/Speed", {"value": 9_000})
        do("PUT", "/registers/UserRegister", {"value": 1_234})
        do("PUT", "/faults/over_temperature")
        state = program.get(D)
        assert (state["pins"]["J2.2"], state["registers"]["Speed"]) == ("low", 9_000)
        assert state["faults"] == {"over_temperature": True, "over_current": False}
        do("PUT", "/pins/J2.2", {"level": "open"})
        do("DELETE", "/faults/over_temperature")
        do("POST", "/power", {"action": "off"})
        state = program.get(D)
        assert (state["powered"], state["faults"]["over_temperature"]) == (False, False)
        status, answer = program.call("PUT", f"{D}/registers/Speed", {"value": 1})
        assert (status, json.loads(answer)["detail"]) == (409, "board has no power")
        do("POST", "/power", {"action": "on"})
        until = time.monotonic() + PATIENCE
        while program.get(D)["registers"]["UserRegister"] != 0:
            assert time.monotonic() < until, "what is not saved is lost with the power"
        assert program.get(D)["pins"]["J2.2"] == "high"


def test_a_pulse_train_runs_alone(both):
    for program in both:
        train = {"count": 1_000, "hz": 10}
        assert program.call("POST", f"{D}/pins/J2.2/pulses", train)[0] == 204
        status, answer = program.call("POST", f"{D}/pins/J2.2/pulses", train)
        sentence = "a pulse train or an encoder drives that pin already"
        assert (status, json.loads(answer)["detail"]) == (409, sentence)


REASONS = [
    ("PUT", "/api/time", {"mode": "manual"}, "a board has no virtual time"),
    ("POST", "/api/time/advance", {"seconds": 1}, "a board has no virtual time"),
    ("PUT", "/api/buses/rs485/faults", {"drop": 1}, "the line of a board is a real one"),
    ("POST", "/api/scenario", {"steps": [{"at_ms": 1, "drive": "board", "power": "cut"}]}, "a scenario is played by a bench"),
    ("GET", f"{D}/received", None, "a board does not report the outcomes of messages"),
    ("PUT", f"{D}/kind", {"kind": "qsb-d"}, "the image of this board is one kind only, md3"),
]


def test_what_a_board_cannot_do_is_a_conflict_with_its_reason(attach):
    program = attach()
    for method, path, body, reason in REASONS:
        status, answer = program.call(method, path, body)
        assert status == 409, (path, answer)
        assert json.loads(answer)["detail"].startswith(reason)
    assert program.call("PUT", "/api/time", {"mode": "real"})[0] == 200


def test_the_memory_goes_down_and_up(attach, tmp_path):
    program, octets = attach(), "application/octet-stream"
    status, erased = program.call("GET", f"{D}/memory")
    assert (status, set(erased)) == (200, {0xFF})
    # A drive with an address of its own saves it.
    nv = tmp_path / "x.nv"
    run = Program("run", "md3", "--fast-boot", "--address", 7, "--nv", nv, "--time", "manual")
    run.end()
    memory = nv.read_bytes()
    assert len(memory) == len(erased) and memory != erased
    status, answer = program.call("PUT", f"{D}/memory", memory, octets)
    assert (status, json.loads(answer)["detail"]) == (409, "board has power; switch it off first")
    program.call("POST", f"{D}/power", {"action": "off"})
    assert program.call("PUT", f"{D}/memory", memory, octets)[0] == 204
    assert program.call("GET", f"{D}/memory")[1] == memory
    program.call("POST", f"{D}/power", {"action": "on"})
    assert program.get(D)["registers"]["DeviceAddress"] == 7
    status, answer = program.call("PUT", f"{D}/memory", memory)
    assert status == 403 and b"application/octet-stream" in answer


def test_what_a_master_does_is_in_the_trace_and_in_the_files(attach, board, tmp_path):
    files = [tmp_path / name for name in ("x.trace", "x.vcd", "x.pcapng")]
    program = attach("--record", files[0], "--vcd", files[1], "--pcap", files[2])
    (device,) = program.ready["devices"]
    assert (device["name"], device["ports"]) == ("board", {"rs485": [f"tcp:{board.bus}"]})
    address = urllib.parse.urlsplit(program.ready["control"]).netloc
    events = http.client.HTTPConnection(address, timeout=PATIENCE)
    events.request("GET", "/api/events?drive=board", headers={"Last-Event-ID": "0"})
    answer = events.getresponse()
    with socket.create_connection(host_and_port(board.bus), timeout=PATIENCE) as line:
        assert ask(line, READ, len(READ_REPLY)) == READ_REPLY
    seen = []
    while not any('"words":"tx' in line for line in seen):
        seen.append(answer.readline().decode())
    assert seen[0] == "event: lost\n", "what was before is not known"
    assert any('"words":"rx 01 03 00 00 00 01 84 0A"' in line for line in seen)
    events.close()
    until = time.monotonic() + PATIENCE
    while b"< tx 01 03 02 00 01 79 84\n" not in program.call("GET", "/api/trace")[1]:
        assert time.monotonic() < until, "the reply is not in the trace"
    assert program.get(D)["ports"]["rs485"]["requests"] == 1
    assert b"$enddefinitions" in program.call("GET", "/api/trace?format=vcd")[1]
    assert program.end() == 0
    text = files[0].read_text()
    assert re.search(r"^drive board md3 elsewhere from [0-9.]+\n# [0-9.]+: events may be missing here\n", text, re.M), text
    assert "> rx 01 03 00 00 00 01 84 0A\n" in text and text.endswith(" end\n")
    replayed = subprocess.run([os.environ["DRIVETWIN"], "replay", files[0]], capture_output=True, text=True, timeout=PATIENCE)
    why = "the drives of this trace are on boards, which a replay cannot repeat"
    assert (replayed.returncode, replayed.stderr) == (2, f"drivetwin: {files[0]}: {why}\n")
    assert b"read DeviceAddress" in files[2].read_bytes()
    assert b"read\\x20DeviceAddress" in files[1].read_bytes()


def test_a_board_that_is_gone_is_said_in_one_sentence(attach, board):
    program = attach()
    board.process.kill()
    board.process.wait(PATIENCE)
    until = time.monotonic() + PATIENCE
    while (answer := program.call("GET", D))[0] == 200:
        assert time.monotonic() < until
    problem = json.loads(answer[1])
    assert (problem["status"], problem["title"]) == (503, "Service Unavailable")
    assert f"tcp:{board.control}" in problem["detail"]
    away = program.get("/api/bench")["boards"][0]
    assert away["image"] is None and f"tcp:{board.control}" in away["away"]
    assert program.end() == 0


@pytest.mark.parametrize(
    "arguments, sentence",
    [
        (["/dev/nothing"], "drivetwin: /dev/nothing cannot be opened: No such file or directory (os error 2)\n"),
        (["/dev/null"], "drivetwin: /dev/null cannot be opened: not a serial port\n"),
        (["usb:E661"], "drivetwin: no board is plugged in, so usb:E661 is not there\n"),
        ([], "drivetwin: no board is plugged in; name its control port if the system does not know it, like /dev/ttyACM1\n"),
    ],
)
def test_a_place_without_a_board(arguments, sentence):
    done = subprocess.run([os.environ["DRIVETWIN"], "attach", *arguments], capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", sentence)


def test_a_board_is_live_and_says_what_it_cannot_do(board, attach):
    program = attach()
    live = Live(program.ready["control"], "?drive=board")
    live.update()
    seen = live.state["drives"]["board"]
    assert (seen["kind"], seen["powered"], seen["moving"]) == ("md3", True, False)
    assert seen["board"]["image"]["version"] == program.get("/api/bench")["boards"][0]["image"]["version"]
    assert live.state["drive"]["registers"] == without_nulls(program.get(D))["registers"]
    assert set(live.state["cannot"]) == {"time", "advance", "line_faults", "scenario", "traffic"}
    # A refused call has the same sentence.
    _, refused = program.call("PUT", "/api/time", {"mode": "manual"})
    assert live.state["cannot"]["time"] == json.loads(refused)["detail"]
    assert program.call("PUT", f"{D}/pins/J2.2", {"level": "low"})[0] == 204
    live.until(lambda live: live.state["drive"]["pins"]["J2.2"] == "low")
    board.end()
    live.until(lambda live: "away" in live.state["drives"]["board"]["board"])
    seen = live.state["drives"]["board"]
    assert not seen["powered"] and "image" not in seen["board"] and "drive" not in live.state
    live.close()
