"""What of the engine outlives a restart, as plain numbers for the store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from math import isfinite
from typing import Any

from yieldmon.engine.mass.budget import MassBudget, MoistureState
from yieldmon.engine.mass.shared_error import ClosedLoadState
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.mass.unseen import FlowAtStop
from yieldmon.engine.sampling.zero import ZeroState
from yieldmon.engine.self_calibration.calibrator_state import CalibratorState, GrainState, PriorState
from yieldmon.engine.self_calibration.earlier_parameters import EarlierParameters
from yieldmon.engine.self_calibration.scale_alarm import ScaleAlarmState, ScaleCheck
from yieldmon.engine.sweeps.disagreement import DisagreementState, SweepPattern


@dataclass(frozen=True, slots=True)
class ZeroUndo:
    """What an undo of the operator's zero calibration needs: the zero before it, whether the one in use is suspect, and mass, kg,
    that joined loads (by number) because the tank scale showed it."""

    before: ZeroState
    suspect: bool
    by_scale: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True, slots=True)
class TicketState:
    """A ticket for a load, kg. waits: it has not been handed to the calibrator. crop: that it waits for or has updated; None: the
    one in use. common_kg: the part of std_dev_kg by another combine's monitor."""

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
    at_stop: None before the first frame."""

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

        A state from before sweeps' patterns, the calibrator's, the scale's alarm or the moisture were kept has none.
        """
        later: dict[str, Any] = {
            "calibrator": None,
            "scale_alarm": {},
            "zero_undo": None,
            "tickets": (),
            "moisture": None,
            "closed": (),
            "at_stop": None,
        }
        data = {"disagreement": {"patterns": (), "present": False}, **later, **data}
        known = {item.name for item in fields(cls)}
        if set(data) != known:
            raise ValueError(f"engine state has keys {sorted(data)}; expected {sorted(known)}")
        try:
            zero = None if data["zero"] is None else _zero(data["zero"])
            undo = data["zero_undo"]
            if undo is not None:
                by_scale = tuple((int(number), float(kg)) for number, kg in undo["by_scale"])
                undo = ZeroUndo(_zero(undo["before"]), bool(undo["suspect"]), by_scale)
            kept = data["disagreement"]
            disagreement = DisagreementState(
                tuple(_pattern(pattern) for pattern in kept["patterns"]),
                kept["present"],
                tuple(_pattern(pattern) for pattern in kept.get("unfinished", ())),
            )
            calibrator = None if data["calibrator"] is None else _calibrator(data["calibrator"])
            parts = {
                "totals": _totals(data["totals"]),
                "zero": zero,
                "disagreement": disagreement,
                "calibrator": calibrator,
                "scale_alarm": _scale_alarm(data["scale_alarm"]),
                "tickets": tuple(TicketState(**ticket) for ticket in data["tickets"]),
                "closed": tuple(ClosedLoadState.from_dict(load) for load in data["closed"] if _by_angle(load)),
                "at_stop": None if data["at_stop"] is None else FlowAtStop(**data["at_stop"]),
                "moisture": None if data["moisture"] is None else MoistureState(**data["moisture"]),
            }
            return cls(**{**data, **parts, "zero_undo": undo})
        except (KeyError, TypeError) as error:
            raise ValueError(f"engine state: {error}") from error


def _zero(data: Mapping[str, Any]) -> ZeroState:
    return ZeroState(**{**data, "vibration_mv": tuple(data.get("vibration_mv", ()))})


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


def _pattern(data: Mapping[str, Any]) -> SweepPattern:
    plain: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in data.items()}
    pattern = SweepPattern(**plain)
    angles, forces, sds = len(pattern.plate_angle_deg), len(pattern.log_force), len(pattern.sd)
    if not angles == forces == sds:
        raise ValueError(f"engine state: a sweep's pattern has {angles} angles, {forces} forces and {sds} standard deviations")
    return pattern


def _scale_alarm(data: Mapping[str, Any]) -> ScaleAlarmState:
    check = data.get("contradiction")
    return ScaleAlarmState(**{**data, "contradiction": None if check is None else ScaleCheck(**check)})


def _calibrator(data: Mapping[str, Any]) -> CalibratorState:
    lists = {name: tuple(data.get(name, ())) for name in ("drifting", "rates", "weighed", "bias")}
    grains = tuple(_grain(grain) for grain in data.get("grains", ()))
    parts = {
        "covariance": _rows(data["covariance"]),
        "origin": _prior_or_none(data.get("origin")),
        "grains": grains,
        "spread": _rows(data.get("spread", ())),
        "past": tuple(EarlierParameters.from_dict(place) for place in data.get("past", ())),
    }
    state = CalibratorState(**{**data, **lists, **parts})
    count = len(state.drifting)
    if len(state.rates) != count or len(state.covariance) != count or len({len(row) for row in state.covariance}) > 1:
        raise ValueError(f"engine state: rates {state.rates} do not fit the parameters {state.drifting}")
    if any(len(row) != len(state.spread) for row in state.spread):
        raise ValueError(f"engine state: a spread of {len(state.spread)} rows is not square")
    return state


def _grain(data: Mapping[str, Any]) -> GrainState:
    origin, left = (_prior_or_none(data.get(name)) for name in ("origin", "left"))
    if (origin is None) != (left is None):
        raise ValueError(f"engine state: of {data['crop']} it has parameters before weighed loads or after them, not both")
    return GrainState(str(data["crop"]), tuple(data["weighed"]), str(data.get("doubted", "")), origin, left)


def _prior_or_none(data: Mapping[str, Any] | None) -> PriorState | None:
    return None if data is None else _prior(data)


def _prior(data: Mapping[str, Any]) -> PriorState:
    values, names = tuple((str(name), float(value)) for name, value in data["values"]), tuple(data["covariance_names"])
    state = PriorState(
        int(data["version"]), values, names, _rows(data["covariance"]), carried_from=str(data.get("carried_from", ""))
    )
    if {len(state.covariance), *map(len, state.covariance)} - {len(names)} or not set(names) <= dict(values).keys():
        raise ValueError(f"engine state: the covariance of the parameters before does not fit {list(names)}")
    return state


def _rows(data: Sequence[Sequence[float]]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in data)
