"""Loads that end when the grain tank is emptied, and masses near the end of what their signals carry."""

from __future__ import annotations

from dataclasses import replace

import pytest
from engine_bench import Bench, feed, monitor, only, results
from numpy import interp

from studies.waveform.frame_runs import run_of
from yieldmon import frames as bus
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.mass.load_summary import LoadClosed, LoadOpened
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import events_in
from yieldmon.engine.settings import EngineSettings, TotalsSettings
from yieldmon.engine.state import EngineState
from yieldmon.frames import NOT_AVAILABLE, Frame
from yieldmon.signal_ranges import signal_ranges

HARVEST = Bench(flow=lambda t: 10.0 if t >= 1005.0 else 0.0).frames(75)
AUGER_S = 0.5


def auger(*on: tuple[float, float], until_s: float = 1075.0, silent: tuple[float, float] = (0.0, 0.0)) -> list[Frame]:
    """GrainTank frames: the auger runs in these intervals; between the two `silent` times there are none."""
    times = (1000.25 + AUGER_S * k for k in range(round((until_s - 1000.25) / AUGER_S)))
    return [
        Frame(at, bus.GRAIN_TANK, {"Unloading": int(any(a <= at < b for a, b in on))})
        for at in times if not silent[0] <= at < silent[1]
    ]  # fmt: skip


def scale(*readings: tuple[float, float], stable: bool = True) -> list[Frame]:
    """TankScale frames each second, linear between (time, mass)."""
    times, masses = zip(*readings, strict=True)
    seconds = range(round(times[-1] - times[0]))
    status = 0 if stable else 1
    shown = [(times[0] + k, float(interp(times[0] + k, times, masses))) for k in seconds]
    return [Frame(at + 0.3, bus.TANK_SCALE, {"TankMass": kg, "TankScaleStatus": status}) for at, kg in shown]


def of(new_load: str) -> EngineSettings:
    return replace(EngineSettings(), totals=TotalsSettings(new_load=new_load))


def mixed(*more: list[Frame]) -> list[Frame]:
    return sorted([*HARVEST, *(frame for part in more for frame in part)], key=lambda frame: frame.time_s)


UNLOADING = (1020.0, 1040.0)
EMPTIED = scale((1000.0, 4000.0), (1020.0, 4150.0), (1040.0, 0.0), (1074.0, 300.0))

CASES = {
    "unloaded on the move": ("switch", auger(UNLOADING), [1050]),
    "a pause of the auger": ("switch", auger((1020.0, 1030.0), (1034.0, 1040.0)), [1050]),
    "a second tank": ("switch", auger((1010.0, 1022.0), (1040.0, 1052.0)), [1032, 1062]),
    "a touch of the switch": ("switch", auger((1020.0, 1024.0)), []),
    "the switch goes silent and comes back": ("switch", auger(UNLOADING, silent=(1041.0, 1055.0)), [1063]),
    "still unloading": ("switch", auger((1020.0, 1075.0)), []),
    "no switch": ("switch", [], []),
    "no switch, with a scale": ("switch", EMPTIED, []),
    "by command alone": ("command", auger(UNLOADING), []),
    "the scale's mass falls": ("tank_scale", EMPTIED, [1050]),
    "the scale fills": ("tank_scale", scale((1000.0, 0.0), (1074.0, 4000.0)), []),
    "a third is taken out": ("tank_scale", scale((1000.0, 6000.0), (1020.0, 6000.0), (1030.0, 4000.0), (1074.0, 4200.0)), []),
    "a scale that is not stable": ("tank_scale", [f._replace(signals={**f.signals, "TankScaleStatus": 1}) for f in EMPTIED], []),
    "an empty tank's play": ("tank_scale", scale((1000.0, 20.0), (1020.0, -15.0), (1074.0, 20.0)), []),
}  # fmt: skip


