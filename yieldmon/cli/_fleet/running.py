"""`fleet run`: logs of many machines and days into a dataset."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from yieldmon.bus.log_files.logs import mend_of
from yieldmon.cli import _named_files
from yieldmon.cli._channels import with_channels
from yieldmon.cli._fleet.arguments import MOST_WORKERS
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import whole_number
from yieldmon.documents.fleet import FleetRunDocument, PartitionProblem, PoisonedDocument
from yieldmon.errors import InputError
from yieldmon.files.crops import misspelt
from yieldmon.files.plain_text import plain
from yieldmon.fleet import manifest, scheduling
from yieldmon.fleet.copies import with_copies
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.filesystem import is_remote
from yieldmon.fleet.identity import parameters_sha256, software
from yieldmon.fleet.partition import Manifest, Partition
from yieldmon.fleet.poisoned import by_name
from yieldmon.fleet.worker import DONE, FAILED, LEFT, SKIPPED, Outcome, Task, refused
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.config.configuration import Configuration
from yieldmon.units import counted

_SAID_EVERY_S = 10.0
_MOST_LEFT_OUT = 50
"""Lines on what a tree holds beside logs: of ten thousand, those on what is wrong would not be read."""
_Configured = tuple[Configuration, str]
"""And its hash."""


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when all that is in the source is in the dataset, 1 when something of it could not be used."""
    _check_options(args)
    found = manifest.load(args.source)
    for path in found.left_out[:_MOST_LEFT_OUT]:
        _say(f"{path}: left out, {_why_left_out(path)}")
    if (more := len(found.left_out) - _MOST_LEFT_OUT) > 0:
        _say(f"{more} more left out: they hold no log of a day (`left_out` of --json has them)")
    _say_alike(found.partitions)
    dataset = Dataset(args.out)
    configurations = _configurations(found.partitions, args)
    unusable = [*found.refused, *(each for each in configurations.values() if isinstance(each, InputError))]
    if args.strict and unusable:
        raise unusable[0]
    looked_at = _with_copies(found.partitions)
    partitions = [partition for partition in looked_at if len(partition.copies) < len(partition.logs)]
    usable = {partition.name for partition in partitions if not isinstance(configurations[partition.config], InputError)}
    token = dataset.begin(usable, lambda problem: _say(f"{problem}"))
    if not found.refused:
        _say_what_is_left(dataset, found.partitions)
    tasks, outcomes = _tasks(partitions, configurations, dataset, token, args.crop)
    try:
        with _interrupted_once(), _progress([task.partition for task in tasks]) as advance:

            def take(outcome: Outcome) -> None:
                if outcome.status == LEFT and not any(before.status == LEFT for before in outcomes):
                    _say(f"{outcome.name}: {outcome.why_left}; left to the next run; continuing with other days")
                outcomes.append(outcome)
                advance(outcome)

            scheduling.run_all(tasks, scheduling.Cluster(args.scheduler, args.workers, args.adaptive), take, _say)
    except KeyboardInterrupt:
        dataset.abandon(token)
        # A worker may have finished more than it has answered for.
        there = len(dataset.whole({partition.name for partition in partitions}))
        _say(f"interrupted; {there} of {len(partitions)} days are in {args.out}; run again to continue")
        raise
    dataset.withdraw_failures([outcome.name for outcome in outcomes if outcome.status == SKIPPED], token)
    if any(outcome.status == LEFT for outcome in outcomes):
        dataset.abandon(token)
    else:
        dataset.end(token)
    document = _document(args.out, outcomes, looked_at, found)
    if args.json:
        print_json(document)
    else:
        print("\n".join(map(plain, _lines_of(document))), file=sys.stderr)
    return 1 if document["poisoned"] or document["left"] else 0


def _why_left_out(path: str) -> str:
    mend = mend_of(path.rpartition("/")[2])
    return f"not read as a log: {mend} if it is one" if mend else "holds no log of a day (MACHINE/DAY/LOGS)"


