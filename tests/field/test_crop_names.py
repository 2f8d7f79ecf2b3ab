"""Names of crops as other programs write them."""

from __future__ import annotations

import pytest

from yieldmon.field.crop_figures import crop

from .test_rows_of_strangers import home, mapped, rows  # noqa: F401


@pytest.mark.parametrize(
    ("name", "of", "bushel_lb"),
    [
        ("CORN_WET", "corn", 56.0),
        ("CORN WHITE", "corn", 56.0),
        ("Corn, White", "corn", 56.0),
        ('"CORN"', "corn", 56.0),
        ('"Oats"', "oats", 32.0),
        ("WHEAT_HARD_RED_WINTER", "wheat", 60.0),
        ("Wheat, Durum", "wheat", 60.0),
    ],
)
def test_names_of_other_programs_are_known(name: str, of: str, bushel_lb: float) -> None:
    found = crop(name)
    assert found is not None
    assert (found.name, found.bushel_lb) == (of, bushel_lb)


@pytest.mark.parametrize("name", ["POPCORN", "Sweet Corn", "CORN_SILAGE", "CORN_EURO", "Earlage", '"', ""])
def test_crops_with_another_bushel_are_not_taken_for_one_that_is_known(name: str) -> None:
    assert crop(name) is None


@pytest.mark.parametrize("name", ["POPCORN", ""])
def test_a_crop_whose_bushel_is_not_known_is_asked_for(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Yields were in lb/ac, without a word why."""
    _, said = mapped(capsys, [row | {"crop": name} for row in rows()], words=("--units", "us"))
    assert f"the bushel of {name or 'an unknown crop'} is not known: yields are in lb/ac; expected --crop, one of corn" in said
    _, said = mapped(capsys, [row | {"crop": name} for row in rows()], words=("--units", "us", "--crop", "corn"))
    assert "bu/ac" in said
