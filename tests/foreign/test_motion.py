"""A move, in real time and with the clock standing."""

import time

from md3 import MOTION_CONTROL

MOVE = 1
"""Bit of MotionControl (7.15)."""


def test_a_move_takes_two_and_a_half_seconds(run, tcp):
    """10,000 steps at 5,000 steps/s and 10,000 steps/s²: 0.5 s up, 1.5 s, 0.5 s down."""
    drivetwin = run("--fast-boot")
    client = tcp(drivetwin)
    before = drivetwin.seconds()
    assert not client.write_register(MOTION_CONTROL, MOVE).isError()
    after = drivetwin.seconds()
    running = []
    while True:
        asked = drivetwin.seconds()
        (control,) = client.read_holding_registers(MOTION_CONTROL).registers
        if control == 0:
            break
        assert control == MOVE
        running.append(asked)
    done = drivetwin.seconds()
    assert running, "it was never seen running"
    # It began between `before` and `after`, and ended between the last look that saw it running and `done`.
    assert running[-1] - after <= 2.5 <= done - before
    motion = drivetwin.drive()["motion"]
    assert (motion["position"], motion["moving"]) == (10_000, False)


def test_the_same_with_the_clock_standing(run, tcp):
    drivetwin = run("--fast-boot", "--time", "manual")
    client = tcp(drivetwin)
    began, wall = drivetwin.seconds(), time.monotonic()
    for turn in range(1, 21):
        client.write_register(MOTION_CONTROL, MOVE)
        drivetwin.advance(1.0)
        motion = drivetwin.drive()["motion"]
        assert motion["moving"] and motion["speed"] == 5_000
        assert 10_000 * (turn - 1) < motion["position"] < 10_000 * turn
        assert client.read_holding_registers(MOTION_CONTROL).registers == [MOVE]
        drivetwin.advance(2.5)
        assert client.read_holding_registers(MOTION_CONTROL).registers == [0]
        motion = drivetwin.drive()["motion"]
        assert not motion["moving"] and motion["position"] == 10_000 * turn
    passed = drivetwin.seconds() - began
    assert passed > 20 * 3.5
    assert time.monotonic() - wall < passed, "manual time is slower than real time"


def test_nothing_moves_the_standing_clock_but_requests(run, tcp):
    drivetwin = run("--fast-boot", "--time", "manual")
    client = tcp(drivetwin)
    client.write_register(MOTION_CONTROL, MOVE)
    began = drivetwin.drive()["motion"]["position"]
    stood = drivetwin.seconds()
    assert [drivetwin.seconds() for _ in range(5)] == [stood] * 5
    assert drivetwin.drive()["motion"]["position"] == began
    client.read_holding_registers(MOTION_CONTROL)
    assert drivetwin.seconds() > stood
