"""A bench with ports, for masters that need them: `drivetwin run` in a thread of this process."""

from ._native import Bench


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
    return Bench._run(_arguments(what, options))


def _arguments(what, options):
    arguments = [str(what)]
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            arguments.append(option)
        elif isinstance(value, dict):
            arguments += [f"{option}={register}={_text(of)}" for register, of in value.items()]
        elif isinstance(value, (list, tuple)):
            arguments += [f"{option}={one}" for one in value]
        else:
            arguments.append(f"{option}={value}")
    return arguments


def _text(value):
    return ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
