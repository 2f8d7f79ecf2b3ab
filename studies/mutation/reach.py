"""Which tests run a line: the map, made once, and the tests of a mutant in the order in which they are tried."""

from __future__ import annotations

import ast
import difflib
import functools
import hashlib
import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypedDict

import coverage

from studies.mutation.mutants import PACKAGES, Mutant

#: Tests whose lines are recorded unless others are named: of these packages and of what stands on them.
RECORDED = (
    "tests/service", "tests/bus", "tests/engine", "tests/network", "tests/signals", "tests/cli", "tests/files", "tests/screen",
    "tests/web", "tests/export", "tests/field", "tests/trial", "tests/fleet", "tests/golden",
    "tests/docs/test_reference_pages.py",
)  # fmt: skip
#: Tests that look at what is declared at import as a whole: tables, defaults, ranges.
DECLARED = ("tests/service/test_configuration.py", "tests/docs/test_reference_pages.py")
MARKS = "not slow and not strace and not vcan and not systemd"
#: Code that a compiler takes elsewhere, which coverage does not see running.
_COMPILED = "compiled_"
#: Where fewer tests than this run a line, those of its module come behind them: what is kept between tests (a table read once)
#: was seen with the first that asked for it alone.
_FEW = 5
#: How far names are followed from a statement at import to the functions that read them.
_FOLLOWED = 3
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


class _About(TypedDict):
    """Beside the map: CPU seconds by test, and a digest by module."""

    cpu_s: dict[str, float]
    modules: dict[str, str]


def record(map_file: Path, tests: Iterable[str], workers: int, root: Path) -> int:
    """Runs tests with their lines recorded and adds these to the map; pytest's exit code."""
    for old in map_file.parent.glob(f"{map_file.name}.gw*"):
        old.unlink()
    options = ("-q", "-n", str(workers), "-p", "studies.mutation.recording", "-p", "no:cacheprovider", "-m", MARKS)
    environment = {**os.environ, "MUTATION_MAP": str(map_file)}
    words = (sys.executable, "-m", "pytest", *options, *(tests or RECORDED))
    status = subprocess.run(words, cwd=root, env=environment, check=False).returncode
    about = _about(map_file)
    data = coverage.CoverageData(basename=str(map_file))
    data.read()
    for part in sorted(map_file.parent.glob(f"{map_file.name}.gw*.part")):
        of_worker = coverage.CoverageData(basename=str(part))
        of_worker.read()
        data.update(of_worker)
        about["cpu_s"] |= json.loads(part.with_suffix(".json").read_text(encoding="utf-8"))
    data.write()
    # A second recording adds tests; lines are those of the first, as long as a module is the same.
    about["modules"] = {**{path: _digest(root / path) for path in modules(PACKAGES, root)}, **about["modules"]}
    _beside(map_file).write_text(json.dumps(about), encoding="utf-8")
    return status


def modules(packages: Iterable[str], root: Path) -> list[str]:
    """Paths of the packages' modules."""
    return [str(path.relative_to(root)) for package in packages for path in sorted((root / "yieldmon" / package).rglob("*.py"))]


def carry(map_file: Path, root: Path) -> list[str]:
    """Moves a map made of an earlier commit, and perhaps in another checkout, to the modules as they are; those it could not.

    A line that stayed keeps its tests. A line that is new has those of the lines that it replaced and of the two around them.
    """
    about = _about(map_file)
    data = coverage.CoverageData(basename=str(map_file))
    data.read()
    measured = {name: file for file in data.measured_files() for name in [file[file.index("/yieldmon/") + 1 :]]}
    by_test: dict[str, dict[str, set[int]]] = defaultdict(lambda: defaultdict(set))
    lost = []
    for path in modules(PACKAGES, root):
        lines: Mapping[int, Iterable[str]] = data.contexts_by_lineno(measured[path]) if path in measured else {}
        if about["modules"].get(path) not in (None, _digest(root / path)):
            before = _text_of(root, path, about["modules"][path])
            if before is None:
                lost.append(path)
                continue
            lines = _moved(lines, before, (root / path).read_text(encoding="utf-8"))
        about["modules"][path] = _digest(root / path)
        for line, tests in lines.items():
            for test in tests:
                by_test[test][str(root / path)].add(line)
    data.erase()
    moved = coverage.CoverageData(basename=str(map_file))
    for test, files in by_test.items():
        moved.set_context(test)
        moved.add_lines(files)
    moved.write()
    _beside(map_file).write_text(json.dumps(about), encoding="utf-8")
    return lost


def _text_of(root: Path, path: str, digest: str) -> str | None:
    """A module's text as it once was, from the history; None where no commit has it."""
    listed = subprocess.run(("git", "log", "--format=%H", "--", path), cwd=root, capture_output=True, text=True, check=True)
    for commit in listed.stdout.split():
        shown = subprocess.run(("git", "show", f"{commit}:{path}"), cwd=root, capture_output=True, check=False)
        if hashlib.sha256(shown.stdout).hexdigest()[:16] == digest:
            return shown.stdout.decode("utf-8")
    return None


