"""A move, in real time and with the clock standing."""

import time

from md3 import MOTION_CONTROL

MOVE = 1
"""Bit of MotionControl (7.15)."""


def test_a_move_takes_two_and_a_half_seconds(run, tcp):
    """10,000 steps at 5,000 steps/s and 10,000 steps/s²: 0.5 s up, 1.5 s, 0.5 s down."""
    standin = run("--fast-boot")
    client = tcp(standin)
    before = standin.seconds()
    assert not client.write_register(MOTION_CONTROL, MOVE).isError()
    after = standin.seconds()
    running = []
    while True:
        asked = standin.seconds()
        (control,) = client.read_holding_registers(MOTION_CONTROL).registers
        if control == 0:
            break
        assert control == MOVE
        running.append(asked)
    done = standin.seconds()
    assert running, "it was never seen running"
    # It began between `before` and `after`, and ended between the last look that saw it running and `done`.
    assert running[-1] - after <= 2.5 <= done - before
    motion = standin.drive()["motion"]
    assert (motion["position"], motion["moving"]) == (10_000, False)


def test_the_same_with_the_clock_standing(run, tcp):
    standin = run("--fast-boot", "--time", "manual")
    client = tcp(standin)
    began, wall = standin.seconds(), time.monotonic()
    for turn in range(1, 21):
        client.write_register(MOTION_CONTROL, MOVE)
        standin.advance(1.0)
        motion = standin.drive()["motion"]
        assert motion["moving"] and motion["speed"] == 5_000
        assert 10_000 * (turn - 1) < motion["position"] < 10_000 * turn
        assert client.read_holding_registers(MOTION_CONTROL).registers == [MOVE]
        standin.advance(2.5)
        assert client.read_holding_registers(MOTION_CONTROL).registers == [0]
        motion = standin.drive()["motion"]
        assert not motion["moving"] and motion["position"] == 10_000 * turn
    passed = standin.seconds() - began
    assert passed > 20 * 3.5
    assert time.monotonic() - wall < passed, "manual time is slower than real time"


def test_nothing_moves_the_standing_clock_but_requests(run, tcp):
    standin = run("--fast-boot", "--time", "manual")
    client = tcp(standin)
    client.write_register(MOTION_CONTROL, MOVE)
    began = standin.drive()["motion"]["position"]
    stood = standin.seconds()
    assert [standin.seconds() for _ in range(5)] == [stood] * 5
    assert standin.drive()["motion"]["position"] == began
    client.read_holding_registers(MOTION_CONTROL)
    assert standin.seconds() > stood
