"""Logs of a dataset that hold what another of its logs holds: the same bytes, or the same samples at other times."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping, Sequence

from yieldmon.errors import InputError
from yieldmon.fleet.querying import Query

Log = tuple[str, str, str]
"""Machine, day and name."""
_OF_NOTHING = hashlib.sha256().hexdigest()
"""What empty logs have in common is no mass."""
_PROVENANCE = "SELECT machine, day, logs FROM provenance ORDER BY machine, day"


class Repeats:
    """Logs that hold what another holds, day by day; overlapping: pairs that share times, the later first."""

    def __init__(self, samples: Mapping[Log, str], overlapping: Collection[tuple[Log, Log]]) -> None:
        self._samples = samples
        self._overlapping = overlapping
        self._first: dict[str, str] = {}
        """By digest."""
        self._first_samples: dict[tuple[str, str], Log] = {}
        """By machine and what the samples are known by."""
        self.digests: dict[Log, str] = {}

    def of_day(self, machine: str, day: str, logs: Sequence[tuple[str, str]]) -> Iterator[tuple[Log, str]]:
        """What of a day's logs, (name, digest), was there before, and a line on it."""
        for name, digest in logs:
            log = machine, day, name
            if content := self._samples.get(log):
                earlier = self._first_samples.setdefault((machine, content), log)
                if earlier != log and self.digests[earlier] != digest and (log, earlier) not in self._overlapping:
                    yield log, f"{name} holds the samples of {earlier[1]} {earlier[2]} at other times; the sums leave it out"
            self.digests[log] = digest
            if digest == _OF_NOTHING:
                continue
            if digest in self._first:
                yield log, f"{name} holds the same as {self._first[digest]}; the sums leave it out"
            self._first.setdefault(digest, f"{machine} {day} {name}")


def samples_of(query: Query) -> dict[Log, str]:
    """What each log's samples are known by; none of days that a yieldmon before this one measured."""
    return {
        (commit.machine, commit.day, str(name)): str(digest)
        for commit in query.commits
        for name, digest in commit.content.get("samples", {}).items()
    }


def logs_of(text: str | None, machine: str, day: str, address: str) -> list[tuple[str, str]]:
    """A day's logs with their digests, as its provenance has them. Raises InputError where they cannot be read."""
    try:
        return [(str(name), str(digest)) for name, digest in json.loads(text or "[]")]
    except (TypeError, ValueError, RecursionError) as error:
        problem = f"provenance of {machine} {day} is damaged"
        raise InputError(address, problem, "a dataset that `yieldmon fleet run` wrote") from error


def repeated_logs(query: Query) -> frozenset[Log]:
    """The logs that hold what an earlier log holds, by machine and day: a second copy says nothing more."""
    repeats, found = Repeats(samples_of(query), frozenset()), list[Log]()
    for row in query.rows(_PROVENANCE):
        where = row["machine"], row["day"]
        found += [log for log, _ in repeats.of_day(*where, logs_of(row["logs"], *where, query.dataset.address))]
    return frozenset(found)


def contents_of(query: Query) -> dict[Log, str]:
    """What each log's content is known by: its samples, or in days of an earlier yieldmon its bytes."""
    samples, found = samples_of(query), dict[Log, str]()
    for row in query.rows(_PROVENANCE):
        where = row["machine"], row["day"]
        for name, digest in logs_of(row["logs"], *where, query.dataset.address):
            found[(*where, name)] = samples.get((*where, name), digest)
    return found
