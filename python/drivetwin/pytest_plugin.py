"""The pytest plugin: drives for a test, and what happened to them when it failed.

The fixture `twin` makes drives on one bench of virtual time, which ends with the test:

    def test_a_move(twin):
        x = twin("md3", fast_boot=True)
        x.registers["MotionControl"] = 1
        twin.bench.advance(2.5)
        assert x.motion.position == 10_000

With `--drivetwin-board DEVICE` the same tests run on a board: `twin` makes its drive a new one, with an erased memory, without
causes of faults and stimuli at its pins, and with the registers of `set` and `address`. A test that needs what a board
cannot do, above all virtual time, is skipped, and the report says why. `twin.bench.wait(2.5)` lets time pass on both.

With `--drivetwin-artifacts DIR`, a test that fails leaves its recording there: `.trace` for `drivetwin replay`, `.vcd` for
GTKWave and `.pcapng` for Wireshark.
"""

import hashlib
import os
import re
import shlex

import pytest

import drivetwin

_LONGEST_NAME = 150
"""Characters of a file's name: that of a parametrised test may be longer than a file system takes."""


_START_UP = 3.0
"""Seconds after which every drive on a board has started."""


class Twin:
    """Makes drives and benches that end with the test."""

    def __init__(self):
        self.benches = []
        self._bench = None

    def __call__(self, kind, name=None, **options):
        """Adds a drive to the bench of the test, with the options of `Bench.add`."""
        return self.bench.add(kind, name, **options)

    @property
    def bench(self):
        """The bench of the test."""
        if self._bench is None:
            self._bench = self.new_bench()
        return self._bench

    def new_bench(self, **options):
        """Another bench, with the options of `Bench`. The first one becomes the bench of the test."""
        return self._keep(drivetwin.Bench(**options))

    def load(self, path):
        """A bench from a bench file. The first one becomes the bench of the test."""
        return self._keep(drivetwin.Bench.load(path))

    def loads(self, text):
        """A bench from the text of a bench file. The first one becomes the bench of the test."""
        return self._keep(drivetwin.Bench.loads(text))

    def run(self, what, **options):
        """A bench with ports, as `drivetwin.run` makes it. The first bench becomes that of the test."""
        return self._keep(drivetwin.run(what, **options))

    def _keep(self, bench):
        self.benches.append(bench)
        if self._bench is None:
            self._bench = bench
        return bench

    def close(self):
        """Ends all benches."""
        for bench in self.benches:
            bench.close()


class BoardTwin(Twin):
    """Makes the drive of a board a new one for each test."""

    def __init__(self, board):
        super().__init__()
        self._keep(board)
        self._is_used = False

    def __call__(self, kind, name=None, *, fast_boot=False, address=None, set=None, **options):
        """Makes the board a new drive of this kind. Its name is "board"."""
        for option, value in options.items():
            if value is not None:
                raise drivetwin.NotOnBoard(f"a board takes no {option}")
        if self._is_used:
            raise drivetwin.NotOnBoard("a board is one drive")
        self._is_used = True
        drive = self._bench._begin_anew(kind, address, set)
        if fast_boot and not self._bench._boots_fast():
            self._bench.wait(_START_UP)
        return drive

    def new_bench(self, **options):
        """A board has no other bench."""
        raise drivetwin.NotOnBoard("the drives of another bench are emulated")

    def load(self, path):
        """A board has no bench file."""
        raise drivetwin.NotOnBoard("the drives of a bench file are emulated")

    loads = load

    def run(self, what, **options):
        """A board runs by itself."""
        raise drivetwin.NotOnBoard("drivetwin.run emulates its drives")

    def close(self):
        """The board stays attached until the last test."""


_TWIN: "pytest.StashKey[Twin]" = pytest.StashKey()
_BOARD: "pytest.StashKey[drivetwin.Bench]" = pytest.StashKey()


@pytest.fixture
def twin(request):
    """A factory of drives on virtual time: `drive = twin("md3", fast_boot=True)`; `twin.bench` is their bench."""
    made = _on_board(request.config) or Twin()
    request.node.stash[_TWIN] = made
    yield made
    made.close()


