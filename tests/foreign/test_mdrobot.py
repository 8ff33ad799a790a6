"""pymodbus with MDROBOT controllers on the pty, at 19,200 8N1, as a robot's computer."""

import json
import urllib.error

import pytest
from pymodbus.pdu import ExceptionResponse

from conftest import ask, receive
from mdrobot import *
from modbus import frame

BAUD = 19_200
"""Of a new controller (p. 2)."""


@pytest.fixture
def master(run, serial):
    """A controller whose clock stops between two requests, and pymodbus on its pty."""

    def start(*options):
        drivetwin = run("--time", "manual", *options, kind="mdrobot")
        drivetwin.advance(0.4)
        return drivetwin, Master(serial(drivetwin, baudrate=BAUD))

    return start


class Master:
    """pymodbus that insists on good answers."""

    def __init__(self, client, device_id=1):
        self.client, self.device_id = client, device_id

    def words(self, pid, count):
        """Reads that many words of a PID."""
        answer = self.client.read_holding_registers(pid, count=count, device_id=self.device_id)
        assert not answer.isError(), answer
        assert len(answer.registers) == count
        return answer.registers

    def read(self, pid):
        """A PID of one word."""
        (word,) = self.words(pid, 1)
        return word

    def signed(self, pid):
        """A PID of one word with a sign."""
        return int.from_bytes(self.read(pid).to_bytes(2, "big"), "big", signed=True)

    def long(self, pid):
        """A PID of two words, the low one first."""
        low, high = self.words(pid, 2)
        return int.from_bytes(bytes([*high.to_bytes(2, "big"), *low.to_bytes(2, "big")]), "big", signed=True)

    def write(self, pid, value):
        """Function 6."""
        answer = self.client.write_register(pid, value & 0xFFFF, device_id=self.device_id)
        assert not answer.isError(), answer
        assert (answer.address, answer.registers) == (pid, [value & 0xFFFF])

    def write_words(self, pid, *words):
        """Function 16."""
        answer = self.client.write_registers(pid, list(words), device_id=self.device_id)
        assert not answer.isError(), answer
        assert (answer.address, answer.count) == (pid, len(words))

    def write_position(self, pid, position, *rest):
        """Two words, the low one first, and what comes behind them."""
        self.write_words(pid, position & 0xFFFF, position >> 16 & 0xFFFF, *rest)

    def arm(self):
        """Arms the controller, so that a velocity moves the motor."""
        self.write(UI_COM, 1)
        self.write(START_STOP, 1)


def test_reads_and_writes_of_all_kinds(master):
    _, master = master()
    assert master.read(VERSION) == 81
    assert master.read(VOLT_IN) == 240
    assert (master.read(MAX_RPM), master.read(P_GAIN)) == (3_000, 6_000)
    assert master.words(SPEED_LIMIT, 2) == [0, 0]
    assert master.words(FUNC_SPEED, 2) == [1_000, 10]
    assert master.words(MONITOR, 6) == [0] * 6
    master.write(P_GAIN, 1_234)
    master.write_words(P_GAIN + 1, 4_321)
    assert [master.read(pid) for pid in (P_GAIN, P_GAIN + 1)] == [1_234, 4_321]
    master.write_words(SPEED_LIMIT, 100, 900)
    assert master.words(SPEED_LIMIT, 2) == [100, 900]
    assert [master.read(pid) for pid in (157, 158)] == [100, 900]
    master.write(DEFAULT_SET, 0x55)
    assert master.words(SPEED_LIMIT, 2) == [0, 0]
    assert master.read(P_GAIN) == 6_000


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (lambda c: c.read_coils(0), 1),
        (lambda c: c.read_input_registers(VERSION), 1),
        (lambda c: c.mask_write_register(address=UI_COM), 1),
        (lambda c: c.read_holding_registers(2), 2),
        (lambda c: c.read_holding_registers(0x0182), 2),
        (lambda c: c.read_holding_registers(TQ_OFF), 2),
        (lambda c: c.read_holding_registers(POSI_CMD, count=2), 2),
        (lambda c: c.read_holding_registers(193), 2),
        (lambda c: c.write_register(VERSION, 1), 2),
        (lambda c: c.read_holding_registers(VERSION, count=2), 3),
        (lambda c: c.read_holding_registers(POSI_DATA), 3),
        (lambda c: c.write_register(POSI_CMD, 1), 3),
        (lambda c: c.write_registers(UI_COM, [1, 1]), 3),
        (lambda c: c.write_register(UI_COM, 2), 3),
        (lambda c: c.write_register(ID, 0x00AA), 3),
    ],
)
def test_exceptions(master, request_, code):
    _, master = master()
    refusal = request_(master.client)
    assert isinstance(refusal, ExceptionResponse) and refusal.exception_code == code
    assert master.read(UI_COM) == 0


