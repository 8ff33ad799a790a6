"""Every call with requests that its description allows, and with others that it forbids."""

import json
import urllib.request

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_schema_conformance,
    status_code_conformance,
)

from conftest import PATIENCE, Drivetwin

CHECKS = (
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    negative_data_rejection,
    response_schema_conformance,
)

ON_BOARDS = {"PUT /api/drives/{name}/kind", "PUT /api/drives/{name}/memory"}
"""Calls that only a board takes."""

BENCH = """
[[bus]]
name = "line1"
drives = ["x", "y"]

[[drive]]
name = "x"
kind = "md3"

[[drive]]
name = "y"
kind = "md3-low"
address = 2

[[drive]]
name = "reader"
kind = "qsb-m"

[[drive]]
name = "brush"
kind = "rs434546"

[[drive]]
name = "net"
kind = "mdrive"

[[motor]]
name = "m"
drive = "x"
steps_per_rev = 200

[[encoder]]
motor = "m"
cycles_per_rev = 1000
to = { a = "reader.A", b = "reader.B", index = "reader.I" }
"""

NAMES = {
    "/api/drives/{name}": {
        "name": ["x", "reader", "z"],
        "pin": ["J2.5", "A", "J2.22"],
        "register": ["Speed", "Mdr0", "Sped"],
        "fault": ["over_temperature", "stall"],
    },
    "/api/terminals/{id}": {"id": [1]},
    "/api/kinds/{kind}": {"kind": ["md3", "qsb-d", "md4"]},
    "/api/buses/{name}": {"name": ["line1", "reader.usb", "brush.rs485", "net.modbus", "line2"]},
}
"""What is called so, and what is not: hardly any other name would meet something."""

TERMINAL = "/api/drives/net/ports/mcode/terminal"

STEPS = [
    {"bus": "line1", "faults": {"drop": {"count": 1}}},
    {"after_ms": 0.5, "drive": "x", "fault": "over_temperature"},
    {"when": {"drive": "x", "register": "Speed"}, "drive": "z", "clear": "over_temperature"},
]
"""Steps of scenarios: hardly any other object would be one."""

LONGEST = 0.01
"""Seconds by which the clock goes on at once: pulses at 8 MHz may run during that."""


SETTINGS = settings(
    max_examples=40, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck)
)


def tame(case):
    """Keeps the clock stopped, and advances it in small steps only."""
    case.headers["Content-Type"] = "application/json"
    body = case.body
    if case.path == "/api/time/advance" and isinstance(body, dict):
        seconds = body.get("seconds")
        if isinstance(seconds, (int, float)) and 0 <= seconds <= 86_400:
            body["seconds"] = seconds / 86_400 * LONGEST
    if case.path == "/api/time" and isinstance(body, dict) and body.get("mode") != "manual":
        body["mode"] = f"not {body.get('mode')}"


@pytest.fixture(scope="module")
def drivetwin(tmp_path_factory):
    bench = tmp_path_factory.mktemp("bench") / "bench.toml"
    bench.write_text(BENCH)
    drivetwin = Drivetwin("--fast-boot", "--time", "manual", kind=bench)
    # Terminal 1 is open meanwhile.
    with urllib.request.urlopen(drivetwin.control + TERMINAL, timeout=PATIENCE) as events:
        assert events.readline() == b"event: open\n"
        yield drivetwin
    assert drivetwin.stop() == 0
    drivetwin.kill()


@pytest.fixture(scope="module")
def described(drivetwin):
    with urllib.request.urlopen(drivetwin.control + "/openapi.json", timeout=PATIENCE) as answer:
        document = json.load(answer)
    # They never end; test_api.py follows them.
    for endless in ["/api/events", "/api/live", "/api/drives/{name}/ports/{port}/terminal"]:
        del document["paths"][endless]
    for path, item in document["paths"].items():
        names = next((names for prefix, names in NAMES.items() if path.startswith(prefix)), {})
        for parameter in (parameter for call in item.values() for parameter in call.get("parameters", [])):
            if parameter["in"] == "path":
                parameter["schema"]["enum"] = names[parameter["name"]]
    document["components"]["schemas"]["Scenario"]["properties"]["steps"]["items"] = {"enum": STEPS}
    return schemathesis.openapi.from_dict(document)


@pytest.mark.parametrize("mode", list(GenerationMode), ids=lambda mode: mode.value)
def test_no_call_surprises(drivetwin, described, mode):
    calls, made = set(), set()
    for found in described.get_all_operations():
        operation = found.ok()
        says_something = {"parameters", "requestBody"} & operation.definition.raw.keys()
        if mode.is_negative and not says_something:
            continue

        @given(case=operation.as_strategy(generation_mode=mode))
        @settings(SETTINGS)
        def call(case):
            tame(case)
            answer = case.call(base_url=drivetwin.control, timeout=PATIENCE)
            case.validate_response(answer, checks=CHECKS)
            made.add((operation.label, answer.status_code))

        call()
        calls.add(operation.label)
    refused = ON_BOARDS if mode.is_positive else set()
    assert calls - refused == {label for label, status in made if (status < 300) == mode.is_positive}
