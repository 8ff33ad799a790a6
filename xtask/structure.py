#!/usr/bin/env python3
"""Structure of a drive: lines, visibility, structs, calls of their own methods from file to file, imports, cycles.

Usage: structure.py FOLDER..., for example firmware/src/mdrive; `cargo xtask structure` passes the drives. Tests are
left out: folders and files named `tests`, and `#[cfg(test)]` modules.

Calls: a call counts if a method calls a method of its own type as `self.method()` or `Self::method()`, and the two
are in different files. A call through a field, an argument or a path (`self.motion.order()`, `Move::of()`) does not
count, so no call from one type to another does. Types of one name are counted as one, and a method's name that is in
several files counts for the last of them. `edges` are pairs of files; `cycle` is the number of files in the largest
cycle of calls, and then their names. A type with less than ten methods, in one or two files and without a cycle, is
not printed.

Imports: a `use` of something of the same drive is an import of the file that defines it, also if another file
re-exports it. Paths in the code without `use` do not count, and a name behind an imported module (`use super::io;`,
then `io::Event`) counts for the file of the module. The `mod.rs` of a drive imports the drive, and has the constants
of the drive's pins, ports and faults, so each file that needs one of them can be in a cycle with it. Therefore the
cycles are also printed without the imports of `mod.rs`.
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
USE = re.compile(r"^[ \t]*(pub(?:\([^)]*\))?\s+)?use\s+([^;]+);", re.M)
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
    """The cycles: strongly connected components of more than one node, largest first, by Tarjan."""
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
    return sorted((sorted(part) for part in found if len(part) > 1), key=len, reverse=True)


def paths(tree):
    """The paths of a `use`, each as a list of names."""
    while group := re.search(r"([\w:]*)\{([^{}]*)\}", tree):
        items = ",".join(group[1] + item.strip() for item in group[2].split(",") if item.strip())
        tree = tree[:group.start()] + items + tree[group.end():]
    return [path.split(" as ")[0].strip().split("::") for path in tree.split(",")]


def imports(drive, texts):
    """The files that each file of a drive imports."""
    modules = {tuple(name.removesuffix(".rs").removesuffix("/mod").split("/")): name for name in texts}
    modules[()] = modules.pop(("mod",))
    uses = {module: [(use[1], path) for use in USE.finditer(texts[name]) for path in paths(use[2])]
            for module, name in modules.items()}

    def definition(module, path):
        if path[:2] == ["crate", drive]:
            module, path = (), path[2:]
        elif path[0] not in ("self", "super") or path[:len(module) + 1] == ["super"] * (len(module) + 1):
            return None
        for name in path:
            if name == "super":
                module = module[:-1]
            elif module + (name,) in modules:
                module += (name,)
            elif name != "self":
                exported = [other for public, other in uses[module] if public and other[-1] == name]
                return definition(module, exported[0]) if exported else modules[module]
        return modules[module]
    edges = {}
    for module, name in modules.items():
        body = USE.sub("", texts[name])
        # A file that re-exports a name need not use it.
        used = [path for public, path in uses[module] if not public or re.search(rf"\b{path[-1]}\b", body)]
        edges[name] = {definition(module, path) for path in used} - {None, name}
    return edges


def measure(folder):
    folder = Path(folder)
    files = [p for p in sorted(folder.rglob("*.rs")) if "tests" not in p.parts and p.name != "tests.rs"]
    bodies = defaultdict(lambda: defaultdict(list))  # struct -> file -> [(method, body)]
    fields = {}  # struct -> number of visible fields
    texts = {}
    lines = pub_super = pub_in = 0
    for path in files:
        text = without_test_modules(blank_strings_and_comments(path.read_text()))
        name = str(path.relative_to(folder))
        texts[name] = text
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
        cycle = next(iter(strongly_connected(list(by_file), edges)), [])
        count = sum(len(fns) for fns in by_file.values())
        rows.append((count, struct, len(by_file), sum(map(len, edges.values())), cycle))
    for count, struct, number, edge, cycle in sorted(rows, reverse=True):
        if count >= 10 or cycle or number > 2:
            print(f"  {struct:<22}{count:>8}{number:>6}{edge:>6}{len(cycle):>6}  {' '.join(cycle)}")

    edges = imports(folder.name, texts)
    below = {file: imported - {"mod.rs"} for file, imported in edges.items()}
    print(f"  imports from file to file: {sum(map(len, edges.values()))}")
    for title, graph in [("cycle of imports", edges), ("without the imports of mod.rs", below)]:
        for cycle in strongly_connected(list(graph), graph):
            print(f"  {title}: {len(cycle)} files: {' '.join(cycle)}")


for argument in sys.argv[1:] or ["firmware/src/mdrive"]:
    measure(argument)