def _check_options(args: argparse.Namespace) -> None:
    whole_number("--workers", args.workers, 0, MOST_WORKERS)
    if meant := misspelt(args.crop):
        raise InputError("--crop", f"is {args.crop!r}", meant)
    if args.scheduler and args.adaptive:
        raise InputError("--adaptive", "is given together with --scheduler", "only one; a cluster adapts on its own")


def _tasks(
    partitions: Sequence[Partition],
    configurations: Mapping[str, _Configured | InputError],
    dataset: Dataset,
    token: str,
    crop: str,
) -> tuple[list[Task], list[Outcome]]:
    """What is to be measured, and the outcomes of days whose configuration cannot be used; crop: of days that name none."""
    tasks, outcomes = list[Task](), list[Outcome]()
    for partition in partitions:
        configured = configurations[partition.config]
        if isinstance(configured, InputError):
            # By the name of its folder, as it is called on each machine that runs this.
            folder = Path(partition.config).parent
            outcomes.append(refused(partition, dataset, token, by_name(str(configured), {str(folder): folder.name})))
            continue
        # That of the parameters is theirs: with other parameters the logs and tickets are the same.
        of_parameters = configured[0].parameters.provenance.get("crop", "")
        whole = replace(partition, crop=partition.crop or ("" if of_parameters else crop))
        tasks.append(Task(whole, dataset.address, token, *configured, software()))
    return tasks, outcomes


def _say(line: str) -> None:
    print(plain(f"yieldmon: {line}"), file=sys.stderr)


def _with_copies(partitions: tuple[Partition, ...]) -> tuple[Partition, ...]:
    found = with_copies(partitions)
    for partition in found:
        for log, same in partition.copies:
            _say(f"{log}: left out, holds the same as {same}")
    return found


def _say_alike(partitions: Sequence[Partition]) -> None:
    """Machines whose names differ in capitals alone, which some computers take for one folder."""
    alike: dict[str, dict[str, None]] = {}
    for partition in partitions:
        alike.setdefault(partition.machine.casefold(), {})[partition.machine] = None
    for names in alike.values():
        if len(names) > 1:
            count = f"differ only in upper and lower case and count as {len(names)} machines"
            _say(f"{' and '.join(names)} {count}; use one name for one machine")


def _say_what_is_left(dataset: Dataset, partitions: Sequence[Partition]) -> None:
    """Days that an earlier run measured and that are not in the source any more, as after a folder was renamed; for a source that
    was read whole."""
    others = Counter(name.partition("/")[0] for name in {*dataset.names()} - {partition.name for partition in partitions})
    for folder, days in sorted(others.items()):
        there, stay = ("is", "it stays until its folder is") if days == 1 else ("are", "they stay until their folders are")
        _say(f"{folder}: {counted(days, 'day')} {there} in {dataset.address} and not in the source; {stay} removed")


@contextmanager
def _interrupted_once() -> Iterator[None]:
    """After the first Ctrl-C others are ignored while the workers are stopped."""

    def interrupt(*_: object) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _configurations(partitions: Sequence[Partition], args: argparse.Namespace) -> dict[str, _Configured | InputError]:
    """Each configuration and its hash, or why it cannot be used; "" is that of machines without one of their own.

    Raises InputError where that, or --params, cannot be used.
    """
    parameters = _named_files.parameters(args.params) if args.params is not None else None
    default = args.config if args.config is not None else str(shipped("config/yieldmon.yaml"))

    def configured(path: str) -> _Configured:
        if is_remote(path):
            raise InputError(path, "is a remote configuration", "a configuration on this machine (--config, or in a manifest)")
        loaded = with_channels(configuration.load(path), args.channels)
        if parameters is not None:
            loaded = replace(loaded, parameters=parameters)
        return loaded, parameters_sha256(loaded)

    found: dict[str, _Configured | InputError] = {"": configured(default)}
    for path in sorted({partition.config for partition in partitions} - {""}):
        try:
            found[path] = configured(path)
        except InputError as error:
            found[path] = error
    return found