def test_arming_and_a_velocity(master):
    drivetwin, master = master()
    master.write(VEL_CMD, 1_000)
    drivetwin.advance(2)
    assert (master.read(VEL_CMD), master.read(RPM_DATA), master.long(POSI_DATA)) == (1_000, 0, 0)
    master.arm()
    drivetwin.advance(2)
    assert master.read(RPM_DATA) == 0, "what was written before is for reading"
    for rpm in (1_000, -400):
        master.write(VEL_CMD, rpm)
        drivetwin.advance(2.5)
        assert abs(master.signed(RPM_DATA) - rpm) <= max(2, abs(rpm) / 100)
        began, at = drivetwin.seconds(), master.long(POSI_DATA)
        drivetwin.advance(3)
        turns = (master.long(POSI_DATA) - at) / COUNTS
        assert turns == pytest.approx(rpm / 60 * (drivetwin.seconds() - began), rel=0.02, abs=0.2)
    motion = drivetwin.drive()["motion"]
    assert motion["moving"] and motion["speed"] / COUNTS * 60 == pytest.approx(-400, abs=20)
    speed, *_ = monitor = master.words(MONITOR, 6)
    assert abs(speed - 0x10000 + 400) <= 6
    assert monitor[5] == 0
    master.write(COMMAND, CMD_BRAKE)
    drivetwin.advance(2)
    assert master.read(RPM_DATA) == 0
    assert not drivetwin.drive()["motion"]["moving"]


def test_positions(master):
    drivetwin, master = master()
    master.write(COMMAND, CMD_UICOM_ON)
    assert master.read(UI_COM) == 1
    master.write(MAX_RPM, 1_000)
    # 600 counts at 1,000 rpm, 200 counts a second, are 3 s; twice that at most.
    master.write_position(POSI_CMD, 600)
    assert master.long(TAR_POSI) == 600
    drivetwin.advance(1.5)
    assert 100 < master.long(POSI_DATA) < 400
    drivetwin.advance(4.5)
    assert abs(master.long(POSI_DATA) - 600) <= 1
    # With a speed: 900 counts at 600 rpm are 7.5 s.
    master.write(IN_POSITION, 5)
    master.write_position(POSI_VEL_CMD, -300, 600)
    assert master.long(TAR_POSI) == -300
    fastest = 0
    for _ in range(14):
        drivetwin.advance(0.5)
        fastest = max(fastest, abs(master.signed(RPM_DATA)))
        assert master.read(IN_POSITION_OK) == 0
    assert 540 <= fastest <= 690
    drivetwin.advance(8)
    assert abs(master.long(POSI_DATA) + 300) <= 1
    assert master.read(IN_POSITION_OK) == 1
    master.write_position(INC_POSI_CMD, 100_000)
    assert abs(master.long(TAR_POSI) - 99_700) <= 1


def test_the_api_sees_and_moves_pins(master):
    drivetwin, master = master()
    pins = "/api/drives/mdrobot/pins"

    def put(pin, **how):
        drivetwin.call("PUT", f"{pins}/{pin}", how)
        drivetwin.advance(0.01)

    assert drivetwin.drive()["pins"]["ALARM"] == "high"
    assert master.read(DI) == 0b110_0000
    put("RUN_BRAKE", level="low")
    put("START_STOP", level="high")
    put("SPEED_IN", volts=2.0)
    assert master.read(DI) == 0b110_1000
    drivetwin.advance(1)
    assert master.read(RPM_DATA) == 0
    put("START_STOP", level="low")
    drivetwin.advance(2.5)
    # 2 V of 5 of 3,000 rpm, and a step of 1,023.
    assert abs(master.signed(RPM_DATA) - 1_200) <= 12 + 3
    put("DIR", level="low")
    drivetwin.advance(2.5)
    assert abs(master.signed(RPM_DATA) + 1_200) <= 12 + 3
    # START/STOP is released: OFF.
    put("START_STOP", level="open")
    drivetwin.advance(20)
    assert (master.read(RPM_DATA), master.read(DI)) == (0, 0b110_1100)


