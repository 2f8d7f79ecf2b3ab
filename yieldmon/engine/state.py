"""The engine's state over a restart, as plain numbers for the store."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from math import isfinite
from typing import Any, TypeVar

from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.moisture_reference import MoistureState
from yieldmon.engine.mass.shared_error import ClosedLoadState
from yieldmon.engine.mass.since_empty import LoadSinceEmpty
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.mass.unseen import FlowAtStop
from yieldmon.engine.sampling.zero import ZeroState
from yieldmon.engine.self_calibration.calibrator_state import CalibratorState
from yieldmon.engine.self_calibration.scale_alarm import ScaleAlarmState
from yieldmon.engine.sweeps.disagreement import DisagreementState

_Part = TypeVar("_Part")


@dataclass(frozen=True, slots=True)
class ZeroUndo:
    """What an undo of the operator's zero calibration needs: the zero before it, whether the one in use is suspect, and masses of
    the tank scale that were added to loads, (load number, kg)."""

    before: ZeroState
    suspect: bool
    by_scale: tuple[tuple[int, float], ...] = ()

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ZeroUndo:
        """Inverse of `dataclasses.asdict`. Raises KeyError or TypeError."""
        by_scale = tuple((int(number), float(kg)) for number, kg in data["by_scale"])
        return cls(ZeroState.from_dict(data["before"]), bool(data["suspect"]), by_scale)


@dataclass(frozen=True, slots=True)
class TicketState:
    """A ticket for a load, kg. waits: it has not been handed to the calibrator. crop: that it belongs to; None: the one in use.
    common_kg: the part of std_dev_kg by another combine's monitor."""

    load_number: int
    weighed_kg: float
    std_dev_kg: float
    waits: bool
    crop: str | None = None
    common_kg: float = 0.0


@dataclass(frozen=True, slots=True)
class EngineState:
    """windows: closed so far. sweep_due_in_s and calibration_age_s (None: not known) count from the moment of the snapshot.
    zero_undo: None where there is no zero calibration to take back. tickets: the newest, in the order they were entered.
    moisture: of the grain for which the parameters hold, None where none was measured. closed: the newest loads.
    at_stop: None before the first frame. since_empty: mass since the plate was last seen empty."""

    totals: Totals = field(default_factory=Totals)
    zero: ZeroState | None = None
    windows: int = 0
    sweep_id: int = 0
    sweep_due_in_s: float = 0.0
    calibration_age_s: float | None = None
    parameter_version: int = 0
    disagreement: DisagreementState = field(default_factory=DisagreementState)
    calibrator: CalibratorState | None = None
    scale_alarm: ScaleAlarmState = field(default_factory=ScaleAlarmState)
    zero_undo: ZeroUndo | None = None
    tickets: tuple[TicketState, ...] = ()
    moisture: MoistureState | None = None
    closed: tuple[ClosedLoadState, ...] = ()
    at_stop: FlowAtStop | None = None
    since_empty: tuple[LoadSinceEmpty, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Nested plain dict of numbers, fit for JSON."""
        document = asdict(self)
        totals = document["totals"]
        for name in ("total_budget", "load_budget"):
            if not all(map(isfinite, totals[name].values())):
                totals[name] = None
        return document

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> EngineState:
        """Inverse of `as_dict`. Raises ValueError when a key is missing, unknown or of the wrong kind.

        Keys that older versions did not store get their defaults.
        """
        later: dict[str, Any] = {
            "calibrator": None,
            "scale_alarm": {},
            "zero_undo": None,
            "tickets": (),
            "moisture": None,
            "closed": (),
            "at_stop": None,
            "since_empty": (),
        }
        data = {"disagreement": {"patterns": (), "present": False}, **later, **data}
        known = {item.name for item in fields(cls)}
        if set(data) != known:
            raise ValueError(f"engine state has keys {sorted(data)}; expected {sorted(known)}")
        try:
            parts = {
                "totals": _totals(data["totals"]),
                "zero": _or_none(ZeroState.from_dict, data["zero"]),
                "disagreement": DisagreementState.from_dict(data["disagreement"]),
                "calibrator": _or_none(CalibratorState.from_dict, data["calibrator"]),
                "scale_alarm": ScaleAlarmState.from_dict(data["scale_alarm"]),
                "zero_undo": _or_none(ZeroUndo.from_dict, data["zero_undo"]),
                "tickets": tuple(TicketState(**ticket) for ticket in data["tickets"]),
                "closed": tuple(ClosedLoadState.from_dict(load) for load in data["closed"] if _by_angle(load)),
                "at_stop": _or_none(lambda kept: FlowAtStop(**kept), data["at_stop"]),
                "since_empty": tuple(LoadSinceEmpty(**load) for load in data["since_empty"]),
                "moisture": _or_none(lambda kept: MoistureState(**kept), data["moisture"]),
            }
            return cls(**{**data, **parts})
        except (KeyError, TypeError) as error:
            raise ValueError(f"engine state: {error}") from error


def _or_none(made: Callable[[Mapping[str, Any]], _Part], data: Mapping[str, Any] | None) -> _Part | None:
    return None if data is None else made(data)


def _by_angle(load: Mapping[str, Any]) -> bool:
    """Whether a closed load was kept by plate angle; an older one stays as stated."""
    return load["shared"] is None or not isinstance(load["shared"]["per_error_kg"], (int, float))


def _totals(data: Mapping[str, Any]) -> Totals:
    """Masses that were kept without a budget have an unknown one; of a mass of 0, grain may be missing all the same."""
    budgets = {
        name: MassBudget(**data[name]) if data.get(name) else MassBudget.unknown() if data[mass] else MassBudget()
        for name, mass in (("total_budget", "total_kg"), ("load_budget", "load_kg"))
    }
    return Totals(**{**data, **budgets})
