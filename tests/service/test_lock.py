"""The lock file pins, with hashes, what pyproject.toml asks for."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def pinned_in(name: str) -> dict[tuple[str, str], list[str]]:
    """Package and version -> hashes."""
    text = (ROOT / name).read_text()
    included = re.search(r"^-r (\S+)$", text, re.M)
    pinned = pinned_in(included[1]) if included else {}
    for entry in re.split(r"\n(?=\S)", text):
        match = re.match(r"([a-z0-9-]+)==(\S+)", entry)
        if match:
            pinned[match[1], match[2]] = re.findall(r"--hash=sha256:[0-9a-f]{64}", entry)
    return pinned


@pytest.mark.parametrize(("lock", "extras"), [("requirements.lock", ()), ("requirements-web.lock", ("web",))])
def test_every_dependency_is_pinned_with_hashes(lock: str, extras: tuple[str, ...]) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = [*project["dependencies"], *(line for extra in extras for line in project["optional-dependencies"][extra])]
    names = {found[0].lower() for line in declared if (found := re.match(r"[A-Za-z0-9-]+", line))}
    pinned = pinned_in(lock)
    assert names <= {name for name, _ in pinned}
    assert all(pinned.values())


def test_the_page_changes_no_version() -> None:
    """One version of each package, whether it is pinned for the page or without it."""
    pinned = pinned_in("requirements-web.lock")
    assert pinned_in("requirements.lock").items() <= pinned.items()
    assert len({name for name, _ in pinned}) == len(pinned)
