"""The control API, by a program that has only HTTP and nothing else of the emulator."""

import http.client
import json
import os
import struct
import subprocess
import threading
import time
import urllib.error
import urllib.parse

import pytest

from conftest import PATIENCE, ask, receive
from live import Live, without_nulls
from md3 import MOTION_CONTROL

JSON = {"Content-Type": "application/json"}
MOVE = bytes.fromhex("01 06 00 11 00 01 18 0F")
"""Function 6: MotionControl (0x11) to 1, which moves (7.15)."""


def connect(drivetwin):
    """A connection of its own."""
    address = urllib.parse.urlsplit(drivetwin.control).netloc
    return http.client.HTTPConnection(address, timeout=PATIENCE)


class Full(Exception):
    """There is no room for one more."""


def answered(connection):
    """The answer to a request: status 200, or `Full` if there is no room."""
    answer = connection.getresponse()
    if answer.status == 503:
        raise Full
    assert answer.status == 200
    return answer


def when_there_is_room(do, meanwhile):
    """The result of `do`, repeated until the program has seen that another client has left."""
    until = time.monotonic() + PATIENCE
    while True:
        meanwhile()
        try:
            return do()
        except Full:
            assert time.monotonic() < until, "there is no room"


class Events:
    """A client that follows the events of the bench."""

    def __init__(self, drivetwin, query="", **headers):
        self.connection = connect(drivetwin)
        self.connection.request("GET", "/api/events" + query, headers=headers)
        self.answer = answered(self.connection)
        assert self.answer.getheader("Content-Type") == "text/event-stream"

    def next(self):
        """The next event of the trace: its kind, its number, and its data."""
        fields = self.wanted(lambda kind: kind != "received")
        return fields["event"], int(fields["id"].partition(".")[0]), json.loads(fields["data"])

    def received(self):
        """The next message that a drive has received."""
        return json.loads(self.wanted(lambda kind: kind == "received")["data"])

    def wanted(self, kinds):
        """The fields of the next event of such a kind."""
        until = time.monotonic() + PATIENCE
        while not (fields := self.piece()) or not kinds(fields["event"]):
            assert time.monotonic() < until, "nothing happens"
        self.last_id = fields["id"]
        return fields

    def piece(self):
        """The fields of the next event; none for a comment, which only keeps the connection alive."""
        fields = {}
        while (line := self.answer.readline().decode()) != "\n":
            assert line, "the bench is gone"
            if not line.startswith(":"):
                name, _, value = line.rstrip("\n").partition(": ")
                fields[name] = value
        return fields

    def close(self):
        self.answer.close()
        self.connection.close()


def level(drivetwin, pin, to):
    drivetwin.call("PUT", f"/api/drives/md3/pins/{pin}", {"level": to})


def refused(drivetwin, method, path, body=None):
    """The problem document of a call."""
    with pytest.raises(urllib.error.HTTPError) as error:
        drivetwin.call(method, path, body)
    assert error.value.headers["Content-Type"] == "application/problem+json"
    problem = json.loads(error.value.read())
    assert problem["status"] == error.value.code
    return problem


def text(drivetwin, query=""):
    """What happened."""
    connection = connect(drivetwin)
    connection.request("GET", "/api/trace" + query)
    return answered(connection).read().decode()


