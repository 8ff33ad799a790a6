"""The type stubs: they name what is there, and nothing else; and all of it is documented."""

import ast
import re
import subprocess
import sys
from pathlib import Path

from test_command import COMMAND

import drivetwin

STUB = ast.parse((Path(drivetwin.__file__).parent / "__init__.pyi").read_text(encoding="utf-8"))
OPERATORS = {f"__{name}__" for name in "getitem contains len iter enter exit".split()}
# Python gives every class all of these, or none.
UNSURE = {"__new__", "__setitem__", "__delitem__"}


def members(body):
    """Names of a module or class, and the nodes of its functions."""
    found = {}
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found[node.name] = node
        elif isinstance(node, ast.AnnAssign):
            found[node.target.id] = node
    return found


def test_the_stubs_name_what_is_there():
    stubs = members(STUB.body)
    imported = {name.asname for node in STUB.body if isinstance(node, ast.ImportFrom) for name in node.names}
    public = {name for name in (*stubs, *imported) if name and not name.startswith("_")}
    assert public == set(drivetwin.__all__)
    for name, stub in stubs.items():
        if isinstance(stub, ast.ClassDef):
            real = getattr(drivetwin, name)
            there = {member for member in vars(real) if not member.startswith("__") or member in OPERATORS}
            assert there == set(members(stub.body)) - UNSURE, name


USE = """
import drivetwin

bench = drivetwin.Bench(seed=2)
x = bench.add("md3", name="x", set={"Speed": 8000})
x.registers["Speed"] += 5
speed: int = x.registers["Speed"]
words: list[int] = x.registers["UserRegister"]
level: str = bench["x"].pins["J2.3"]
with drivetwin.run("md3", time="manual", control=False) as rack:
    reply: bytes = rack["md3"].ask(b"")
"""

WRONG_USE = """
import drivetwin

drivetwin.Bench()["x"].registers["Speed"] = 2.5
"""


def test_a_program_passes_the_checker_of_types(tmp_path):
    for program, code in (USE, 0), (WRONG_USE, 1):
        file = tmp_path / "use.py"
        file.write_text(program)
        command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", tmp_path / "cache", file]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == code, done.stdout + done.stderr
        assert code == 0 or "use.py:4: error: Incompatible types in assignment" in done.stdout


def test_the_stubs_have_the_arguments_of_the_package(tmp_path):
    settings = tmp_path / "mypy.ini"
    settings.write_text("[mypy]\nignore_missing_imports = True\nfollow_imports = silent\n")
    # Their base classes are of pyserial, which has no types.
    allowed = tmp_path / "allowed"
    modules = ("protocol_drivetwin", "protocol_drivetwin_rfc2217")
    allowed.write_text("".join(f"drivetwin.urlhandler.{module}.Serial\n" for module in modules))
    options = ["--mypy-config-file", settings, "--allowlist", allowed]
    command = [sys.executable, "-m", "mypy.stubtest", "drivetwin", *options]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


def test_everything_has_a_docstring():
    for name in drivetwin.__all__:
        real = getattr(drivetwin, name)
        assert real.__doc__, name
        if isinstance(real, type):
            for member, value in vars(real).items():
                assert member.startswith("_") or value.__doc__, f"{name}.{member}"


def test_run_has_every_option_of_the_command():
    usage = subprocess.run([COMMAND, "run", "--help"], capture_output=True, text=True).stdout
    options = {option.replace("-", "_") for option in re.findall(r"^ +(?:-\w, )?--([a-z-]+)", usage, re.MULTILINE)}
    run = members(STUB.body)["run"]
    # The command's own: what it prints, and what it shows in the terminal.
    assert options - {"json", "help", "verbose", "quiet", "view"} == {argument.arg for argument in run.args.kwonlyargs}