def test_the_api_makes_faults(master):
    drivetwin, master = master()
    master.arm()
    for fault, bit, cleared in (("over_voltage", OVER_VOLT, False), ("hall_fail", HALL_FAIL, True), ("stall", STALL, True)):
        master.write(VEL_CMD, 800)
        drivetwin.advance(2.5)
        assert abs(master.signed(RPM_DATA) - 800) <= 8, fault
        drivetwin.call("PUT", f"/api/drives/mdrobot/faults/{fault}")
        drivetwin.advance(3)
        assert master.read(CTRL_STATUS) == ALARM | bit, fault
        assert drivetwin.drive()["pins"]["ALARM"] == "low"
        drivetwin.advance(20)
        assert master.read(RPM_DATA) == 0
        if not cleared:
            assert master.read(VOLT_IN) == 610
            master.write(COMMAND, CMD_ALARM_RESET)
            drivetwin.advance(0.01)
            assert master.read(CTRL_STATUS) == ALARM | bit, "the cause is there still"
        drivetwin.call("DELETE", f"/api/drives/mdrobot/faults/{fault}")
        drivetwin.advance(0.1)
        assert master.read(CTRL_STATUS) == ALARM | bit, "it is latched"
        master.write(ALARM_RESET, 0)
        drivetwin.advance(0.01)
        assert master.read(CTRL_STATUS) == 0
        assert drivetwin.drive()["pins"]["ALARM"] == "high"


def test_settings_hold_when_power_fails(run, serial, tmp_path):
    nv = tmp_path / "md.nv"
    drivetwin = run("--time", "manual", "--nv", nv, kind="mdrobot")
    drivetwin.advance(0.4)
    master = Master(serial(drivetwin, baudrate=BAUD))
    master.write(MAX_RPM, 1_500)
    master.write_words(FUNC_SPEED, 700, 33)
    master.write(ID, 9 << 8 | 0xAA)
    drivetwin.advance(0.1)
    assert master.read(MAX_RPM) == 1_500, "the id is 1 until the power fails"
    drivetwin.kill()
    drivetwin = run("--time", "manual", "--nv", nv, kind="mdrobot")
    drivetwin.advance(0.4)
    master = Master(serial(drivetwin, baudrate=BAUD), device_id=9)
    assert (master.read(MAX_RPM), master.words(FUNC_SPEED, 2)) == (1_500, [700, 33])
    assert (master.read(UI_COM), master.read(START_STOP)) == (0, 0)


def test_presets_and_the_address(run, serial):
    drivetwin = run(
        "--time", "manual", "--fast-boot", "--address", 42, "--set", "PID_MAX_RPM=1200", "--set", "TAR_VEL=300",
        kind="mdrobot",
    )  # fmt: skip
    master = Master(serial(drivetwin, baudrate=BAUD), device_id=42)
    assert [master.read(pid) for pid in (MAX_RPM, TAR_VEL, VERSION)] == [1_200, 300, 81]


def test_in_real_time(run, serial):
    """While time goes on: the bench gives the times, and no poll is missed."""
    drivetwin = run("--fast-boot", kind="mdrobot")
    master = Master(serial(drivetwin, baudrate=BAUD))
    master.arm()
    master.write(VEL_CMD, 600)
    began = drivetwin.seconds()
    while drivetwin.seconds() < began + 2.5:
        assert master.words(MONITOR, 6)[5] == 0
    assert abs(master.signed(RPM_DATA) - 600) <= 6
    before = drivetwin.seconds()
    at = master.long(POSI_DATA)
    between = drivetwin.seconds()
    while drivetwin.seconds() < between + 1:
        assert abs(master.signed(RPM_DATA) - 600) <= 6
    then = drivetwin.seconds()
    turns = (master.long(POSI_DATA) - at) / COUNTS
    after = drivetwin.seconds()
    assert (then - between) * 10 * 0.98 - 0.2 <= turns <= (after - before) * 10 * 1.02 + 0.2
    master.write(TQ_OFF, 0)


BENCH = """
time = "manual"

[[bus]]
name = "wheels"
drives = ["left", "right"]

[[drive]]
name = "left"
kind = "mdrobot"
address = 1

[[drive]]
name = "right"
kind = "mdrobot"
address = 2
set = { INV_SIGN_CMD = 1 }
"""


