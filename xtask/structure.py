#!/usr/bin/env python3
"""Structure of a drive: structs, their methods, calls from file to file, cycles, visibility, lines.

Usage: structure.py FOLDER..., for example firmware/src/mdrive; `cargo xtask structure` passes the drives. Tests are left
out: folders and files named
`tests`, and `#[cfg(test)]` modules.
"""
import re
import sys
from collections import defaultdict
from pathlib import Path

IMPL = re.compile(r"^impl(?:<[^{]*?>)?\s+(?:(?:[\w:]+(?:<[^{]*>)?)\s+for\s+)?([A-Z]\w*)(?:<[^{]*>)?\s*(?:where[^{]*)?\{", re.M)
STRUCT = re.compile(r"^(?:pub(?:\([^)]*\))?\s+)?struct\s+(\w+)(?:<[^{;(]*>)?\s*\{", re.M)
VISIBLE_FIELD = re.compile(r"^    pub\((?:super|in [^)]*)\) \w+:", re.M)
FN = re.compile(r"^    (?:pub(?:\([^)]*\))?\s+)?(?:const\s+)?(?:unsafe\s+)?fn\s+(\w+)", re.M)
SELF_CALL = re.compile(r"(?:\bself|\bSelf)\s*(?:\.|::)\s*(\w+)\s*\(")
# In `modbus`, the drive is a field of what the server sees.
CODE_TOKEN = re.compile(r'"(?:\\.|[^"\\])*"|b?\'(?:\\.|[^\'\\])\'|//[^\n]*|/\*.*?\*/', re.S)


def blank_strings_and_comments(text):
    def blank(match):
        token = match.group()
        if token.startswith("//") or token.startswith("/*"):
            return re.sub(r"[^\n]", " ", token)
        return token[0] + re.sub(r"[^\n]", "_", token[1:-1]) + token[-1]
    return CODE_TOKEN.sub(blank, text)


def block_end(text, begin):
    depth = 0
    for i in range(begin, len(text)):
        if text[i] == "{":
            depth += 1
        elif text[i] == "}":
            depth -= 1
            if depth == 0:
                return i + 1
    return len(text)


def without_test_modules(text):
    while match := re.search(r"#\[cfg\(test\)\]\s*(?:pub(?:\([^)]*\))?\s+)?mod \w+\s*(\{|;)", text):
        end = block_end(text, match.end() - 1) if match.group(1) == "{" else match.end()
        text = text[:match.start()] + text[end:]
    return text


def strongly_connected(nodes, edges):
    """Tarjan, largest component first."""
    index, low, stack, found = {}, {}, [], []

    def visit(v):
        index[v] = low[v] = len(index)
        stack.append(v)
        for w in edges[v]:
            if w not in index:
                visit(w)
                low[v] = min(low[v], low[w])
            elif w in stack:
                low[v] = min(low[v], index[w])
        if low[v] == index[v]:
            part = []
            while True:
                part.append(stack.pop())
                if part[-1] == v:
                    break
            found.append(part)
    for v in nodes:
        if v not in index:
            visit(v)
    return max(found, key=len, default=[])


def measure(folder):
    folder = Path(folder)
    files = [p for p in sorted(folder.rglob("*.rs")) if "tests" not in p.parts and p.name != "tests.rs"]
    bodies = defaultdict(lambda: defaultdict(list))  # struct -> file -> [(method, body)]
    fields = {}  # struct -> number of visible fields
    lines = pub_super = pub_in = 0
    for path in files:
        text = without_test_modules(blank_strings_and_comments(path.read_text()))
        name = str(path.relative_to(folder))
        lines += sum(1 for line in text.splitlines() if line.strip())
        pub_super += text.count("pub(super)")
        pub_in += text.count("pub(in")
        for struct in STRUCT.finditer(text):
            fields[struct.group(1)] = len(VISIBLE_FIELD.findall(text[struct.end():block_end(text, struct.end() - 1)]))
        for impl in IMPL.finditer(text):
            body = text[impl.end() - 1:block_end(text, impl.end() - 1)]
            fns = list(FN.finditer(body))
            for fn, after in zip(fns, fns[1:] + [None]):
                bodies[impl.group(1)][name].append((fn.group(1), body[fn.start():after.start() if after else None]))
            if not fns:
                bodies[impl.group(1)][name]
    print(f"{folder}: {len(files)} files, {lines} lines of code, pub(super) {pub_super}, pub(in {pub_in}, "
          f"{sum(n for struct, n in fields.items() if struct in bodies)} visible fields of structs with methods")
    print(f"  {'struct':<22}{'methods':>8}{'files':>6}{'edges':>6}{'cycle':>6}")
    rows = []
    for struct, by_file in bodies.items():
        home = {method: file for file, fns in by_file.items() for method, _ in fns}
        edges = {file: set() for file in by_file}
        for file, fns in by_file.items():
            for _, body in fns:
                for called in SELF_CALL.findall(body):
                    if home.get(called, file) != file:
                        edges[file].add(home[called])
        cycle = strongly_connected(list(by_file), edges)
        count = sum(len(fns) for fns in by_file.values())
        rows.append((count, struct, len(by_file), sum(map(len, edges.values())), cycle if len(cycle) > 1 else []))
    for count, struct, number, edge, cycle in sorted(rows, reverse=True):
        if count >= 10 or cycle or number > 2:
            print(f"  {struct:<22}{count:>8}{number:>6}{edge:>6}{len(cycle):>6}  {' '.join(sorted(cycle))}")


for argument in sys.argv[1:] or ["firmware/src/mdrive"]:
    measure(argument)
