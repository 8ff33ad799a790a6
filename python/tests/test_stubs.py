"""The type stubs: they name what is there, and nothing else; and all of it is documented."""

import ast
import re
import subprocess
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
    # The command's own: what it prints.
    assert options - {"json", "help", "verbose", "quiet"} == {argument.arg for argument in run.args.kwonlyargs}