def closed_s(target: Monitor, frames: list[Frame]) -> list[float]:
    """Bus times at which loads ended; each ended load is followed by the next, and no mass is lost between them."""
    events = [e for e in events_in(results(target, frames)) if isinstance(e, LoadOpened | LoadClosed)]
    ends = [event.load for event in events if isinstance(event, LoadClosed)]
    starts = [event.load for event in events if isinstance(event, LoadOpened)]
    assert [load.number for load in starts] == list(range(1, len(ends) + 2))
    assert sum(load.measured_kg for load in ends) + target.totals.load_kg == pytest.approx(target.totals.total_kg, rel=1e-12)
    return [load.end_s for load in ends]


@pytest.mark.parametrize("name", CASES)
def test_a_load_ends_when_the_tank_is_emptied(name: str) -> None:
    new_load, frames, ends = CASES[name]
    found = closed_s(monitor(of(new_load)), mixed(frames))
    assert len(found) == len(ends)
    assert found == pytest.approx(ends, abs=2.5)


def test_without_mass_there_is_no_load_to_end() -> None:
    empty = Bench(flow=lambda t: 0.0).frames(70)
    frames = sorted([*empty, *auger(UNLOADING)], key=lambda frame: frame.time_s)
    assert closed_s(monitor(), frames) == []


def test_a_run_gives_the_same() -> None:
    frames = mixed(auger((1010.0, 1022.0), (1040.0, 1052.0)))
    one_by_one, whole = monitor(), monitor()
    feed(one_by_one, frames)
    whole.feed_run(run_of(frames))
    assert repr(whole.records) == repr(one_by_one.records)
    assert repr(events_in(whole.results)) == repr(events_in(one_by_one.results))
    assert whole.totals.load_number == 3


def near(total_kg: float, load_kg: float) -> Monitor:
    """A monitor that has measured this much."""
    target = monitor()
    state: EngineState = target.snapshot()
    target.restore(replace(state, totals=Totals(total_kg=total_kg, load_kg=load_kg)))
    return target


LARGEST = {name: signal_ranges()[bus.ACCUMULATED_MASS][name][1] for name in ("LoadMass", "TotalMass")}


@pytest.mark.parametrize(
    ("total", "load", "said", "available"),
    [
        (0.90, 0.90, (), ("LoadMass", "TotalMass")),
        (0.96, 0.10, ("TotalMass",), ("LoadMass", "TotalMass")),
        (0.10, 0.96, ("LoadMass",), ("LoadMass", "TotalMass")),
        (0.96, 0.96, ("LoadMass", "TotalMass"), ("LoadMass", "TotalMass")),
        (1.01, 0.96, ("LoadMass", "TotalMass"), ("LoadMass",)),
        (1.01, 1.01, ("LoadMass", "TotalMass"), ()),
    ],
)
def test_a_fault_comes_before_a_mass_is_not_available(total: float, load: float, said: tuple, available: tuple) -> None:
    target = near(total * LARGEST["TotalMass"], load * LARGEST["LoadMass"])
    out = feed(target, HARVEST[: 280 * 4])
    assert target.faults.is_active(FaultCode.MASS_NEAR_END) is bool(said)
    assert tuple(name for name in LARGEST if name in target.faults.detail(FaultCode.MASS_NEAR_END)) == said
    shown = only(out, bus.ACCUMULATED_MASS)[-1].signals
    assert tuple(name for name in LARGEST if shown[name] is not NOT_AVAILABLE) == available


def test_a_new_load_ends_the_fault_of_a_load() -> None:
    target = near(LARGEST["LoadMass"], 0.96 * LARGEST["LoadMass"])
    feed(target, HARVEST[: 280 * 3])
    assert target.faults.is_active(FaultCode.MASS_NEAR_END)
    target.start_load()
    feed(target, HARVEST[280 * 3 : 280 * 6])
    assert not target.faults.is_active(FaultCode.MASS_NEAR_END)


def test_the_masses_of_a_machine_s_life_fit() -> None:
    """16 h at 100 t/h in a load; 10,000 h at 42 t/h in all."""
    assert LARGEST["LoadMass"] > 16 * 100e3
    assert LARGEST["TotalMass"] > 10_000 * 42e3
