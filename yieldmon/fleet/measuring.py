"""Measures one partition with the same function as `process`, and collects its events as tables."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.log_order import in_time_order
from yieldmon.documents.process import ProcessSummary
from yieldmon.engine.health import FaultEvent
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import Result, WindowResult
from yieldmon.engine.runs import FrameRun
from yieldmon.engine.self_calibration.parameter_updater import ParametersChanged
from yieldmon.engine.sweeps.plate import SweepEnded
from yieldmon.errors import InputError, of_the_computer
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import machine_file, parameter_file
from yieldmon.files.crops import shipped_name
from yieldmon.finite import finite
from yieldmon.fleet import tables
from yieldmon.fleet.identity import Identity
from yieldmon.fleet.partition import Partition
from yieldmon.fleet.poisoned import Poisoned, by_name
from yieldmon.fleet.ticket_rows import ticket_rows
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.logs import log_record
from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch
from yieldmon.service.logs.tables import open_table
from yieldmon.service.storage.rows import SecondRow

_SAMPLES_BYTES = 16


@dataclass(frozen=True)
class Measured:
    """A measured partition.

    Parameters
    ----------
    document : ProcessSummary
        As `process --json` prints it.
    crop : str
    poisoned : tuple of Poisoned
        Logs and tickets that could not be used.
    samples : mapping of str to str
        Hash of the impact sensors' samples, without their times, by each log's name.
    """

    document: ProcessSummary
    crop: str
    poisoned: tuple[Poisoned, ...]
    samples: Mapping[str, str]


@dataclass(slots=True)
class _Span:
    """A log's part of a record.

    Parameters
    ----------
    log : str
    first_row : int
        Of the rows that came while it was read.
    frames, ours : int
        Frames, and how many of them the engine took.
    start_s, end_s : float
        Times of the first and the last frame.
    sensors : dict of int to hash
        Hash of each impact sensor's samples.
    repeats : bool
        Whether it begins with frames of a log before it.
    """

    log: str
    first_row: int
    frames: int = 0
    ours: int = 0
    start_s: float = float("nan")
    end_s: float = float("nan")
    sensors: dict[int, Any] = field(default_factory=dict)
    repeats: bool = False

    def take(self, run: FrameRun) -> None:
        if not isfinite(self.start_s):
            self.start_s = float(run.times_s[0])
        self.end_s = float(run.times_s[-1])
        for number, samples in enumerate(run.samples):
            if samples.rows.size:
                digest = self.sensors.setdefault(number, hashlib.blake2b(digest_size=_SAMPLES_BYTES))
                digest.update(np.ascontiguousarray(samples.rows))

    @property
    def samples(self) -> str:
        """Counters and samples of all sensors; "" where there are none."""
        return "-".join(self.sensors[number].hexdigest() for number in sorted(self.sensors))


@dataclass
class _Taken:
    """What is noted of a record while it is measured."""

    configured: Configuration
    rows: list[tuple[float, float, float]] = field(default_factory=list)
    spans: list[_Span] = field(default_factory=list)
    faults: list[dict[str, Any]] = field(default_factory=list)
    sweeps: list[dict[str, Any]] = field(default_factory=list)
    parameters: list[dict[str, Any]] = field(default_factory=list)

    def row(self, row: SecondRow) -> None:
        self.rows.append((row.time_s, row.duration_s, row.mass_kg))

    def progress(self, stretch: Stretch | EndOfLog) -> None:
        if isinstance(stretch, EndOfLog):
            self.spans[-1].log, self.spans[-1].repeats = stretch.path, stretch.repeats
            self.spans.append(_Span("", len(self.rows)))
            return
        span = self.spans[-1]
        span.frames += stretch.frames
        span.ours += stretch.ours
        for run in stretch.runs:
            span.take(run)

    def results(self, results: Sequence[Result]) -> None:
        for result in results:
            time_s = result.record.time_s if isinstance(result, WindowResult) else result.frames[0].time_s
            for event in result.events:
                if isinstance(event, FaultEvent):
                    self._fault(event)
                elif isinstance(event, SweepEnded):
                    self.sweeps.append({
                        "sweep_id": event.sweep_id, "time_s": time_s, "state": event.state.name, "reason": event.reason,
                        "angles_deg": " ".join(f"{angle:g}" for angle in event.angles_deg),
                        "parameter_version": event.parameter_version,
                    })  # fmt: skip
                elif isinstance(event, ParametersChanged):
                    self.parameters += _parameter_rows(event.parameters, time_s, event.origin, event.reason)

    def _fault(self, event: FaultEvent) -> None:
        if event.active:
            self.faults.append({"code": event.code.value, "begin_s": event.time_s, "end_s": None, "detail": event.detail})
            return
        for row in reversed(self.faults):
            if row["code"] == event.code.value and row["end_s"] is None:
                row["end_s"] = event.time_s
                return


def measure(
    logs: Sequence[str], tickets: str, partition: Partition, configured: Configuration, folder: Path, names: Mapping[str, str]
) -> Measured:
    """Measure a partition and write all its tables but the provenance.

    Parameters
    ----------
    logs : sequence of str
        Paths, by name; one record in the order of their times (`in_time_order`). One that cannot be read is left out and named
        in the result.
    tickets : str
        Path of a table of tickets, "" for none. A number means the log in that place of `names`; a name the log of that name.
    partition : Partition
        What is known of it beside its files; no crop: that of the parameters.
    configured : Configuration
    folder : Path
        Where the tables are written.
    names : dict of str to str
        Name of each log of the day as it is to be called, in order; also of those that are not measured.

    Returns
    -------
    Measured

    Raises
    ------
    InputError
        Nothing of the partition can be used, or this computer cannot read it at present (`errors.of_the_computer`).
    """
    usable, poisoned = list(logs), []
    while True:
        usable = in_time_order(usable)
        try:
            taken, document, monitor = _record(usable, configured, folder / f"{tables.RECORDS}.parquet")
            break
        except InputError as error:
            culprit = _culprit(error, usable)
            if culprit is None or len(usable) == 1 or of_the_computer(error) is not None:
                raise
            later = usable[usable.index(culprit) + 1 :]
            faulty = {culprit: error} | {log: problem for log in later if (problem := _problem(log)) is not None}
            if len(faulty) == len(usable):
                raise
            usable = [log for log in usable if log not in faulty]
            poisoned += [Poisoned(names[log], by_name(str(problem), names)) for log, problem in faulty.items()]
    rows = _log_rows(taken, names)
    covered, unmatched = ticket_rows(rows, tickets, list(names.values()), taken.rows, partition)
    tables.write(tables.LOADS, [*_load_rows(monitor), *rows, *covered], folder / "loads.parquet")
    start_s = taken.rows[0][0] if taken.rows else float("nan")
    first = _parameter_rows(configured.parameters, start_s, ParameterOrigin.FILE, "as configured")
    tables.write(tables.PARAMETERS, [*first, *taken.parameters], folder / "parameters.parquet")
    tables.write(tables.SWEEPS, taken.sweeps, folder / "sweeps.parquet")
    tables.write(tables.FAULTS, taken.faults, folder / "faults.parquet")
    crop = partition.crop or configured.parameters.provenance.get("crop", "")
    crop = shipped_name(crop) or crop
    document["damages"] = [by_name(text, names) for text in [*document["damages"], *_without_ours(taken)]]
    samples = {names[span.log]: span.samples for span in taken.spans if span.log and span.samples}
    return Measured(document, crop, (*poisoned, *unmatched), samples)


def write_provenance(
    measured: Measured, identity: Identity, logs: list[tuple[str, str]], configured: Configuration, folder: Path
) -> None:
    """Write what the partition's tables follow from. logs: name and SHA-256."""
    document = measured.document
    row = {
        "key": identity.key, "software_version": identity.software.version, "source_sha256": identity.software.source_sha256,
        "libraries": identity.software.libraries, "parameters_sha256": identity.parameters_sha256,
        "inputs_sha256": identity.inputs_sha256, "crop": measured.crop, "logs": json.dumps(logs),
        "poisoned": json.dumps([asdict(item) for item in measured.poisoned]), "damages": json.dumps(document["damages"]),
        "frames": document["frames"], "frames_of_ours": document["frames_of_ours"],
        "frames_malformed": document["frames_malformed"], "seconds": document["windows"],
        "total_mass_kg": document["total_mass_kg"], "dry_mass_kg": document["dry_mass_kg"],
        "zero_known": document["zero_known"], "machine_document": json.dumps(machine_file.to_document(configured.machine)),
        "parameters_document": json.dumps(parameter_file.to_document(configured.parameters)),
    }  # fmt: skip
    tables.write(tables.PROVENANCE, [row], folder / "provenance.parquet")


