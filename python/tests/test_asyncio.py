"""Masters on asyncio, with drives in the same process: whose thread serves the ports, so the event loop does not stop."""

import asyncio
import time

import pytest
from modbus import crc, read, write
from pymodbus import FramerType
from pymodbus.client import AsyncModbusTcpClient

import drivetwin

MODES = pytest.mark.parametrize("mode", ["manual", "real"])


def run(mode):
    return drivetwin.run("md3", time=mode, fast_boot=True, set={"Speed": 8000})


async def pass_time(bench, seconds):
    """Lets bench time pass: at once, or by waiting."""
    if bench.time == "manual":
        await asyncio.to_thread(bench.advance, seconds)
    else:
        await asyncio.sleep(seconds)


@MODES
def test_pymodbus(mode):
    async def master(bench):
        x = bench["md3"]
        _, host, port = x.uri("rs485").split(":")
        client = AsyncModbusTcpClient(host, port=int(port), framer=FramerType.RTU, retries=0)
        assert await client.connect()
        try:
            assert (await client.read_holding_registers(0x14, count=2)).registers == [0, 8000]
            assert not (await client.write_register(0x13, 2_000)).isError()
            assert not (await client.write_register(0x11, 1)).isError()
            assert x.motion.moving
            await pass_time(bench, 1.2)
            assert (await client.read_holding_registers(0x11, count=1)).registers == [0]
        finally:
            client.close()
        return x.motion.position

    with run(mode) as bench:
        assert asyncio.run(master(bench)) == 2_000


@MODES
def test_a_plain_stream(mode):
    async def master(bench):
        _, host, port = bench["md3"].uri("rs485").split(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        try:
            for request, reply in [
                (read(1, 0x14, 2), crc(bytes([1, 3, 4, 0, 0, 0x1F, 0x40]))),
                (write(1, 0x11, 1), write(1, 0x11, 1)),
            ]:
                writer.write(request)
                assert await asyncio.wait_for(reader.readexactly(len(reply)), 5) == reply
            with pytest.raises(asyncio.TimeoutError):
                writer.write(read(9, 0x14, 2))
                await asyncio.wait_for(reader.read(1), 0.1)
        finally:
            writer.close()
            await writer.wait_closed()

    with run(mode) as bench:
        asyncio.run(master(bench))


def test_calls_in_another_thread_do_not_stop_the_event_loop():
    async def main(bench):
        x = bench["md3"]
        longest, last = 0.0, time.monotonic()
        asks = [asyncio.to_thread(x.ask, read(1, 0x14, 2)) for _ in range(5)]
        work = asyncio.gather(*asks)
        while not work.done():
            await asyncio.sleep(0.001)
            now = time.monotonic()
            longest, last = max(longest, now - last), now
        assert all(len(reply) == 9 for reply in await work)
        return longest

    with run("real") as bench:
        # Five requests at 9,600 baud take 0.1 s.
        assert asyncio.run(main(bench)) < 0.1
