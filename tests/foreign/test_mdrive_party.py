"""Clients that were written against MDrives on a party line, as they come from the Python index: dvg-devices 1.8.1 and
pymdrive 1.0.0. They hold port 503 of a drive with `SerialCommands`, by way of a pty."""

import asyncio
import importlib.resources
import logging
import time
import warnings

import pytest
from dvg_devices.MDrive_stepper_protocol_RS422 import MDrive_Controller, Movement_type
from pymdrive import MdriveAxis, MdriveComm, emergency_stop

from conftest import PATIENCE
from party import party_line, set_up

SWITCHES = """
[[drive]]
name = "x"
kind = "mdrive"
fast_boot = true
set = { SerialCommands = 1 }

[[motor]]
name = "x-axis"
drive = "x"

[[switch]]                      # normally closed, at both ends
motor = "x-axis"
closed = { above_rev = -0.5 }
to = "x.IO1"

[[switch]]
motor = "x-axis"
closed = { below_rev = 3 }
to = "x.IO2"

[[drive]]
name = "z"
kind = "mdrive"
fast_boot = true
set = { SerialCommands = 1 }

[[motor]]
name = "z-axis"
drive = "z"

[[switch]]                      # normally open, at the bottom
motor = "z-axis"
closed = { below_rev = -0.1 }
to = "z.IO1"
"""
"""Two axes as the two programs of dvg-devices need them."""


def example(name):
    """The lines of a program that comes with dvg-devices, without comments: with them some are longer than the drive
    takes (MC 5-57)."""
    text = importlib.resources.files("dvg_devices").joinpath(f"MDrive_example_motion_program_{name}.mxt").read_text()
    lines = [line.split("'")[0].strip() for line in text.splitlines()]
    return [line for line in lines if line]


def controller(path, names):
    """dvg-devices, connected to what is on that port."""
    mdrive = MDrive_Controller()
    assert mdrive.connect_at_port(path)
    mdrive.begin(names)
    return mdrive


def wait_still(motor):
    """Polls as the client's own demonstration does."""
    ends = time.monotonic() + PATIENCE
    while motor.state.is_moving:
        assert motor.query_is_moving()
        assert time.monotonic() < ends, "it moves on"
    assert motor.query_state() and motor.query_errors()


@pytest.fixture
def complaints(capsys):
    """Messages of dvg-devices about the drive; it goes on after that."""

    def read():
        said = capsys.readouterr().out
        assert "ERROR" not in said and "WARNING" not in said and "CRITICAL" not in said, said
        return said

    return read


def test_dvg_devices_finds_and_moves_a_motor(run, complaints):
    drivetwin = run("--set", "SerialCommands=1", kind="mdrive")
    set_up(drivetwin, None, example("x"))
    with party_line(drivetwin.ports["mcode"]) as path:
        mdrive = controller(path, "wx0")
        (motor,) = mdrive.motors
        config = motor.config
        assert (motor.device_name, config.serial_number) == ("x", "123456789")
        assert (config.movement_type, config.calibration_constant) == (Movement_type.LINEAR, 51_200)
        assert (config.motion_VI, config.motion_VM) == (25_600, 256_000)
        assert (config.motion_A, config.motion_D, config.motion_LM) == (1_024_000, 1_024_000, 4)
        assert (config.motion_MS, config.motion_RC, config.motion_HC, config.motion_HT) == (256, 25, 5, 500)
        assert (config.IO_S1, config.IO_S2, config.IO_S3) == ("3, 1, 0", "2, 1, 0", "0, 1, 0")
        assert config.user_variables == {"CT": 0, "C0": 51_200, "L1": 3, "L2": 2}
        assert {"SU", "M0", "MM", "F1", "F2", "FH"} == set(config.user_subroutines)
        assert motor.query("s1=0,0,0") == (True, "") and motor.query("s2=0,0,0") == (True, "")

        assert motor.move_absolute_mm(2)
        wait_still(motor)
        assert (motor.state.position, motor.state.velocity, motor.state.has_error) == (102_400, 0, False)
        assert motor.move_relative_steps(-2_400)
        wait_still(motor)
        assert motor.state.position == 100_000

        # An error is there until a subroutine runs.
        assert motor.query("rc=101") == (True, "")
        assert motor.query_errors() and (motor.state.has_error, motor.state.error) == (True, 21)
        assert motor.query_errors() and not motor.state.has_error, "reading ER clears EF"

        assert motor.slew_mm_per_sec(1)
        assert motor.query_state() and motor.state.is_moving
        mdrive.STOP()
        # Its reset is a broadcast, which gets no answer.
        mdrive.RESET()
        assert motor.query_state() and not motor.state.is_moving
        assert motor.save_to_NVM()
        complaints()
        mdrive.close()


