"""docs/frames.md says what the DBC says."""

from __future__ import annotations

from pathlib import Path

import pytest

from yieldmon.bus.codec import Codec
from yieldmon.bus.frame_table import BEGIN, END, insert, main, markdown
from yieldmon.errors import InputError

PAGE = Path(__file__).parents[2] / "docs" / "frames.md"


def test_the_page_is_up_to_date() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert insert(page, markdown(), "docs/frames.md") == page


def test_every_message_and_signal_is_in_it() -> None:
    table = markdown()
    for layout in Codec().layouts.values():
        assert f"### {layout.name}\n" in table
        assert f"`0x{layout.frame_id:08X}`" in table
        assert all(f"| `{signal.name}` |" in table for signal in layout.signals)


def test_goes_between_the_marks(tmp_path: Path) -> None:
    page = tmp_path / "frames.md"
    page.write_text(f"before\n{BEGIN}\nyesteryear\n{END}\nafter\n", encoding="utf-8")
    main([str(page)])
    text = page.read_text(encoding="utf-8")
    assert text.startswith(f"before\n{BEGIN}\n")
    assert text.endswith(f"{END}\nafter\n")
    assert "yesteryear" not in text
    assert "ImpactSensorSamples" in text


@pytest.mark.parametrize("page", ["", BEGIN, f"{END} {BEGIN}"])
def test_a_page_without_marks_is_refused(page: str) -> None:
    with pytest.raises(InputError, match="no place for the table"):
        insert(page, "", "page.md")
