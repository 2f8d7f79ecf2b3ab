"""Parameters that come into use, go with a crop, and are taken back: what is in use after each, and what cannot be undone."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.service.test_remeasuring import known
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file
from yieldmon.files.crops import crops
from yieldmon.service.history.memory import KEPT_VERSIONS, Memory
from yieldmon.service.history.parameter_history import ParameterHistory
from yieldmon.service.tickets.action_log import ActionLog

OWN = known(0)
"""A file of the operator's own, of no stated crop."""


class Run:
    """A history that begins with a file, and what is in use."""

    def __init__(self, configured: ParameterSet = OWN, memory: Memory | None = None, crop: str = "") -> None:
        self.log = ActionLog((), (), 5.0)
        self.history = ParameterHistory(memory or Memory(), configured, self.log)
        self.crop = crop

    def learns(self, version: int, density: float, origin: str = "sweep") -> ParameterSet:
        learnt = known(version, density)
        self.history.use(learnt, origin, reason=f"reason {version}", tickets=[version])
        return learnt

    def undo(self, version: int, in_use: ParameterSet) -> tuple[ParameterSet, str]:
        return self.history.undo(version, in_use, named=self.crop, who="anna", now_s=9.0)


def test_what_comes_into_use_is_numbered_reported_and_brought_once() -> None:
    run = Run()
    run.learns(1, 800.0, "file")
    run.learns(2, 810.0)
    assert [action.document for action in run.log] == [
        {"version": 1, "from_version": 0, "origin": "file", "reason": "reason 1", "effects": [], "tickets": [1]},
        {"version": 2, "from_version": 1, "origin": "sweep", "reason": "reason 2", "effects": [], "tickets": [2]},
    ]
    versions, steps = run.history.take(77.0)
    assert [(v.version, v.time_s, v.origin, v.document["density"]) for v in versions] == [
        (1, 77.0, "file", 800.0), (2, 77.0, "sweep", 810.0),
    ]  # fmt: skip
    assert (steps, run.history.version) == ((), 2)
    assert run.history.take(78.0) == ((), ())
    run.history.report_all()
    run.history.report_all()
    assert [v.version for v in run.history.take(79.0)[0]] == [2]


def test_a_history_without_parameters_has_none_to_bring() -> None:
    run = Run()
    run.history.report_all()
    assert run.history.take(1.0) == ((), ())
    remembered = Run(memory=Memory(parameters=known(7), parameter_origin="sweep", last_version=7, versions={7: known(7)}))
    assert remembered.history.version == 7
    remembered.history.report_all()
    assert [(v.version, v.origin) for v in remembered.history.take(1.0)[0]] == [(7, "sweep")]


def test_an_undo_brings_back_what_was_before_under_a_new_number() -> None:
    run = Run()
    run.learns(1, 800.0, "file")
    learnt = run.learns(2, 850.0)
    found, crop = run.undo(2, learnt)
    assert (found.version, found.values["density"], crop, run.history.version) == (3, 800.0, "", 3)
    reported = [(action.kind, action.who, action.time_s, action.document.get("reason")) for action in run.log][2:]
    assert reported == [("parameters-undo", "anna", 9.0, None), ("parameters", "anna", 5.0, "version 2 undone: as version 1")]
    assert [row.document["origin"] for row in list(run.log)[3:]] == ["undo"]


def test_what_followed_on_an_undone_version_is_undone_with_it() -> None:
    """Or undoing that too would bring back the version that was undone first."""
    run = Run()
    run.learns(1, 800.0, "file")
    run.learns(2, 850.0)
    found, _ = run.undo(2, run.learns(3, 860.0))
    assert found.values["density"] == 800.0
    with pytest.raises(InputError, match="version 3: is undone already"):
        run.undo(3, found)
    states = {row["version"]: row["state"] for row in run.history.table(found, run.crop)}
    assert states == {1: "", 2: "undone", 3: "undone", 4: "in use"}


def test_what_another_crop_learnt_since_is_not_undone() -> None:
    run = Run(crop="corn")
    run.learns(1, 800.0, "file")
    corn = run.learns(2, 850.0)
    wheat = run.history.change_crop("wheat", corn, "corn")
    assert wheat is not None
    learnt = replace(wheat, version=5)
    run.history.use(learnt, "ticket", tickets=[5])
    run.crop = "wheat"
    run.undo(2, learnt)
    table = run.history.table(learnt, run.crop)
    assert {row["version"]: row["state"] for row in table if row["state"] == "undone"} == {2: "undone"}
    assert run.undo(5, run.history.change_crop("wheat", learnt, "wheat") or learnt)[0].values == wheat.values


def test_each_version_is_listed_with_its_crop() -> None:
    run = Run()
    run.learns(1, 800.0, "file")
    corn = run.learns(2, 850.0, "ticket")
    assert [row["crop"] for row in run.history.table(corn, "")] == ["", ""]
    wheat = run.history.change_crop("wheat", corn, "corn")
    assert wheat is not None
    learnt = replace(wheat, version=5)
    run.history.use(learnt, "ticket", tickets=[5])
    run.log.add("zero", "anna", {"second": 1, "signs": ""})
    assert [(row["version"], row["crop"]) for row in run.history.table(learnt, "wheat")] == [
        (1, "corn"), (2, "corn"), (3, "corn"), (4, "wheat"), (5, "wheat"), (None, ""),
    ]  # fmt: skip


