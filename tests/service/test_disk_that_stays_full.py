"""A disk without room: what is refused meanwhile, and what is said of seconds that are not written or have no record."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import pytest

from tests.service.bench import running, wait_for
from tests.service.test_ticket_of_another_crop import harvest, said
from tests.service.test_tickets_after_restart import ask
from yieldmon.cli import main as cli
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreError


def no_room(store: Store, batches: object) -> None:
    raise StoreError(f"{store.path}: database or disk is full")


def test_a_crop_is_corrected_once_the_seconds_of_its_load_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running(tmp_path, retry_s=0.05, written_s=0.2) as bench:
        bench.play(14, 0.0)
        bench.played()
        with monkeypatch.context() as full:
            full.setattr(Store, "commit", no_room)
            harvest(tmp_path, bench, "corn", 5, 60.0)
            harvest(tmp_path, bench, "corn", 3, 60.0)
            words = ["load", "correct", "2", "--crop", "wheat", "--socket", str(tmp_path / "yieldmon.sock")]
            with contextlib.redirect_stderr(io.StringIO()) as warned, pytest.raises(SystemExit, match="1"):
                cli.main(words)
            assert "the store cannot be written, so it lacks seconds of these loads" in warned.getvalue()
            assert ask(tmp_path, "load", "list")["loads"][0]["crop"] == "corn"
            assert ask(tmp_path, "load", "correct", "2", "--field", "north")["field"] == "north"
        wait_for(lambda: bench.daemon.writer.health().pending == 0, "what waited, written once there is room")
        assert ask(tmp_path, "load", "correct", "2", "--crop", "wheat")["measured_again"] == [2]


def test_status_says_how_many_records_were_dropped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "{bus: {transmit_max_age_s: 60}, store: {pending_seconds: 10}}"
    with running(tmp_path, text, retry_s=0.05, written_s=0.2) as bench:
        bench.play(14, 0.0)
        bench.played()
        with monkeypatch.context() as full:
            full.setattr(Store, "commit", no_room)
            bench.play(25, 60.0)
            bench.played()
        wait_for(lambda: bench.daemon.writer.health().pending == 0, "what waited, written once there is room")
        bench.play(1, 0.0)
        bench.played()
        dropped = bench.status["store"]["records_dropped"]
        assert dropped >= 14
        assert f"{dropped} s of records dropped (their mass counts)" in " ".join(said(tmp_path, "status")[0].split())


@pytest.mark.parametrize("pending_seconds", [3600, 10], ids=["all wait", "records dropped"])
def test_a_stop_on_a_full_disk_says_what_is_lost(
    pending_seconds: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    text = f"{{bus: {{transmit_max_age_s: 60}}, store: {{pending_seconds: {pending_seconds}}}}}"
    with monkeypatch.context() as full, running(tmp_path, text, retry_s=0.05, written_s=0.2) as bench:
        bench.play(14, 0.0)
        bench.play(6, 60.0)
        bench.played()
        wait_for(lambda: bench.daemon.writer.health().pending == 0, "the seconds before")
        before_kg = bench.status["total"]["mass_kg"]
        full.setattr(Store, "commit", no_room)
        bench.play(20, 60.0)
        bench.played()
        total_kg = bench.status["total"]["mass_kg"]
        assert total_kg > before_kg + 5.0
        assert (bench.daemon.writer.health().records_dropped > 0) is (pending_seconds == 10)
    with running(tmp_path, text, start_s=bench.now_s + 5.0) as after:
        after.play(14, 0.0)
        after.played()
        load = after.status["load"]
        assert load["mass_kg"] == pytest.approx(before_kg)
        assert load["unrecorded_s"] >= 0.0
        shown = " ".join(said(tmp_path, "status")[0].split())
        assert "goes on from before a stop of the daemon" in shown
        assert "without a record: grain of that time is missing here and in the total" in shown
        ask(tmp_path, "load", "start")
        after.play(1, 0.0)
        after.played()
        assert after.status["load"]["unrecorded_s"] is None
    lost = [record.getMessage() for record in caplog.records if "are lost" in record.getMessage()]
    assert len(lost) == 1
    assert lost[0].startswith(f"the last 20 s could not be written and are lost, with {total_kg - before_kg:.1f} kg: ")
    assert lost[0].endswith(f"the total was {total_kg:.1f} kg, load 1 held {total_kg:.1f} kg")
