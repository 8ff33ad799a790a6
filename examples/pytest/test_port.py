from pymodbus import FramerType
from pymodbus.client import ModbusTcpClient


def test_a_move_takes_its_time(twin):
    bench = twin.run("md3", time="manual", fast_boot=True)  # or a bench file; every option of `drivetwin run`
    x = bench["md3"]
    _, host, port = x.uri("rs485").split(":")  # tcp:127.0.0.1:40123; x.pty is the path of a pty
    with ModbusTcpClient(host, port=int(port), framer=FramerType.RTU) as master:
        assert not master.write_register(0x11, 1).isError()  # MotionControl: Move
        bench.advance(1.25)
        assert x.motion.moving
        bench.advance(1.25)
        assert x.motion.position == 10_000
