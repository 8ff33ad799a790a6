"""The pytest plugin: drives for a test, and what happened to them when it failed.

The fixture `twin` makes drives on one bench of virtual time, which ends with the test:

    def test_a_move(twin):
        x = twin("md3", fast_boot=True)
        x.registers["MotionControl"] = 1
        twin.bench.advance(2.5)
        assert x.motion.position == 10_000

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


_TWIN: "pytest.StashKey[Twin]" = pytest.StashKey()


@pytest.fixture
def twin(request):
    """A factory of drives on virtual time: `drive = twin("md3", fast_boot=True)`; `twin.bench` is their bench."""
    made = Twin()
    request.node.stash[_TWIN] = made
    yield made
    made.close()


def pytest_addoption(parser):
    """Adds the option."""
    parser.getgroup("drivetwin").addoption(
        "--drivetwin-artifacts",
        metavar="DIR",
        help="write what happened on the bench of a test that fails to DIR: .trace, .vcd and .pcapng, named after the test",
    )


def pytest_configure(config):
    """Makes the folder absolute, as other processes of pytest-xdist may have another working folder."""
    folder = config.getoption("drivetwin_artifacts")
    if folder is not None:
        config.option.drivetwin_artifacts = os.path.abspath(folder)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item):
    """Adds to the report of a failure how to see what happened."""
    outcome = yield
    report = outcome.get_result()
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
