"""Arguments of another type, and numbers that nothing can have, given to the public interface: one line names them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from yieldmon import api

PRIOR = api.load_parameters()
MACHINE = api.Machine()
MODEL = api.ForwardModel(MACHINE, PRIOR.effects)
LOADED = api.load_configuration(api.shipped("config/yieldmon.yaml"))
ONES = np.ones(3)
SWEEP = api.Sweep(np.arange(3.0), np.radians([40.0, 60.0, 80.0]), 400.0 * api.RPM * ONES, 90.0 * ONES, ONES)
MASS = api.WeighedMass(9000.0, 45.0, 300.0 * ONES, 90.0 * ONES, 1.22 * ONES, 41.9 * ONES)
AT = api.Conditions(SWEEP.plate_angle_rad, SWEEP.elevator_speed_rad_s, mass_flow_kg_s=12.0)
ROWS = api.Measurements(AT, ONES)
CODEC = api.Codec()
SPEED = api.Frame(1.0, "ElevatorSpeed", {"ElevatorSpeed": 400.0})
TABLE = api.Table("bench.csv", "", "mass_flow_kg_s", "force_n", {}, {})
any_: Any = api
"""For arguments that no type checker would let through."""


def monitor() -> Any:
    return api.build_monitor(LOADED.engine, LOADED.machine, LOADED.parameters)


WRONG: dict[str, tuple[Callable[[], object], str]] = {
    "one sweep": (lambda: any_.self_calibrate(MODEL, PRIOR, SWEEP), "sweeps: is of type Sweep; expected a list of Sweep"),
    "sweeps of tuples": (lambda: any_.self_calibrate(MODEL, PRIOR, [(1, 2)]), "sweeps[0]: is of type tuple; expected"),
    "one mass": (lambda: any_.self_calibrate(MODEL, PRIOR, [], masses=MASS), "masses: is of type WeighedMass; expected a list"),
    "density as a number": (
        lambda: any_.self_calibrate(MODEL, PRIOR, [SWEEP], density=1080.0),
        "density: is of type float; expected a MeasuredDensity",
    ),
    "settings as a dict": (lambda: any_.self_calibrate(MODEL, PRIOR, [SWEEP], settings={}), "settings: is of type dict;"),
    "prior before model": (lambda: any_.self_calibrate(PRIOR, MODEL, [SWEEP]), "model: is of type ParameterSet; expected"),
    "path before parameters": (lambda: any_.save_parameters("p.yaml", PRIOR), "parameters: is of type str; expected"),
    "values for parameters": (lambda: any_.save_parameters(dict(PRIOR.values), "p.yaml"), "parameters: is of type dict;"),
    "no path": (lambda: any_.save_parameters(PRIOR, None), "path: is of type NoneType; expected a path"),
    "model for an open loop": (lambda: any_.OpenLoop("corn", PRIOR), "model: is of type str; expected a ForwardModel"),
    "no machine": (lambda: any_.ForwardModel(None), "machine: is of type NoneType; expected a Machine"),
    "no effects": (lambda: any_.ForwardModel(MACHINE, None), "effects: is of type NoneType; expected names"),
    "force of a number": (lambda: any_.ForwardModel(MACHINE).force(1.2, PRIOR.values), "conditions: is of type float; expected"),
    "rows of no conditions": (lambda: any_.Measurements(None, ONES), "measurements: conditions: is of type NoneType; expected"),
    "a calibration of no model": (
        lambda: any_.calibrate(MACHINE, ROWS, dict(PRIOR.values), ["friction"]),
        "model: is of type Machine; expected a ForwardModel",
    ),
    "a table by its path": (lambda: any_.diagnose("bench.csv", MACHINE, PRIOR), "table: is of type str; expected a Table"),
    "machine after parameters": (lambda: any_.diagnose(TABLE, PRIOR, MACHINE), "machine: is of type ParameterSet; expected"),
    "options as a dict": (lambda: any_.diagnose(TABLE, MACHINE, PRIOR, {}), "options: is of type dict; expected Options"),
    "an effect that is none": (lambda: api.Options(without=("gravty",)), "without: 'gravty' is not an effect; expected one of"),
    "effects as a text": (lambda: any_.Options(without="gravity"), "without: is of type str; expected names such as"),
    "an unknown form": (lambda: api.Options(form="k1"), "form: is 'k1'; expected auto, restitution or exchange"),
    "machine before settings": (
        lambda: any_.build_monitor(LOADED.machine, LOADED.engine, LOADED.parameters),
        "settings: is of type Machine; expected `engine`",
    ),
    "a monitor of no parameters": (
        lambda: any_.build_monitor(LOADED.engine, LOADED.machine, None),
        "parameters: is of type NoneType; expected a ParameterSet",
    ),
    "a message to a monitor": (
        lambda: monitor().feed(can.Message(arbitration_id=0x0CFF1180, data=bytes(8))),
        "frame: is of type Message; expected a Frame, as `Codec.decode` makes it",
    ),
    "no frame to a monitor": (lambda: monitor().feed(None), "frame: is of type NoneType; expected a Frame"),
    "market moisture that is none": (lambda: monitor().set_market_moisture(float("nan")), "moisture_pct: is nan; expected"),
    "market moisture as a share": (lambda: monitor().set_market_moisture(155.0), "moisture_pct: is 155.0; expected"),
    "kernels without weight": (lambda: monitor().set_kernel_weight(float("nan")), "thousand_kernel_weight_g: is nan; expected"),
    "no message to decode": (lambda: any_.Codec().decode(SPEED), "Frame: no can.Message to decode"),
    "no frame to encode": (lambda: any_.Codec().encode(None), "NoneType: no Frame to encode"),
    "a text for a value": (
        lambda: CODEC.encode(api.Frame(1.0, "ElevatorSpeed", any_dict(ElevatorSpeed="fast"))),
        "ElevatorSpeed.ElevatorSpeed: fast, expected a finite number",
    ),
    "a scenario by its name": (lambda: any_.VirtualCombine("demo"), "scenario: is of type str; expected a Scenario"),
    "a codec for a monitor": (
        lambda: any_.process_logs(["a.log"], CODEC, CODEC, print),
        "monitor: is of type Codec; expected a Monitor",
    ),
    "nothing that takes rows": (
        lambda: any_.process_logs(["a.log"], monitor(), CODEC, None),
        "take_row: is of type NoneType; expected a function",
    ),
    "one channel": (
        lambda: any_.process_logs(["a.log"], monitor(), CODEC, print, channels="can0"),
        "channels: is 'can0'; expected a list of names",
    ),
    "a log of no path": (lambda: list(any_.read_log(None)), "path: is of type NoneType; expected a path"),
    "a machine of no path": (lambda: any_.load_machine(3), "path: is of type int; expected a path"),
    "parameters of no path": (lambda: any_.load_parameters([]), "path: is of type list; expected a path"),
    "a scenario of no path": (lambda: any_.load_scenario(None), "path: is of type NoneType; expected a path"),
    "a table of no path": (lambda: any_.load_table(None), "path: is of type NoneType; expected a path"),
    "a database of no path": (lambda: any_.Codec(3), "path: is of type int; expected a path"),
    "an empty path to a log": (lambda: list(api.read_log("")), "path: is ''; expected a path"),
    "an empty path to a configuration": (lambda: api.load_configuration(""), "path: is ''; expected a path"),
    "seconds of no path": (lambda: any_.read_seconds(3), "path: is of type int; expected a path"),
    "loads of no path": (lambda: any_.read_loads(None), "path: is of type NoneType; expected a path"),
    "a configuration of no path": (lambda: any_.load_configuration(None), "path: is of type NoneType; expected a path"),
    "moisture of fewer windows": (
        lambda: api.Sweep(np.arange(3.0), 1.2 * ONES, 42.0 * ONES, 90.0 * ONES, ONES, np.ones(2)),
        "sweep: moisture_pct must hold one number for each window",
    ),
    "windows of several lengths": (
        lambda: api.WeighedMass.from_windows(9000.0, 45.0, ONES, np.ones(2), ONES, ONES),
        "weighed mass: duration_s must hold one finite number for each window",
    ),
    "no groups": (
        lambda: api.WeighedMass.from_windows(9000.0, 45.0, ONES, ONES, ONES, 42.0 * ONES, groups=0),
        "weighed mass: groups 0: expected 1 or more",
    ),
    "a total at no flow": (
        lambda: api.WeighedMass.from_total(
            1.0, 1.0, 1.0, model=MODEL, parameters=PRIOR, mass_flow_kg_s=0.0, plate_angle_rad=1.2, elevator_speed_rad_s=42.0
        ),
        "weighed mass: mass_flow_kg_s 0: expected a flow above 0",
    ),
    "no test weight": (
        lambda: api.MeasuredDensity.from_test_weight(0.0, 10.0, 1.5, 0.06),
        "density: test_weight_kg_m3 0: expected a number above 0",
    ),
}  # fmt: skip


def any_dict(**values: object) -> Any:
    return values


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_argument_is_named(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    call, text = WRONG[name]
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the text is compared below
        call()
    assert str(caught.value).startswith(text)
    assert not list(tmp_path.iterdir())


def test_lists_of_numbers_are_windows() -> None:
    lists = [[1.0, 1.0], [90.0, 90.0], [1.22, 1.22], [41.9, 41.9]]
    arrays = [np.array(column) for column in lists]
    of_lists, of_arrays = (any_.WeighedMass.from_windows(20.0, 1.0, *columns) for columns in (lists, arrays))
    for name in ("duration_s", "force_n", "plate_angle_rad", "elevator_speed_rad_s"):
        assert getattr(of_lists, name).tolist() == getattr(of_arrays, name).tolist()


@pytest.mark.parametrize("time_s", [float("nan"), float("inf"), -5.0, 0.0])
def test_frames_at_any_time_are_taken(time_s: float) -> None:
    fed = monitor()
    fed.feed(SPEED)
    assert fed.feed(SPEED._replace(time_s=time_s)) == []