def _moved(lines: Mapping[int, Iterable[str]], before: str, now: str) -> dict[int, set[str]]:
    matching = difflib.SequenceMatcher(None, before.splitlines(), now.splitlines(), autojunk=False)
    found: dict[int, set[str]] = {}
    for what, old, old_end, new, new_end in matching.get_opcodes():
        if what == "equal":
            found |= {new + i + 1: set(lines.get(old + i + 1, ())) for i in range(new_end - new)}
        else:
            around = {test for line in range(old, old_end + 2) for test in lines.get(line, ())} - {""}
            found |= {line + 1: set(around) for line in range(new, new_end)}
    return {line: tests for line, tests in found.items() if tests}


class Reach:
    """The map.

    Parameters: map_file, what `record` wrote; root, the checkout.
    """

    def __init__(self, map_file: Path, root: Path) -> None:
        self._root = root
        if not _beside(map_file).exists():
            raise SystemExit(f"{map_file}: no map; make one with: python -m studies.mutation record --map {map_file}")
        self._data = coverage.CoverageData(basename=str(map_file))
        self._data.read()
        about = _about(map_file)
        self.cpu_s: dict[str, float] = about["cpu_s"]
        self._digests: dict[str, str] = about["modules"]

    @functools.cache  # noqa: B019 - one for a run
    def _lines(self, path: str) -> dict[int, frozenset[str]]:
        by_line = self._data.contexts_by_lineno(str(self._root / path))
        return {line: frozenset(tests) for line, tests in by_line.items()}

    def tests(self, mutant: Mutant) -> list[str]:
        """Tests that run a mutant's lines in the order of trial: all that are named after the module, then one of each function
        of tests, those of its package before others and the quick ones before the slow, then the next one of each."""
        by_line = self._lines(mutant.path)
        whole = frozenset().union(*by_line.values()) - {""}
        changed = self._digests.get(mutant.path) != _digest(self._root / mutant.path)
        if changed or Path(mutant.path).stem.startswith(_COMPILED):
            at_import = statement_lines(self._root / mutant.path, mutant.at) is None
            return self._ordered(mutant.path, whole | (self._declared() if at_import else frozenset()), declared=at_import)
        reaching = self._reaching(mutant)
        found = self._ordered(mutant.path, reaching - {""}, declared="" in reaching)
        return found + self._ordered(mutant.path, whole - reaching) if reaching and len(found) < _FEW else found

    def _reaching(self, mutant: Mutant) -> frozenset[str]:
        """Tests that run it; "": it is run at import."""
        by_line = self._lines(mutant.path)
        spans = statement_lines(self._root / mutant.path, mutant.at)
        if spans is None:
            readers: frozenset[str] = frozenset()
            for path, line in readers_of(self._root, mutant.path, mutant.at[0]):
                readers |= self._lines(path).get(line, frozenset())
            return readers | {""} | self._declared()
        return frozenset().union(*(by_line.get(line, frozenset()) for line in range(spans[0], spans[1] + 1)))

    def _declared(self) -> frozenset[str]:
        """Tests of what is declared at import."""
        return frozenset(test for test in self.cpu_s if test.startswith(DECLARED))

    def _ordered(self, path: str, tests: Iterable[str], *, declared: bool = False) -> list[str]:
        present = {test for test in tests if (self._root / test.split("::", 1)[0]).exists()}
        part, name = path.split("/")[1], Path(path).stem
        groups: dict[str, list[str]] = defaultdict(list)
        for test in sorted(present, key=lambda test: self.cpu_s.get(test, 1.0)):
            groups[test.split("[", 1)[0]].append(test)

        def rank(group: str) -> tuple[bool, bool, float]:
            file = group.split("::", 1)[0]
            own = name in Path(file).stem or (declared and file in DECLARED)
            return not own, Path(file).parent.name != part, self.cpu_s.get(groups[group][0], 1.0)

        ranked = sorted(groups, key=rank)
        own = [group for group in ranked if not rank(group)[0]]
        others = ranked[len(own) :]
        depth = max((len(groups[group]) for group in others), default=0)
        return [
            *(test for group in own for test in groups[group]),
            *(groups[group][place] for place in range(depth) for group in others if place < len(groups[group])),
        ]

    def unreached(self, path: str) -> list[tuple[str, int]]:
        """Functions of a module with lines that no test runs, and how many statements: `[("Class.method", 3)]`."""
        by_line = self._lines(path)
        tree = _tree(self._root / path)
        counts: dict[str, int] = defaultdict(int)
        for name, statement in _statements(tree, ""):
            first, last = _header(statement)
            if not any(by_line.get(line) for line in range(first, last + 1)):
                counts[name] += 1
        return list(counts.items())