def test_of_versions_that_are_no_longer_kept_no_crop_is_known() -> None:
    run = Run(crop="corn")
    for version in range(1, KEPT_VERSIONS + 3):
        last = run.learns(version, 800.0)
    assert [row["crop"] for row in run.history.table(last, run.crop)] == ["", "", *["corn"] * KEPT_VERSIONS]


def changed_crop(run: Run) -> ParameterSet:
    chosen = run.history.change_crop("wheat", known(2, 810.0), "corn", "anna")
    assert chosen is not None
    return chosen


@pytest.mark.parametrize(
    ("version", "wrong"),
    [
        (9, "version 9: no such calibration; expected a version that `yieldmon calibrations list` shows"),
        (2, "version 2: is undone already; expected one that is not undone"),
        (4, "version 4: is a change of crop"),
        (5, "version 5: is a change of crop"),
        (1, "version 1: the parameters before it are not known; expected a later version"),
    ],
)
def test_what_cannot_be_undone(version: int, wrong: str) -> None:
    run = Run(crop="wheat")
    run.learns(1, 800.0, "file")
    run.undo(2, run.learns(2, 810.0))
    chosen = changed_crop(run)
    before = [action.number for action in run.log]
    with pytest.raises(InputError) as caught:
        run.undo(version, chosen)
    assert wrong in str(caught.value)
    assert [action.number for action in run.log] == before, "nothing is recorded that did not happen"


def test_a_change_of_crop_keeps_what_was_known_and_takes_what_is_known_of_the_other() -> None:
    run = Run()
    run.learns(1, 800.0, "file")
    corn = known(1, 800.0)
    assert run.history.change_crop("corn", corn, "corn") is None, "the same crop"
    assert run.history.change_crop("wheat", corn, "") is None, "nobody said whose these are"
    wheat = run.history.change_crop("wheat", corn, "corn", "anna")
    assert wheat is not None
    assert (wheat.version, wheat.values) == (3, crops()["wheat"].parameters().values)
    again = run.history.change_crop("corn", wheat, "wheat")
    assert again is not None
    assert (again.version, again.values["density"], again.provenance["crop"]) == (5, 800.0, "corn")
    assert [(a.who, a.document["origin"], a.document["reason"]) for a in list(run.log)[1:]] == [
        ("anna", "crop", "what is known of corn is kept"), ("anna", "crop", "what is known of wheat"),
        ("", "crop", "what is known of wheat is kept"), ("", "crop", "what is known of corn"),
    ]  # fmt: skip


def test_a_crop_of_which_nothing_is_known_begins_with_a_copy() -> None:
    run = Run()
    run.learns(1, 800.0, "file")
    assert not run.history.keeps("corn")
    copy = run.history.change_crop("nothing known", known(1, 800.0), "corn")
    assert copy is not None
    assert (copy.version, copy.values["density"], copy.provenance["crop"]) == (3, 800.0, "nothing known")
    corn = run.history.change_crop("corn", replace(copy, values={**copy.values, "density": 900.0}), "nothing known")
    assert corn is not None
    assert corn.values["density"] == 800.0
    assert run.history.keeps("corn")
    assert run.history.keeps("nothing known")
    reasons = [a.document["reason"] for a in list(run.log)[1:]]
    assert reasons[:2] == ["what is known of corn is kept", "nothing known begins with what is known of corn"]


def test_an_undo_of_another_crops_update_leaves_those_in_use() -> None:
    run = Run(crop="wheat")
    run.learns(1, 800.0, "file")
    corn = run.learns(2, 850.0)
    wheat = run.history.change_crop("wheat", corn, "corn")
    assert wheat is not None
    found, crop = run.undo(2, wheat)
    assert (crop, found.values, found.provenance["crop"]) == ("corn", wheat.values, "wheat")
    assert (found.version, run.history.version) == (6, 6)
    back = run.history.change_crop("corn", found, "wheat")
    assert back is not None
    assert back.values["density"] == 800.0


def test_parameters_without_a_crop_are_corn_where_the_file_is_the_shipped_one() -> None:
    shipped = Run(parameter_file.load())
    assert (shipped.history.crop_of(OWN, ""), shipped.history.crop_of(OWN, "oats")) == ("corn", "oats")
    assert (Run().history.crop_of(OWN, ""), Run().history.crop_of(OWN, "oats")) == ("", "oats")


def test_a_file_counts_anew_when_it_has_changed() -> None:
    run = Run()
    run.learns(1, 800.0, "file")
    assert run.history.unlike(OWN) is None
    other = run.history.unlike(known(0, 900.0))
    assert other is not None
    assert (other.version, other.values["density"]) == (2, 900.0)
    run.history.configure(known(0, 900.0))
    assert run.history.unlike(known(0, 900.0)) is None
    assert run.history.unlike(OWN) is not None


def test_so_many_versions_can_be_undone() -> None:
    run = Run()
    for version in range(1, KEPT_VERSIONS + 3):
        last = run.learns(version, 800.0 + version)
    with pytest.raises(InputError, match="the parameters before it are not known"):
        run.undo(3, last)
    assert run.undo(4, last)[0].values["density"] == 803.0
