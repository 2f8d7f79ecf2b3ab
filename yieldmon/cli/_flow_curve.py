"""A curve of `calibrate --estimator`, instead of the model, as verbs take it: `--estimator F`."""

from __future__ import annotations

import argparse

from yieldmon.estimation.flow_curve import with_curve
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import flow_curve_file


def add_file(parser: argparse.ArgumentParser) -> None:
    """--estimator F of the verbs that use a curve."""
    parser.add_argument("--estimator", metavar="FILE", help="curve of `calibrate --estimator`, instead of the model")


def with_file(known: ParameterSet, path: str | None) -> ParameterSet:
    """The set with the curve of --estimator, if one is named."""
    return known if path is None else with_curve(known, flow_curve_file.load(path))
