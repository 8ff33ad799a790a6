"""pymodbus with a drive of another crate (examples/own-drive), in a program that is drivetwin with that drive."""

import pytest
from pymodbus.pdu import ExceptionResponse

COMMAND, SETPOINT, FREQUENCY = 0, 1, 3


@pytest.fixture
def vfd(run):
    drivetwin = run("--time", "manual", kind="own-vfd", program="own-drive")
    drivetwin.advance(1)
    return drivetwin


def test_a_master_runs_it(vfd, tcp):
    master = tcp(vfd)
    assert not master.write_register(SETPOINT, 1_000, device_id=1).isError()
    assert not master.write_register(COMMAND, 1, device_id=1).isError()
    # 10 Hz, at 5 s from standstill to 50 Hz: 1 s.
    vfd.advance(1)
    assert master.read_holding_registers(FREQUENCY, count=2, device_id=1).registers == [1_000, 0b011]
    refused = master.write_register(SETPOINT, 5_001, device_id=1)
    assert isinstance(refused, ExceptionResponse) and refused.exception_code == 3


def test_the_api_and_the_page_know_it(vfd):
    state = vfd.call("GET", "/api/drives/own-vfd")
    assert state["kind"] == "own-vfd"
    assert list(state["registers"]) == ["Command", "Setpoint", "RampTime", "Frequency", "Status"]
    vfd.call("PUT", "/api/drives/own-vfd/faults/overload")
    vfd.advance(0.001)
    assert vfd.drive()["registers"]["Status"] == 4
    description = vfd.call("GET", "/api/kinds/own-vfd")
    assert "0.01 Hz" in str(description)


def test_bench_files_may_have_it(run, tmp_path):
    file = tmp_path / "mixed.toml"
    file.write_text(
        """
        [[drive]]
        name = "v"
        kind = "own-vfd"
        set = { Setpoint = 5000 }

        [[drive]]
        name = "x"
        kind = "md3"
        """
    )
    mixed = run("--time", "manual", kind=str(file), program="own-drive")
    assert [drive["kind"] for drive in mixed.call("GET", "/api/bench")["drives"]] == ["own-vfd", "md3"]
    assert mixed.call("GET", "/api/drives/v")["registers"]["Setpoint"] == 5_000
