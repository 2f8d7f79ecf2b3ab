"""What is reported about a mapping before it is used."""

from __future__ import annotations

from pathlib import Path

import pytest

from yieldmon.service import configuration
from yieldmon.service.mapping_check import notes

DBC = """\
VERSION ""
BU_: Cell
BO_ 257 CellData: 4 Cell
 SG_ Force0 : 0|16@1- (0.1,0) [0|0] "N" Cell
 SG_ Force1 : 16|16@1- (0.1,0) [0|0] "N" Cell
"""


@pytest.mark.parametrize(("quantity", "unit", "reported"), [("impact_force", "N", True), ("impact_voltage", "mV", False)])
def test_a_force_from_the_bus_says_that_the_gain_of_the_machine_file_does_not_act(
    tmp_path: Path, quantity: str, unit: str, reported: bool
) -> None:
    """The gain that `setup` finds with hung weights would be lost without a word."""
    (tmp_path / "cell.dbc").write_text(DBC)
    binding = f"{{dbc: cell.dbc, message: CellData, signals: [Force0, Force1], rate_hz: 500, unit: {unit}}}"
    (tmp_path / "c.yaml").write_text(f"plate: {{fixed_angle_deg: 70}}\nsignals:\n  {quantity}: {binding}\n")
    found = [note for note in notes(configuration.load(tmp_path / "c.yaml")) if "gain_n_per_mv" in note]
    assert len(found) == reported
    assert all("(0.4448) does not act on it" in note and "bind impact_voltage with unit: mV" in note for note in found)
