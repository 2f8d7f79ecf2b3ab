"""The wheel holds what its verbs use: each module is reached from a verb or from the public Python interface."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1] / "yieldmon"
FOUND_BY_FOLDER = ("yieldmon.cli", "yieldmon.physics.effects", "yieldmon.field.sources", "yieldmon.field.products")
"""Packages whose modules the program finds by listing the folder."""
IMPORT = re.compile(r"^[ \t]*(?:from +(\.*)([\w.]*) +import +(\([^)]*\)|[^\n]*)|import +([\w.]+))", re.M)


def modules() -> dict[str, Path]:
    names = {".".join(("yieldmon", *path.relative_to(ROOT).with_suffix("").parts)): path for path in ROOT.rglob("*.py")}
    return {name.removesuffix(".__init__"): path for name, path in names.items()}


def imported(name: str, path: Path) -> set[str]:
    """Names that a module imports, of modules and of what is in them; names of modules in strings (`import_module`) as well."""
    text = path.read_text(encoding="utf-8")
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    found = set(re.findall(r"\"(yieldmon\.[\w.]+)\"", text))
    for dots, origin, names, plain in IMPORT.findall(text):
        base = package[: len(package) - len(dots) + 1] if dots else []
        source = ".".join([*base, *([origin] if origin else [])]) or plain
        found |= {source, *(f"{source}.{each}" for each in re.findall(r"\w+", names))}
    return found


def test_every_module_is_used_by_a_verb_or_the_public_interface() -> None:
    known = modules()
    scanned = {name for name in known if name.startswith(tuple(f"{package}." for package in FOUND_BY_FOLDER))}
    reached, waiting = set[str](), {"yieldmon.__main__", "yieldmon.api", *scanned}
    while waiting:
        name = waiting.pop()
        reached.add(name)
        parents = {name.rpartition(".")[0]} - {""}
        waiting |= ((imported(name, known[name]) & known.keys()) | parents) - reached
    assert len(reached) > 400
    assert known.keys() - reached == set()
