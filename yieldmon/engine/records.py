"""What the engine hands on about each window.

`WindowRecord` is the one declaration of the columns of a second: each of its fields says where its value comes from, under which
name and unit a row carries it, and which signal publishes it. Store, tables, exports, `status` and frames follow from it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from enum import IntEnum
from math import degrees, isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.faults import FaultCode
from yieldmon.estimation.waveform.kernel_noise import KernelVerdict
from yieldmon.estimation.waveform.shape_verdict import ShapeVerdict
from yieldmon.frames import EstimateQuality, OperatingState
from yieldmon.physics.machine import RPM

if TYPE_CHECKING:
    from yieldmon.engine.flow import Flow
    from yieldmon.engine.mass.totals import Totals
    from yieldmon.engine.measurement import Reading
    from yieldmon.engine.waveform.waveform_reading import WaveformReading


class Second(NamedTuple):
    """All that is known of a window when its record is made. flow: as published; mass_kg: as measured; totals: after it."""

    bus_s: float
    number: int
    reading: Reading
    flow: Flow
    mass_kg: float
    area_m2: float
    totals: Totals
    operating_state: OperatingState
    faults: tuple[FaultCode, ...]
    sweep_id: int
    sweep_step: int
    usable_for_calibration: bool
    parameter_version: int
    waveform: WaveformReading


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a second's row.

    name, kind (float, int, str), optional (None for "not available"): as rows have them. attribute: of the WindowRecord. convert:
    from values as records have them, of one or several such columns, to the rows' values. since: schema version of the store that
    brought it. published: message and signal that carry it, None for none.
    """

    name: str
    kind: type
    optional: bool
    attribute: str
    convert: Callable[[Iterable[Any]], list[Any]]
    since: int
    published: tuple[str, str] | None


class _Declared(NamedTuple):
    take: Callable[[Second], Any]
    row: str | None
    kind: type
    optional: bool
    convert: Callable[[Iterable[Any]], list[Any]]
    since: int
    published: tuple[str, str] | None


def _known(values: Iterable[float]) -> list[float | None]:
    return [value if isfinite(value) else None for value in map(float, values)]


def _codes(values: Iterable[tuple[FaultCode, ...]]) -> list[str]:
    return [" ".join([code.value for code in value]) for value in values]


def _names(values: Iterable[IntEnum]) -> list[str | None]:
    return [value.name.lower() if value else None for value in values]


_SAME = ""
_CONVERSIONS: dict[str, tuple[type, bool, Callable[[Iterable[Any]], list[Any]]]] = {
    "number": (float, False, lambda values: list(map(float, values))),
    "known": (float, True, _known),
    "deg": (float, True, lambda values: _known(map(degrees, values))),
    "rpm": (float, True, lambda values: _known([value / RPM for value in values])),
    "whole": (int, False, lambda values: list(map(int, values))),
    "codes": (str, False, _codes),
    "verdict": (str, True, _names),
}


def second_field(
    take: Callable[[Second], Any],
    conversion: str,
    *,
    row: str | None = _SAME,
    since: int = 1,
    published: tuple[str, str] | None = None,
    default: Any = float("nan"),
) -> Any:
    """A field of the record.

    take: its value of a Second. conversion: "number", "known" (nan becomes None), "deg" and "rpm" (known, from rad and rad/s),
    "whole" (counts, codes and flags), "codes" (faults), "verdict" (a code by name, None for its 0). row: name in rows where it is
    another, None where rows do not have it. since: schema version of the store from which on there is such a column. published:
    message and signal that carry it. default: of such a later column.
    """
    kind, optional, convert = _CONVERSIONS[conversion]
    metadata = {"declared": _Declared(take, row, kind, optional, convert, since, published)}
    # Records made by hand, and rows of older tables, need not know of a column that came later.
    return field(metadata=metadata, default=default) if optional and since > 1 else field(metadata=metadata)


