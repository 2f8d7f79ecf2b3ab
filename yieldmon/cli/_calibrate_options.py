"""Options of `calibrate` that one way of calibrating uses and another does not: refused there, not ignored."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from yieldmon.errors import InputError

PHYSICAL_MODEL = (
    "robust", "by_moisture", "compare", "identifiability", "profiles", "free", "fix", "bounds", "impact", "effects", "stop_gap",
    "starts", "seed",
)  # fmt: skip
"""Names in the namespace of options that fit the physical model to a table."""
_TABLE = (*PHYSICAL_MODEL, "response_scale", "plate_angle")


def refuse(args: argparse.Namespace, names: Iterable[str], problem: str, expected: str) -> None:
    """Raises InputError for the first of these options that is given."""
    for name in names:
        value = getattr(args, name)
        if value is not None and value is not False and value not in ("", []):
            raise InputError(f"--{name.replace('_', '-')}", problem, expected)


def refuse_table_options(args: argparse.Namespace, option: str) -> None:
    """Raises InputError for an option that applies to a table of a test facility, where another option excludes such a table."""
    refuse(args, _TABLE, "applies to a table of a test facility only", f"none with {option}")


def refuse_table(args: argparse.Namespace, option: str) -> None:
    """Raises InputError for a table of a test facility, where another option excludes it."""
    if args.data is not None:
        raise InputError(args.data, f"is given together with {option}", "either a table of a test facility or weighed loads")


def refuse_load_options(args: argparse.Namespace) -> None:
    """Raises InputError for an option that applies to logs and weighed loads, where a table of a test facility is given."""
    refuse(args, ("tickets",), "applies to weighed loads only", "--loads with it, instead of a table")
    refuse(args, ("config",), "applies to logs and weighed loads only", "--machine FILE for a table")
