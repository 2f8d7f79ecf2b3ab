"""`status` says that a load lacks seconds: faults of the moment are gone by the time somebody looks."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.service.bench import running
from tests.service.test_ticket_of_another_crop import said
from tests.service.test_tickets_after_restart import ask

LINE = "not every second of it was measured: grain of the others is missing here and in the total"


@pytest.mark.parametrize(("silent_s", "complete"), [(0.0, True), (20.0, False)])
def test_a_load_with_seconds_that_were_not_measured(tmp_path: Path, silent_s: float, complete: bool) -> None:
    with running(tmp_path) as bench:
        bench.play(14, 0.0)
        bench.played()
        ask(tmp_path, "load", "start")
        bench.play(6, 60.0)
        bench.now_s += silent_s
        bench.play(14, 60.0)
        bench.played()
        assert bench.status["load"]["complete"] is complete
        assert (LINE in " ".join(said(tmp_path, "status")[0].split())) is not complete
        ask(tmp_path, "load", "stop")
        assert bench.status["load"]["complete"] is complete
