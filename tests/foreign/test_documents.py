"""Every command in a Markdown file does what the file shows. `documents.py` has the rules."""

import json
import os
import re
import select
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request

import pytest

import documents
from conftest import PATIENCE
from documents import ROOT, Names, Wrong

NEEDED = ("bash", "curl", "mbpoll", "python3")


class Page:
    """A page whose blocks are run one after the other."""

    def __init__(self, folder):
        self.folder = folder
        self.names = Names()
        # The drive, and commands beside it that do not end.
        self.processes = []
        self.control = None
        self.ran = 0
        for entry in ROOT.iterdir():
            if entry.name not in ("target", ".git"):
                (folder / entry.name).symlink_to(entry)
        programs = folder / ".programs"
        programs.mkdir()
        (programs / "drivetwin").symlink_to(os.path.abspath(os.environ["DRIVETWIN"]))
        # The environment of the tests has the packages that pages use.
        packages = os.path.dirname(sys.executable)
        environment = {name: value for name, value in os.environ.items() if name != "DRIVETWIN"}
        path = f"{programs}:{packages}:{os.environ['PATH']}"
        self.environment = {**environment, "PATH": path, "HOME": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}

    def take(self, block):
        """Runs a block."""
        if "norun" in block.settings:
            return
        if name := block.settings.get("file"):
            path = self.folder / name
            assert path.parent == self.folder and not path.is_symlink(), f"{block.place}: {name} is a file already"
            path.write_text(self.names.put(block.text))
        if not block.has_commands:
            return
        commands = block.commands()
        if {"run", "stop"} & block.options:
            self.stop()
        if "run" in block.options:
            ((command, printed),) = commands
            self.start(block, command, printed)
        elif "endless" in block.options:
            for command, printed in commands:
                self.follow(block, command, printed)
        else:
            for place, (command, printed) in enumerate(commands):
                may_fail = "fails" in block.options and place == len(commands) - 1
                self.command(block, command, printed, may_fail)
        self.ran += len(commands)

    def shell(self, command):
        """A command as this machine runs it."""
        return self.names.put(command.replace("cargo run --release -- ", "drivetwin "))

    def command(self, block, command, printed, may_fail):
        """Runs a command to its end and compares what it prints."""
        deadline = time.monotonic() + PATIENCE
        while True:
            self.notice()
            done = subprocess.run(
                ["bash", "-c", self.shell(command)],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                timeout=2 * PATIENCE,
                text=True,
            )
            is_right = self.names.match(printed, done.stdout) and (done.returncode != 0) == may_fail
            if is_right or "again" not in block.options or time.monotonic() > deadline:
                break
        shown = "\n".join(printed)
        assert is_right, (
            f"{block.place}: `{command}` ends with {done.returncode} and prints\n{done.stdout}\nnot\n{shown}"
        )

    def start(self, block, command, printed):
        """Starts a drive, and waits for what it prints and until it has started."""
        for address in re.findall(r"127\.0\.0\.1:([1-9]\d+)", command):
            with socket.create_server(("127.0.0.1", 0)) as free:
                self.names.learn(f"127.0.0.1:{address}", f"127.0.0.1:{free.getsockname()[1]}")
        # Names of an earlier program mean nothing now, unless the command gives them.
        self.names.here = {
            name: here
            for name, here in self.names.here.items()
            if re.search(rf"(?<!\d){re.escape(name)}(?!\d)", command)
        }
        out = self.follow(block, command, printed)
        control = re.search(r"http://[\d.]+:\d+", out)
        self.control = control and control[0]
        self.wait_for_start(command)

    def follow(self, block, command, printed):
        """Begins a command that does not end; returns its output once that is what the page shows."""
        process = subprocess.Popen(
            ["bash", "-c", "exec " + self.shell(command)],
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        self.processes.append(process)
        out, deadline = b"", time.monotonic() + PATIENCE
        while not self.names.match(printed, out.decode(errors="replace")):
            left = deadline - time.monotonic()
            readable, _, _ = select.select([process.stdout], [], [], max(left, 0))
            piece = os.read(process.stdout.fileno(), 4096) if readable else b""
            assert piece, f"{block.place}: `{command}` prints\n{out.decode()}\nnot\n" + "\n".join(printed)
            out += piece
        return out.decode(errors="replace")

    def wait_for_start(self, command):
        """Waits until the drives have started, as a reader of the page would."""
        if self.control is None or "--time manual" in command:
            return
        while self.bench()["time"]["seconds"] < 3:
            assert self.processes[0].poll() is None

    def notice(self):
        """Returns when the program has noticed that a client has left (see `Drivetwin.notice`)."""
        if self.control:
            for _ in range(3):
                self.bench()

    def bench(self):
        with urllib.request.urlopen(self.control + "/api/bench", timeout=PATIENCE) as answer:
            return json.load(answer)

    def stop(self):
        """Ends what runs, as Ctrl-C does."""
        for process in self.processes[:1]:
            os.killpg(process.pid, signal.SIGINT)
            assert process.wait(PATIENCE) == 0
        self.kill()
        self.control = None

    def kill(self):
        for process in self.processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            process.stdout.close()
        self.processes.clear()


def blocks(page):
    return documents.blocks(page, (ROOT / page).read_text())


@pytest.mark.parametrize("page", documents.pages())
def test_a_page_shows_what_its_commands_print(page, tmp_path, record_property):
    found = blocks(page)
    marked = [(block.place, block.settings["norun"]) for block in found if "norun" in block.settings]
    record_property("marked", marked)
    if not any(block.has_commands and "norun" not in block.settings for block in found):
        return
    for program in NEEDED:
        assert shutil.which(program), f"{program} is missing"
    run = Page(tmp_path)
    try:
        for block in found:
            run.take(block)
        run.stop()
    finally:
        run.kill()
    record_property("ran", run.ran)


def test_every_call_of_the_api_is_on_its_page(run):
    drivetwin = run("--time", "manual")
    calls = {
        f"{method.upper()} {path}"
        for path, methods in drivetwin.call("GET", "/openapi.json")["paths"].items()
        for method in methods
    }
    page = (ROOT / "docs/reference/control-api.md").read_text()
    # What a browser shows and what describes the calls is no call.
    others = {"GET /", "GET /openapi.json"}
    assert set(re.findall(r"`((?:GET|PUT|POST|DELETE) /[^`?]*)`", page)) - others == calls


def text(*lines):
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    "page, why",
    [
        (text("```sh", "ls", "```"), "has no output; use `console`"),
        (text("", "    cargo test"), "has no info string; make it a fence"),
        (text("```console nowrun=x", "$ ls", "```"), "which nothing here knows"),
        (text("```console norun=", "$ ls", "```"), "which nothing here knows"),
        (text("```console", "ls", "```"), "does not begin with a command"),
        (text("```console", "$ ls"), "the fence has no end"),
        (text("```text", "$ ls", "```"), "commands are in a `console` block"),
        (text("```", "ls", "```"), "the fence says no language"),
    ],
)
def test_a_block_that_would_not_be_run_is_refused(page, why):
    with pytest.raises(Wrong, match=re.escape(why)):
        for block in documents.blocks("page.md", page):
            block.commands()


