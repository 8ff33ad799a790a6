"""Bad input, and uses that a bench refuses."""

import contextlib
import gc
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from modbus import write

import drivetwin
from drivetwin import Bench, Error, UnknownName, _native


@pytest.fixture
def x():
    return Bench().add("md3", name="x", fast_boot=True)


UNKNOWN = [
    (lambda x: x.bench.add("md4"), "there is no kind 'md4'; the nearest is 'md3'"),
    (lambda x: x.bench["y"], "there is no drive 'y'; the nearest is 'x'"),
    (lambda x: x.registers["Sped"], "there is no register 'Sped'; the nearest is 'Speed'"),
    (lambda x: x.registers.__setitem__("Sped", 1), "there is no register of md3 'Sped'; the nearest is 'Speed'"),
    (
        lambda x: x.bench.add("md3", name="y", set={"Sped": 1}),
        "set: there is no register of md3 'Sped'; the nearest is 'Speed'",
    ),
    (lambda x: x.pins["J2.33"], "there is no pin 'J2.33'; the nearest is 'J2.3'"),
    (lambda x: x.pins.__setitem__("J2.33", "low"), "there is no pin 'J2.33'; the nearest is 'J2.3'"),
    (lambda x: x.fault("over_temprature"), "there is no fault 'over_temprature'; the nearest is 'over_temperature'"),
    (lambda x: x.port("rs458"), "there is no port 'rs458'; the nearest is 'rs485'"),
    (lambda x: x.ask(b"", port="rs458"), "there is no port 'rs458'; the nearest is 'rs485'"),
    (lambda x: x.power("cycles"), "there is no power action 'cycles'; the nearest is 'cycle'"),
    (lambda x: x.bench.line("rs458"), "there is no bus 'rs458'; the nearest is 'rs485'"),
    (lambda x: x.line().faults(drops=1), "there is no key of [[fault]] 'drops'; the nearest is 'drop'"),
    (lambda x: x.bench.motor("y"), "there is no drive 'y'; the nearest is 'x'"),
    (lambda x: x.bench.motor("x", stepsperrev=1), "there is no key of [[motor]] 'stepsperrev'; the nearest is 'steps_per_rev'"),
    (lambda x: x.bench.switch("m", closed={"below_rev": 0}, to="x.J2.2"), "there is no motor 'm'"),
    (lambda x: x.received(register="Sped"), "there is no register 'Sped'; the nearest is 'Speed'"),
]  # fmt: skip


@pytest.mark.parametrize(("act", "sentence"), UNKNOWN, ids=[sentence for _, sentence in UNKNOWN])
def test_a_name_that_is_not_there_is_an_unknown_name(x, act, sentence):
    with pytest.raises(UnknownName) as raised:
        act(x)
    assert str(raised.value) == sentence
    assert isinstance(raised.value, Error) and isinstance(raised.value, KeyError)
    assert isinstance(raised.value, ValueError)


ENDLESS_LIST = []
ENDLESS_LIST.append(ENDLESS_LIST)
ENDLESS_DICT = {}
ENDLESS_DICT["a"] = ENDLESS_DICT
TOO_DEEP = "a value is too deep: it has more than 32 dicts and lists inside each other"
OF_ANOTHER_BENCH = "x is a drive of another bench"


def nested(depth):
    value = 1
    for _ in range(depth):
        value = [value]
    return value


def other():
    return Bench().add("md3", name="x")


