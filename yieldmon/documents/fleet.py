"""What `yieldmon fleet WORD --json` prints."""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict

from .common import Number

Cause = Literal["inputs_sha256", "parameters_sha256", "software"]
"""A hash by which two results of the same day differ."""


class CopyDocument(TypedDict):
    """A log that was left out, since it holds the same as another."""

    log: str
    same_as: str


class PartitionProblem(TypedDict):
    """What is wrong with a machine's day (MACHINE/DAY)."""

    partition: str
    problem: str


class PoisonedDocument(PartitionProblem):
    """A log, ticket or configuration that could not be used. partition: "" of the source as a whole."""

    where: str


class FleetRunDocument(TypedDict):
    """`yieldmon fleet run --json`. partitions: machine-days, of which done were measured, skipped there already, failed without a
    result, and left to the next run (why_left). left_out: what holds no log; doubtful: damaged parts of logs."""

    dataset: str
    partitions: int
    done: int
    skipped: int
    failed: int
    left: int
    frames: int
    seconds: int
    left_out: list[str]
    copies: list[CopyDocument]
    poisoned: list[PoisonedDocument]
    why_left: list[PartitionProblem]
    doubtful: list[PartitionProblem]


class TicketErrors(TypedDict):
    """Measured against weighed loads, %; null without tickets."""

    count: int
    mean_error_pct: Number
    rms_error_pct: Number
    worst_error_pct: Number


class FleetTotals(TypedDict):
    """Sums. counted_again_kg: what logs hold twice, which mass_kg is without; software: with the first of its hash."""

    machines: int
    machine_days: int
    hours: float
    mass_kg: float
    counted_again_kg: float
    tickets: TicketErrors
    software: list[str]
    parameter_hashes: int


class MachineFault(TypedDict):
    """A fault of a machine: how often, on how many days, how long."""

    count: int
    days: int
    seconds: float


class ParameterDrift(TypedDict):
    """A parameter at the end of the first and last day, and of each. std_dev: of the last; change_pct: of a grain parameter,
    relative to what the force follows (restitution: the gain 1 + e); null for effects and where the days did not begin with the
    same value."""

    first: float
    last: float
    std_dev: Number
    change_pct: Number
    by_day: dict[str, float]


class MachineSummary(TypedDict):
    """A machine. model_disagrees: days with that fault; sweeps: how often each ended how."""

    machine: str
    days: int
    first_day: str
    last_day: str
    crops: list[str]
    hours: float
    mass_kg: float
    counted_again_kg: float
    days_without_zero: list[str]
    faults: dict[str, MachineFault]
    model_disagrees: list[str]
    sweeps: dict[str, int]
    parameters: dict[str, ParameterDrift]
    tickets: TicketErrors


class DaySummary(TypedDict):
    """A machine's day. faults: how often each came."""

    machine: str
    day: str
    crop: str | None
    zero_known: bool | None
    hours: float
    mass_kg: float
    counted_again_kg: float
    faults: dict[str, int]


class TicketRow(TypedDict):
    """A weighed load. error_pct: measured less weighed."""

    machine: str
    day: str
    name: str
    measured_kg: Number
    weighed_kg: float
    error_pct: Number


class DayProblem(TypedDict):
    """What is wrong with a machine's day. where: the log, ticket or configuration."""

    machine: str
    day: str
    problem: str
    where: NotRequired[str]


class FleetReportDocument(TypedDict):
    """`yieldmon fleet report --json`. failed: days without a result; poisoned: parts of days that could not be used; doubtful:
    what may be wrong with those that are measured; unfinished: a run is under way, was interrupted or left days out."""

    dataset: str
    unfinished: bool
    totals: FleetTotals
    machines: list[MachineSummary]
    days: list[DaySummary]
    tickets: list[TicketRow]
    failed: list[DayProblem]
    poisoned: list[DayProblem]
    doubtful: list[DayProblem]


class ColumnDifference(TypedDict):
    """Of a column of the records: in how many seconds it differs, the number of the first, and the largest difference of
    numbers."""

    seconds: int
    first_number: int
    largest: NotRequired[Number]


class DayDifference(TypedDict):
    """A machine's day that differs. because: which hashes do; tables: which results do; seconds, mass_kg: in the first and the
    second dataset."""

    machine: str
    day: str
    because: list[Cause]
    tables: list[str]
    seconds: list[int]
    mass_kg: list[float]
    mass_change_pct: Number
    columns: dict[str, ColumnDifference]


class FleetCompareDocument(TypedDict):
    """`yieldmon fleet compare --json`. partitions: machine-days in both; equal: to the byte; because, columns_only_in_first and
    columns_only_in_second: with the number of days."""

    first: str
    second: str
    partitions: int
    only_in_first: list[str]
    only_in_second: list[str]
    equal: int
    because: dict[Cause, int]
    columns_only_in_first: dict[str, int]
    columns_only_in_second: dict[str, int]
    different: list[DayDifference]


class PriorParameter(TypedDict):
    """A parameter for the next machine."""

    value: float
    standard_deviation: float


class DensityAndGain(TypedDict):
    """Of both parameters of the scale, %."""

    density: float
    gain: float


class PriorMachine(TypedDict):
    """A machine that it was estimated from, and how it differs from the crop's mean."""

    loads: int
    density_pct: float
    gain_pct: float


class FleetPriorDocument(TypedDict):
    """`yieldmon fleet prior --json`. crop_shift_pct: from the shipped crop; left_out: tickets that could not be used, and why."""

    parameters: dict[str, PriorParameter]
    crop_shift_pct: DensityAndGain
    between_machines_sd_pct: DensityAndGain
    machines: dict[str, PriorMachine]
    left_out: list[str]


class FleetEffect(TypedDict):
    """An effect that is named. equivalent: those that the sweeps do not distinguish from it; confidence: that it is one of
    these."""

    name: str
    confidence: float
    equivalent: list[str]
    parameters: dict[str, float]


class MachineEffects(TypedDict):
    """What a machine shows beside the others. verdict: effect, none, unknown (it differs, and too many effects would explain it),
    or why there is none."""

    machine: str
    verdict: str
    effects: list[FleetEffect]


class VisibleEffect(TypedDict):
    """From which size of its parameter on an effect of one machine shows in 80 of 100 such fleets; null: at no physical size."""

    name: str
    parameter: str
    size: Number
    unit: str


class FleetDiagnosisDocument(TypedDict):
    """`yieldmon fleet diagnose --json`. shared: whether the model lacks an effect (model) for all machines; candidates: the
    nearest to a name where that is unknown."""

    shared: Literal["effect", "unknown", "none", "not compared"]
    model: list[FleetEffect]
    candidates: list[FleetEffect]
    machines: list[MachineEffects]
    visible_from: list[VisibleEffect]