def statement_lines(file: Path, at: tuple[int, int]) -> tuple[int, int] | None:
    """First and last line of the statement around some lines, without what it contains; None where it runs at import."""
    inner: ast.stmt | None = None
    in_function = False
    node: ast.AST = _tree(file)
    while True:
        child = next((c for c in ast.iter_child_nodes(node) if _spans(c, at)), None)
        if child is None:
            break
        if isinstance(node, _FUNCTIONS):
            in_body = child in node.body if isinstance(node.body, list) else child is node.body
            in_function = in_function or in_body
        if isinstance(child, ast.stmt | ast.ExceptHandler | ast.match_case):
            inner = child  # type: ignore[assignment]
        node = child
    if inner is None or not in_function:
        return None
    return _header(inner)


def _spans(node: ast.AST, at: tuple[int, int]) -> bool:
    if isinstance(node, ast.arguments | ast.match_case):
        return any(_spans(child, at) for child in ast.iter_child_nodes(node))
    first, last = getattr(node, "lineno", None), getattr(node, "end_lineno", None)
    return first is not None and last is not None and first <= at[0] and at[1] <= last


def _header(statement: ast.AST) -> tuple[int, int]:
    body = getattr(statement, "body", None)
    first = statement.pattern.lineno if isinstance(statement, ast.match_case) else statement.lineno  # type: ignore[attr-defined]
    if isinstance(body, list) and body:
        return first, max(first, body[0].lineno - 1)
    if isinstance(statement, ast.Match):
        return first, statement.subject.end_lineno or first
    return first, statement.end_lineno or first  # type: ignore[attr-defined]


def _statements(tree: ast.AST, name: str) -> Iterator[tuple[str, ast.stmt]]:
    for child in ast.iter_child_nodes(tree):
        own = f"{name}.{child.name}".lstrip(".") if isinstance(child, (*_FUNCTIONS[:2], ast.ClassDef)) else name
        inside = isinstance(tree, _FUNCTIONS[:2]) or getattr(tree, "_inside", False)
        if inside:
            child._inside = True  # type: ignore[attr-defined]
        is_text = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
        if inside and isinstance(child, ast.stmt) and not is_text and not isinstance(child, ast.Nonlocal | ast.Global):
            yield name, child
        yield from _statements(child, own)


def readers_of(root: Path, path: str, line: int) -> set[tuple[str, int]]:
    """Lines within functions of the four packages that read what a line sets at import, over a few names on the way."""
    found: set[tuple[str, int]] = set()
    names, seen = bound_at(root / path, line), set()
    places = [path] if all(name.startswith("_") for name in names) else modules(PACKAGES, root)
    for _ in range(_FOLLOWED):
        if not names:
            break
        seen |= names
        following: set[str] = set()
        for place in places:
            for name, at, in_function in _uses(root / place):
                if name in names and in_function:
                    found.add((place, at))
                elif name in names and (place, at) != (path, line):
                    following |= bound_at(root / place, at)
        names = following - seen
        if any(not name.startswith("_") for name in names):
            places = modules(PACKAGES, root)
    return found


@functools.cache
def bound_at(file: Path, line: int) -> set[str]:
    """Names that the statement at import around a line binds; a function's where the line is among its defaults."""
    names: set[str] = set()
    for node in ast.walk(_tree(file)):
        if not isinstance(node, ast.stmt) or not _spans(node, (line, line)):
            continue
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {leaf.id for target in targets for leaf in ast.walk(target) if isinstance(leaf, ast.Name)}
        elif isinstance(node, ast.FunctionDef):
            names |= {node.name}
    return names


@functools.cache
def _uses(file: Path) -> list[tuple[str, int, bool]]:
    uses = []

    def walk(node: ast.AST, in_function: bool) -> None:
        name = {ast.Name: "id", ast.Attribute: "attr", ast.keyword: "arg"}.get(type(node))
        if name and getattr(node, name) and not isinstance(getattr(node, "ctx", None), ast.Store):
            uses.append((getattr(node, name), node.end_lineno or 0, in_function))  # type: ignore[attr-defined]
        for child in ast.iter_child_nodes(node):
            body = getattr(node, "body", None)
            inside = isinstance(node, _FUNCTIONS) and (child in body if isinstance(body, list) else child is body)
            walk(child, in_function or inside)

    walk(_tree(file), False)
    return uses


@functools.cache
def _tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16] if file.exists() else ""


def _beside(map_file: Path) -> Path:
    return map_file.with_name(map_file.name + ".json")


def _about(map_file: Path) -> _About:
    beside = _beside(map_file)
    if not beside.exists():
        return {"cpu_s": {}, "modules": {}}
    about: _About = json.loads(beside.read_text(encoding="utf-8"))
    return about