def test_dvg_devices_homes_two_motors_on_one_line(run, tmp_path, complaints):
    bench = tmp_path / "stages.toml"
    bench.write_text(SWITCHES)
    drivetwin = run(kind=bench)
    for name in ("x", "z"):
        set_up(drivetwin, name, example(name))
    with party_line(*(drivetwin.drives[name]["mcode"] for name in ("x", "z"))) as path:
        mdrive = controller(path, "wxyz")
        x, z = mdrive.motors
        assert (x.device_name, z.device_name) == ("x", "z")
        assert (x.config.calibration_constant, z.config.calibration_constant) == (51_200, 6_400)
        for motor in (x, z):
            assert motor.home()
            wait_still(motor)
            # H waits between homing and the way back.
            time.sleep(0.1)
            motor.query_is_moving()
            wait_still(motor)
            assert (motor.state.position, motor.state.error, motor.state.is_home_known) == (0, 0, True)
        # Homing ends beside the switch.
        turns = [motor["revolutions"] for motor in revolutions(drivetwin)]
        assert -0.5 < turns[0] < -0.4 and -0.1 < turns[1] < 0.2, turns

        assert x.move_absolute_mm(1) and z.move_absolute_mm(2)
        wait_still(x)
        wait_still(z)
        assert (x.state.position, z.state.position) == (51_200, 12_800)

        # Up to the limit switch: error 83, reached plus LIMIT switch (MC 9).
        assert x.slew_steps_per_sec(200_000)
        wait_still(x)
        assert x.state.error == 83
        assert not x.state.is_home_known
        assert x.init_interface() and not x.state.has_error
        complaints()
        mdrive.close()


def revolutions(drivetwin):
    """The motors of the bench."""
    return drivetwin.call("GET", "/api/bench")["motors"]


pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""pymdrive's destructor calls one that its base class has not."""


@pytest.fixture
def play(caplog):
    """Runs a session of pymdrive on a line, which must not log warnings."""

    def run(session, *ports):
        async def whole(path):
            comm = MdriveComm(path)
            await comm.start()
            await session(comm)
            await comm.stop()

        with party_line(*ports) as path, warnings.catch_warnings(), caplog.at_level(logging.WARNING):
            warnings.simplefilter("error", UserWarning)
            asyncio.run(asyncio.wait_for(whole(path), 2 * PATIENCE))
        assert not caplog.records, caplog.text

    return run


def test_pymdrive_stops_a_motor(run, play):
    drivetwin = run("--set", "SerialCommands=1", kind="mdrive")
    set_up(drivetwin, None, ['DN="X"'])

    async def session(comm):
        x = MdriveAxis(comm, "X")
        await x.move_relative(10_000_000)
        assert await x.is_moving()
        emergency_stop(comm)
        assert not await x.is_moving()
        assert 0 < await x.get_position() < 20_000_000

    # The second connection needs no Ctrl-J of its own.
    for _ in range(2):
        play(session, drivetwin.ports["mcode"])


def test_pymdrive_moves_two_motors(run, play, tmp_path):
    bench = tmp_path / "stages.toml"
    bench.write_text(SWITCHES)
    drivetwin = run(kind=bench)
    for drive, name in (("x", "X"), ("z", "Z")):
        set_up(drivetwin, drive, [f'DN="{name}"', "VM=100000", "S1=3,1,0" if name == "X" else "S1=3,0,0"])

    async def session(comm):
        x, z = MdriveAxis(comm, "X"), MdriveAxis(comm, "Z")
        x.enable()
        x.set_velocity(200_000)
        assert (await x.get_velocity(), await z.get_velocity()) == (200_000, 100_000)
        await x.set_acceleration(2_000_000)
        assert await x.get_acceleration() == 2_000_000
        await x.set_position(500)
        await x.move_relative(20_000)
        await z.move_absolute(-1_000)
        await x.wait_for_motion_done()
        await z.wait_for_motion_done()
        assert (await x.get_position(), await z.get_position()) == (20_500, -1_000)

        await x.move_relative(10_000_000)
        assert await x.is_moving()
        await x.abort_move()
        await x.wait_for_motion_done()
        assert 20_500 < await x.get_position() < 10_000_000

        assert not await x.is_homed()
        await x.home_negative()
        assert await x.is_homed() and await x.get_position() == 0

        # It leaves out the first line.
        parameters = dict(line.split(" = ", 1) for line in await x.read_all_parameters())
        assert (parameters["VM"], parameters["P"], parameters["DN"]) == ("200000", "0", '"X"')
        x.disable()
        assert (await x.read_all_parameters()).count("DE = 0") == 1

    play(session, *(drivetwin.drives[name]["mcode"] for name in ("x", "z")))
