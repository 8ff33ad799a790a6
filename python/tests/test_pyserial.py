"""The pyserial URL `drivetwin://`, with unmodified masters above it."""

import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import serial
from modbus import read, write
from pymodbus.client import ModbusSerialClient

import drivetwin
from drivetwin import Error

EVEN = {"baudrate": 9600, "parity": "E", "timeout": 1.0}
"""The line of an MD3: 9600 8E1 (3.1)."""

SPEED = read(1, 0x14, 2)


def opened(url, **settings):
    return serial.serial_for_url(url, **{**EVEN, **settings})


def test_pymodbus_moves_a_motor():
    client = ModbusSerialClient("drivetwin://md3?Speed=8000&fast_boot=1", baudrate=9600, parity="E", retries=0)
    assert client.connect()
    assert client.read_holding_registers(0x14, count=2).registers == [0, 8000]
    assert not client.write_register(0x11, 1).isError()
    client.socket.bench.advance(3.0)
    assert client.socket.drive.motion.position == 10_000
    begin = time.monotonic()
    for _ in range(20):
        assert not client.read_holding_registers(0x14, count=2).isError()
    assert time.monotonic() - begin < 5.0, "nothing waits for the 25 ms that a request takes on the line, or a timeout"
    client.close()
    assert client.connect() and client.socket.drive.motion.position == 0, "a client that connects again has a new drive"
    client.close()


def test_a_port_that_is_opened_again_has_the_same_drive():
    port = opened("drivetwin://md3?fast_boot=1")
    port.drive.registers["Speed"] = 9_000
    port.close()
    port.open()
    port.write(SPEED)
    assert port.read(9)[3:7] == (9_000).to_bytes(4, "big")


def test_a_drive_has_the_address_of_its_url():
    port = opened("drivetwin://md3?address=2&fast_boot=yes&port=rs485&seed=7&line=fast")
    port.write(read(2, 0x14, 2))
    assert port.read(9)[:3] == bytes([2, 3, 4])
    port.write(SPEED)
    assert port.read(9) == b""


def test_other_settings_than_those_of_the_line_have_no_answer():
    port = opened("drivetwin://md3?fast_boot=1")
    for settings in {"parity": "N"}, {"parity": "O"}, {"baudrate": 19200}, {"stopbits": 2}, {"bytesize": 7}:
        before = {name: getattr(port, name) for name in settings}
        for name, value in settings.items():
            setattr(port, name, value)
        port.write(SPEED)
        assert port.read(9) == b"", settings
        for name, value in before.items():
            setattr(port, name, value)
        port.reset_input_buffer()
        port.write(SPEED)
        assert len(port.read(9)) == 9
    with pytest.raises(ValueError, match="no mark or space parity"):
        port.parity = "M"


def test_timeouts_are_in_bench_time():
    port = opened("drivetwin://md3", timeout=1.0)
    begin = time.monotonic()
    port.write(SPEED)
    assert port.read(9) == b"" and port.bench.now == pytest.approx(1.0, abs=0.1), "it starts for 2.5 s"
    port.timeout = 1000.0
    assert port.read(1) == b"" and port.bench.now == pytest.approx(1001.0, abs=0.1)
    assert time.monotonic() - begin < 2.0
    port.write(SPEED)
    assert port.in_waiting == 9
    assert port.read(4) == bytes([1, 3, 4, 0]) and port.in_waiting == 5
    port.timeout = 0
    assert len(port.read(100)) == 5 and port.read(1) == b""
    port.timeout = None
    port.write(SPEED[:3])
    port.write(SPEED[3:])
    port.flush()
    assert len(port.read(9)) == 9 and port.out_waiting == 0
    assert (port.cts, port.dsr, port.cd, port.ri) == (True, True, True, False)


def test_dtr_and_an_open_reset_a_qsb():
    port = serial.serial_for_url("drivetwin://qsb-d", baudrate=230400, timeout=1.0)
    assert port.read(12) == b"QSB-D  0E!\r\n", "the greeting after an open"
    port.write(b"V\r")
    assert port.read_until(b"\n").endswith(b"!\r\n")
    port.dtr = False
    port.dtr = True
    assert port.read(12) == b"QSB-D  0E!\r\n"
    port.close()
    port.open()
    assert port.read(12) == b"QSB-D  0E!\r\n"
    port.close()
    with pytest.raises(serial.SerialException):
        port.read(1)


