"""The bench in the process of the test. Registers and times of the MD3 are those of its user guide."""

import pytest
from modbus import crc, read, write

import drivetwin
from drivetwin import Bench

MOVE = write(1, 0x11, 1)
"""Write 1, Move, to MotionControl (7.15)."""

HOMING = """
[[drive]]
name = "x"
kind = "md3"
fast_boot = true
set = { HomingConfiguration = 0x10 } # backward, stop at once (7.5)

[[motor]]
name = "m"
drive = "x"

[[switch]]
motor = "m"
closed = { below_rev = -2.0 }
to = "x.J2.2"
"""


def test_the_ten_kinds_can_be_added():
    assert drivetwin.kinds() == [
        "md3", "md3-low", "qsb-d", "qsb-m", "qsb-s", "rs434544", "rs434546", "mdrobot", "mdrive", "mdrive-hybrid",
    ]  # fmt: skip
    bench = Bench()
    for kind in drivetwin.kinds():
        drive = bench.add(kind)
        assert (drive.kind, drive.name, drive.powered) == (kind, kind, True)
        assert bench[kind] == drive and kind in bench and len(drive.registers) > 5
    assert list(bench) == drivetwin.kinds() and len(bench) == 10
    assert [drive.name for drive in bench.values()] == bench.keys()


def test_a_master_moves_a_motor():
    bench = Bench()
    x = bench.add("md3", name="x", address=2, set={"Speed": 8000})
    assert x.ask(read(2, 0x14, 2)) == b"", "an MD3 does not answer for 2.5 s"
    bench.run_until(2.5)
    assert x.ask(read(2, 0x14, 2)) == crc(bytes([2, 3, 4, 0, 0, 0x1F, 0x40]))
    assert x.ask(write(2, 0x11, 1)) == write(2, 0x11, 1)
    began = bench.now
    bench.advance(0.5)
    half_way = x.motion
    assert half_way.moving and 0 < half_way.position < 10_000 and half_way.current > 0
    bench.advance(2.5)
    assert (x.motion.position, x.motion.speed, x.motion.moving, x.motion.duty) == (10_000, 0.0, False, 0.0)
    pulses = x.pulses()
    assert len(pulses) == 10_000
    assert {step for _, step in pulses} == {1} and began < pulses[0][0] < pulses[-1][0] < bench.now


def test_registers_are_read_and_written_past_the_bus():
    x = Bench().add("md3", fast_boot=True)
    x.registers["Speed"] = 0x12345
    assert x.registers["Speed"] == 0x12345
    assert (x.registers["SpeedHigh"], x.registers["SpeedLow"]) == (1, 0x2345)
    x.registers["SpeedLow"] = "0x10"
    assert x.registers["Speed"] == 0x10010
    assert "Speed" in x.registers and "Sped" not in x.registers and 5 not in list(x.registers)
    assert dict(x.registers) == dict(x.registers.items()) and x.registers.get("Sped", 7) == 7
    assert len(x.registers) == len(list(x.registers)) == len(x.registers.values())


def test_words_and_text_are_values_of_registers():
    bench = Bench()
    motor = bench.add("mdrobot")
    motor.registers["FUNC_SPEED"] = [1000, 10]
    assert motor.registers["FUNC_SPEED"] == [1000, 10]
    mdrive = bench.add("mdrive", set={"PartNumber": "MDI3CRL23A7"})
    first = mdrive.registers["PartNumber1"]
    assert b"".join(word.to_bytes(2, "big") for word in first) == b"MDI3CRL2"


def test_pins_lights_faults_and_power():
    bench = Bench()
    x = bench.add("md3", fast_boot=True)
    assert x.pins["J2.3"] == "high"
    x.pins["J2.3"] = "low"
    bench.advance(0.001)
    assert x.pins["J2.3"] == dict(x.pins)["J2.3"] == "low"
    x.pins["J2.3"] = "open"
    bench.advance(0.001)
    assert x.pins["J2.3"] == "high", "a pull-up"
    assert set(x.leds) == {"D5", "D6"} and not set(x.leds) & set(x.pins)
    assert x.faults == {"over_temperature": False, "over_current": False}
    x.fault("over_temperature")
    bench.advance(0.001)
    assert x.faults["over_temperature"]
    x.clear("over_temperature")
    x.power("off")
    bench.advance(0.001)
    assert not x.powered and not x.faults["over_temperature"]
    assert x.ask(read(1, 0, 1)) == b""
    with pytest.raises(drivetwin.Error, match="^md3 has no power$"):
        x.registers["Speed"] = 1
    x.power("on")
    bench.advance(3.0)
    assert x.ask(MOVE) == MOVE


