"""Drives with ports in a thread of the process."""

import os
import socket
import subprocess
import threading

import pytest
from modbus import read, write
from pymodbus import FramerType
from pymodbus.client import ModbusTcpClient
from test_command import COMMAND

import drivetwin
from drivetwin import Error, UnknownName

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
            (lambda: rack.advance(-1), Error, "seconds takes 0 to 86400"),
        ]:
            with pytest.raises(error) as raised:
                act()
            assert sentence is None or str(raised.value) == sentence
    with pytest.raises(Error, match="does not answer"):
        rack.now
    rack.close()
    with drivetwin.run("md3", control="off") as rack, pytest.raises(Error, match="^the control API is off"):
        rack.now


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
