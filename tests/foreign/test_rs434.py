"""Third-party masters use RTU and ASCII with an RS 434544, and load, run, pause and read back
its user program."""

import pytest
from minimalmodbus import BYTEORDER_LITTLE_SWAP, Instrument, NoResponseError
from pymodbus import FramerType
from pymodbus.pdu import ExceptionResponse

from conftest import ask, receive
from modbus import serial_port
from rs434 import *

BAUD = 115_200
"""Of a new drive (6)."""
FRAMINGS = ["rtu", "ascii"]


def drive(run, framing, *options):
    """A drive whose clock stops between two requests, in that framing."""
    kind = {"rtu": 3, "ascii": 1}[framing]
    return run("--fast-boot", "--time", "manual", "--set", f"TYPE_MODBUS={kind}", *options, kind="rs434544")


def ascii(*body):
    """A message in ASCII of an address and a PDU (Modbus over serial line, 2.5.2)."""
    return b":%s%02X\r\n" % (bytes(body).hex().upper().encode(), -sum(body) & 0xFF)


@pytest.fixture(params=[(way, framing) for way in ("tcp", "pty") for framing in FRAMINGS], ids="-".join)
def master(request, run, tcp, serial):
    """A drive, and pymodbus connected to it in either framing over TCP or on the pty."""
    way, framing = request.param
    drivetwin = drive(run, framing)
    framer = {"rtu": FramerType.RTU, "ascii": FramerType.ASCII}[framing]
    return drivetwin, tcp(drivetwin, framer) if way == "tcp" else serial(drivetwin, framer, BAUD)


@pytest.fixture(params=FRAMINGS)
def instrument(request, run):
    """A drive, and minimalmodbus connected to it on the pty in either framing."""
    drivetwin = drive(run, request.param)
    with serial_port(drivetwin, BAUD, bytesize=7 if request.param == "ascii" else 8) as port:
        yield drivetwin, Instrument(port, 1, request.param)


def test_pymodbus_reads_and_writes_all_four_spaces(master):
    _, client = master
    assert client.read_holding_registers(SLAVE_ADDRESS_MODBUS, count=3).registers[::2] == [1, 9]
    assert len(client.read_holding_registers(SLAVE_ADDRESS_MODBUS, count=0x27).registers) == 0x27
    assert client.read_input_registers(HW_MAJOR).registers == [1001]
    assert client.read_discrete_inputs(IN_HARD_STOP_BIT).bits[0] is True
    assert not client.write_coil(CLR_POSITION_BIT, True).isError()
    assert not client.write_coils(START_BIT + 1, [False, False, True]).isError()
    assert client.read_coils(START_BIT, count=4).bits[:4] == [False] * 4
    written = client.write_register(SPEED, 1234)
    assert not written.isError() and written.registers == [1234]
    # 32 bits, the low word first.
    assert not client.write_registers(TARGET_POSITION1, [0x2345, 0x0001]).isError()
    assert client.read_holding_registers(TARGET_POSITION1, count=2).registers == [0x2345, 0x0001]
    assert client.read_holding_registers(SPEED).registers == [1234]


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (lambda c: c.mask_write_register(address=SPEED), 1),
        (lambda c: c.read_holding_registers(0x5027), 2),
        (lambda c: c.read_holding_registers(SPEED - 0x500), 2),
        (lambda c: c.write_register(PC_REG, 0), 2),
        (lambda c: c.write_register(SPEED, 29), 3),
        (lambda c: c.write_register(FLAG_SAVE_INI, SAVE + 1), 3),
    ],
)
def test_exceptions(master, request_, code):
    _, client = master
    refusal = request_(client)
    assert isinstance(refusal, ExceptionResponse) and refusal.exception_code == code
    error = OUT_OF_RANGE if code == 3 else 0
    assert client.read_holding_registers(ERROR).registers == [error]


