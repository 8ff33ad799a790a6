"""Drives with ports in a thread of the process."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time

import pytest
from modbus import crc, read, write
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException
from test_command import COMMAND

import drivetwin
from drivetwin import Error, UnknownName
from drivetwin._native import panic_for_test

MANUAL = {"time": "manual", "fast_boot": True}


def master(drive):
    _, host, port = drive.uri("rs485").split(":")
    return ModbusTcpClient(host, port=int(port), framer=FramerType.RTU, retries=0)


def test_pymodbus_moves_a_motor_in_manual_time():
    with drivetwin.run("md3", **MANUAL, line="fast", set={"Speed": 8000}) as rack:
        x = rack["md3"]
        with master(x) as client:
            assert client.read_holding_registers(0x14, count=2).registers == [0, 8000]
            assert not client.write_register(0x11, 1).isError()
        rack.advance(0.5)
        assert x.motion.moving and 0 < x.motion.position < 10_000
        rack.advance(2.5)
        assert (x.motion.position, x.motion.speed, x.motion.moving) == (10_000, 0.0, False)
        assert rack.time == "manual" and rack.now > 3.0 and rack.control.startswith("http://127.0.0.1:")
        assert list(rack) == ["md3"] and len(rack) == 1 and "md3" in rack and x.ports == ["rs485"]


def test_a_drive_with_ports_has_the_methods_of_one_without():
    """The same program, against a bench with ports and one without, has the same results."""
    with drivetwin.run("md3", **MANUAL, control="off", seed=3) as served, drivetwin.Bench(seed=3) as alone:
        alone.add("md3", fast_boot=True)
        assert served.control is None and served.time == alone.time == "manual"
        seen = []
        for bench in served, alone:
            x = bench["md3"]
            of = [x.bench == bench, x.name, x.kind, x.ports, x.powered, dict(x.registers), dict(x.pins), x.leds]
            of += [x.ask(write(1, 0x11, 1)), x.ask(b"\x01"), x.ask(write(9, 0x11, 1)), bench.now]
            bench.advance(0.25)
            of += [repr(x.motion), bench.now]
            x.registers["UserRegister"] = 7
            x.pins["J2.3"] = "low"
            x.encoder(40, hz=1_000)
            x.pulse("J2.4", 10, hz=1_000)
            bench.motor("md3", steps_per_rev=200)
            bench.switch("m", closed={"above_rev": 1.0}, to="md3.J2.2")
            bench.wire("md3.J3.7", "md3.J2.5")
            bench.run_until(4.0)
            x.fault("over_temperature")
            x.line().faults(drop={"count": 1, "direction": "reply"})
            x.line().strict = True
            stream = x.port("rs485")
            stream.configure(9600, 8, "E", 1)
            stream.write(read(1, 0x1D, 1))
            assert not stream.wait(0.1) and stream.read() == b""
            stream.write(read(1, 0x1D, 1))
            stream.settle()
            stream.drain(1.0)
            of += [stream.read(), stream.unsent]
            stream.close()
            of += [dict(x.registers), dict(x.pins), x.leds, x.faults, x.line().strict]
            # Where the clock stands between requests, their silence tells nothing.
            of += [{**x.statistics(), "shortest_silence": None}]
            of += [list(map(repr, x.received())), x.wrote_before("MotionControl", "Speed")]
            of += [round(bench.motors["m"].revolutions, 5), list(bench), len(bench.values())]
            of += [x.pulses().tolist(), bench.history(x).tolist()[:-1]]
            assert len(of[-1]) > len(of[-2]) // 10 > 40
            seen.append(of)
        assert seen[0] == seen[1] and seen[0][8] == write(1, 0x11, 1) and seen[0][10] == b""
    with drivetwin.run("md3", **MANUAL) as served:
        x = served["md3"]
        assert x.ask(write(1, 0x11, 1)) == write(1, 0x11, 1)
        served.advance(3.0)
        assert len(x.pulses()) == 10_000 and x.url().startswith("drivetwin://?shared=")


def test_real_time_does_what_it_can_and_says_what_it_cannot():
    with drivetwin.run("md3", fast_boot=True) as rack:
        x = rack["md3"]
        assert rack.time == "real"
        began = rack.now
        for _ in range(3):
            assert x.ask(read(1, 0x14, 2))[:3] == bytes([1, 3, 4])
        assert x.ask(read(9, 0x14, 2)) == b"" and x.ask(b"\x01\x03") == b""
        # Each request and reply takes its time at 9,600 baud.
        assert rack.now - began > 5 * 8 * 11 / 9_600
        with x.port("rs485") as stream:
            stream.write(write(1, 0x11, 1))
            stream.settle()
            assert stream.wait(1.0)
            stream.drain(1.0)
            assert stream.read() == write(1, 0x11, 1) and not stream.wait(0.05)
            # What comes later stays until it is read, and the bench goes on.
            stream.write(read(1, 0x14, 2))
            at = rack.now
            while rack.now < at + 0.2:
                assert x.motion.moving
            assert len(stream.read()) == 9
        sentence = "the clock follows the wall clock (time is 'real'), so a call cannot move it; use time='manual'"
        for act in lambda: rack.advance(1.0), lambda: rack.run_until(100.0):
            with pytest.raises(Error) as raised:
                act()
            assert str(raised.value) == sentence
        rack.time = "x100"
        began = rack.now
        while rack.now < began + 3.0:
            pass
        assert x.motion.position == 10_000 and rack.time == "x100"
        rack.time = "manual"
        at = rack.now
        rack.advance(1.0)
        assert rack.now == pytest.approx(at + 1.0)
    with drivetwin.Bench() as bench, pytest.raises(Error, match="^a bench without ports has virtual time"):
        bench.time = "real"


def test_everything_of_the_control_api():
    with drivetwin.run("md3", **MANUAL) as rack:
        x = rack["md3"]
        x.registers["Speed"] = 9_000
        assert x.registers["Speed"] == 9_000 and "Speed" in x.registers and len(x.registers) == len(dict(x.registers))
        x.pins["J2.3"] = "low"
        rack.advance(0.001)
        assert x.pins["J2.3"] == "low" and set(x.leds) == {"D5", "D6"}
        x.fault("over_temperature")
        assert x.faults["over_temperature"]
        x.clear("over_temperature")
        x.power("off")
        assert not x.powered
        x.power("on")
        rack.advance(3.0)
        x.line().faults(drop={"count": 1, "direction": "reply"})
        with master(x) as client:
            client.comm_params.timeout_connect = 0.2
            with pytest.raises(Exception, match="(?i)no response|modbus"):
                client.write_register(0x15, 8_000)
            assert not client.write_register(0x15, 8_000).isError()
        first, second = x.received(register="Speed")
        assert first.bytes == first.answer == second.answer == write(1, 0x15, 8_000)
        assert first.outcome == "done; by a fault, the reply was dropped"
        assert (first.verdict, second.function, second.registers[0].name) == ("done", 6, "SpeedLow")
        assert str(second) == "rs485 <- write SpeedLow = 8000 -> done"
        x.pulse("J2.4", 10, hz=1000)
        rack.scenario([{"after_ms": 100, "drive": "md3", "fault": "over_temperature"}])
        rack.advance(0.05)
        assert not x.faults["over_temperature"]
        rack.advance(0.1)
        assert x.faults["over_temperature"]
        assert rack.trace().startswith("drivetwin trace") and b"$enddefinitions" in rack.vcd()
        assert rack.pcapng()[:4] == bytes.fromhex("0A0D0D0A")
        rack.time = "x10"
        assert rack.time == "x10"
    with drivetwin.run("qsb-d", **MANUAL) as rack:
        rack["qsb-d"].encoder(400, hz=10_000)
        with pytest.raises(Error, match="moves nothing"):
            rack["qsb-d"].motion


def test_a_pty_and_a_place_of_ones_own(tmp_path):
    link = tmp_path / "md3.tty"
    with drivetwin.run("md3", **MANUAL, listen=[f"pty:{link}", "tcp:127.0.0.1:0"]) as rack:
        x = rack["md3"]
        assert os.path.exists(x.pty) and os.path.realpath(link) == os.path.realpath(x.pty)
        assert len(x.uris()) == 3 and x.uri().startswith("pty:")
        terminal = os.open(x.pty, os.O_RDWR | os.O_NOCTTY)
        try:
            import tty

            tty.setraw(terminal)
            os.write(terminal, read(1, 0x14, 2))
            reply = b""
            while len(reply) < 9:
                reply += os.read(terminal, 9)
            assert reply[:3] == bytes([1, 3, 4])
        finally:
            os.close(terminal)
    assert not os.path.lexists(link)


def test_a_bench_file_and_its_lines(tmp_path):
    file = tmp_path / "bench.toml"
    file.write_text(
        '[[bus]]\nname = "line1"\ndrives = ["x", "y"]\n'
        + "".join(f'[[drive]]\nname = "{name}"\nkind = "md3"\naddress = {n}\n' for n, name in enumerate("xy", 1))
    )
    record = tmp_path / "x.trace"
    with drivetwin.run(file, **MANUAL, record=record) as rack:
        assert rack["y"].line().name == rack.line("line1").name == "line1"
        rack.line("line1").faults(mute=True)
        assert rack["x"].uri() == rack["y"].uri()
        rack.advance(1.0)
    assert subprocess.run([COMMAND, "replay", record]).returncode == 0


def test_what_is_wrong_is_one_sentence():
    for act, error, sentence in [
        (lambda: drivetwin.run("md4"), UnknownName, "there is no kind 'md4'; the nearest is 'md3'"),
        (lambda: drivetwin.run("md3", set={"Sped": 1}), UnknownName, None),
        (lambda: drivetwin.run("md3", tim="manual"), Error, "unexpected argument '--tim' found; tip: a similar argument exists: '--time'"),
        (lambda: drivetwin.run("md3", time="soon"), Error, None),
        (lambda: drivetwin.run("md3", listen="stdio:"), Error, "stdio: is not possible here: standard input is that of Python"),
    ]:  # fmt: skip
        with pytest.raises(error) as raised:
            act()
        assert sentence is None or str(raised.value) == sentence
    with drivetwin.run("md3", **MANUAL) as rack:
        x = rack["md3"]
        for act, error, sentence in [
            (lambda: rack["md"], UnknownName, "there is no drive 'md'; the nearest is 'md3'"),
            (lambda: x.registers["Sped"], UnknownName, "there is no register 'Sped'; the nearest is 'Speed'"),
            (lambda: x.registers.__setitem__("Sped", 1), UnknownName, None),
            (lambda: x.registers.__setitem__("DeviceAddress", 300), Error, "DeviceAddress takes 1 to 247, not 300"),
            (lambda: x.fault("over_temprature"), UnknownName, None),
            (lambda: x.uri("rs458"), UnknownName, "there is no port 'rs458'; the nearest is 'rs485'"),
            (lambda: rack.line("rs458"), UnknownName, "there is no bus 'rs458'; the nearest is 'rs485'"),
            (lambda: rack.advance(-1), Error, "advance takes seconds from 0 to 1000000000, not -1"),
            (lambda: rack.add("md3", name="y"), Error, None),
            (lambda: rack.bus("b", ["md3"]), Error, None),
            (lambda: setattr(rack, "time", "soon"), Error, "time: it takes real, xN (N from 1 to 1000) or manual, not 'soon'"),
        ]:
            with pytest.raises(error) as raised:
                act()
            assert sentence is None or str(raised.value) == sentence
    with pytest.raises(Error, match="^the bench is closed$"):
        rack.now
    assert rack.closed
    rack.close()


@pytest.mark.parametrize(
    "end",
    [
        "",
        "raise ValueError('a test asked for this')",
        "del rack; print(os.path.lexists(link), open(record).read().count('end'))",
        "x = rack['md3']; del rack",
        "if os.fork() == 0: sys.exit()\nos.wait(); rack.now",
    ],
)
def test_a_run_that_is_not_closed_ends_with_the_interpreter(tmp_path, end):
    link, record = tmp_path / "md3.tty", tmp_path / "x.trace"
    program = f"""
