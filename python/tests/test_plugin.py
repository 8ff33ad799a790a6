"""The pytest plugin."""

import re
import shlex
import subprocess

import pytest
from test_command import COMMAND

pytest_plugins = ["pytester"]

FAILS = """
def test_that_fails(twin):
    x = twin("md3", fast_boot=True)
    x.registers["MotionControl"] = 1
    twin.bench.advance(1.25)
    other = twin.new_bench(seed=2)
    other.add("qsb-d", fast_boot=True)
    assert x.motion.position == 0

def test_that_passes(twin):
    assert twin("md3", name="x").bench == twin.bench
    assert twin("md3", name="y").bench["x"].name == "x"

def test_without_a_drive():
    assert False
"""


def test_a_drive_ends_with_its_test(pytester):
    pytester.makepyfile(
        """
        import pytest, drivetwin
        kept = []

        def test_makes(twin):
            kept.append(twin("md3", fast_boot=True))
            kept.append(twin.loads("[[drive]]\\nname='x'\\nkind='md3'")["x"])
            assert kept[0].bench != kept[1].bench

        def test_sees_the_end(twin):
            for drive in kept:
                with pytest.raises(drivetwin.Error, match="the bench is closed"):
                    drive.motion
        """
    )
    pytester.runpytest_subprocess().assert_outcomes(passed=2)


@pytest.mark.parametrize("workers", [[], ["-n", "2"]])
def test_a_failing_test_leaves_its_recording(pytester, workers):
    pytester.makepyfile(test_it=FAILS)
    result = pytester.runpytest_subprocess("--drivetwin-artifacts", "kept here", *workers)
    result.assert_outcomes(passed=1, failed=2)
    folder = pytester.path / "kept here"
    bases = ["test_it.py-test_that_fails", "test_it.py-test_that_fails-2"]
    wanted = {base + ending for base in bases for ending in (".trace", ".vcd", ".pcapng")}
    assert {file.name for file in folder.iterdir()} == wanted
    lines = [line for line in result.outlines if "replay: " in line]
    assert len(lines) == 2 and lines[0].startswith("the bench was at 1.25 s; replay: drivetwin replay ")
    _, command = lines[0].split("replay: drivetwin ")
    assert subprocess.run([COMMAND, *shlex.split(command)]).returncode == 0


def test_without_a_folder_the_report_names_the_option(pytester):
    pytester.makepyfile(test_it=FAILS)
    result = pytester.runpytest_subprocess()
    result.assert_outcomes(passed=1, failed=2)
    assert len(re.findall("--drivetwin-artifacts DIR keeps", result.stdout.str())) == 2
    assert [file.name for file in pytester.path.iterdir() if file.suffix in (".trace", ".vcd")] == []


def test_a_folder_that_cannot_be_made_is_reported(pytester):
    pytester.makepyfile(test_it=FAILS)
    (pytester.path / "taken").write_text("")
    result = pytester.runpytest_subprocess("--drivetwin-artifacts", "taken/x")
    result.assert_outcomes(passed=1, failed=2)
    result.stdout.fnmatch_lines(["the recording of the bench cannot be kept: *Not a directory*"])


def test_long_and_strange_names_are_file_names(pytester):
    pytester.makepyfile(
        test_it="""
        import pytest

        @pytest.mark.parametrize("it", ["a/../b", "é" * 5, "x" * 300, "x" * 301], ids=lambda it: it)
        def test_that_fails(twin, it):
            twin("md3")
            assert False
        """
    )
    pytester.runpytest_subprocess("--drivetwin-artifacts", "kept").assert_outcomes(failed=4)
    assert len(list((pytester.path / "kept").iterdir())) == 12


def test_different_tests_have_different_files(pytester):
    pytester.makepyfile(
        test_it="""
        import pytest

        @pytest.mark.parametrize("it", ["1", "-1", "a/b", "a-b", "2"], ids=lambda it: it)
        def test_c(twin, it):
            twin("md3")
            assert False

        class TestIt:
            def test_c(self, twin):
                twin("md3")
                twin.new_bench().add("md3")
                assert False
        """
    )
    pytester.runpytest_subprocess("--drivetwin-artifacts", "kept").assert_outcomes(failed=6)
    traces = {file.name for file in (pytester.path / "kept").glob("*.trace")}
    assert len(traces) == 7
    plain = {"test_it.py-TestIt-test_c.trace", "test_it.py-TestIt-test_c-2.trace"}
    hashed = [re.fullmatch(r"test_it\.py-test_c-(1|a-b|2)--?[0-9a-f]{8}\.trace", name) for name in traces - plain]
    assert len(hashed) == 5 and all(hashed)


def test_waveforms_that_are_too_long_are_left_out(pytester):
    pytester.makepyfile(
        test_it="""
        def test_that_fails(twin):
            x = twin("md3", fast_boot=True, set={"Speed": 40_000})
            x.registers["MotionControl"] = 2  # jog forward
            x.bench.advance(100_000)
            assert False
        """
    )
    result = pytester.runpytest_subprocess("--drivetwin-artifacts", "kept")
    result.assert_outcomes(failed=1)
    base = "test_it.py-test_that_fails"
    assert {file.name for file in (pytester.path / "kept").iterdir()} == {base + ".trace", base + ".pcapng"}
    result.stdout.fnmatch_lines(
        ["the bench was at 100000.* s; replay: *", f"there is no {base}.vcd: the waveforms have more than 256 MiB; *"]
    )


def test_a_bench_with_ports_ends_with_its_test(pytester):
    pytester.makepyfile(
        """
        import pytest, drivetwin
        kept = []

        def test_makes(twin):
            kept.append(twin.run("md3", time="manual"))
            assert twin.bench == kept[0] and kept[0]["md3"].uri().startswith("tcp:127.0.0.1:")
            kept[0].advance(1.5)
            assert False

        def test_sees_the_end(twin):
            with pytest.raises(drivetwin.Error, match="^the bench is closed$"):
                kept[0].now
        """
    )
    result = pytester.runpytest_subprocess("--drivetwin-artifacts", "kept")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["the bench was at 1.5 s; replay: *"])
    assert len(list((pytester.path / "kept").iterdir())) == 3