@dataclass(frozen=True, slots=True)
class WindowRecord:
    """One second of measurement. nan where a value is not known; angles in rad, speeds in rad/s.

    Attributes
    ----------
    window
        Number of the window.
    time_s
        Bus time of the window's end: seconds since 1970 where the bus or log has a date.
    duration_s
        Before time_s, less half a paddle pattern: what the second stands for.
    mass_flow_kg_s
        Wet grain, as published: filtered with the windows before.
    std_dev_kg_s, force_std_dev_n, load_std_dev_kg, total_std_dev_kg
        Standard deviation of mass_flow_kg_s, force_n, load_kg and total_kg.
    shape_std_dev_kg_s, shape_volume_std_dev_m3_s, kernel_std_dev_kg_s, mean_force_std_dev_kg_s
        Standard deviation of the flow of that name.
    quality
        Code of EstimateQuality.
    operating_state
        Code of OperatingState.
    mass_kg
        Wet grain that the second adds to load and total, as measured.
    load_number
        Of the open load, or of the last one where none is open.
    load_kg
        Wet grain of the load, this second included.
    total_kg
        Wet grain since the totals were reset, this second included.
    coverage
        Share of the window that was measured, 0 to 1.
    force_n
        Mean force of the grain on the plate; where the flow begins, ends or jumps, that of a steady flow of the same size.
    elevator_speed_rad_s
        Speed of the upper shaft.
    plate_angle_rad
        Plate angle from the horizontal; 90 deg is upright.
    plate_still
        The plate did not move while the window was formed.
    moisture_pct, test_weight_kg_m3, grain_temperature_degc
        As received from the combine; not available once too old.
    zero_mv
        Zero-load voltage that was subtracted.
    pulse_mv
        Amplitude of the signal that repeats with the paddle pattern.
    saturated_share
        Share of samples at the end of the sensor's range, or at a ceiling below it.
    lost_frames
        Sample frames lost, by their counter and time.
    surplus_frames
        Sample, speed and angle frames of a second sender.
    repeated_frames
        Duplicate sample frames; one of each is used.
    sweep_id
        Number of the sweep in progress, 0 outside sweeps.
    sweep_step
        Step of the sweep in progress, from 0; -1 outside sweeps.
    usable_for_calibration
        The window counts for its sweep step.
    parameter_version
        Version of the parameters in use.
    faults
        Names of the active faults.
    latitude_deg, longitude_deg, ground_speed_m_s, course_deg
        Of the GNSS receiver at the window's end, not of the ground where the grain was cut.
    position_group, speed_group
        Parameter group of the standard source in use; not known where it is that of the DBC.
    factory_mass_flow_kg_s
        Mass flow from the factory-fitted monitor; recorded, never used.
    noise_std_dev_kg_s
        Part of the measured flow's standard deviation that averages out over seconds.
    shape_flow_kg_s
        Flow from the pulses' shape.
    kernel_flow_kg_s
        Flow from kernel noise.
    area_m2
        Area harvested for the second's grain.
    shape_volume_flow_m3_s
        Volume flow on the paddles, from the pulses' shape.
    mean_force_flow_kg_s
        Flow from the mean force alone.
    thousand_kernel_weight_g
        Thousand-kernel weight used with kernel noise.
    kernel_verdict, shape_verdict
        Whether that estimator gives a flow, else why not.
    """

    window: int = second_field(lambda s: s.number, "whole", row=None)
    time_s: float = second_field(lambda s: s.bus_s, "number")
    duration_s: float = second_field(lambda s: s.reading.window.weight_s, "number")
    mass_flow_kg_s: float = second_field(lambda s: s.flow.rate_kg_s, "known")
    std_dev_kg_s: float = second_field(lambda s: s.flow.std_dev_kg_s, "known")
    quality: EstimateQuality = second_field(lambda s: s.flow.quality, "whole")  # noqa: RUF009
    operating_state: OperatingState = second_field(lambda s: s.operating_state, "whole")  # noqa: RUF009
    mass_kg: float = second_field(lambda s: s.mass_kg, "number")
    load_number: int = second_field(lambda s: s.totals.load_number, "whole")
    load_kg: float = second_field(lambda s: s.totals.load_kg, "number", published=("AccumulatedMass", "LoadMass"))
    total_kg: float = second_field(lambda s: s.totals.total_kg, "number", published=("AccumulatedMass", "TotalMass"))
    coverage: float = second_field(lambda s: s.reading.window.coverage, "number")
    force_n: float = second_field(lambda s: s.flow.force_n, "known")
    force_std_dev_n: float = second_field(lambda s: s.flow.force_std_dev_n, "known")
    elevator_speed_rad_s: float = second_field(lambda s: s.reading.speed_rad_s, "rpm", row="elevator_speed_rpm")
    plate_angle_rad: float = second_field(lambda s: s.reading.window.plate_angle_rad, "deg", row="plate_angle_deg")
    plate_still: bool = second_field(lambda s: s.reading.still, "whole")
    moisture_pct: float = second_field(lambda s: s.reading.inputs.fresh["moisture"], "known")
    test_weight_kg_m3: float = second_field(lambda s: s.reading.inputs.fresh["test_weight"], "known")
    zero_mv: float = second_field(lambda s: s.reading.zero.zero_mv if s.reading.zero else float("nan"), "known")
    pulse_mv: float = second_field(lambda s: s.reading.window.pulse_mv, "known")
    saturated_share: float = second_field(lambda s: s.reading.window.saturated_share, "known")
    lost_frames: int = second_field(lambda s: s.reading.window.lost_frames, "whole")
    surplus_frames: int = second_field(lambda s: s.reading.window.surplus_frames, "whole")
    repeated_frames: int = second_field(lambda s: s.reading.window.repeated_frames, "whole")
    sweep_id: int = second_field(lambda s: s.sweep_id, "whole")
    sweep_step: int = second_field(lambda s: s.sweep_step, "whole")
    usable_for_calibration: bool = second_field(lambda s: s.usable_for_calibration, "whole")
    parameter_version: int = second_field(lambda s: s.parameter_version, "whole")
    faults: tuple[FaultCode, ...] = second_field(lambda s: s.faults, "codes")
    latitude_deg: float = second_field(lambda s: s.reading.inputs.fresh["latitude"], "known")
    longitude_deg: float = second_field(lambda s: s.reading.inputs.fresh["longitude"], "known")
    ground_speed_m_s: float = second_field(lambda s: s.reading.inputs.fresh["ground_speed"], "known")
    course_deg: float = second_field(lambda s: s.reading.inputs.fresh["course"], "known")
    position_group: float = second_field(lambda s: s.reading.inputs.fresh["position_group"], "known", since=5)
    speed_group: float = second_field(lambda s: s.reading.inputs.fresh["speed_group"], "known", since=5)
    factory_mass_flow_kg_s: float = second_field(lambda s: s.reading.inputs.fresh["factory_mass_flow"], "known", since=5)
    noise_std_dev_kg_s: float = second_field(lambda s: s.flow.budget.noise_kg_s, "known", since=5)
    load_std_dev_kg: float = second_field(
        lambda s: s.totals.load_budget.std_dev_kg, "known", since=5, published=("MassStdDev", "LoadMassStdDev")
    )
    total_std_dev_kg: float = second_field(
        lambda s: s.totals.total_budget.std_dev_kg, "known", since=5, published=("MassStdDev", "TotalMassStdDev")
    )
    shape_flow_kg_s: float = second_field(lambda s: s.waveform.shape_kg_s, "known", since=6)
    shape_std_dev_kg_s: float = second_field(lambda s: s.waveform.shape_std_dev_kg_s, "known", since=6)
    kernel_flow_kg_s: float = second_field(lambda s: s.waveform.kernels_kg_s, "known", since=6)
    kernel_std_dev_kg_s: float = second_field(lambda s: s.waveform.kernels_std_dev_kg_s, "known", since=6)
    area_m2: float = second_field(lambda s: s.area_m2, "known", since=7)
    grain_temperature_degc: float = second_field(lambda s: s.reading.inputs.fresh["grain_temperature"], "known", since=9)
    shape_volume_flow_m3_s: float = second_field(lambda s: s.waveform.volume_m3_s, "known", since=10)
    shape_volume_std_dev_m3_s: float = second_field(lambda s: s.waveform.volume_std_dev_m3_s, "known", since=10)
    mean_force_flow_kg_s: float = second_field(lambda s: s.waveform.mean_kg_s, "known", since=10)
    mean_force_std_dev_kg_s: float = second_field(lambda s: s.waveform.mean_std_dev_kg_s, "known", since=10)
    thousand_kernel_weight_g: float = second_field(lambda s: s.waveform.kernel_weight_g, "known", since=10)
    kernel_verdict: KernelVerdict = second_field(  # noqa: RUF009
        lambda s: s.waveform.kernels, "verdict", since=10, default=KernelVerdict.NOT_LOOKED_AT
    )
    shape_verdict: ShapeVerdict = second_field(  # noqa: RUF009
        lambda s: s.waveform.shape, "verdict", since=11, default=ShapeVerdict.NOT_LOOKED_AT
    )


_DECLARED = tuple((item.name, item.metadata["declared"]) for item in fields(WindowRecord))
_TAKES = tuple(declared.take for _, declared in _DECLARED)
_made = maker_of(WindowRecord)

COLUMNS: tuple[Column, ...] = tuple(
    Column(
        name=declared.row or name,
        kind=declared.kind,
        optional=declared.optional,
        attribute=name,
        convert=declared.convert,
        since=declared.since,
        published=declared.published,
    )
    for name, declared in _DECLARED
    if declared.row is not None
)
"""The columns of a second's row, in order."""


def record_of(second: Second) -> WindowRecord:
    """The record of a second."""
    return _made(*[take(second) for take in _TAKES])
