"""What `yieldmon status --json` prints."""

from __future__ import annotations

from typing import TypedDict

from .common import Harvested, Number
from .loads import ListedLoad


class StatusCrop(TypedDict):
    """The crop that is measured, its bushel where it has one, and the moisture of dry mass."""

    name: str
    bushel_kg: Number
    market_moisture_pct: float


class StatusNow(TypedDict):
    """What a driver looks at: the last second, the yield of the last seconds, and why no area is known of the last one."""

    mass_flow_kg_s: Number
    std_dev_kg_s: Number
    quality: str | None
    yield_kg_m2: Number
    area_missing_because: str | None
    moisture_pct: Number
    ground_speed_m_s: Number
    plate_angle_deg: Number
    elevator_speed_rpm: Number


class StatusConfiguration(TypedDict):
    """File in use; what the last reload said, how many there were; keys that the file has under a former name."""

    file: str
    reload: str
    reloads: int
    notes: list[str]


class StdDevByCause(TypedDict):
    """Parts of a mass's standard deviation, kg. noise: with what may have come in seconds that were not measured."""

    noise: Number
    parameters: Number
    zero: Number
    moisture: Number


class StatusLoad(Harvested):
    """The load, open or the last one. contested_mass_kg: measured while more than one node sent samples. unrecorded_s:
    between the last record of a run before and this one, null where the load began since or the clock does not tell; grain
    of that time is not in it. complete: whether every second of it was measured, by this run; null where it began in another
    or is not known to this one."""

    number: int
    open: bool
    field: str
    crop: str
    mass_kg: float
    contested_mass_kg: float
    std_dev_kg: Number
    std_dev_by_cause_kg: StdDevByCause
    dry_mass_kg: Number
    unrecorded_s: Number
    complete: bool | None


class StatusTotal(TypedDict):
    """All mass since the totals were set to 0; dry mass is that of known moisture."""

    mass_kg: float
    std_dev_kg: Number
    std_dev_by_cause_kg: StdDevByCause
    dry_mass_kg: float
    contested_mass_kg: float
    mass_of_unknown_moisture_kg: float


class StatusWaveform(TypedDict):
    """What the last second's samples say beside their mean: volume flow from the pulses' shape and the flow that it means, flow
    from kernel noise, or why there is none. shape_verdict, kernel_verdict: as in records, by name. contradiction:
    of shape or kernel noise with the mean force. stretch_by_mean_force, kernel_bias_by_mean_force: the `waveform.stretch` and
    `waveform.kernel_bias` with which they would agree with it over the last windows; with `waveform.shape_terms` a factor on the
    terms' stretch. only_kernels_set_scale: kernel noise gives a flow, and neither a weighed load nor a calibration confirms its
    scale, which is proportional to the thousand-kernel weight."""

    published: bool
    shape_volume_flow_m3_s: Number
    shape_volume_std_dev_m3_s: Number
    shape_flow_kg_s: Number
    shape_std_dev_kg_s: Number
    shape_verdict: str
    shape_missing_because: str | None
    kernel_flow_kg_s: Number
    kernel_std_dev_kg_s: Number
    kernel_verdict: str
    kernel_missing_because: str | None
    thousand_kernel_weight_g: Number
    only_kernels_set_scale: bool
    contradiction: str | None
    stretch_by_mean_force: Number
    kernel_bias_by_mean_force: Number


class StatusSweep(TypedDict):
    """Sweeps of the plate. due_in_s: null where none comes by schedule. last_update: what the last whole sweep or weighed mass
    changed, or why nothing. declined: sweeps that were due and not worth making (`sweep.when: information`)."""

    state: str
    progress_pct: float
    sweeps: int
    due_in_s: Number
    aborted_because: str | None
    declined: int
    declined_because: str | None
    last_update: str | None


class ValueWithStdDev(TypedDict):
    """A parameter."""

    value: float
    std_dev: float


class StatusParameters(TypedDict):
    """Parameters in use, by name; age_s since they were calibrated or updated. estimator: "physical", "alpha_beta", "table".
    scale_error: relative standard deviation of the force where no load of this machine and crop set the scale, else 0.
    carried_from: the crop whose weighed loads set it, where it is another one's, else ""."""

    version: int
    age_s: Number
    estimator: str
    values: dict[str, ValueWithStdDev]
    scale_error: float
    carried_from: str
    provenance: dict[str, str]


class StatusFault(TypedDict):
    """A fault that is shown. since_s: bus time."""

    code: str
    severity: str
    since_s: Number
    occurrences: int
    detail: str
    cause: str
    effect: str
    remedy: str


class StatusBus(TypedDict):
    """Counts since the start. dropped: never reached the engine; kernel_drops: nor the receiver. incomplete: messages of several
    frames that lacked one. late, refused: not sent. time_stamps: who stamped the frames."""

    interface: str
    channel: str
    time_stamps: str
    frames_per_s: float
    received: int
    dropped: int
    kernel_drops: int
    error_frames: int
    bus_offs: int
    interface_losses: int
    failures: int
    malformed: int
    incomplete: int
    sent: int
    late: int
    refused: int
    last_refusal: str | None


class NetworkPartner(TypedDict):
    """A node that has claimed an address."""

    address: int
    name: str


class StatusTaskController(TypedDict):
    """Connection to a task controller."""

    state: str
    server: int | None
    task_active: bool
    problem: str | None


class StatusNetwork(TypedDict):
    """Our NAME and address, and the other nodes. preferred_address: what the configuration asks for."""

    name: str | None
    address: int | None
    preferred_address: int
    claim: str
    partners: list[NetworkPartner]
    task_controller: StatusTaskController | None


class StatusSignals(TypedDict):
    """Rates of the impact sensors, aliasing by elevator speed (rpm), constant quantities, and notes on the mapping."""

    rate_hz: list[float]
    aliasing_std_dev_pct: dict[str, float]
    fixed: dict[str, float]
    notes: list[str]


class StatusStore(TypedDict):
    """The store. failing: why records cannot be written. pending batches wait, the oldest for waiting_s; records_dropped
    one-second records found no place in memory; replacements: times a damaged, removed or replaced file was put in order."""

    file: str
    note: str | None
    failing: str | None
    pending: int
    waiting_s: float
    committed: int
    records_dropped: int
    batches_refused: int
    replacements: int
    replaced_because: str


class StatusFigures(TypedDict):
    """What a running daemon is doing. windows: the last one-second records, quality and operating state by name. loads: the last
    ten with grain, or open, as `yieldmon load list --json` has them. waveform: None where it is switched off."""

    version: str
    uptime_s: float
    state: str
    units: str
    crop: StatusCrop
    now: StatusNow
    configuration: StatusConfiguration
    load: StatusLoad
    loads: list[ListedLoad]
    total: StatusTotal
    windows: list[dict[str, float | str | None]]
    zero_mv: Number
    zero_waits_for: str | None
    sweep: StatusSweep
    waveform: StatusWaveform | None
    parameters: StatusParameters
    faults: list[StatusFault]
    bus: StatusBus
    network: StatusNetwork
    signals: StatusSignals
    store: StatusStore


class Status(StatusFigures):
    """`yieldmon status --json`. age_s: of the figures; stale: older than they should be."""

    age_s: float
    stale: bool