def test_a_power_cut_in_a_save_leaves_a_bad_memory():
    bench = Bench()
    x = bench.add("md3", set={"UserRegister": 1234})
    bench.advance(2.5)
    x.registers["UserRegister"] = 5678
    x.power("cut")
    assert x.ask(write(1, 0x1A, 1)) in (b"", write(1, 0x1A, 1))  # EepromControl: Save (7.20)
    bench.advance(0.1)
    assert not x.powered
    x.power("on")
    bench.advance(3.0)
    assert x.registers["UserRegister"] == 0, "the memory is bad, so the registers have their defaults (7.20)"


def test_an_encoder_and_pulses_drive_inputs():
    bench = Bench()
    reader = bench.add("qsb-d", name="q", fast_boot=True, set={"Mdr0": 0x43})  # four counts a cycle
    reader.encoder(400, hz=10_000)
    bench.advance(0.05)
    with reader.port("usb") as port:
        port.write(b"R0E\r")
        bench.advance(0.05)
        assert port.read().endswith(b"r 0E 00000190 !\r\n") and port.read() == b""
    assert port.closed
    with pytest.raises(drivetwin.Error, match="closed"):
        port.read()
    x = bench.add("md3", name="x", fast_boot=True)
    x.pulse("J2.4", 100, hz=1_000)
    with pytest.raises(drivetwin.Error, match="a pulse train or an encoder drives that pin already"):
        x.pulse("J2.4", 1, hz=1_000)
    bench.advance(0.2)
    x.pulse("J2.4", 1, hz=1_000)


def test_a_motor_a_switch_and_a_wire():
    bench = Bench()
    x = bench.add("md3", name="x", fast_boot=True, set={"HomingConfiguration": 0x10})
    motor = bench.motor("x", steps_per_rev=200)
    assert (motor.name, motor.drive, motor.revolutions) == ("m", "x", 0.0)
    bench.switch("m", closed={"below_rev": -2.0}, to="x.J2.2")
    reader = bench.add("qsb-d", name="reader", fast_boot=True, set={"Mdr0": 0x43})
    bench.encoder("m", cycles_per_rev=100, to={"a": "reader.A", "b": "reader.B"})
    x.registers["MotionControl"] = 4  # home (7.15)
    bench.advance(5.0)
    assert x.motion.position == -3_200, "two turns of 1,600 steps"
    assert abs(bench.motors["m"].revolutions + 2) < 0.01
    count = int.from_bytes(bytes.fromhex(reader.ask(b"R0E\r")[5:13].decode()), "big", signed=True)
    assert abs(count + 800) <= 1, "two turns of 100 cycles, four counts each, backwards"
    x.registers["MoveSteps"] = -10
    x.registers["MotionControl"] = 1
    bench.advance(1.0)
    assert x.pins["J2.2"] == "low"
    y = bench.add("md3", name="y", fast_boot=True)
    bench.wire("x.D6", "y.J2.4")
    bench.advance(0.001)
    assert y.pins["J2.4"] == ("high" if x.leds["D6"] else "low")
    assert bench.motor(y).name == "m2"


def test_a_motor_of_its_own_comes_with_the_drive():
    bench = Bench()
    with pytest.raises(drivetwin.Error, match="^the motor of rs434544 must be there from the start: "):
        bench.motor(bench.add("rs434544", name="a"))
    bench.add("rs434544", name="b", motor={"name": "shaft", "inertia_gcm2": 50})
    assert bench.motors["shaft"].drive == "b"


def test_a_bench_file_is_loaded(tmp_path):
    file = tmp_path / "bench.toml"
    file.write_text(HOMING + '[[drive]]\nname = "y"\nkind = "md3"\nnv = "y.nv"\naddress = 3\n')
    for make, source in (Bench.loads, HOMING), (Bench.load, file), (Bench.load, str(file)):
        with make(source) as bench:
            bench["x"].registers["MotionControl"] = 4
            bench.advance(5.0)
            assert bench["x"].motion.position == -3_200
    assert (tmp_path / "y.nv").exists()


def test_memory_stays_in_a_file(tmp_path):
    file = tmp_path / "x.nv"
    for value in None, 1234:
        with Bench() as bench:
            x = bench.add("md3", nv=file, fast_boot=True)
            assert value is None or x.registers["UserRegister"] == value
            x.registers["UserRegister"] = 1234
            assert x.ask(write(1, 0x1A, 1)) == write(1, 0x1A, 1)
            bench.advance(0.1)
            with pytest.raises(drivetwin.Error, match="another drive keeps its memory there"):
                bench.add("md3", name="y", nv=file)
            assert "y" not in bench