def test_pymodbus_loads_runs_pauses_and_reads_back_a_program(master):
    drivetwin, client = master

    def status():
        (status,) = client.read_input_registers(STATUS_USER_PROGRAM).registers
        return status

    def read(register):
        (value,) = client.read_holding_registers(register).registers
        return value

    def write(register, *values):
        assert not client.write_registers(register, list(values)).isError()

    assert status() == STOPPED
    for line, instruction in enumerate(COUNTER):
        # As in the manual, or with one request (6.6).
        if line % 2:
            write(CMD_W, *instruction)
            assert not client.write_register(WRITE_CMD, line).isError()
        else:
            write(WRITE_CMD, line, *instruction)
    assert not client.write_register(FLAG_SAVE_USER_PROGRAM, PROGRAM_TO_FLASH).isError()
    drivetwin.advance(1)
    # The buffer is not the program.
    write(WRITE_CMD, 0, 0x0D, 0)
    assert not client.write_register(FLAG_SAVE_USER_PROGRAM, PROGRAM_TO_BUFFER).isError()
    drivetwin.advance(1)
    for line, instruction in enumerate([*COUNTER, [0, 0]]):
        assert not client.write_register(READ_CMD, line).isError()
        assert client.read_holding_registers(CMD_R, count=2).registers == instruction

    assert not client.write_register(MODE_USER_PROGRAM, START).isError()
    drivetwin.advance(0.1)
    assert (status(), read(PC_REG), read(AX_REG)) == (RUNS, 1, 7)
    drivetwin.advance(1)
    assert (read(PC_REG), read(AX_REG)) == (3, 8)
    drivetwin.advance(1)
    assert (read(PC_REG), read(AX_REG)) == (1, 8)
    # The program sees what the bus writes.
    write(AX_REG, 100)
    drivetwin.advance(1)
    assert (read(PC_REG), read(AX_REG)) == (3, 101)

    assert not client.write_register(MODE_USER_PROGRAM, STOP).isError()
    drivetwin.advance(10)
    assert (status(), read(AX_REG)) == (STOPPED, 101)
    assert not client.write_register(MODE_USER_PROGRAM, START).isError()
    drivetwin.advance(0.1)
    assert (status(), read(PC_REG), read(AX_REG)) == (RUNS, 1, 7)
    assert read(ERROR) == 0


def test_minimalmodbus_loads_runs_and_pauses_a_program(instrument):
    drivetwin, master = instrument
    assert master.read_register(HW_MAJOR, functioncode=4) == 1001
    assert master.read_bit(IN_HARD_STOP_BIT) == 1
    master.write_bit(CLR_POSITION_BIT, 1)
    master.write_long(TARGET_POSITION1, -70_000, signed=True, byteorder=BYTEORDER_LITTLE_SWAP)
    assert master.read_long(TARGET_POSITION1, signed=True, byteorder=BYTEORDER_LITTLE_SWAP) == -70_000
    for line, instruction in enumerate(COUNTER):
        master.write_registers(WRITE_CMD, [line, *instruction])
    master.write_register(FLAG_SAVE_USER_PROGRAM, PROGRAM_TO_FLASH, functioncode=6)
    drivetwin.advance(1)
    for line, instruction in enumerate(COUNTER):
        master.write_register(READ_CMD, line, functioncode=6)
        assert master.read_registers(CMD_R, 2) == instruction
    master.write_register(MODE_USER_PROGRAM, START, functioncode=6)
    drivetwin.advance(1.5)
    assert master.read_register(STATUS_USER_PROGRAM, functioncode=4) == RUNS
    assert (master.read_register(PC_REG), master.read_register(AX_REG)) == (3, 8)
    master.write_register(MODE_USER_PROGRAM, STOP, functioncode=6)
    assert master.read_register(STATUS_USER_PROGRAM, functioncode=4) == STOPPED


def test_ascii_after_a_save_and_a_restart(run, tcp):
    drivetwin = run("--time", "manual", kind="rs434544")
    drivetwin.advance(1)
    client = tcp(drivetwin)
    assert not client.write_register(TYPE_MODBUS, 1).isError()
    # Nothing has changed yet (6.4).
    assert client.read_holding_registers(TYPE_MODBUS).registers == [1]
    assert not client.write_register(FLAG_SAVE_INI, SAVE).isError()
    drivetwin.advance(0.1)
    assert not client.write_register(FLAG_RESTART, RESTART).isError()
    drivetwin.advance(1)
    client = tcp(drivetwin, FramerType.ASCII)
    assert client.read_holding_registers(TYPE_MODBUS).registers == [1]
    # A new speed holds after a save and a restart, too; and RTU again.
    assert not client.write_registers(TYPE_MODBUS, [5, 3]).isError()
    assert not client.write_register(FLAG_SAVE_INI, SAVE).isError()
    drivetwin.advance(0.1)
    assert not client.write_register(FLAG_RESTART, RESTART).isError()
    drivetwin.advance(1)
    with serial_port(drivetwin, BAUD, parity="N", stopbits=2, timeout=3) as port:
        with pytest.raises(NoResponseError):
            Instrument(port, 1).read_register(BITRATE_MODBUS)
    with serial_port(drivetwin, 4_800, parity="N", stopbits=2) as port:
        assert Instrument(port, 1).read_registers(TYPE_MODBUS, 2) == [5, 3]