@pytest.mark.parametrize(
    "page",
    [
        text("```console", "$ echo one", "two", "```"),
        text("```console", "$ echo one", "```"),
        text("```console", "$ false", "```"),
        text("```console fails", "$ true", "```"),
        text("```console", "$ printf 'one\\ntwo\\n'", "one", "```"),
        text("```console run", "$ drivetwin run md3", "md4: ...", "```"),
    ],
)
def test_a_page_that_shows_something_else_fails(page, tmp_path, monkeypatch):
    monkeypatch.setattr("test_documents.PATIENCE", 1)
    run = Page(tmp_path)
    with pytest.raises(AssertionError, match="page.md:1"):
        try:
            for block in documents.blocks("page.md", page):
                run.take(block)
        finally:
            run.kill()


def test_names_of_a_page_are_those_of_this_machine():
    names = Names()
    assert names.match(["  pty:/dev/pts/4", "...", "at 127.0.0.1:4001"], "  pty:/dev/pts/17\none\ntwo\nat 127.0.0.1:38211\n")
    assert names.put("mbpoll -p 4001 /dev/pts/4, not /dev/pts/41") == "mbpoll -p 38211 /dev/pts/17, not /dev/pts/41"
    assert names.match(["/dev/pts/4 ... end"], "/dev/pts/17 is the end\n")
    assert not names.match(["/dev/pts/4"], "/dev/pts/18\n")