def test_faults_of_a_line():
    bench = Bench()
    x = bench.add("md3", name="x", fast_boot=True)
    x.line().faults(drop={"count": 1, "direction": "reply", "register": "MotionControl"})
    assert x.ask(MOVE) == b""
    assert x.received()[-1].outcome == "done; by a fault, the reply was dropped"
    assert x.ask(MOVE) == MOVE
    x.line().faults(mute=True, delay_ms=5)
    assert x.ask(MOVE) == b""
    bench.line("rs485").faults()
    before = bench.now
    assert x.ask(MOVE) == MOVE
    x.line().faults(delay_ms=500)
    assert x.ask(MOVE) == MOVE and bench.now - before > 0.5


def test_drives_share_a_line():
    bench = Bench()
    x, y = (bench.add("md3", name=name, address=n, fast_boot=True) for n, name in enumerate("xy", 1))
    line = bench.bus("line1", [x, "y"])
    assert line.name == x.line().name == y.line("rs485").name == "line1"
    assert y.ask(MOVE) == MOVE, "any drive's line reaches all drives of it"
    bench.advance(2.5)
    assert (x.motion.position, y.motion.position) == (10_000, 0)
    bench.line("line1").faults(mute=True)
    assert x.ask(MOVE) == b""
    assert not line.strict
    line.strict = True
    assert bench.line("line1").strict


def test_the_journal_says_what_was_received():
    bench = Bench()
    x = bench.add("md3", fast_boot=True)
    x.ask(write(1, 0x15, 9_000))
    later = bench.now
    bench.advance(1.0)
    x.ask(MOVE)
    x.ask(read(1, 0x14, 2))
    speed, move, back = x.received()
    assert str(speed) == "rs485 <- write SpeedLow = 9000 -> done"
    assert (speed.bytes, speed.answer) == (write(1, 0x15, 9_000),) * 2
    assert (speed.port, speed.verdict, speed.reason, speed.address, speed.function) == ("rs485", "done", None, 1, 6)
    assert [(it.name, it.value, it.written) for it in speed.registers] == [("SpeedLow", 9_000, True)]
    assert 0 < speed.at <= later < move.at < back.at
    assert [it.at for it in x.received(since=later + 0.5)] == [move.at, back.at]
    assert [it.at for it in x.received(function=3)] == [it.at for it in x.received(register="SpeedHigh")] == [back.at]
    assert x.wrote_before("Speed", "MotionControl") and not x.wrote_before("MotionControl", "Speed")
    assert x.statistics()["requests"] == 3 and x.statistics()["starting"] == 0


def test_mcode_is_spoken_on_a_stream():
    bench = Bench()
    drive = bench.add("mdrive", name="x", fast_boot=True)
    assert drive.ports == ["modbus", "mcode"]
    with drive.port("mcode") as port:
        port.write(b"PR P\r")
        bench.advance(0.1)
        assert b"0" in port.read()
    drive.power("off")
    bench.advance(0.001)
    with pytest.raises(drivetwin.Error, match="^x refuses a connection: the drive has no power$"):
        drive.port("mcode")


def test_a_scenario_is_played():
    bench = Bench()
    x = bench.add("md3", name="x", fast_boot=True)
    bench.scenario([{"at_s": 0.5, "drive": "x", "fault": "over_temperature"}])
    bench.advance(0.4)
    assert not x.faults["over_temperature"]
    bench.advance(0.2)
    assert x.faults["over_temperature"]
    with pytest.raises(drivetwin.Error, match="past|over|already|now"):
        bench.scenario([{"at_s": 0.5, "drive": "x", "clear": "over_temperature"}])


def test_the_same_calls_have_the_same_recording():
    def run():
        bench = Bench(seed=7)
        x = bench.add("md3", name="x", fast_boot=True)
        x.line().faults(drop=0.5)
        answers = [x.ask(MOVE) for _ in range(20)]
        return answers, bench.trace(), bench.vcd(), bench.pcapng()

    first, second = run(), run()
    assert first == second and {len(answer) for answer in first[0]} == {0, 8}
    assert first[1].startswith("drivetwin") and b"$enddefinitions" in first[2]
    assert first[3][:4] == bytes.fromhex("0A0D0D0A"), "a section header of pcapng"


def test_fast_characters_take_no_time():
    x = Bench(line="fast").add("md3", fast_boot=True)
    before = x.bench.now
    assert x.ask(MOVE) == MOVE and x.bench.now - before < 1e-6
    assert x.bench == x.bench and hash(x.bench) == hash(x.bench) and x.bench != Bench()
    assert x == x.bench["md3"] and hash(x) == hash(x.bench["md3"])