def _record(logs: Sequence[str], configured: Configuration, path: Path) -> tuple[_Taken, ProcessSummary, Monitor]:
    taken = _Taken(configured, spans=[_Span("", 0)])
    with open_table(str(path)) as table:

        def take(row: SecondRow) -> None:
            table.write(row)
            taken.row(row)

        summary, monitor = log_record.measure(logs, configured, take, progress=taken.progress, take_results=taken.results)
    return taken, log_record.document(summary, monitor), monitor


def _without_ours(taken: _Taken) -> list[str]:
    """The logs that add nothing to the day, a line each."""
    nothing = [span for span in taken.spans if span.log and not span.ours and not span.repeats]
    whys = (f"none of its {s.frames} frames is one that yieldmon takes in" if s.frames else "no frame at all" for s in nothing)
    return [f"{span.log}: {why}" for span, why in zip(nothing, whys, strict=True)]


def _problem(log: str) -> InputError | None:
    """Why a log cannot be read; None where it can. Once one cannot, all are looked at, so as not to begin anew with each."""
    notes = LogNotes(on_damage=lambda damage: None)
    try:
        for _ in iter_blocks(log, notes):
            pass
    except InputError as error:
        if of_the_computer(error) is not None:
            raise
        return error
    return None


def _culprit(error: InputError, logs: Sequence[str]) -> str | None:
    """The log that an error speaks of: the longest of the names that it begins with."""
    named = [log for log in logs if error.where.startswith(log)]
    return max(named, key=len, default=None)


