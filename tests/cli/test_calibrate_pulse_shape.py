"""`calibrate --pulse-shape` on logs of a virtual combine whose stream is wider than the model's."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.schema_check import problems
from yieldmon.cli.main import main
from yieldmon.files import pulse_shape_file

FLOWS = (5, 12, 8)


@pytest.fixture(scope="module")
def loads(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], str]:
    """Three logs of a quarter of a minute's harvest each, and a table of their true masses."""
    folder = tmp_path_factory.mktemp("loads")
    logs, rows = [], ["load,weighed_kg"]
    for k, flow in enumerate(FLOWS, 1):
        pieces = [{"kind": "steady", "duration_s": s, "flow_kg_s": f} for s, f in ((8, 0), (14, flow), (6, 0))]
        crop = {"friction": 0.2, "restitution": 0.55, "bulk_density_kg_m3": 1100}
        scenario = {
            "duration_s": 28, "crop": crop, "effects": {"stream_spread": {"half_width_deg": 3.0}}, "flow": {"pieces": pieces},
        }  # fmt: skip
        (folder / "s.yaml").write_text(json.dumps(scenario))
        log, truth = folder / f"load{k}.log", folder / f"t{k}.csv"
        words = ["--scenario", folder / "s.yaml", "--log", log, "--truth", truth, "--seed", k]
        assert main(["simulate", *map(str, words)]) == 0
        logs.append(str(log))
        rows.append(f"{k},{truth.read_text().splitlines()[-1].split(',')[2]}")
    tickets = folder / "tickets.csv"
    tickets.write_text("\n".join(rows) + "\n")
    return logs, str(tickets)


def test_the_shape_of_weighed_loads_gives_the_flow_of_a_load_left_out(loads, tmp_path, capsys) -> None:
    logs, tickets = loads
    out = tmp_path / "shape.yaml"
    assert main(["calibrate", "--pulse-shape", "--loads", *logs, "--tickets", tickets, "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert problems(found, "calibrate-pulse-shape") == []
    assert [load["load"] for load in found["loads"]] == ["1", "2", "3"]
    for load in found["loads"]:
        assert load["before_error_pct"] < -15.0
        assert abs(load["left_out_error_pct"]) < abs(load["before_error_pct"])
    # A per cent of stretch is about two of flow: what is stated is no less than what the loads left out show.
    left_out = [0.01 * load["left_out_error_pct"] for load in found["loads"]]
    assert found["std_dev"][0] >= 0.5 * (sum(error**2 for error in left_out) / len(left_out)) ** 0.5 * (1.0 - 1e-6)
    # The others lie on both sides of it.
    assert abs(found["loads"][2]["left_out_error_pct"]) < 8.0
    law = pulse_shape_file.load(out)
    assert law.fills == pytest.approx(found["load_share"])
    assert law.plate_angles_rad == pytest.approx((1.2217, 1.2217), abs=0.01)
    # The whole way: a daemon with that file gives the flow by the shape.
    (tmp_path / "c.yaml").write_text("pulse_shape_file: shape.yaml\nwaveform: {enabled: true, shape_terms: true}\n")
    table = tmp_path / "out.jsonl"
    words = ["process", logs[2], "--config", str(tmp_path / "c.yaml"), "--out", str(table), "--jobs", "1"]
    assert main(words) == 0
    rows = [row for row in map(json.loads, table.read_text().splitlines()) if row["shape_flow_kg_s"]]
    by_shape, by_force = (sum(row[name] for row in rows) for name in ("shape_flow_kg_s", "mean_force_flow_kg_s"))
    assert len(rows) >= 8
    assert by_shape == pytest.approx(by_force, rel=0.08)


@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ((1.0, 1.0, 1.0), None),
        (
            (2.2046, 2.2046, 2.2046),
            r"^the loads weigh \+1\d\d\.\d\d % against what was measured, which is a lot: are the tickets in",
        ),
        ((1.0, 1.0, 1.3), r"^load 3 weighs 1\.[23]\d times what the mean force makes of it beside the others: check its ticket$"),
    ],
    ids=["right", "pounds", "one ticket wrong"],
)
def test_tickets_that_the_mean_force_doubts_are_told(factors, said, loads, tmp_path, capsys) -> None:
    logs, tickets = loads
    heading, *rows = Path(tickets).read_text().splitlines()
    masses = [row.split(",") for row in rows]
    wrong = [f"{load},{factor * float(mass):.1f}" for (load, mass), factor in zip(masses, factors, strict=True)]
    (tmp_path / "t.csv").write_text("\n".join([heading, *wrong]) + "\n")
    main(["calibrate", "--pulse-shape", "--loads", *logs, "--tickets", str(tmp_path / "t.csv"), "--json"])
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert len(notes) == (said is not None)
    if said is not None:
        assert re.search(said, notes[0])


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ([], "--pulse-shape: has no loads; expected --loads LOG... and --tickets FILE"),
        (
            ["--loads", "a.sqlite", "--tickets", "T"],
            "a.sqlite: is a store, which holds no samples; expected logs of weighed loads",
        ),
        (["--loads", "A", "A", "--tickets", "T"], "--loads: names A twice; expected each log once"),
        (
            ["--loads", "A", "--tickets", "T", "--robust"],
            "--robust: applies to a table of a test facility only; expected none with ",
        ),
        (
            ["--loads", "A", "--tickets", "T", "--estimator", "table"],
            "--estimator: fits a curve; expected either --estimator or ",
        ),
        (["--loads", "A", "B", "--tickets", "T"], "A, B: 2 loads with pulses, expected 3 or more; expected loads at flows that "),
    ],
)
def test_what_is_missing_is_reported_in_a_line(words, line, loads, tmp_path, capsys) -> None:
    logs, tickets = loads
    two = tmp_path / "two.csv"
    two.write_text("".join(Path(tickets).read_text().splitlines(keepends=True)[:3]))
    names = {"A": logs[0], "B": logs[1], "T": str(two)}
    assert main(["calibrate", "--pulse-shape", *(names.get(word, word) for word in words)]) == 2
    said = capsys.readouterr().err
    for short, name in names.items():
        said = said.replace(name, short)
    assert said.startswith(f"yieldmon: {line}")
    assert said.count("\n") == 1