import os, sys, drivetwin
link, record = {str(link)!r}, {str(record)!r}
rack = drivetwin.run("md3", time="manual", listen="pty:" + link, record=record)
assert os.path.lexists(link)
rack.advance(1.5)
{end}
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    last = done.stderr.splitlines()[-1:]
    assert last == (["ValueError: a test asked for this"] if end.startswith("raise") else [])
    assert done.stdout == ("False 1\n" if end.startswith("del") else "")
    assert not os.path.lexists(link)
    assert record.read_text().endswith("1500.000000 end\n")
    assert subprocess.run([COMMAND, "replay", record]).returncode == 0


MEMORY = """
import resource, sys, drivetwin
from modbus import write

def may_write(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

nv, kind, is_closed = sys.argv[1:]
if kind == "run":
    bench = drivetwin.run("md3", time="manual", fast_boot=True, nv=nv)
else:
    bench = drivetwin.Bench()
    bench.add("md3", fast_boot=True, nv=nv)
may_write(0)
x = bench["md3"]
assert x.ask(write(1, 0x1D, 1234)) and x.ask(write(1, 0x1A, 1))  # EEPROMControl: save
bench.advance(1.0)
if is_closed == "closed":
    bench.close()
"""


@pytest.mark.parametrize(("kind", "is_closed"), [("run", "closed"), ("run", ""), ("bench", "closed")])
def test_a_memory_that_cannot_be_saved_is_an_error(tmp_path, kind, is_closed):
    command = [sys.executable, "-c", MEMORY, tmp_path / "x.nv", kind, is_closed]
    done = subprocess.run(command, cwd=os.path.dirname(__file__), stderr=subprocess.PIPE, text=True)
    sentence = f"drivetwin._errors.Error: {tmp_path}/x.nv does not keep what the drive stored: File too large (os error 27)"
    assert done.stderr.splitlines()[-1] == sentence
    assert done.returncode == (1 if is_closed else 0)


