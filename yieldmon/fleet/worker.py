"""The task of a worker: one partition, measured and committed unless it exists already."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from yieldmon.errors import OF_THE_MEDIUM, InputError, of_the_computer, system_text
from yieldmon.files import digests
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.filesystem import local_copies
from yieldmon.fleet.identity import Identity, Software, inputs_sha256, software
from yieldmon.fleet.measuring import measure, write_provenance
from yieldmon.fleet.partition import Partition
from yieldmon.fleet.poisoned import Poisoned, by_name
from yieldmon.fleet.tables import TABLES
from yieldmon.repeats import repeated
from yieldmon.service.config.configuration import Configuration

DONE, SKIPPED, FAILED, LEFT = "done", "skipped", "failed", "left"
_COPY, _UNREADABLE = "copy", "unreadable"


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
    """The outcome of a partition.

    Parameters
    ----------
    name : str
    status : str
        DONE; SKIPPED, as the dataset has it already; FAILED; or LEFT to the next run, by no fault of the partition.
    frames, seconds : int
        Read, and measured.
    poisoned : tuple of Poisoned
        Logs and tickets that could not be used.
    damages : tuple of str
        A line for each damaged place of its logs.
    why_left : str
        One line; "" unless LEFT.
    """

    name: str
    status: str
    frames: int = 0
    seconds: int = 0
    poisoned: tuple[Poisoned, ...] = ()
    damages: tuple[str, ...] = ()
    why_left: str = ""


def work(task: Task) -> Outcome:
    """Measure a partition, unless the dataset has it from the same inputs, parameters and software.

    A place that is full, read-only or not to be used by this user leaves the partition to the next run.

    Raises
    ------
    dataset.Superseded
        Another run has taken the dataset over.
    OSError
        The storage fails in another way, which it may not do again.
    """
    try:
        return _worked(task)
    except OSError as error:
        if error.errno not in OF_THE_MEDIUM:
            raise
        error.filename = Dataset(task.dataset).place_of(error.filename)
        return left_to_next_run(task, error)


def left_to_next_run(task: Task, error: BaseException) -> Outcome:
    """A partition that the next run is to measure: the computer failed, so nothing is noted in the dataset.

    Raises Superseded.
    """
    with suppress(OSError):
        Dataset(task.dataset).require(task.token)
    return Outcome(task.partition.name, LEFT, why_left=system_text(error))


def _worked(task: Task) -> Outcome:
    dataset = Dataset(task.dataset)
    if software() != task.software:
        # Not noted as a failure of the day: one worker that was not updated would soon have failed all of them.
        dataset.require(task.token)
        ours, theirs = (f"{s.version} ({s.source_sha256[:12]}, {s.libraries})" for s in (software(), task.software))
        why = f"a worker runs yieldmon {ours}; expected that of the client, {theirs}"
        return Outcome(task.partition.name, LEFT, why_left=why)
    try:
        return _measured(task, dataset)
    except InputError as error:
        computer = of_the_computer(error)
        if computer is not None:
            raise computer from error
        return failed(task, str(error))


def failed(task: Task, problem: str) -> Outcome:
    """Note in the dataset that a partition cannot be measured."""
    return refused(task.partition, Dataset(task.dataset), task.token, problem)


def refused(partition: Partition, dataset: Dataset, token: str, problem: str) -> Outcome:
    """Note in the dataset that a partition cannot be measured, for which there is no task."""
    dataset.fail(partition.name, {"machine": partition.machine, "day": partition.day, "problem": problem}, token)
    return Outcome(partition.name, FAILED, poisoned=(Poisoned(partition.name, problem),))


def found_in_dataset(task: Task) -> Outcome | None:
    """The partition where the dataset has it from these inputs, parameters and software: a worker may have died, or have been
    thought dead, between its commit and its answer. None where it is not there, or its inputs cannot be looked at."""
    dataset = Dataset(task.dataset)
    try:
        with _inputs(task, dataset) as inputs:
            return _skipped(task, dataset, inputs)
    except (InputError, OSError):
        return None


@dataclass(frozen=True)
class _Inputs:
    """The files that a partition is measured from, on this machine.

    Parameters
    ----------
    folder : Path
        To work in.
    names : dict of str to str
        Name of each log, by path.
    hashes : list of (str, str)
        Name and SHA-256 of each log that is measured.
    usable : list of str
        Paths of these.
    unreadable : list of (str, InputError)
        Name and reason, of logs or tickets.
    tickets : str
        Path of their table; "" where there is none to read.
    identity : Identity
    states : dict
        Size and time of the last write of each file, by path, before it was read.
    """

    folder: Path
    names: dict[str, str]
    hashes: list[tuple[str, str]]
    usable: list[str]
    unreadable: list[tuple[str, InputError]]
    tickets: str
    identity: Identity
    states: dict[str, tuple[int, int] | None]

    def changed(self) -> list[str]:
        """Names of the files that were written to since `states` was taken, as by a transfer under way."""
        return [self.names.get(path, Path(path).name) for path, before in self.states.items() if _written(path) != before]


@contextmanager
def _inputs(task: Task, dataset: Dataset) -> Iterator[_Inputs]:
    partition = task.partition
    with ExitStack() as stack:
        folder = stack.enter_context(dataset.workspace())
        addresses = (*partition.logs, *((partition.tickets,) if partition.tickets else ()))
        paths = stack.enter_context(local_copies(addresses, folder))
        logs = paths[: len(partition.logs)]
        tickets = paths[-1] if partition.tickets else ""
        names = dict(zip(logs, _names(partition.logs), strict=True))
        written = {path: _written(path) for path in paths}
        repeated = dict(partition.copies)
        # What is not measured is part of the inputs too: a log that can be read again is measured again.
        states = [(names[p], _COPY if log in repeated else _state(p)) for p, log in zip(logs, partition.logs, strict=True)]
        hashes = [(name, state) for name, state in states if isinstance(state, str) and state != _COPY]
        unreadable = [(name, state) for name, state in states if isinstance(state, InputError)]
        of_tickets = _state(tickets) if tickets else ""
        if isinstance(of_tickets, InputError):
            # The day is measured without, as where its tickets are damaged.
            called = Path(partition.tickets).name
            reason = InputError(by_name(of_tickets.where, {tickets: called}), of_tickets.problem, of_tickets.expected)
            unreadable.append((called, reason))
            tickets, of_tickets = "", _UNREADABLE
        measurable = {name for name, _ in hashes}
        inputs = inputs_sha256(
            [(name, state if isinstance(state, str) else _UNREADABLE) for name, state in states],
            of_tickets,
            partition.crop,
            partition.sharing,
        )
        identity = Identity(task.software, task.parameters_sha256, inputs)
        usable = [path for path in logs if names[path] in measurable]
        yield _Inputs(folder, names, hashes, usable, unreadable, tickets, identity, written)


def _skipped(task: Task, dataset: Dataset, inputs: _Inputs) -> Outcome | None:
    try:
        commit = dataset.commit_of(task.partition.name)
        if commit is None or commit.key != inputs.identity.key:
            return None
        for table in TABLES:
            dataset.check(commit, table)
    except InputError as error:
        if of_the_computer(error) is not None:
            raise
        # Damaged: measured again.
        return None
    poisoned = tuple(Poisoned(**item) for item in commit.content["poisoned"])
    return Outcome(task.partition.name, SKIPPED, poisoned=poisoned, damages=tuple(commit.content.get("damages", ())))


def _measured(task: Task, dataset: Dataset) -> Outcome:
    partition = task.partition
    with _inputs(task, dataset) as inputs:
        names, unreadable, identity = inputs.names, inputs.unreadable, inputs.identity
        if not inputs.usable:
            problem = by_name(str(unreadable[0][1]), names) if unreadable else "each log repeats one of another day"
            return failed(task, problem)
        skipped = _skipped(task, dataset, inputs)
        if skipped is not None:
            return skipped
        output = inputs.folder / "output"
        output.mkdir()
        try:
            measured = measure(inputs.usable, inputs.tickets, partition, task.configured, output, names)
        except InputError as error:
            if inputs.changed():
                return _still_written(task, dataset, inputs)
            raise InputError(by_name(error.where, names), by_name(error.problem, names), error.expected) from error
        if inputs.changed():
            return _still_written(task, dataset, inputs)
        left_out = tuple(Poisoned(name, by_name(str(error), names)) for name, error in unreadable)
        measured = replace(measured, poisoned=left_out + measured.poisoned)
        write_provenance(measured, identity, inputs.hashes, task.configured, output)
        document = measured.document
        content = {
            "key": identity.key, "software": asdict(identity.software), "parameters_sha256": identity.parameters_sha256,
            "inputs_sha256": identity.inputs_sha256, "poisoned": [asdict(item) for item in measured.poisoned],
            "damages": document["damages"], "samples": dict(measured.samples),
        }  # fmt: skip
        dataset.commit(partition.name, output, content, task.token)
        damages = tuple(document["damages"])
        return Outcome(partition.name, DONE, document["frames"], document["windows"], measured.poisoned, damages)


def _still_written(task: Task, dataset: Dataset, inputs: _Inputs) -> Outcome:
    dataset.require(task.token)
    why = f"{inputs.changed()[0]} was written to while it was measured; expected files whose transfer is complete"
    return Outcome(task.partition.name, LEFT, why_left=why)


def _written(path: str) -> tuple[int, int] | None:
    """Size and time of the last write; None where there is no file."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns


def _state(log: str) -> str | InputError:
    """SHA-256 of a log's content, or why it cannot be read."""
    try:
        return digests.of_file(log)
    except InputError as error:
        if of_the_computer(error) is not None:
            raise
        return error


def _names(logs: tuple[str, ...]) -> list[str]:
    """The logs' own names; with as many of the folders above as tell those apart that are called the same."""
    depth = 1
    names = [Path(log).name for log in logs]
    while twice := {*repeated(names)}:
        depth += 1
        names = ["/".join(log.split("/")[-depth:]) if name in twice else name for log, name in zip(logs, names, strict=True)]
    return names
