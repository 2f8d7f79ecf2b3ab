"""docs/reference says what the code says."""

from __future__ import annotations

import pytest

from tools.reference import columns, pages
from yieldmon.bus.codec import Codec
from yieldmon.cli.main import find_verbs
from yieldmon.engine.faults import FAULTS
from yieldmon.service.config.document import Document

REFERENCE = pages.DOCS / "reference"


def text(name: str) -> str:
    return (REFERENCE / f"{name}.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", [path.relative_to(pages.DOCS).as_posix() for path in pages.pages()])
def test_pages_are_what_the_code_says(page: str) -> None:
    found = (pages.DOCS / page).read_text(encoding="utf-8")
    assert pages.is_current(found, page), "make it anew: tools/docs"


def test_every_part_has_its_page() -> None:
    placed = [name for path in pages.pages() for name in pages.parts_of(path.read_text(encoding="utf-8"))]
    assert sorted(placed) == sorted(pages.BLOCKS)


def test_nothing_is_missing() -> None:
    frames, commands, faults, configuration = (text(name) for name in ("frames", "commands", "faults", "configuration"))
    for layout in Codec().layouts.values():
        assert f"### {layout.name}\n" in frames
        assert all(f"|`{signal.name}`|" in frames for signal in layout.signals)
    assert all(f"## {verb}\n" in commands for verb in find_verbs())
    assert all(f"|{code.value}|" in faults for code in FAULTS)
    assert all(f"## {key}\n" in configuration or f"|`{key}`|" in configuration for key in Document.model_fields)


def test_every_column_of_a_second_has_a_meaning() -> None:
    assert [name for name, meaning in columns.meanings().items() if not meaning] == []


def test_a_part_is_put_between_its_marks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(pages.BLOCKS, "one", lambda: "new")
    page = "before\n<!-- made by tools/docs: one -->\nold\n<!-- end of one -->\nafter\n"
    assert pages.fill(page) == "before\n<!-- made by tools/docs: one -->\n\nnew\n\n<!-- end of one -->\nafter\n"
    assert pages.fill(pages.fill(page)) == pages.fill(page)


@pytest.mark.parametrize(
    ("page", "wrong"),
    [("<!-- made by tools/docs: nobody -->\n<!-- end of nobody -->", "nothing makes nobody"),
     ("<!-- made by tools/docs: faults -->\n", "faults has no end")],
)  # fmt: skip
def test_marks_that_do_not_fit_are_refused(page: str, wrong: str) -> None:
    with pytest.raises(ValueError, match=wrong):
        pages.fill(page)