WRONG = [
    (lambda x: x.registers.__setitem__("DeviceAddress", 300), "DeviceAddress takes 1 to 247, not 300"),
    (lambda x: x.bench.add("md3", name="y", address=300), "address: DeviceAddress takes 1 to 247, not 300"),
    (lambda x: x.bench.add("qsb-d", address=1), "address: qsb-d has no bus address"),
    (lambda x: x.bench.add("md3", name="x"), "the name x is in use already"),
    (lambda x: x.bench.add("md3", name="a b"), '"a b" is not a valid name for a drive: use one word without dots'),
    (lambda x: x.pins.__setitem__("J2.3", "on"), "J2.3 takes 'low', 'high' or 'open', not 'on'"),
    (lambda x: x.pins.__setitem__("J2.3", True), "J2.3 takes 'low', 'high' or 'open', not True"),
    (lambda x: x.pins.__setitem__("J2.3", 2.5), "a digital input takes a level: low, high or open"),
    (lambda x: x.pins.__setitem__("STEP", "low"), "STEP is an output"),
    (lambda x: x.pins.milliamps("J2.3", 2.5), "this pin takes no current; send a level or volts"),
    (lambda x: x.line().faults(drop=2), "drop takes a number from 0 to 1, not 2"),
    (lambda x: x.line().faults(bus="x"), "bus is not an argument: these are the faults of one line"),
    (lambda x: x.bench.advance(-1), "advance takes seconds from 0 to 1000000000, not -1"),
    (lambda x: x.bench.advance(float("nan")), "advance takes seconds from 0 to 1000000000, not NaN"),
    (lambda x: x.encoder(0, hz=1), None),
    (lambda x: x.pulse("J2.4", 1, hz=0), "a train has at least 1 pulse, and 0.000001 to 8000000 of them a second"),
    (lambda x: Bench(line="slow"), "line takes timed or fast, not 'slow'"),
    (lambda x: Bench.load("nowhere.toml"), "nowhere.toml: No such file or directory (os error 2)"),
    (lambda x: Bench.load("bench.txt"), "'bench.txt' is not a bench file: its name ends in .toml"),
    (lambda x: Bench.loads("[[drive]]\nname = 1"), "line 2, column 8: name takes a string, not 1"),
    (lambda x: x.bench.wire("x.J2.2", "x.J2.3"), "'x.J2.2' is an input; an output is wanted here"),
    (lambda x: x.bench.add("qsb-d", name="q").pulses(), "q has no STEP output"),
    (lambda x: x.bench.add("qsb-d", name="q").motion, "q moves nothing: qsb-d has no axis"),
    (lambda x: x.registers.__setitem__("Speed", 2**63), "Speed: 9223372036854775808 is out of range"),
    (lambda x: x.registers.__setitem__("Speed", [2**63]), "Speed: 9223372036854775808 is out of range"),
    (lambda x: x.registers.__setitem__("Speed", []), "Speed takes a number or words, not an empty list"),
    (lambda x: x.bench.add("md3", set={"Speed": 2**63}), "set: Speed: 9223372036854775808 is out of range"),
    (lambda x: x.bench.add("md3", set={"Speed": []}), "set: Speed takes a number or words, not an empty list"),
    (lambda x: x.bench.add("md3", address=2**70), "address: 1180591620717411303424 is out of range"),
    (lambda x: x.encoder(2**63, hz=1), "counts: 9223372036854775808 is out of range"),
    (lambda x: x.pulse("J2.4", -10, hz=100), "count: -10 is out of range"),
    (lambda x: x.received(function=-1), "function: -1 is out of range"),
    (lambda x: x.received(function=300), "function: 300 is out of range"),
    (lambda x: x.port("rs485").configure(baud=-1), "baud: -1 is out of range"),
    (lambda x: x.port("rs485").configure(baud=0), "baud takes a number from 1, not 0"),
    (lambda x: x.port("rs485").configure(data=-1), "data: -1 is out of range"),
    (lambda x: Bench(seed=-1), "seed: -1 is out of range"),
    (lambda x: x.bench.scenario(ENDLESS_LIST), TOO_DEEP),
    (lambda x: x.bench.motor("x", inertia_gcm2=ENDLESS_DICT), TOO_DEEP),
    (lambda x: x.line().faults(drop=ENDLESS_DICT), TOO_DEEP),
    (lambda x: x.bench.motor("x", inertia_gcm2=nested(10_000)), TOO_DEEP),
    (lambda x: x.bench.motor("x", inertia_gcm2=nested(32)), "inertia_gcm2 takes a whole number from 1 to 10000000, not a list"),
    (lambda x: x.bench.history(other()), OF_ANOTHER_BENCH),
    (lambda x: x.bench.plot(other()), OF_ANOTHER_BENCH),
    (lambda x: x.bench.motor(other()), OF_ANOTHER_BENCH),
    (lambda x: x.bench.bus("l", [x, other()]), OF_ANOTHER_BENCH),
]  # fmt: skip


@pytest.mark.parametrize(("act", "sentence"), WRONG, ids=[str(sentence) for _, sentence in WRONG])
def test_a_wrong_value_raises_one_sentence(x, act, sentence):
    with pytest.raises(Error) as raised:
        act(x)
    assert not isinstance(raised.value, KeyError)
    assert sentence is None or str(raised.value) == sentence


@pytest.mark.parametrize(
    "act",
    [
        lambda x: x.ask("text"),
        lambda x: x.registers.__setitem__("Speed", 2.5),
        lambda x: x.registers.__setitem__("Speed", None),
        lambda x: x.pins.__setitem__("J2.3", []),
        lambda x: x.bench.advance("1"),
        lambda x: x.bench.motor("x", steps_per_rev=object()),
        lambda x: x.bench.add("md3", speed=5),
        lambda x: Bench(seed="1"),
        lambda x: x.received(function="3"),
    ],
)
def test_a_value_of_another_type_raises(x, act):
    with pytest.raises(TypeError):
        act(x)


def test_the_sentences_are_those_of_the_command():
    said = subprocess.run([COMMAND, "run", "md3", "--set", "Sped=1"], stderr=subprocess.PIPE, text=True).stderr
    with pytest.raises(UnknownName) as raised:
        Bench().add("md3", set={"Sped": 1})
    assert said == f"drivetwin: --{raised.value}\n"


COMMAND = os.path.join(os.path.dirname(sys.executable), "drivetwin")


def test_time_does_not_go_back(x):
    x.bench.run_until(2.0)
    with pytest.raises(Error, match="^1 s have passed already: the bench is at 2 s$"):
        x.bench.run_until(1.0)
    x.bench.run_until(2.0)
    assert x.bench.now == 2.0


