"""The shipped DBC is the default mapping as data: the same bus under other names, mapped, gives the same results."""

from __future__ import annotations

import dataclasses

import pytest

from studies.waveform.frame_runs import run_of
from yieldmon.bus.databases import load_messages
from yieldmon.engine.results import Result, frames_in, records_in
from yieldmon.engine.sources import DEFAULT_SOURCES, QUANTITIES, Sources
from yieldmon.files import machine_file, parameter_file
from yieldmon.frames import Frame
from yieldmon.plant import scenario
from yieldmon.plant.combine import VirtualCombine
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config.document import Document
from yieldmon.service.config.engine_sections import engine_settings

SECONDS = 24
SHIPPED = load_messages(shipped("dbc/yieldmon.dbc"))
# Made of other groups or of a factory monitor's frames; no signal of the shipped DBC.
DERIVED = {"position_group", "speed_group", "factory_mass_flow"}


def other(name: str) -> str:
    return f"Maker_{name[::-1]}"


def renamed(sources: Sources) -> Sources:
    """The same layout in another maker's words."""
    impact = tuple(
        dataclasses.replace(
            source,
            message=other(source.message),
            signals=tuple(other(signal) for signal in source.signals),
            counter=other(source.counter) if source.counter else None,
            status=other(source.status) if source.status else None,
        )
        for source in sources.impact
    )
    inputs = tuple(dataclasses.replace(each, message=other(each.message), signal=other(each.signal)) for each in sources.inputs)
    return Sources(impact, inputs, sources.fixed)


def told_otherwise(frame: Frame) -> Frame:
    return Frame(frame.time_s, other(frame.message), {other(name): value for name, value in frame.signals.items()})


@pytest.fixture(scope="module")
def heard() -> list[Frame]:
    pieces = [
        {"kind": "steady", "duration_s": 12.0, "flow_kg_s": 0.0},
        {"kind": "steady", "duration_s": 100.0, "flow_kg_s": 12.0},
    ]
    reported = scenario.from_mapping({"duration_s": float(SECONDS), "flow": {"pieces": pieces}}, "default-mapping")
    return list(VirtualCombine(reported, machine_file.load(None), 3).frames_until(float(SECONDS)))


def results(frames: list[Frame], sources: Sources, *, in_bulk: bool) -> list[Result]:
    monitor = build_monitor(engine_settings(Document()), machine_file.load(None), parameter_file.load(), None, sources)
    if in_bulk:
        return list(monitor.feed_run(run_of(frames, sources)))
    return [result for frame in frames for result in monitor.feed(frame)]


@pytest.mark.parametrize("in_bulk", [False, True], ids=["frame by frame", "in bulk"])
def test_no_name_is_special(heard: list[Frame], in_bulk: bool) -> None:
    usual = results(heard, DEFAULT_SOURCES, in_bulk=in_bulk)
    mapped = results([told_otherwise(frame) for frame in heard], renamed(DEFAULT_SOURCES), in_bulk=in_bulk)
    assert repr(records_in(mapped)) == repr(records_in(usual))
    assert repr(frames_in(mapped)) == repr(frames_in(usual))
    assert records_in(usual)[-1].mass_flow_kg_s == pytest.approx(12.0, rel=0.2)


def test_shipped_names_mean_nothing_to_another_mapping(heard: list[Frame]) -> None:
    found = records_in(results(heard, renamed(DEFAULT_SOURCES), in_bulk=False))
    assert len(found) > SECONDS // 2
    assert all(record.coverage == 0.0 and not record.mass_flow_kg_s > 0.0 for record in found)


def test_every_entry_is_a_signal_of_the_shipped_dbc_in_the_quantitys_unit() -> None:
    for source in DEFAULT_SOURCES.impact:
        names = {*source.signals, source.counter, source.status}
        assert names <= set(SHIPPED[source.message].signals)
    entries = [entry for entry in DEFAULT_SOURCES.inputs if entry.quantity not in DERIVED]
    assert {entry.quantity for entry in entries} | DERIVED == set(QUANTITIES)
    for entry in entries:
        assert SHIPPED[entry.message].signals[entry.signal].unit == QUANTITIES[entry.quantity].unit
