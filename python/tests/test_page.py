"""The page of the documentation for Python: its files, and what they print."""

import re
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs/how-to/python.md"


def test_the_page_is_right(tmp_path):
    text = PAGE.read_text(encoding="utf-8")
    files = dict(re.findall(r"```python file=(\S+)\n(.*?)```", text, re.DOTALL))
    assert set(files) == {"test_axis.py", "test_master.py", "try.py", "ports.py"}
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    # Everything but blank lines counts.
    assert len([line for line in files["test_axis.py"].splitlines() if line]) < 40

    def run(*command):
        done = subprocess.run([sys.executable, "-B", *command], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    for file in "try.py", "ports.py":
        printed = re.search(rf"\$ python {file}\n(.*?)```", text, re.DOTALL).group(1)
        assert run(file) == printed
    for file, passed in ("test_axis.py", "2 passed"), ("test_master.py", "1 passed"):
        assert passed in run("-m", "pytest", "-q", "-p", "no:cacheprovider", file)
