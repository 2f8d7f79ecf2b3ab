"""The option --units."""

from __future__ import annotations

import argparse

from yieldmon.units import UnitSystem


def add_units(parser: argparse.ArgumentParser, default: str) -> None:
    """--units. default: where the choice comes from without it, for the help."""
    parser.add_argument("--units", choices=[str(system) for system in UnitSystem], help=f"units to show (default: {default})")
