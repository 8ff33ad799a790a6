"""A bench with ports, for masters that need them: `drivetwin run` in a thread of this process."""

import atexit
import os

from ._native import Bench, end_runs

_FLAGS = {"fast_boot", "strict"}
_OF_THE_COMMAND = {"help", "json", "quiet", "verbose", "version"}
"""Options of what the command prints."""

# A bench that is not closed when the interpreter ends leaves whole files, and no pty.
atexit.register(end_runs)


def run(what, **options):
    """Runs a kind of drive, or a bench file, with ports and control API, which a thread of this process serves.

    Returns a `Bench` whose drives have addresses: `bench["md3"].uri("rs485")`, `bench["md3"].pty`, `bench.control`.
    `options` are those of `drivetwin run`, by their names: `time="manual"`, `line="fast"`, `fast_boot=True`, `address=2`,
    `set={"Speed": 8000}`, `listen=["tcp:127.0.0.1:5020", "pty:"]`. `with run(...) as bench:` ends it.

    In manual time only requests and calls of the bench move the clock. In real time, the default, calls that wait for
    bench time (`ask`, and `wait`, `settle`, `drain` of a port) take real time, and those that move the clock
    (`advance`, `run_until`) raise. Every call of the bench waits for its turn; in a coroutine use `asyncio.to_thread`
    for those that take long.
    """
    return Bench._run([_path(what, "run takes a kind or the path of a bench file"), *arguments(None, options, "run")])


def arguments(what, options, of):
    """Arguments of the command `of` for options by their names."""
    arguments = [] if what is None else [_path(what, f"{of} takes a string")]
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if name in _OF_THE_COMMAND:
            raise TypeError(f"{of} has no argument {name!r}: it prints nothing")
        if value is None:
            continue
        if name in _FLAGS:
            arguments += [option] if value else []
        elif value is False and name == "control":
            arguments.append(f"{option}=off")
        elif isinstance(value, bool):
            raise TypeError(f"{name} is no flag: it takes a value, not {value}")
        elif isinstance(value, dict):
            arguments += [f"{option}={register}={_text(of)}" for register, of in value.items()]
        elif isinstance(value, (list, tuple)):
            arguments += [f"{option}={_text(one)}" for one in value]
        else:
            arguments.append(f"{option}={_path(value, f'{name} takes a string')}")
    return arguments


def _path(value, what):
    """Text of an argument that may be a path."""
    if value is None or isinstance(value, (bytes, bytearray)):
        raise TypeError(f"{what}, not {value!r}")
    return str(os.fspath(value) if isinstance(value, os.PathLike) else value)


def _text(value):
    if isinstance(value, (list, tuple)):
        return ",".join(map(_text, value))
    # A flag in a register is 1 or 0.
    return str(int(value) if isinstance(value, bool) else value)
