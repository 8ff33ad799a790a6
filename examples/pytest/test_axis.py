import pytest


def rtu(*body):  # a Modbus RTU frame with its CRC
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 * (crc & 1)
    return bytes(body) + crc.to_bytes(2, "little")


def write(drive, register, value):  # the program under test: it asks once more if there is no answer
    request = rtu(1, 6, 0, register, value >> 8, value & 0xFF)
    return any(drive.ask(request) == request for attempt in range(2))


@pytest.fixture
def x(twin):
    x = twin("md3", name="x", fast_boot=True, set={"HomingConfiguration": 0x10})  # backward, stop at once
    x.bench.motor("x", steps_per_rev=200)
    x.bench.switch("m", closed={"below_rev": -2.0}, to="x.J2.2")
    return x


def test_homing_finds_the_switch(x):
    x.line().faults(drop={"count": 1, "direction": "reply"})  # the next reply is lost
    assert write(x, 0x11, 4)  # MotionControl: home
    assert [request.verdict for request in x.received()] == ["done", "without effect"]
    x.bench.advance(5.0)  # seconds of the drive, at once
    assert (x.motion.position, x.motion.moving) == (-3200, False)  # 1,600 microsteps a turn


def test_a_power_cut_in_a_save(x):
    assert write(x, 0x1D, 1234)  # UserRegister
    x.power("cut")  # in the middle of the next save
    write(x, 0x1A, 1)  # EEPROMControl: save
    x.bench.advance(0.1)
    x.power("on")
    x.bench.advance(2.5)
    assert x.registers["UserRegister"] == 0  # the memory is bad, so the drive has its factory values
