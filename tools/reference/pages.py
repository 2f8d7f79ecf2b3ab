"""Pages with generated parts. A part stands between ``<!-- made by tools/docs: NAME -->`` and ``<!-- end of NAME -->``."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from tools.reference import api, columns, commands, configuration, faults, frames, schemas

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SCHEMAS = DOCS / "reference" / "schemas"

#: Name of a part -> what makes its Markdown.
BLOCKS: dict[str, Callable[[], str]] = {
    "api": api.markdown,
    "column-meanings": columns.meanings_markdown,
    "columns": columns.markdown,
    "commands": commands.markdown,
    "configuration": configuration.markdown,
    "faults": faults.markdown,
    "frames": frames.markdown,
    "schemas": schemas.markdown,
}

_PART = re.compile(r"(<!-- made by tools/docs: (\S+) -->\n).*?(<!-- end of \2 -->)", re.S)
_BEGIN = re.compile(r"<!-- made by tools/docs: (\S+) -->")


def parts_of(page: str) -> list[str]:
    """Names of the parts that a page has a place for."""
    return _BEGIN.findall(page)


def fill(page: str, where: str = "page") -> str:
    """The page with every part made anew.

    Raises
    ------
    ValueError
        For a part without its end, or that nothing makes.
    """
    whole = [match[2] for match in _PART.finditer(page)]
    for name in parts_of(page):
        if name not in BLOCKS:
            raise ValueError(f"{where}: nothing makes {name}; expected one of {', '.join(BLOCKS)}")
        if name not in whole:
            raise ValueError(f"{where}: {name} has no end; expected <!-- end of {name} -->")
    return _PART.sub(lambda match: f"{match[1]}\n{BLOCKS[match[2]]().rstrip()}\n\n{match[3]}", page)


def pages() -> Iterator[Path]:
    """Pages with generated parts."""
    for path in sorted(DOCS.rglob("*.md")):
        if parts_of(path.read_text(encoding="utf-8")):
            yield path


def is_current(page: str, where: str = "page") -> bool:
    """Whether a page is what `fill` makes of it; from Python 3.13 on, whose argparse has other columns, blanks do not count."""
    made = fill(page, where)
    return page == made or (sys.version_info >= (3, 13) and "".join(page.split()) == "".join(made.split()))


def stale() -> list[Path]:
    """Pages and schemas that are not what the code says."""
    wrong = [path for path in pages() if not is_current(path.read_text(encoding="utf-8"), path.name)]
    made = schemas.files(SCHEMAS)
    wrong += [path for path, text in made.items() if not path.is_file() or path.read_text(encoding="utf-8") != text]
    return wrong + [path for path in sorted(SCHEMAS.glob("*")) if path not in made]


def write() -> list[Path]:
    """Make every page and schema anew; returns those that changed."""
    changed, made = stale(), schemas.files(SCHEMAS)
    SCHEMAS.mkdir(exist_ok=True)
    for path in changed:
        if path in made:
            path.write_text(made[path], encoding="utf-8")
        elif path.parent == SCHEMAS:
            path.unlink()
        else:
            path.write_text(fill(path.read_text(encoding="utf-8"), path.name), encoding="utf-8")
    return changed