def test_settings_hold_when_power_fails(run, tcp, tmp_path):
    nv = tmp_path / "rs434.nv"
    drivetwin = drive(run, "rtu", "--nv", nv)
    client = tcp(drivetwin)
    assert not client.write_registers(SLAVE_ADDRESS_MODBUS, [9, 1]).isError()
    assert not client.write_registers(WRITE_CMD, [3, 0x19, 1]).isError()
    assert not client.write_register(FLAG_SAVE_USER_PROGRAM, PROGRAM_TO_FLASH).isError()
    drivetwin.advance(1)
    assert not client.write_register(FLAG_SAVE_INI, SAVE).isError()
    drivetwin.advance(1)
    drivetwin.kill()
    client = tcp(run("--fast-boot", "--nv", nv, kind="rs434544"), FramerType.ASCII)
    assert client.read_holding_registers(SLAVE_ADDRESS_MODBUS, count=2, device_id=9).registers == [9, 1]
    assert not client.write_register(FLAG_SAVE_USER_PROGRAM, PROGRAM_TO_BUFFER, device_id=9).isError()
    assert not client.write_register(READ_CMD, 3, device_id=9).isError()
    assert client.read_holding_registers(CMD_R, count=2, device_id=9).registers == [0x19, 1]


def test_noise_in_ascii_ends_at_the_next_colon(run):
    drivetwin = drive(run, "ascii")
    good, reply = ascii(1, 3, 0x50, 1, 0, 1), ascii(1, 3, 2, 0, 1)
    with drivetwin.socket() as master:
        for noise in (
            b":",
            b"0103500100",
            good[:9],
            good.replace(b"5001", b"5002"),
            good[:-2],
            b"\r\n",
            b":" * 600,
            b":" + b"0" * 600,
            bytes(range(256)).replace(b":", b""),
            ascii(2, 3, 0x50, 1, 0, 1),
        ):
            master.sendall(noise)
            drivetwin.advance(0.5)
            assert ask(master, good, len(reply)) == reply, noise
        # Half a message may wait for a second, in which other masters may not send; lower-case digits are valid.
        master.sendall(good[:5])
        drivetwin.advance(0.9)
        assert ask(master, good[5:].lower(), len(reply)) == reply
        # A broadcast gets no answer.
        master.sendall(ascii(0, 6, 0x50, 0x0B, 0x01, 0x02))
        assert ask(master, ascii(1, 3, 0x50, 0x0B, 0, 1), len(reply)) == ascii(1, 3, 2, 0x01, 0x02)


def test_several_clients_share_a_line_of_ascii(run):
    drivetwin = drive(run, "ascii")
    first, second = drivetwin.socket(), drivetwin.socket()
    drivetwin.notice()
    request, reply = ascii(1, 3, 0x50, 1, 0, 1), ascii(1, 3, 2, 0, 1)
    first.sendall(request + request)
    second.sendall(request)
    for client in (first, second):
        assert receive(client, 3 * len(reply)) == 3 * reply
        client.close()


def test_ascii_while_time_goes_on(run, tcp):
    """In real time and without any: what a request waits for does not depend on silences."""
    for options in ([], ["--line", "fast"], ["--time", "x10"]):
        drivetwin = run("--fast-boot", "--set", "TYPE_MODBUS=1", *options, kind="rs434544")
        client = tcp(drivetwin, FramerType.ASCII)
        for value in range(100, 110):
            assert not client.write_register(SPEED, value).isError()
            assert client.read_holding_registers(SPEED).registers == [value]
