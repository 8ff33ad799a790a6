"""The commands in the project's Markdown files, and what they print.

A fence says by its info string what becomes of its block:

- `console`: each line that begins with `$ ` is a command for bash (`> ` continues it); the lines below are what it
  prints, stderr included. A line `...` stands for any lines, `...` within a line for any characters.
- `console run`: the one command of the block does not end. What it prints first is compared, then it goes on until the
  next block with `run` or `stop`, or to the end of the page.
- `console endless`: commands that do not end either, beside it; what they print first is compared.
- `console stop`: first ends, as Ctrl-C does, what a `run` started.
- `console fails`: the last command ends with another exit code than 0.
- `console again`: each command is repeated until it prints what is there: something is waited for.
- `toml file=NAME` (any language): the block is written to that file first.
- `console norun="REASON"`: shown and not run, with the reason. They are counted.

Commands run in a folder of the page's own, in which the files of the repository are found by their names.
`cargo run --release -- ` and `drivetwin` mean the program that is tested. Ports and ptys that a page names are examples:
each stands for what the program has on this machine, in all later blocks of the page.
"""

import os
import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

SHELL = {"console", "sh", "bash", "shell", "zsh"}
"""Languages of fences with commands. All but the first are refused: input and output must be apart."""

OPTIONS = {"run", "endless", "stop", "fails", "again"}


@dataclass
class Block:
    """A fenced block."""

    page: str
    line: int
    language: str
    options: set = field(default_factory=set)
    settings: dict = field(default_factory=dict)
    text: str = ""

    @property
    def place(self):
        return f"{self.page}:{self.line}"

    @property
    def has_commands(self):
        return self.language in SHELL

    def commands(self):
        """Each command of the block with what it prints."""
        commands = []
        for line in self.text.splitlines():
            if line.startswith("$ "):
                commands.append([line[2:], []])
            elif not commands:
                raise Wrong(self, "the block does not begin with a command: `$ ...`")
            elif not commands[-1][1] and (commands[-1][0].endswith("\\") or line.startswith("> ")):
                commands[-1][0] += "\n" + line.removeprefix("> ")
            else:
                commands[-1][1].append(line)
        return [(command, printed) for command, printed in commands]


class Wrong(Exception):
    """A block that the page must not have."""

    def __init__(self, block, why):
        super().__init__(f"{block.place}: {why}")


def pages():
    """The Markdown files of the repository, by their paths in it."""
    found = []
    for folder, folders, files in os.walk(ROOT):
        folders[:] = [name for name in folders if name not in ("target", "node_modules", ".git", ".pytest_cache")]
        found += [str((Path(folder) / name).relative_to(ROOT)) for name in files if name.endswith(".md")]
    return sorted(found)


def blocks(page, text):
    """The fenced blocks of a page. Indented ones are refused: they have no info string."""
    found, open_fence, before, in_list = [], None, "", False
    for number, line in enumerate(text.splitlines(), 1):
        fence = re.match(r"( *)(`{3,}|~{3,})(.*)$", line)
        if open_fence:
            block, indent, marks = open_fence
            if fence and fence[2].startswith(marks) and not fence[3].strip():
                if not block.has_commands and re.search(r"^\$ ", block.text, re.MULTILINE):
                    raise Wrong(block, "commands are in a `console` block")
                found.append(block)
                open_fence = None
            else:
                block.text += (line[indent:] if not line[:indent].strip() else line) + "\n"
        elif fence:
            open_fence = (begin(page, number, fence[3].strip()), len(fence[1]), fence[2])
        else:
            if re.match(r" {0,3}([-*+]|\d+\.) ", line):
                in_list = True
            elif line.strip() and not line.startswith(" "):
                in_list = False
            if line.startswith("    ") and not before.strip() and not in_list:
                raise Wrong(Block(page, number, ""), "a block by indentation has no info string; make it a fence")
        before = line
    if open_fence:
        raise Wrong(open_fence[0], "the fence has no end")
    return found


def begin(page, number, info):
    """The block that a fence with this info string begins."""
    language, *words = shlex.split(info) or [""]
    block = Block(page, number, language)
    for word in words:
        name, is_setting, value = word.partition("=")
        if is_setting and name in ("norun", "file") and value:
            block.settings[name] = value
        elif word in OPTIONS and language == "console":
            block.options.add(word)
        else:
            raise Wrong(block, f"the info string has `{word}`, which nothing here knows")
    if block.has_commands and language != "console":
        raise Wrong(block, f"`{language}` has no output; use `console`, with `$ ` before each command")
    if not language:
        raise Wrong(block, "the fence says no language; `text` is one")
    return block


ADDRESS = r"/dev/pts/\d+|127\.0\.0\.1:[1-9]\d{3,4}"
"""Names that differ from run to run."""


class Names:
    """What the names of a page are on this machine."""

    def __init__(self):
        self.here = {}

    def learn(self, name, here):
        """Stores that the page's `name` is `here` now; for an address its port, too."""
        self.here[name] = here
        if name.startswith("127.0.0.1:"):
            self.here[name.rpartition(":")[2]] = here.rpartition(":")[2]

    def put(self, text):
        """The text with the names of this machine."""
        if not self.here:
            return text
        names = sorted(self.here, key=len, reverse=True)
        pattern = r"(?<![\w.])(" + "|".join(map(re.escape, names)) + r")(?!\w)"
        return re.sub(pattern, lambda found: self.here[found[1]], text)

    def pattern(self, line, groups):
        """A pattern for a line that is printed; names that are not known yet become `groups`."""
        out, place = "", 0
        for found in re.finditer(ADDRESS + r"|\.\.\.", line):
            out += re.escape(self.put(line[place : found.start()]))
            place = found.end()
            name = found[0]
            if name == "...":
                out += ".*"
            elif name in self.here:
                out += re.escape(self.here[name])
            elif name in groups.values():
                out += f"(?P={next(group for group, known in groups.items() if known == name)})"
            else:
                group = f"name{len(groups)}"
                groups[group] = name
                out += f"(?P<{group}>/dev/pts/\\d+|[\\d.]+:\\d+|\\d+)"
        return out + re.escape(self.put(line[place:]))

    def match(self, expected, printed):
        """Returns whether a text matches that of a page; learns names from it."""
        groups, pattern = {}, ""
        for line in expected:
            pattern += r"(?:[^\n]*\n)*?" if line.strip() == "..." else self.pattern(line.rstrip(), groups) + r"[ \t]*\n"
        found = re.fullmatch(pattern, printed.rstrip("\n") + "\n" if printed.strip() else "")
        if found is None:
            return False
        for group, name in groups.items():
            self.learn(name, found[group])
        return True
