"""`fleet run`: logs of many machines and days into a dataset."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

from yieldmon.cli._json import print_json
from yieldmon.errors import InputError
from yieldmon.files import parameter_file
from yieldmon.files.plain_text import plain
from yieldmon.fleet import manifest, scheduling
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.filesystem import is_remote
from yieldmon.fleet.identity import parameters_sha256, software
from yieldmon.fleet.manifest import Partition
from yieldmon.fleet.worker import DONE, FAILED, SKIPPED, Outcome, Task
from yieldmon.resources import shipped
from yieldmon.service import configuration
from yieldmon.service.configuration import Configuration

_SAID_EVERY_S = 10.0


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when all that is in the source is in the dataset, 1 when something of it could not be used."""
    if not 0 <= args.workers <= 1024:
        raise InputError("--workers", f"is {args.workers}", "a whole number from 0 to 1024")
    if args.scheduler and args.adaptive:
        raise InputError("--adaptive", "is given beside --scheduler", "one of them; a cluster elsewhere has its own adaptation")
    found = manifest.load(args.source)
    for path in found.left_out:
        print(plain(f"yieldmon: {path}: left out, holds no log of a day (MACHINE/DAY/LOGS)"), file=sys.stderr)
    dataset = Dataset(args.out)
    configured = _configurations(found.partitions, args)
    token = dataset.begin()
    tasks = [
        Task(_with_crop(partition, configured, args.crop), dataset.address, token, *configured(partition.config), software())
        for partition in found.partitions
    ]
    outcomes: list[Outcome] = []
    cluster = scheduling.Cluster(args.scheduler, args.workers, args.adaptive)
    with _progress(found.partitions) as advance:

        def take(outcome: Outcome) -> None:
            outcomes.append(outcome)
            advance(outcome)

        scheduling.run_all(tasks, cluster, take, lambda line: print(f"yieldmon: {line}", file=sys.stderr))
    dataset.end(token)
    document = _document(args.out, outcomes)
    if args.json:
        print_json(document)
    else:
        print("\n".join(map(plain, _lines_of(document))), file=sys.stderr)
    return 1 if document["poisoned"] else 0


def _configurations(partitions: Sequence[Partition], args: argparse.Namespace) -> Callable[[str], tuple[Configuration, str]]:
    """Each partition's configuration and its hash; all are read before the work begins."""
    parameters = parameter_file.load(args.params) if args.params is not None else None
    default = args.config if args.config is not None else str(shipped("config/yieldmon.yaml"))

    @cache
    def configured(path: str) -> tuple[Configuration, str]:
        if is_remote(path):
            raise InputError(path, "is a remote configuration", "a configuration on this machine (--config, or in a manifest)")
        loaded = configuration.load(path or default)
        if parameters is not None:
            loaded = replace(loaded, parameters=parameters)
        return loaded, parameters_sha256(loaded)

    for partition in partitions:
        configured(partition.config)
    return configured


def _with_crop(partition: Partition, configured: Callable[[str], tuple[Configuration, str]], otherwise: str) -> Partition:
    loaded, _ = configured(partition.config)
    return replace(partition, crop=partition.crop or loaded.parameters.provenance.get("crop", "") or otherwise)


def _document(out: str, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    counts = {status: sum(outcome.status == status for outcome in outcomes) for status in (DONE, SKIPPED, FAILED)}
    return {
        "dataset": out,
        "partitions": len(outcomes),
        **counts,
        "frames": sum(outcome.frames for outcome in outcomes),
        "seconds": sum(outcome.seconds for outcome in outcomes),
        "poisoned": [
            {"partition": outcome.name, **asdict(item)}
            for outcome in sorted(outcomes, key=lambda outcome: outcome.name)
            for item in outcome.poisoned
        ],
    }


def _lines_of(document: dict[str, Any]) -> list[str]:
    lines = [f"poisoned: {item['partition']}: {item['problem']}" for item in document["poisoned"]]
    lines.append(
        f"{document['dataset']}: {document['done']} measured, {document['skipped']} there already, {document['failed']} failed; "
        f"{document['frames']} frames"
    )
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
