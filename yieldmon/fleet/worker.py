"""The task of a worker: one partition, measured and committed unless it is there already."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

from yieldmon.errors import InputError
from yieldmon.files import digests
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.filesystem import local_copies
from yieldmon.fleet.identity import Identity, Software, inputs_sha256, software
from yieldmon.fleet.manifest import Partition
from yieldmon.fleet.measuring import Poisoned, by_name, measure, write_provenance
from yieldmon.service.configuration import Configuration

DONE, SKIPPED, FAILED = "done", "skipped", "failed"


@dataclass(frozen=True)
class Task:
    """One partition, and all that a worker elsewhere needs for it. token: of the run that may write."""

    partition: Partition
    dataset: str
    token: str
    configured: Configuration
    parameters_sha256: str
    software: Software


@dataclass(frozen=True)
class Outcome:
    """What became of a partition. status: DONE, SKIPPED (there already) or FAILED; frames: read for it."""

    name: str
    status: str
    frames: int = 0
    seconds: int = 0
    poisoned: tuple[Poisoned, ...] = ()


def work(task: Task) -> Outcome:
    """Measure a partition, unless the dataset has it from the same inputs, parameters and software.

    Raises
    ------
    dataset.Superseded
        Another run has taken the dataset over.
    OSError
        The storage fails.
    """
    dataset = Dataset(task.dataset)
    try:
        if software() != task.software:
            ours, theirs = (f"{s.version} ({s.source_sha256[:12]}, {s.libraries})" for s in (software(), task.software))
            raise InputError("worker", f"runs yieldmon {ours}", f"that of the client, {theirs}")
        return _measured(task, dataset)
    except InputError as error:
        return failed(task, str(error))


def failed(task: Task, problem: str) -> Outcome:
    """Note in the dataset that a partition cannot be measured."""
    partition = task.partition
    content = {"machine": partition.machine, "day": partition.day, "problem": problem}
    Dataset(task.dataset).fail(partition.name, content, task.token)
    return Outcome(partition.name, FAILED, poisoned=(Poisoned(partition.name, problem),))


def _measured(task: Task, dataset: Dataset) -> Outcome:
    partition = task.partition
    with ExitStack() as stack:
        folder = stack.enter_context(dataset.workspace())
        addresses = (*partition.logs, *((partition.tickets,) if partition.tickets else ()))
        paths = stack.enter_context(local_copies(addresses, folder))
        logs = paths[: len(partition.logs)]
        tickets = paths[-1] if partition.tickets else ""
        names = dict(zip(logs, _names(partition.logs), strict=True))
        hashes = [(names[path], digests.of_file(path)) for path in logs]
        inputs = inputs_sha256(hashes, digests.of_file(tickets) if tickets else "", partition.crop)
        identity = Identity(task.software, task.parameters_sha256, inputs)
        there = dataset.commit_of(partition.name)
        if there is not None and there.key == identity.key:
            return Outcome(partition.name, SKIPPED, poisoned=tuple(Poisoned(**item) for item in there.content["poisoned"]))
        output = folder / "output"
        output.mkdir()
        try:
            measured = measure(logs, tickets, partition.crop, task.configured, output, names)
        except InputError as error:
            raise InputError(by_name(error.where, names), by_name(error.problem, names), error.expected) from error
        write_provenance(measured, identity, hashes, task.configured, output)
        document = measured.document
        content = {
            "key": identity.key, "software": asdict(identity.software), "parameters_sha256": identity.parameters_sha256,
            "inputs_sha256": identity.inputs_sha256, "poisoned": [asdict(item) for item in measured.poisoned],
        }  # fmt: skip
        dataset.commit(partition.name, output, content, task.token)
        return Outcome(partition.name, DONE, document["frames"], document["windows"], measured.poisoned)


def _names(logs: tuple[str, ...]) -> list[str]:
    """The logs' own names; with their folder where two are called the same."""
    names = [Path(log).name for log in logs]
    return [name if names.count(name) == 1 else f"{Path(log).parent.name}/{name}" for log, name in zip(logs, names, strict=True)]