def test_arguments_as_python_writes_them(tmp_path):
    program = tmp_path / "x.toml"
    program.write_text('[[drive]]\nname = "x"\nkind = "md3"\n')
    with drivetwin.run("md3", time="manual", control=False, fast_boot=1, strict=0, set={"UserRegister": True}) as rack:
        x = rack["md3"]
        assert rack.control is None and not x.line().strict and x.registers["UserRegister"] == 1
        assert x.ask(read(1, 0x14, 2))
    with drivetwin.run(program, time="manual", fast_boot=0, control=None) as rack:
        assert rack.control and rack["x"].ask(read(1, 0x14, 2)) == b""
    for act, sentence in [
        (lambda: drivetwin.run(None), "run takes a kind or the path of a bench file, not None"),
        (lambda: drivetwin.run(b"md3"), "run takes a kind or the path of a bench file, not b'md3'"),
        (lambda: drivetwin.run("md3", record=b"x.trace"), "record takes a string, not b'x.trace'"),
        (lambda: drivetwin.run("md3", help=True), "run has no argument 'help': it prints nothing"),
        (lambda: drivetwin.run("md3", verbose=2), "run has no argument 'verbose': it prints nothing"),
        (lambda: drivetwin.run("md3", control=True), "control is no flag: it takes a value, not True"),
    ]:
        with pytest.raises(TypeError) as raised:
            act()
        assert str(raised.value) == sentence