def test_two_controllers_on_one_bus(run, tmp_path):
    """The wheels of a robot: polled in turn, commanded together, one of them inverted (p. 7)."""
    file = tmp_path / "robot.toml"
    file.write_text(BENCH)
    drivetwin = run(kind=file)
    bench = drivetwin.call("GET", "/api/bench")
    (bus,) = bench["buses"]
    (uri,) = [port for port in json.dumps(bus).split('"') if port.startswith("tcp:")]
    host, port = uri.removeprefix("tcp:").rsplit(":", 1)
    drivetwin.tcp = (host, int(port))
    drivetwin.advance(0.4)
    read_monitor = {unit: frame(unit, 3, 0, MONITOR, 0, 6) for unit in (1, 2)}

    def signed(word):
        return int.from_bytes(word, "big", signed=True)

    with drivetwin.socket() as master:
        for unit in (1, 2):
            for pid in (UI_COM, START_STOP):
                request = frame(unit, 6, 0, pid, 0, 1)
                assert ask(master, request, 8) == request
        # A broadcast gets no answer, so the next reply is for the next request.
        master.sendall(frame(ID_ALL, 6, 0, VEL_CMD, *(500).to_bytes(2, "big")))
        drivetwin.advance(2.5)
        for poll in range(500):
            unit = 1 + poll % 2
            reply = ask(master, read_monitor[unit], 17)
            assert (reply[0], frame(*reply[:-2])) == (unit, reply)
            assert abs(signed(reply[3:5]) - (500 if unit == 1 else -500)) <= 5
        master.sendall(frame(ID_ALL, 6, 0, BRAKE, 0, 0))
        drivetwin.advance(2)
        for unit, sign in ((1, 1), (2, -1)):
            reply = ask(master, read_monitor[unit], 17)
            position = signed(reply[11:13] + reply[9:11])
            assert signed(reply[3:5]) == 0
            assert position * sign > 100
    for name in ("left", "right"):
        statistics = json.dumps(drivetwin.call("GET", f"/api/drives/{name}"))
        assert '"refused": 0' in statistics, statistics


def test_an_encoder_of_a_bench_file(run, tmp_path):
    """A wheel with an encoder of 500 cycles; a controller set to 1,000 turns it twice as fast (p. 14)."""
    file = tmp_path / "wheel.toml"
    file.write_text(
        'time = "manual"\n'
        '[[drive]]\nname = "x"\nkind = "mdrobot"\nset = { ENC_PPR = 1000 }\n'
        '[[motor]]\nname = "wheel"\ndrive = "x"\npoles = 10\n'
        '[[encoder]]\nmotor = "wheel"\ncycles_per_rev = 500\nto = { a = "x.ENC_A", b = "x.ENC_B" }\n'
    )
    drivetwin = run(kind=file)
    bench = drivetwin.call("GET", "/api/bench")
    (uri,) = [port for port in json.dumps(bench).split('"') if port.startswith("tcp:")]
    host, port = uri.removeprefix("tcp:").rsplit(":", 1)
    drivetwin.tcp = (host, int(port))
    drivetwin.advance(0.4)
    with drivetwin.socket() as master:
        for pid, value in ((UI_COM, 1), (START_STOP, 1), (VEL_CMD, 500)):
            request = frame(1, 6, 0, pid, *value.to_bytes(2, "big"))
            assert ask(master, request, 8) == request
        drivetwin.advance(3)
        reply = ask(master, frame(1, 3, 0, RPM_DATA, 0, 1), 7)
        assert abs(int.from_bytes(reply[3:5], "big") - 500) <= 5
    (motor,) = drivetwin.call("GET", "/api/bench")["motors"]
    assert motor["rpm"] == pytest.approx(1_000, rel=0.05), motor


def test_what_the_api_refuses(run):
    drivetwin = run("--time", "manual", kind="mdrobot")
    for path, body in (("faults/over_current", None), ("pins/J2.2", {"level": "low"})):
        with pytest.raises(urllib.error.HTTPError) as refused:
            drivetwin.call("PUT", f"/api/drives/mdrobot/{path}", body)
        assert refused.value.code == 404


def test_the_reference_names_every_pid(run):
    """What a program reads of a running controller has the PIDs by their names."""
    drivetwin = run("--time", "manual", kind="mdrobot")
    drivetwin.advance(0.4)
    registers = drivetwin.drive()["registers"]
    for name, value in (("MAX_RPM", 3_000), ("VERSION", 81), ("USE_LIMIT_SW", 1), ("PV_GAIN", 20), ("VOLT_IN", 240)):
        assert registers[name] == value


def test_wire_of_a_frame(run):
    """A read of VERSION byte by byte over TCP, and the echo of a write (p. 3, p. 4)."""
    drivetwin = run("--time", "manual", "--fast-boot", kind="mdrobot")
    with drivetwin.socket() as master:
        master.sendall(bytes.fromhex("01 03 00 01 00 01 D5 CA"))
        assert receive(master, 7) == bytes.fromhex("01 03 02 00 51 79 B8")
        assert ask(master, frame(1, 6, 0, 168, 0x13, 0x88), 8) == bytes.fromhex("01 06 00 A8 13 88 05 7C")