def test_a_closed_bench_raises(x):
    port = x.port("rs485")
    bench = x.bench
    bench.close()
    bench.close()
    for act in [lambda: bench.now, lambda: x.ask(b""), lambda: x.registers["Speed"], lambda: x.motion, port.read]:
        with pytest.raises(Error, match="^the bench is closed$"):
            act()
    del port
    gc.collect()


def test_a_bench_shows_that_it_is_closed(x):
    assert repr(x.bench) == "<Bench at 0 s with 1 drives>"
    x.bench.close()
    assert repr(x.bench) == "<Bench, closed>"


def test_a_string_is_no_list_of_drives(x):
    with pytest.raises(TypeError, match="^bus takes a list of drives or names, not a string$"):
        x.bench.bus("l", "x")


def test_a_fork_does_not_take_the_bench_along(x):
    port = x.port("rs485")
    child = os.fork()
    if child == 0:
        code = 1
        try:
            x.bench.now
        except Error as error:
            code = 0 if str(error).startswith("the bench belongs to the process that made it") else 2
        del port
        code = code or (0 if Bench().add("md3", fast_boot=True).ask(write(1, 0x11, 1)) else 3)
        os._exit(code)
    assert os.waitpid(child, 0)[1] == 0
    assert x.ask(write(1, 0x11, 1))
    port.close()


def test_a_panic_is_an_exception_and_the_end_of_the_bench(x):
    with pytest.raises(BaseException, match="a test asked for this panic") as raised:
        _native.panic_for_test(x.bench)
    assert type(raised.value).__name__ == "PanicException"
    with pytest.raises(Error, match="has panicked"):
        x.bench.now


def busy_bench():
    """A bench with thousands of events a second: a step pulse every 25 µs, at a wire."""
    bench = Bench()
    x, y = bench.add("md3", name="x", fast_boot=True), bench.add("md3", name="y", fast_boot=True)
    bench.wire("x.STEP", "y.J2.4")
    x.registers["MoveSteps"] = 2_000_000_000
    x.registers["Speed"] = 40_000
    x.registers["MotionControl"] = 1
    return bench


def test_two_threads_wait_for_each_other():
    bench = busy_bench()
    x = bench["y"]
    answers = []

    def ask():
        answers.extend(x.ask(write(1, 0x1D, n)) for n in range(300))

    threads = [threading.Thread(target=ask) for _ in range(2)]
    threads.append(threading.Thread(target=bench.advance, args=(5.0,)))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(answers) == 600 and set(map(len, answers)) == {8}
    assert bench.now >= 5.0


def test_other_threads_run_while_time_advances():
    bench, beats, done = busy_bench(), [], threading.Event()

    def beat():
        while not done.is_set():
            beats.append(None)
            time.sleep(0)

    thread = threading.Thread(target=beat)
    thread.start()
    try:
        before = len(beats)
        bench.advance(20.0)
        assert len(beats) > before + 10
    finally:
        done.set()
        thread.join()


@contextlib.contextmanager
def ctrl_c(seconds):
    # A shell starts programs in the background with SIGINT ignored.
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(seconds, os.kill, [os.getpid(), signal.SIGINT])
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            yield
    finally:
        timer.join()
        signal.signal(signal.SIGINT, usual)


def test_ctrl_c_interrupts_a_long_advance():
    bench = busy_bench()
    with ctrl_c(0.3):
        bench.advance(1e6)
    assert 0 < bench.now < 1e6
    x = bench["x"]
    at = bench.now
    bench.advance(1.0)
    assert bench.now == pytest.approx(at + 1.0) and x.motion.moving


def test_a_recording_of_two_thousand_million_steps():
    bench = Bench()
    x = bench.add("md3", name="x", fast_boot=True)
    x.registers["MoveSteps"] = 2_000_000_000
    x.registers["Speed"] = 40_000
    x.registers["MotionControl"] = 1
    bench.advance(60_000.0)
    for act, sentence in [
        (x.pulses, "x has made more than 10000000 pulses since its last power-on; bench.history has the motion"),
        (bench.vcd, "the waveforms have more than 256 MiB; bench.plot(start=, end=) shows a part of the time"),
        (lambda: bench.history(x), "the history has more than 10000000 samples; take a greater every"),
    ]:
        with pytest.raises(Error) as raised:
            act()
        assert str(raised.value) == sentence
    assert len(bench.history(x, every=1.0)) > 50_000
    # All of them would take minutes.
    with ctrl_c(0.3):
        bench.plot()
    with ctrl_c(0.3):
        bench.vcd()
    x.power("cycle")
    bench.advance(1.0)
    assert len(x.pulses()) == 0


def test_a_sentence_about_no_name_is_no_unknown_name(tmp_path):
    program = tmp_path / "empty.rsasm"
    program.write_text("")
    with pytest.raises(Error, match="there is no command in this program") as raised:
        Bench().add("rs434544", program=program)
    assert not isinstance(raised.value, UnknownName)