def _on_board(config):
    """A factory for the board of the option; None without the option."""
    device = config.getoption("drivetwin_board")
    if device is None:
        return None
    if config.stash.get(_BOARD, None) is None:
        bus = config.getoption("drivetwin_bus")
        config.stash[_BOARD] = drivetwin.attach(None if device == "usb" else device, bus=bus, control=False)
    return BoardTwin(config.stash[_BOARD])


def pytest_unconfigure(config):
    """Lets the board go."""
    board = config.stash.get(_BOARD, None)
    if board is not None:
        board.close()


def pytest_addoption(parser):
    """Adds the options."""
    group = parser.getgroup("drivetwin")
    group.addoption(
        "--drivetwin-board",
        metavar="DEVICE",
        help="run the tests on a board: the path of its control port, usb:SERIAL, tcp:HOST:PORT, or usb for the only one "
        "that is plugged in",
    )
    group.addoption(
        "--drivetwin-bus",
        metavar="URI",
        help="address of the bus of the board, if it is not at the same USB cable: tcp:HOST:PORT or rfc2217:HOST:PORT",
    )
    group.addoption(
        "--drivetwin-artifacts",
        metavar="DIR",
        help="write what happened on the bench of a test that fails to DIR: .trace, .vcd and .pcapng, named after the test",
    )


def pytest_configure(config):
    """Makes the folder absolute, as other processes of pytest-xdist may have another working folder."""
    if config.getoption("drivetwin_board") is not None and getattr(config.option, "numprocesses", None):
        raise pytest.UsageError("--drivetwin-board: a board runs one test after the other; leave out -n")
    folder = config.getoption("drivetwin_artifacts")
    if folder is not None:
        config.option.drivetwin_artifacts = os.path.abspath(folder)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    """Adds to the report of a failure how to see what happened. On a board, a test that needs a bench is skipped."""
    outcome = yield
    report = outcome.get_result()
    if item.config.getoption("drivetwin_board") is not None and call.excinfo is not None:
        if call.excinfo.errisinstance(drivetwin.NotOnBoard):
            path, line, _ = item.location
            report.outcome = "skipped"
            report.longrepr = (path, (line or 0) + 1, f"Skipped: not on a board: {call.excinfo.value}")
    made = item.stash.get(_TWIN, None)
    if report.failed and report.when != "teardown" and made is not None and made.benches:
        lines = _keep_artifacts(item.nodeid, made.benches, item.config.getoption("drivetwin_artifacts"))
        report.sections.append(("drivetwin", "\n".join(lines)))


def _keep_artifacts(test, benches, folder):
    """Writes the files, and says in lines how to use them."""
    lines = []
    for number, bench in enumerate(benches, 1):
        try:
            at = bench.now
            if folder is None:
                lines.append(f"the bench was at {at} s; --drivetwin-artifacts DIR keeps its recording for `drivetwin replay`")
                continue
            base = os.path.join(folder, _file_name(test) + (f"-{number}" if number > 1 else ""))
            os.makedirs(folder, exist_ok=True)
            _write(base + ".trace", bench.trace().encode())
            lines.append(f"the bench was at {at} s; replay: drivetwin replay {shlex.quote(base + '.trace')}")
            _write(base + ".pcapng", bench.pcapng())
            try:
                _write(base + ".vcd", bench.vcd())
            except drivetwin.Error as error:
                lines.append(f"there is no {os.path.basename(base)}.vcd: {error}")
        except (drivetwin.Error, OSError) as error:
            lines.append(f"the recording of the bench cannot be kept: {error}")
    return lines


def _write(path, content):
    with open(path, "wb") as file:
        file.write(content)


def _file_name(test):
    """A file name for a test."""
    name = re.sub(r"[^A-Za-z0-9_.]+", "-", test).strip("-")
    # Tests of different names have different files: what is not the plain name of a file and of a function has a hash.
    if len(name) > _LONGEST_NAME or not re.fullmatch(r"([A-Za-z0-9_.]+/)*[A-Za-z0-9_.]+(::[A-Za-z0-9_.]+)+", test):
        name = f"{name[:_LONGEST_NAME]}-{hashlib.sha256(test.encode()).hexdigest()[:8]}"
    return name