def test_events_tell_what_the_trace_tells(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    events = Events(drivetwin)
    level(drivetwin, "J2.2", "low")
    with drivetwin.socket() as line:
        assert ask(line, MOVE, len(MOVE)) == MOVE
    drivetwin.advance(2.5)
    level(drivetwin, "J2.2", "high")
    seen = [events.next()]
    while seen[-1][2]["words"] != "pin J2.2 high":
        seen.append(events.next())
    kinds = [(kind, data["words"]) for kind, _, data in seen]
    assert kinds[0] == ("fed", "pin J2.2 low")
    assert ("fed", "rx 01 06 00 11 00 01 18 0F") in kinds
    assert ("did", "tx 01 06 00 11 00 01 18 0F") in kinds
    # 10,000 steps at 5,000 steps/s and 10,000 steps/s² (7.15).
    assert ("did", "plan motor 0 500.000000@5000 1500.000000@5000 500.000000@0 10000") in kinds
    assert {data["drive"] for _, _, data in seen} == {"md3"}
    first = seen[0][1]
    assert [number for _, number, _ in seen] == list(range(first, first + len(seen)))
    told = {f"{data['seconds'] * 1000:.6f} {'>' if kind == 'fed' else '<'} {data['words']}" for kind, _, data in seen}
    assert told <= set(text(drivetwin).splitlines())


def test_events_have_what_became_of_each_message(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    events = Events(drivetwin)
    refused_write = bytes.fromhex("01 06 00 0B 00 05 38 0B")
    with drivetwin.socket() as line:
        ask(line, MOVE, len(MOVE))
        ask(line, refused_write, 5)
    move, refused_one = events.received(), events.received()
    assert (move["number"], move["drive"], move["bus"]) == (1, "md3", None)
    assert (move["text"], move["verdict"], move["reason"]) == ("write MotionControl = 1", "done", None)
    assert (move["bytes"], move["answer"]) == ("010600110001180F", "010600110001180F")
    assert (refused_one["number"], refused_one["verdict"]) == (2, "refused")
    # The journal has the same.
    journal = drivetwin.call("GET", "/api/drives/md3/received")
    assert journal["requests"] == [
        {name: value for name, value in event.items() if name not in ("number", "drive", "bus")}
        for event in (move, refused_one)
    ]
    assert journal["lost"] == 0
    assert journal["counts"]["functions"] == {"6": 2}
    assert journal["counts"]["registers"]["Reserved"] == {"read": 0, "written": 1}


def test_events_go_on_where_they_broke_off(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    events = Events(drivetwin)
    for to in ["low", "high", "low"]:
        level(drivetwin, "J2.2", to)
    seen = [events.next() for _ in range(3)]
    events.close()
    level(drivetwin, "J2.2", "high")
    events = Events(drivetwin, **{"Last-Event-ID": str(seen[0][1])})
    assert [events.next(), events.next()] == seen[1:]
    kind, number, data = events.next()
    assert (kind, number, data["words"]) == ("fed", seen[-1][1] + 1, "pin J2.2 high")


def test_messages_go_on_where_they_broke_off(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    events = Events(drivetwin)
    with drivetwin.socket() as line:
        ask(line, MOVE, len(MOVE))
        first, last_id = events.received(), events.last_id
        events.close()
        ask(line, MOVE, len(MOVE))
    second = Events(drivetwin, **{"Last-Event-ID": last_id}).received()
    assert [(message["number"], message["verdict"]) for message in (first, second)] == [(1, "done"), (2, "without effect")]
    assert second["reason"] == "a motion runs: ignored, not queued; Stop, or wait until bits 4:0 are 0"
    everything = Events(drivetwin, **{"Last-Event-ID": "0"})
    assert [everything.received(), everything.received()] == [first, second]


def test_events_come_while_the_clock_is_advanced(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    drivetwin.call("POST", "/api/drives/md3/pins/J2.5/pulses", {"count": 4_000_000_000, "hz": 50_000})
    events = Events(drivetwin)
    # A day of pulses: the advance ends only when it is given up.
    day = connect(drivetwin)
    day.request("POST", "/api/time/advance", json.dumps({"seconds": 86_400}), JSON)
    # The bench is faster than any reader: the stream may report missed events.
    told = [events.next() for _ in range(1_000)]
    kinds = {data["words"] for kind, _, data in told if kind != "lost"}
    assert kinds >= {"pin J2.5 low", "pin J2.5 high"}
    assert refused(drivetwin, "POST", "/api/time/advance", {"seconds": 1})["status"] == 409
    day.close()
    assert 0 < drivetwin.seconds() < 86_400


def test_who_is_too_slow_is_told_and_goes_on(run):
    """No event is read until the ring of 64 MiB has been filled: an event takes 64 bytes of it or more."""
    drivetwin = run("--fast-boot", "--time", "manual")
    events = Events(drivetwin)
    drivetwin.call("POST", "/api/drives/md3/pins/J2.5/pulses", {"count": 1_500_000, "hz": 5_000_000})
    drivetwin.advance(1)
    seen = [events.next()]
    while seen[-1][0] != "lost":
        seen.append(events.next())
    _, number, data = seen[-1]
    assert number == seen[-2][1] + data["events"]
    kind, following, _ = events.next()
    assert (kind in ("fed", "did"), following) == (True, number + 1)
    assert text(drivetwin).splitlines()[3].startswith("lost ")


def test_who_follows_a_quiet_drive_on_a_busy_bench_hears_that_somebody_is_there(run, tmp_path):
    bench = tmp_path / "bench.toml"
    drives = [f"[[drive]]\nname = '{name}'\nkind = 'md3'\n" for name in ("busy", "quiet")]
    bench.write_text("".join(drives))
    drivetwin = run("--fast-boot", kind=bench)
    drivetwin.call("POST", "/api/drives/busy/pins/J2.5/pulses", {"count": 1_000_000, "hz": 1_000})
    quiet, busy = Events(drivetwin, "?drive=quiet"), Events(drivetwin, "?drive=busy")
    assert quiet.piece() == {}
    assert busy.next()[2]["words"] in ("pin J2.5 low", "pin J2.5 high")


def test_only_so_many_follow_the_bench(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    readers = [Events(drivetwin) for _ in range(16)]
    problem = refused(drivetwin, "GET", "/api/events")
    assert (problem["status"], problem["detail"]) == (
        503,
        "the maximum number of clients that follow the bench is reached; wait until one disconnects",
    )
    drivetwin.seconds()
    readers.pop().close()
    last = when_there_is_room(lambda: Events(drivetwin), lambda: level(drivetwin, "J2.4", "low"))
    level(drivetwin, "J2.4", "high")
    for reader in [*readers, last]:
        while reader.next()[2]["words"] != "pin J2.4 high":
            pass


def test_the_trace_can_be_replayed(run, tmp_path):
    drivetwin = run("--fast-boot", "--time", "manual")
    with drivetwin.socket() as line:
        ask(line, MOVE, len(MOVE))
        drivetwin.advance(1.0)
    file = tmp_path / "bench.trace"
    file.write_text(text(drivetwin, "?format=trace"))
    replayed = subprocess.run([os.environ["DRIVETWIN"], "replay", file], capture_output=True, text=True)
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr


def test_frames_of_the_lines(run):
    """A section of pcapng, whose blocks have the length in their headers: the line, a request, a reply."""
    drivetwin = run("--fast-boot", "--time", "manual")
    with drivetwin.socket() as line:
        ask(line, MOVE, len(MOVE))
    connection = connect(drivetwin)
    connection.request("GET", "/api/trace?format=pcapng")
    answer = connection.getresponse()
    assert (answer.status, answer.getheader("Content-Type")) == (200, "application/x-pcapng")
    file = answer.read()
    kinds = []
    while file:
        kind, length = struct.unpack_from("<II", file)
        assert file[length - 4 : length] == file[4:8]
        kinds.append(kind)
        if kind == 6:
            assert MOVE in file[:length]
        file = file[length:]
    assert kinds == [0x0A0D0D0A, 1, 6, 6]


def test_waveforms_have_every_step(run):
    """10,000 steps (7.15): as many rising edges of STEP."""
    drivetwin = run("--fast-boot", "--time", "manual")
    with drivetwin.socket() as line:
        ask(line, MOVE, len(MOVE))
    drivetwin.advance(3.0)
    waves = text(drivetwin, "?format=vcd")
    head, changes = waves.split("$enddefinitions $end\n")
    (code,) = [words[3] for words in map(str.split, head.splitlines()) if words[4:5] == ["STEP"]]
    assert changes.splitlines().count(f"1{code}") == 10_000
    assert drivetwin.drive()["motion"]["position"] == 10_000


def test_waveforms_without_end_hold_nobody_up(run):
    """A jog for a day at 8,000 steps/s is a few events and some 15 GB of waveforms, which are made as they are read."""
    drivetwin = run("--fast-boot", "--time", "manual", "--set", "Speed=8000")
    with drivetwin.socket() as line:
        ask(line, bytes.fromhex("01 06 00 11 00 02 58 0E"), 8)
    drivetwin.advance(86_400)
    readers = [connect(drivetwin), connect(drivetwin)]
    for reader in readers:
        reader.request("GET", "/api/trace?format=vcd")
    pieces = [reader.getresponse().read(1 << 20) for reader in readers]
    assert pieces[0] == pieces[1] and len(pieces[0]) == 1 << 20
    assert refused(drivetwin, "GET", "/api/trace")["status"] == 503
    assert drivetwin.drive()["motion"]["moving"]
    for reader in readers:
        reader.close()
    when_there_is_room(lambda: text(drivetwin), drivetwin.seconds)
    assert drivetwin.stop() == 0


def test_sixty_five_connections_and_half_bodies(run):
    """All 64 connections are in use; requests that come too slowly are ended."""
    drivetwin = run("--fast-boot", "--time", "manual")
    halves = []
    for _ in range(64):
        half = connect(drivetwin)
        half.putrequest("PUT", "/api/time")
        half.putheader("Content-Type", "application/json")
        half.putheader("Content-Length", "17")
        half.endheaders(b'{"mode":')
        halves.append(half)
    # There is no room until the halves are given up.
    assert drivetwin.seconds() == 0
    given_up = 0
    for half in halves:
        try:
            answer = half.getresponse()
        except http.client.RemoteDisconnected:
            # Its head had not been read when there was no room.
            continue
        assert answer.status == 408
        assert json.loads(answer.read())["detail"] == "the body took too long"
        given_up += 1
    assert given_up > 0


def test_a_body_that_is_too_long_is_not_read(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    endless = connect(drivetwin)
    endless.putrequest("PUT", "/api/time")
    endless.putheader("Content-Type", "application/json")
    endless.putheader("Content-Length", str(1 << 40))
    endless.endheaders(b" " * (1 << 17))
    answer = endless.getresponse()
    assert (answer.status, answer.getheader("Content-Type")) == (413, "application/problem+json")


def test_calls_at_once_are_all_answered(run):
    drivetwin = run("--fast-boot")
    failed = []

    def work():
        try:
            for _ in range(20):
                drivetwin.drive()
                level(drivetwin, "J2.4", "low")
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=work) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed


def test_a_motor_is_seen_turning(run, tmp_path):
    """At 5,000 steps/s and 10,000 steps/s² (7.15) a move has made 6,250 steps after 1.5 s; 8 of them are a full
    step (7.2), 200 of those a turn."""
    bench = tmp_path / "bench.toml"
    bench.write_text(
        """
        [[drive]]
        name = "x"
        kind = "md3"

        [[motor]]
        name = "m"
        drive = "x"
        steps_per_rev = 200
        """
    )
    drivetwin = run("--fast-boot", "--time", "manual", kind=bench)
    drivetwin.call("PUT", "/api/drives/x/registers/MotionControl", {"value": 1})
    drivetwin.call("POST", "/api/time/advance", {"seconds": 1.5})
    (motor,) = drivetwin.call("GET", "/api/bench")["motors"]
    assert (motor["name"], motor["drive"], motor["stalled"]) == ("m", "x", False)
    assert motor["revolutions"] == pytest.approx(6_250 / 1_600, abs=1e-3)
    assert motor["rpm"] == pytest.approx(5_000 / 1_600 * 60)


def test_what_is_live_is_what_the_calls_tell(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    live, details = Live(drivetwin.control), Live(drivetwin.control, "?drive=md3")
    for client in (live, details):
        client.update()
    assert live.state["drives"]["md3"] == {
        "index": 0, "kind": "md3", "powered": True, "lit": live.state["drives"]["md3"]["lit"],
        "fault": False, "moving": False, "position": 0, "speed": 0.0, "refused": 0, "unanswered": 0,
    }
    with drivetwin.socket() as line:
        assert ask(line, MOVE, len(MOVE)) == MOVE
    live.until(lambda live: live.state["drives"]["md3"]["moving"] and live.traffic)
    assert (live.traffic[0]["text"], live.traffic[0]["verdict"]) == ("write MotionControl = 1", "done")
    assert live.traffic[0]["bytes"] == live.traffic[0]["answer"] == MOVE.hex().upper()
    # 10,000 steps of the factory settings (7.15) take 2.5 s.
    time_then = drivetwin.call("POST", "/api/time/advance", {"seconds": 2.5})
    for client in (live, details):
        client.until(lambda client: client.state["time"] == time_then)
    drive = without_nulls(drivetwin.call("GET", "/api/drives/md3"))
    assert drive["motion"]["position"] == live.state["drives"]["md3"]["position"] == 10_000
    assert details.state["drive"] == drive
    (bus,) = drivetwin.call("GET", "/api/buses")
    name = bus.pop("name")
    assert live.state["buses"] == {name: without_nulls(bus)}
    assert live.state["cannot"] == {}
    for client in (live, details):
        client.close()


def test_what_calls_change_is_live(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    live = Live(drivetwin.control)
    live.update()
    drivetwin.call("PUT", "/api/buses/rs485/faults", {"drop": 0.5})
    live.until(lambda live: live.state["buses"]["rs485"]["faults"]["drop"] == 0.5)
    drivetwin.call("POST", "/api/drives/md3/power", {"action": "off"})
    live.until(lambda live: not live.state["drives"]["md3"]["powered"])
    drivetwin.call("PUT", "/api/time", {"mode": "x2"})
    live.until(lambda live: live.state["time"]["mode"] == "x2" and "advance" in live.state["cannot"])
    live.close()
    assert "the nearest is 'md3'" in refused(drivetwin, "GET", "/api/live?drive=md4")["detail"]


def test_a_busy_bench_gives_at_most_30_updates_a_second(run):
    """A QSB that streams 512 records a second changes all the time."""
    drivetwin = run("--fast-boot", kind="qsb-d")
    live = Live(drivetwin.control, "?drive=qsb-d")
    live.update()
    drivetwin.call("POST", "/api/drives/qsb-d/encoder", {"counts": 1_000_000, "hz": 100_000})
    began, first = time.monotonic(), live.updates
    while live.updates < first + 40:
        live.update()
    # Two updates may have waited for the reader.
    assert time.monotonic() - began > (40 - 2) / 30
    counts = live.state["drive"]["registers"]
    live.until(lambda live: live.state["drive"]["registers"] != counts)
    live.close()


def test_a_reader_that_stops_keeps_nobody_waiting_and_goes_on_with_the_present(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    live = Live(drivetwin.control)
    live.update()
    for n in range(1, 300):
        drivetwin.call("PUT", "/api/drives/md3/registers/Speed", {"value": n})
        drivetwin.call("POST", "/api/time/advance", {"seconds": 0.001})
    now = drivetwin.call("POST", "/api/time/advance", {"seconds": 1})
    live.until(lambda live: live.state["time"] == now)
    live.close()


class Terminal:
    """A terminal at a port of a drive."""

    def __init__(self, drivetwin, port):
        self.drivetwin, self.shown = drivetwin, ""
        self.connection = connect(drivetwin)
        self.connection.request("GET", f"/api/drives/{drivetwin.kind}/ports/{port}/terminal")
        self.answer = answered(self.connection)
        kind, data = self.event()
        assert kind == "open"
        self.id = data["id"]

    def event(self):
        """The kind and the data of the next event; None if the drive has ended the connection."""
        fields = {}
        while not fields:
            while (line := self.answer.readline().decode()) != "\n":
                if not line:
                    return None
                if not line.startswith(":"):
                    name, _, value = line.rstrip("\n").partition(": ")
                    fields[name] = value
        return fields["event"], json.loads(fields["data"])

    def type(self, text):
        self.drivetwin.call("POST", f"/api/terminals/{self.id}", {"text": text})

    def until(self, text):
        """Reads until this text has come."""
        until = time.monotonic() + PATIENCE
        while text not in self.shown:
            assert time.monotonic() < until, self.shown
            kind, data = self.event()
            assert kind == "text"
            self.shown += data["text"]

    def close(self):
        self.answer.close()
        self.connection.close()


def test_a_terminal_at_mcode_and_its_end(run):
    """VM is 768,000 in a new drive (MCode manual, VM)."""
    drivetwin = run("--fast-boot", "--time", "manual", kind="mdrive")
    first, second = Terminal(drivetwin, "mcode"), Terminal(drivetwin, "mcode")
    assert (first.id, second.id) == (1, 2)
    assert drivetwin.drive()["ports"]["mcode"]["connected"] == 2
    first.type("PR ")
    first.type("VM\r")
    first.until("PR VM\r\n768000\r\n")
    second.close()
    until = time.monotonic() + PATIENCE
    while drivetwin.drive()["ports"]["mcode"]["connected"] == 2:
        assert time.monotonic() < until, "the client is still there"
    assert "there is no terminal 2" in refused(drivetwin, "POST", "/api/terminals/2", {"text": "PR VM\r"})["detail"]
    # Without power the connection is lost, and there is no other one.
    drivetwin.call("POST", "/api/drives/mdrive/power", {"action": "off"})
    while first.event():
        pass
    problem = refused(drivetwin, "GET", "/api/drives/mdrive/ports/mcode/terminal")
    assert (problem["status"], problem["detail"]) == (409, "mdrive accepts no connection: the drive has no power")
    problem = refused(drivetwin, "GET", "/api/drives/mdrive/ports/modbus/terminal")
    assert (problem["status"], problem["detail"]) == (422, "a terminal is for a port of mdrive with text; it has mcode")


def test_a_terminal_at_a_qsb(run):
    """ReadEncoder is register 0E (4.1)."""
    drivetwin = run("--fast-boot", kind="qsb-d")
    terminal = Terminal(drivetwin, "usb")
    terminal.type("R0E\r")
    terminal.until("r 0E 00000000")
    terminal.close()


def test_the_clock_runs_to_the_next_event(run):
    """An MD3 answers 2.5 s after power-on; a move of 10,000 steps takes 2.5 s (7.15)."""
    drivetwin = run("--fast-boot", "--time", "manual")
    drivetwin.advance(1)
    drivetwin.call("PUT", "/api/drives/md3/registers/MotionControl", {"value": 1})
    while drivetwin.drive()["motion"]["moving"]:
        before = drivetwin.call("GET", "/api/bench")["time"]["seconds"]
        after = drivetwin.call("POST", "/api/time/advance", {"to": "next"})["seconds"]
        assert before < after < before + 2.6
    assert drivetwin.drive()["motion"]["position"] == 10_000
    for body in ({}, {"seconds": 1, "to": "next"}):
        assert "takes seconds, or" in refused(drivetwin, "POST", "/api/time/advance", body)["detail"]
    drivetwin.call("PUT", "/api/time", {"mode": "real"})
    assert refused(drivetwin, "POST", "/api/time/advance", {"to": "next"})["status"] == 409
