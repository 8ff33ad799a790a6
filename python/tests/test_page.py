"""The page of the documentation for Python: its files, and what they print."""

import re
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
TEXT = (REPOSITORY / "docs/how-to/python.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"```python file=(\S+)\n(.*?)```", TEXT, re.DOTALL))


def test_the_examples_are_the_tests_of_the_page():
    # The check runs them, in an environment with the packages that the page names.
    examples = {file.name: file.read_text(encoding="utf-8") for file in (REPOSITORY / "examples/pytest").glob("*.py")}
    assert examples == {name: content for name, content in FILES.items() if name.startswith("test_")}
    assert len(examples) == 3
    # Everything but blank lines counts.
    assert len([line for line in FILES["test_axis.py"].splitlines() if line]) < 40


def test_the_programs_of_the_page_print_what_it_says(tmp_path):
    assert {name for name in FILES if not name.startswith("test_")} == {"try.py", "figure.py"}
    for name in "try.py", "figure.py":
        (tmp_path / name).write_text(FILES[name], encoding="utf-8")
        done = subprocess.run([sys.executable, "-B", name], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert done.stdout == re.search(rf"\$ python {name}\n(.*?)```", TEXT, re.DOTALL).group(1)
    assert (tmp_path / "move.png").read_bytes()[1:4] == b"PNG"
