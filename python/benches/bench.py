"""Speed of the package: python python/benches/bench.py [--pymodbus], with a release wheel installed.

A request through `ask`, ten minutes of a jogging MD3, a test with the fixture `twin`; with --pymodbus beside the simulator
of pymodbus, which must be installed then.
"""

import gc
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import drivetwin

READ = bytes.fromhex("010300140002840F")
"""Read two registers from 0x14, Speed."""


def best(act, times, rounds=7):
    """Median over rounds of the seconds of one call."""
    took = []
    gc.disable()
    for _ in range(rounds):
        start = time.perf_counter()
        for _ in range(times):
            act()
        took.append((time.perf_counter() - start) / times)
    gc.enable()
    return statistics.median(took)


def say(what, seconds, limit=None):
    unit, scale = ("µs", 1e6) if seconds < 1e-3 else ("ms", 1e3)
    asked = f" (at most {limit * scale:g} {unit})" if limit else ""
    print(f"{what:<58} {seconds * scale:8.2f} {unit}{asked}")


def ask():
    drive = drivetwin.Bench().add("md3", fast_boot=True)
    assert len(drive.ask(READ)) == 9
    say("a request through drive.ask", best(lambda: drive.ask(READ), 10_000), 3e-6)


def advance():
    def ten_minutes():
        with drivetwin.Bench() as bench:
            drive = bench.add("md3", fast_boot=True, set={"Speed": 40_000})
            drive.registers["MotionControl"] = 2  # jog forward (7.15)
            bench.advance(1.0)
            start = time.perf_counter()
            bench.advance(600.0)
            took = time.perf_counter() - start
            assert drive.motion.speed == 40_000
            return took

    say("advance of 10 minutes, an MD3 jogging at 40,000 steps/s", statistics.median(ten_minutes() for _ in range(20)), 1e-3)


def add():
    def one():
        with drivetwin.Bench() as bench:
            bench.add("md3")

    say("a bench with an MD3, and its end", best(one, 200))


def fixture():
    test = "import pytest\n@pytest.mark.parametrize('n', range({}))\ndef test_one({}n): {}\n"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "test_fixture.py"

        def run(count, *parts):
            file.write_text(test.format(count, *parts))
            command = [sys.executable, "-B", "-m", "pytest", "-q", "-p", "no:cacheprovider", str(file)]
            start = time.perf_counter()
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=folder)
            return time.perf_counter() - start

        count = 1_000
        run(1, "", "pass")  # the first run reads the files of pytest from the disk
        bare, with_drive = (
            min(run(count, *parts) for _ in range(3)) for parts in (("", "pass"), ("twin, ", "twin('md3')"))
        )
        say("a test with twin('md3'), beyond an empty test", (with_drive - bare) / count, 5e-3)
        say("an empty test of pytest", bare / count)


def pymodbus():
    """A server of pymodbus's simulator in a process, and the first request to it."""
    import socket

    from pymodbus.client import ModbusTcpClient

    server = """
import asyncio, sys
from pymodbus.server import StartAsyncTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice
device = SimDevice(1, simdata=[SimData(0, count=100, values=7, datatype=DataType.REGISTERS)])
asyncio.run(StartAsyncTcpServer(context=device, address=("127.0.0.1", int(sys.argv[1]))))
"""

    def start():
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        process = subprocess.Popen([sys.executable, "-c", server, str(port)])
        client = ModbusTcpClient("127.0.0.1", port=port, retries=0)
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            assert process.poll() is None, "the simulator of pymodbus does not start"
        assert client.connect()
        assert not client.read_holding_registers(0x14, count=2).isError()
        return process, client

    took = []
    for _ in range(5):
        begin = time.perf_counter()
        process, client = start()
        took.append(time.perf_counter() - begin)
        client.close()
        process.kill()
        process.wait()
    say("pymodbus's simulator in a process, until its first answer", statistics.median(took))
    process, client = start()
    say("a request to it", best(lambda: client.read_holding_registers(0x14, count=2), 200, 3))
    client.close()
    process.kill()
    process.wait()


if __name__ == "__main__":
    ask()
    advance()
    add()
    fixture()
    if "--pymodbus" in sys.argv:
        pymodbus()