def test_nothing_is_left_behind():
    def here():
        return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))

    with drivetwin.run("md3", **MANUAL):
        pass
    before = here()
    for _ in range(20):
        with drivetwin.run("md3", **MANUAL) as rack:
            _, host, port = rack["md3"].uri().split(":")
            pty = rack["md3"].pty
            assert rack.now == 0.0
    assert here() == before
    assert not os.path.exists(pty)
    with socket.socket() as probe:
        assert probe.connect_ex((host, int(port))) != 0


def test_two_benches_run_beside_each_other():
    with drivetwin.run("md3", **MANUAL) as a, drivetwin.run("mdrobot", **MANUAL) as b:
        threads = [threading.Thread(target=rack.advance, args=(100.0,)) for rack in (a, b)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert a.now >= 100.0 and b.now >= 100.0


def test_asks_in_real_time_beside_another_master_get_their_own_answers():
    replies, other = [], []
    with drivetwin.run("md3", time="x100", fast_boot=True, set={"Speed": 8000}) as rack:
        x = rack["md3"]
        began = time.monotonic()

        def ask():
            while len(replies) < 200 and time.monotonic() < began + 60:
                replies.append(x.ask(read(1, 0x14, 2)))

        def master():
            _, host, port = x.uri("rs485").split(":")
            with socket.create_connection((host, int(port)), timeout=10) as line:
                while len(replies) < 200 and time.monotonic() < began + 60:
                    line.sendall(read(1, 0x1D, 1))
                    heard = b""
                    while crc(bytes([1, 3, 2, 0, 0])) not in heard:
                        heard += line.recv(100)
                    other.append(heard)

        threads = [threading.Thread(target=act) for act in (ask, ask, ask, master)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(replies) >= 200 and len(other) > 10
    assert set(replies) == {crc(bytes([1, 3, 4, 0, 0, 0x1F, 0x40]))}


@pytest.mark.parametrize("mode", ["manual", "real"])
def test_a_drive_with_ports_has_a_url_for_pyserial(mode):
    with drivetwin.run("md3", time=mode, fast_boot=True) as rack:
        x = rack["md3"]
        with ModbusSerialClient(x.url(), baudrate=9600, parity="E", timeout=0.2, retries=0) as client:
            for speed in 9_000, 8_000:
                assert not client.write_register(0x15, speed).isError()
                assert x.registers["Speed"] == speed
            x.line().faults(mute=True)
            with pytest.raises(ModbusException):
                client.write_register(0x15, 1)
            x.line().faults()
            x.registers["Speed"] = 8_000
        with master(x) as client:
            assert client.read_holding_registers(0x14, count=2).registers == [0, 8_000]


def test_ctrl_c_interrupts_a_wait_in_real_time():
    with drivetwin.run("md3", fast_boot=True) as rack, rack["md3"].port("rs485") as stream:
        # A shell starts programs in the background with SIGINT ignored.
        usual = signal.signal(signal.SIGINT, signal.default_int_handler)
        timer = threading.Timer(0.2, os.kill, [os.getpid(), signal.SIGINT])
        timer.start()
        try:
            with pytest.raises(KeyboardInterrupt):
                stream.wait(60.0)
        finally:
            timer.join()
            signal.signal(signal.SIGINT, usual)
        assert rack.now < 30.0 and len(rack["md3"].ask(read(1, 0x14, 2))) == 9


def test_a_panic_is_an_exception_and_the_run_can_be_closed():
    with drivetwin.run("md3", **MANUAL) as rack:
        with pytest.raises(BaseException, match="a test asked for this panic"):
            panic_for_test(rack)
        with pytest.raises(Error, match="a call of the bench has panicked"):
            rack.now


def test_a_fork_must_make_its_own():
    with drivetwin.run("md3", **MANUAL) as rack:
        child = os.fork()
        if child == 0:
            try:
                rack.now
            except Error as error:
                os._exit(0 if str(error).startswith("the bench belongs to the process that made it") else 1)
            os._exit(2)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert rack.now == 0.0