def _log_rows(taken: _Taken, names: Mapping[str, str]) -> list[dict[str, Any]]:
    spans = [span for span in taken.spans if span.log]
    firsts = [span.first_row for span in spans] + [len(taken.rows)]
    for place, span in enumerate(spans[1:], 1):
        # A log's last second closes with the first frames of the next.
        while firsts[place] < firsts[place + 1] and _middle_s(taken.rows[firsts[place]]) < span.start_s:
            firsts[place] += 1
    rows = []
    for span, first, last in zip(spans, firsts, firsts[1:], strict=False):
        rows.append({
            "kind": tables.LOG, "name": names[span.log], "first_number": first + 1, "last_number": last,
            "start_s": finite(span.start_s), "end_s": finite(span.end_s), "seconds": last - first,
            "measured_kg": float(sum(mass for _, _, mass in taken.rows[first:last])),
        })  # fmt: skip
    return rows


def _middle_s(row: tuple[float, float, float]) -> float:
    return row[0] - 0.5 * row[1]


def _load_rows(monitor: Monitor) -> list[dict[str, Any]]:
    return [
        {
            "kind": tables.LOAD, "name": str(load.number), "start_s": finite(load.start_s), "end_s": finite(load.end_s),
            "measured_kg": load.measured_kg, "std_dev_kg": finite(load.std_dev_kg), "complete": load.complete,
        }
        for load in monitor.loads
    ]  # fmt: skip


def _parameter_rows(known: ParameterSet, time_s: float, origin: ParameterOrigin, reason: str) -> list[dict[str, Any]]:
    return [
        {
            "time_s": finite(time_s), "version": known.version, "origin": origin, "reason": reason, "name": name,
            "value": value, "std_dev": known.standard_deviation(name),
        }
        for name, value in known.values.items()
    ]  # fmt: skip
