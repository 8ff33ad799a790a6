"""The command `drivetwin` of the wheel."""

import json
import os
import signal
import subprocess
import sys

import drivetwin

COMMAND = os.path.join(os.path.dirname(sys.executable), "drivetwin")


def run(*arguments, **options):
    return subprocess.run([COMMAND, *arguments], capture_output=True, text=True, **options)


def test_it_lists_the_kinds():
    done = run("list", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert [kind["kind"] for kind in json.loads(done.stdout)] == drivetwin.kinds()
    assert run("--version").stdout == f"drivetwin {drivetwin.__version__}\n"


def test_bad_usage_is_a_sentence_and_exit_code_2():
    done = run("run", "md4")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "drivetwin: there is no kind 'md4'; the nearest is 'md3'\n"


def test_a_recording_of_a_bench_replays(tmp_path):
    with drivetwin.Bench() as bench:
        bench.add("md3", fast_boot=True).registers["MotionControl"] = 1
        bench.advance(3.0)
        trace = bench.trace()
    file = tmp_path / "x.trace"
    file.write_text(trace)
    assert run("replay", str(file)).returncode == 0
    file.write_text(trace.replace("poke MotionControl 1", "poke MotionControl 2"))
    assert "poke MotionControl 1" in trace and run("replay", str(file)).returncode == 1


def served(*arguments):
    process = subprocess.Popen(
        [COMMAND, "run", "md3", "--json", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    return process, json.loads(process.stdout.readline())


def test_signals_end_a_run_as_they_end_the_binary(tmp_path):
    for number in signal.SIGINT, signal.SIGTERM:
        memory = tmp_path / f"{number}.nv"
        process, ready = served("--nv", str(memory), "--record", str(tmp_path / "x.trace"))
        assert ready["devices"][0]["ports"]["rs485"]
        process.send_signal(number)
        out, said = process.communicate(timeout=10)
        assert (process.returncode, out, said) == (0, "", "")
        assert run("replay", str(tmp_path / "x.trace")).returncode == 0


def test_a_closed_pipe_is_no_error():
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([COMMAND, "describe", "mdrive"], stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")
