"""Published schemas hold for what the commands print (kept outputs, held equal to real ones), and see spoilt documents."""

from __future__ import annotations

import copy
import json

import pytest

from tests.golden import kept
from tests.schema_check import SCHEMAS, problems
from tools.reference.documents import DOCUMENTS

KEPT = {
    "calibrate-dem": "calibrate", "calibrate-bench": "calibrate", "calibrate-corn": "calibrate", "diagnose-dem": "diagnose",
    "diagnose-bench": "diagnose", "demo": "demo", "self-calibrate": "self-calibrate",
}  # fmt: skip


@pytest.mark.parametrize(("case", "schema"), KEPT.items())
def test_kept_outputs_follow_their_schema(case: str, schema: str) -> None:
    assert problems(json.loads(kept.load(case)), schema) == []


def test_every_document_has_a_schema() -> None:
    assert {path.stem for path in SCHEMAS.glob("*.json")} == set(DOCUMENTS)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [(lambda d: d.pop("verdict"), "document has no verdict"),
     (lambda d: d.update(verdict="perhaps"), "document.verdict is 'perhaps'"),
     (lambda d: d.update(more=1), "document has more"),
     (lambda d: d["gap"].update(noise_floor_rms="small"), "document.gap.noise_floor_rms is 'small'"),
     (lambda d: d["candidates"].append({}), "has no name"),
     (lambda d: d["notes"].append(True), "not string")],
)  # fmt: skip
def test_a_corrupt_document_is_detected(spoil, said: str) -> None:
    document = copy.deepcopy(json.loads(kept.load("diagnose-dem")))
    spoil(document)
    assert any(said in problem for problem in problems(document, "diagnose"))