def test_a_drive_of_a_bench_has_a_url(twin):
    x = twin("md3", name="x", fast_boot=True)
    port = opened(x.url())
    assert port.drive == x and port.bench == twin.bench
    port.write(write(1, 0x11, 1))
    twin.bench.advance(3.0)
    assert port.read(8) == write(1, 0x11, 1) and x.motion.position == 10_000
    other = opened(x.url("rs485"))
    other.write(SPEED)
    assert len(other.read(9)) == 9, "two masters on one line"
    twin.bench.close()
    for act in [lambda: port.read(1), lambda: opened(x.url())]:
        with pytest.raises(Error):
            act()
    port.close()


def test_threads_make_urls_at_the_same_time():
    def urls(_):
        made = []
        for _ in range(100):
            with drivetwin.Bench() as bench:
                x = bench.add("md3")
                made.append(x.url())
                assert x.url() == made[-1]
        return made

    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as pool:
            made = [url for of_one in pool.map(urls, range(8)) for url in of_one]
    finally:
        sys.setswitchinterval(usual)
    assert len(set(made)) == len(made) == 800


def test_ports_of_a_bench_file_are_on_one_bench(tmp_path):
    file = tmp_path / "bench.toml"
    file.write_text("".join(f'[[drive]]\nname = "{name}"\nkind = "md3"\nfast_boot = true\n' for name in "xy"))
    x, y = (opened(f"drivetwin://?bench={file}&drive={name}") for name in "xy")
    assert x.bench == y.bench and (x.drive.name, y.drive.name) == ("x", "y")
    x.write(SPEED)
    assert len(x.read(9)) == 9 and y.in_waiting == 0
    assert opened(f"drivetwin://?bench={file}").drive.name == "x"


def test_a_drive_in_real_time_answers_when_it_would():
    port = opened("drivetwin://md3?fast_boot=1&time=real")
    begin = time.monotonic()
    port.write(SPEED)
    assert port.in_waiting == 0
    assert len(port.read(9)) == 9
    # 17 characters of 11 bits at 9600 baud, and the gap before the reply.
    assert 0.0195 < time.monotonic() - begin < 1.0
    fast = opened("drivetwin://md3?time=x100", timeout=0.5)
    begin = time.monotonic()
    while not fast.read(9):
        fast.write(SPEED)
        assert time.monotonic() - begin < 10.0
    assert fast.bench.now > 2.5


def test_a_read_in_real_time_can_be_cancelled():
    port = opened("drivetwin://md3?fast_boot=1&time=real", timeout=None)
    timer = threading.Timer(0.1, port.cancel_read)
    timer.start()
    assert port.read(1) == b""
    timer.join()


@pytest.mark.parametrize(
    ("url", "sentence"),
    [
        ("drivetwin://md4", "there is no kind 'md4'; the nearest is 'md3'"),
        ("drivetwin://md3?Sped=1", "set: there is no register of md3 'Sped'; the nearest is 'Speed'"),
        ("drivetwin://md3?port=rs458", "there is no port 'rs458'; the nearest is 'rs485'"),
        ("drivetwin://md3?time=soon", "time takes real, xN (N from 1 to 1000) or manual, not 'soon'"),
        ("drivetwin://md3?fast_boot=perhaps", "fast_boot takes 1 or 0, not 'perhaps'"),
        ("drivetwin://md3?seed=abc", "seed takes a whole number from 0, not 'abc'"),
        ("drivetwin://md3?seed=-1", "seed takes a whole number from 0, not '-1'"),
        ("drivetwin://md3?line=slow", "line takes timed or fast, not 'slow'"),
        ("drivetwin://?shared=77", "drivetwin://?shared=77 is of a bench that is not in this process, or is closed"),
    ],
)
def test_a_wrong_url_is_one_sentence(url, sentence):
    with pytest.raises((Error, serial.SerialException)) as raised:
        opened(url)
    assert str(raised.value) == sentence


def test_a_bench_file_takes_no_options_of_a_drive(tmp_path):
    file = tmp_path / "bench.toml"
    file.write_text('[[drive]]\nname = "x"\nkind = "md3"\n')
    with pytest.raises(Error, match="has 'Speed', which is for a single drive only$"):
        opened(f"drivetwin://?bench={file}&Speed=1")


def test_the_package_is_there_without_pyserial():
    assert "drivetwin.urlhandler" in serial.protocol_handler_packages
    assert drivetwin.Bench().add("md3").url().startswith("drivetwin://?shared=")
