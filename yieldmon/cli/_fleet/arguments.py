"""The arguments of `fleet`'s words, apart from what the words do, which takes long to import."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

from yieldmon.cli import _outputs
from yieldmon.cli._channels import add_channels

if TYPE_CHECKING:
    Words = argparse._SubParsersAction[argparse.ArgumentParser]


def run(words: Words) -> None:
    """Of `fleet run`."""
    parser = words.add_parser(
        "run",
        help="measure all logs of a manifest or a folder tree",
        description="Measure all logs of a manifest or a folder tree. What the dataset has from the same logs, parameters and "
        "software is skipped.",
        epilog="example: yieldmon fleet run logs/ --out season",
    )
    parser.add_argument("source", metavar="SOURCE", help="manifest (CSV: machine, day, log), or folder MACHINE/DAY/LOGS")
    parser.add_argument("--out", required=True, metavar="DATASET", help="folder, or address such as s3://bucket/season")
    parser.add_argument("--config", metavar="FILE", help="configuration of machines that have none of their own")
    parser.add_argument("--params", metavar="FILE", help="parameters for all, in place of the configurations'")
    add_channels(parser)
    parser.add_argument("--crop", metavar="NAME", default="", help="crop of days for which nothing else names one")
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        default=os.cpu_count() or 1,
        help="processes here (default: one a core); 0: none but this one",
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", default="", help="Dask scheduler of a cluster, tcp://host:8786")
    parser.add_argument("--strict", action="store_true", help="measure nothing if a configuration or name is wrong")
    parser.add_argument("--adaptive", action="store_true", help="as many of the processes as there is work for")
    parser.add_argument("--json", action="store_true", help="print a summary as one JSON document")


def report(words: Words) -> None:
    """Of `fleet report`."""
    parser = words.add_parser(
        "report",
        help="machines, days, faults, drift of parameters and errors of loads of a dataset",
        description="Machines, days, faults, drift of parameters, ModelDisagrees and errors of loads against their tickets.",
        epilog="example: yieldmon fleet report season --html season.html",
    )
    parser.add_argument("dataset", metavar="DATASET", help="what `fleet run` wrote")
    parser.add_argument("--html", metavar="FILE", help="write the report as one HTML file as well")
    parser.add_argument("--json", action="store_true", help="print the report as one JSON document")
    _outputs.add_force(parser, "html")


def compare(words: Words) -> None:
    """Of `fleet compare`."""
    parser = words.add_parser(
        "compare",
        help="where and how two datasets of the same logs differ",
        description="Where and how two datasets of the same logs differ, measured with other parameters or releases.",
        epilog="example: yieldmon fleet compare season season-new-parameters",
    )
    parser.add_argument("first", metavar="A", help="dataset")
    parser.add_argument("second", metavar="B", help="dataset; differences are B minus A")
    parser.add_argument("--json", action="store_true", help="print the comparison as one JSON document")


def prior(words: Words) -> None:
    """Of `fleet prior`."""
    parser = words.add_parser(
        "prior",
        help="a crop's parameters for a new machine, from the tickets of the others",
        description="A crop's parameters for a new machine, with deviations that include how machines differ.",
        epilog="example: yieldmon fleet prior season --crop corn --out corn-fleet.yaml",
    )
    parser.add_argument("dataset", metavar="DATASET", help="what `fleet run` wrote, with tickets of at least 3 machines")
    parser.add_argument("--crop", required=True, metavar="NAME", help="crop, as shipped")
    parser.add_argument("--out", metavar="FILE", help="parameter file to write")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON document")
    _outputs.add_force(parser, "out")


def diagnose(words: Words) -> None:
    """Of `fleet diagnose`."""
    parser = words.add_parser(
        "diagnose",
        help="missing effects that machines share, and those of single machines",
        description="Missing effects in the sweeps of many machines: what all show is the model's, what one shows its own.",
        epilog="example: yieldmon fleet diagnose season --json",
    )
    parser.add_argument("dataset", metavar="DATASET", help="what `fleet run` wrote, with sweeps of at least 3 machines")
    parser.add_argument("--workers", type=int, metavar="N", default=os.cpu_count() or 1, help="processes (default: one a core)")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON document")
