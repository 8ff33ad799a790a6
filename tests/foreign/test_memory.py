"""The EEPROM in a file: what survives SIGKILL, and what a bad one does (4, 7.20)."""

import threading

import pytest

from conftest import receive
from md3 import DEFAULTS, EEPROM_CONTROL, USER_REGISTER
from modbus import frame, write

SAVE = 1
PASSED, SAVED, FAILED = 0x9A00, 0x0000, 0xF100
BAD_DEFAULTS = [*DEFAULTS[:EEPROM_CONTROL], FAILED, *DEFAULTS[EEPROM_CONTROL + 1 :]]


def test_a_save_survives_sigkill(run, tcp, tmp_path):
    nv = tmp_path / "md3.nv"
    drivetwin = run("--fast-boot", "--time", "manual", "--nv", nv)
    client = tcp(drivetwin)
    client.write_register(USER_REGISTER, 0x1234)
    client.write_register(EEPROM_CONTROL, SAVE)
    drivetwin.advance(0.02)
    assert client.read_holding_registers(EEPROM_CONTROL).registers == [SAVED]
    drivetwin.kill()
    client = tcp(run("--fast-boot", "--nv", nv))
    assert client.read_holding_registers(EEPROM_CONTROL).registers == [PASSED]
    assert client.read_holding_registers(USER_REGISTER).registers == [0x1234]


def test_sigkill_inside_a_save_leaves_bad_memory(run, tcp, tmp_path):
    """The clock stops right after the answer, before the 20 ms of the save are over."""
    nv = tmp_path / "md3.nv"
    drivetwin = run("--fast-boot", "--time", "manual", "--nv", nv)
    client = tcp(drivetwin)
    client.write_register(USER_REGISTER, 0x1234)
    client.write_register(EEPROM_CONTROL, SAVE)
    drivetwin.kill()
    bad = nv.read_bytes()
    drivetwin = run("--fast-boot", "--time", "manual", "--nv", nv)
    client = tcp(drivetwin)
    assert client.read_holding_registers(0, count=32).registers == BAD_DEFAULTS
    assert nv.read_bytes() == bad, "bad memory stays as it is until a save"
    client.write_register(EEPROM_CONTROL, SAVE)
    drivetwin.advance(1)
    drivetwin.kill()
    client = tcp(run("--fast-boot", "--nv", nv))
    assert client.read_holding_registers(0, count=32).registers == DEFAULTS


@pytest.mark.parametrize("seed", range(8))
def test_sigkill_at_any_instant_of_a_loop_of_saves(run, tcp, tmp_path, seed):
    """The old registers, the new ones, or bad memory; never anything else."""
    nv = tmp_path / "md3.nv"
    drivetwin = run("--fast-boot", "--line", "fast", "--nv", nv)
    killer = threading.Timer(0.05 + 0.037 * seed, drivetwin.process.kill)
    asked = answered = 0
    with drivetwin.socket() as master:
        killer.start()
        try:
            while True:
                asked += 1
                for request in (write(1, USER_REGISTER, asked), write(1, EEPROM_CONTROL, SAVE)):
                    master.sendall(request)
                    assert receive(master, 8) == request
                answered = asked
        except (OSError, AssertionError):
            assert drivetwin.process.wait(30) == -9
    client = tcp(run("--fast-boot", "--nv", nv))
    (status,) = client.read_holding_registers(EEPROM_CONTROL).registers
    (value,) = client.read_holding_registers(USER_REGISTER).registers
    if status == FAILED:
        assert client.read_holding_registers(0, count=32).registers == BAD_DEFAULTS
    else:
        # A save requested while one runs is ignored, so an older value may be the newest saved.
        assert status == PASSED and 0 <= value <= asked
    assert answered > 0, "it was killed before it saved anything"


@pytest.mark.parametrize("content", [b"\x00", bytes(64), b"not an EEPROM" * 100])
def test_a_corrupt_file_is_bad_memory(run, tcp, tmp_path, content):
    nv = tmp_path / "md3.nv"
    nv.write_bytes(content)
    drivetwin = run("--fast-boot", "--time", "manual", "--nv", nv)
    client = tcp(drivetwin)
    assert client.read_holding_registers(0, count=32).registers == BAD_DEFAULTS
    assert drivetwin.stop() == 0
    assert nv.read_bytes() == content


def test_bad_memory_delays_the_first_answer(run, tcp, tmp_path):
    """Red flashes for 5 s before the 2.5 s of every start (2, 7.20)."""
    nv = tmp_path / "md3.nv"
    nv.write_bytes(bytes(64))
    drivetwin = run("--time", "manual", "--nv", nv)
    with drivetwin.socket() as master:
        drivetwin.advance(7.4)
        master.sendall(frame(1, 3, 0, 0, 0, 1))
        drivetwin.advance(0.2)
        master.sendall(frame(1, 3, 0, 0, 0, 2))
        assert receive(master, 9) == frame(1, 3, 4, 0, 1, 0x03, 0x0A)


@pytest.mark.parametrize("content", [b"", b"\xff" * 10])
def test_an_empty_file_is_a_new_drive(run, tcp, tmp_path, content):
    """So is one of erased bytes."""
    nv = tmp_path / "md3.nv"
    nv.write_bytes(content)
    client = tcp(run("--fast-boot", "--nv", nv))
    assert client.read_holding_registers(0, count=32).registers == DEFAULTS