def _document(out: str, outcomes: Sequence[Outcome], partitions: Sequence[Partition], found: Manifest) -> FleetRunDocument:
    counts = Counter(outcome.status for outcome in outcomes)
    return {
        "dataset": out,
        "partitions": len(outcomes),
        "done": counts[DONE],
        "skipped": counts[SKIPPED],
        "failed": counts[FAILED],
        "left": counts[LEFT],
        "frames": sum(outcome.frames for outcome in outcomes),
        "seconds": sum(outcome.seconds for outcome in outcomes),
        "left_out": list(found.left_out),
        "copies": [{"log": log, "same_as": same} for partition in partitions for log, same in partition.copies],
        "poisoned": [
            *(PoisonedDocument(partition="", where=error.where, problem=str(error)) for error in found.refused),
            *(
                PoisonedDocument(partition=outcome.name, where=item.where, problem=item.problem)
                for outcome in sorted(outcomes, key=lambda outcome: outcome.name)
                for item in outcome.poisoned
            ),
        ],
        "why_left": [
            {"partition": outcome.name, "problem": outcome.why_left}
            for outcome in sorted(outcomes, key=lambda outcome: outcome.name)
            if outcome.status == LEFT
        ],
        "doubtful": [
            {"partition": outcome.name, "problem": problem}
            for outcome in sorted(outcomes, key=lambda outcome: outcome.name)
            for problem in outcome.damages
        ],
    }


def _lines_of(document: FleetRunDocument) -> list[str]:
    failed = [item for item in document["poisoned"] if item["where"] == item["partition"]]
    parts = [item for item in document["poisoned"] if item["where"] != item["partition"]]
    lines = [*_by_machine("not measured", failed), *_by_machine("left out", parts)]
    lines += [*_by_machine("left to the next run", document["why_left"])]
    lines += [f"doubtful: {item['partition']}: {item['problem']}" for item in document["doubtful"]]
    lines.append(
        f"{document['dataset']}: {document['done']} measured, {document['skipped']} already there, {document['failed']} failed"
        + (f", {document['left']} left to the next run" if document["left"] else "")
        + f"; {counted(document['frames'], 'frame')}"
    )
    return lines


def _by_machine(what: str, items: Sequence[PartitionProblem]) -> list[str]:
    """A line for each problem of a machine."""
    found: dict[tuple[str, str], list[str]] = {}
    for item in items:
        found.setdefault((item["partition"].partition("/")[0], item["problem"]), []).append(item["partition"])
    lines = []
    for (machine, problem), names in found.items():
        where = names[0] if len(names) == 1 else f"{machine} ({len(names)} days)"
        lines.append(f"{what}: {where}: {problem}" if where else f"{what}: {problem}")
    return lines


@contextmanager
def _progress(partitions: Sequence[Partition]) -> Iterator[Callable[[Outcome], None]]:
    """Time left by the bytes of the logs: a bar on a terminal, else a line now and then."""
    sizes = {partition.name: sum(_size(log) for log in partition.logs) or 1 for partition in partitions}
    total = sum(sizes.values())
    if not sys.stderr.isatty():
        yield _lines(sizes, total)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(), TextColumn("{task.percentage:.0f} %"), TextColumn("{task.fields[done]} days"), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=total, done=0)

        def advance(outcome: Outcome) -> None:
            bar.update(task, advance=sizes[outcome.name], done=bar.tasks[0].fields["done"] + 1)

        yield advance


def _lines(sizes: dict[str, int], total: int) -> Callable[[Outcome], None]:
    began = said = time.monotonic()
    done = measured = count = 0

    def advance(outcome: Outcome) -> None:
        nonlocal said, done, measured, count
        done, count = done + sizes[outcome.name], count + 1
        # Days that are there already say nothing about how long the others take.
        measured += sizes[outcome.name] if outcome.status != SKIPPED else 0
        now = time.monotonic()
        if now - said >= _SAID_EVERY_S:
            said = now
            left = f", {(now - began) * (total - done) / measured:.0f} s left" if measured else ""
            print(f"yieldmon: {count} of {len(sizes)} days{left}", file=sys.stderr)

    return advance


def _size(log: str) -> int:
    try:
        return 0 if is_remote(log) else Path(log).stat().st_size
    except OSError:
        return 0
