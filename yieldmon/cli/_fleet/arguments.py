"""The arguments of `fleet`'s words, apart from what the words do, which takes long to import."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

from yieldmon.cli import _outputs
from yieldmon.cli._channels import add_channels

if TYPE_CHECKING:
    Words = argparse._SubParsersAction[argparse.ArgumentParser]

MOST_WORKERS = 1024
"""Processes that --workers may ask for."""


def run(words: Words) -> None:
    """Of `fleet run`."""
    parser = words.add_parser(
        "run",
        help="measure all logs of a manifest or a folder tree",
        description="Measure all logs of a manifest or a folder tree. Partitions measured from the same logs with the same "
        "parameters and software are skipped.",
        epilog="example: yieldmon fleet run logs/ --out season",
    )
    parser.add_argument("source", metavar="SOURCE", help="manifest (CSV: machine, day, log), or folder MACHINE/DAY/LOGS")
    parser.add_argument("--out", required=True, metavar="DATASET", help="folder, or address such as s3://bucket/season")
    parser.add_argument("--config", metavar="FILE", help="configuration of machines without their own")
    parser.add_argument("--params", metavar="FILE", help="parameters for all machines, instead of the configurations'")
    add_channels(parser)
    parser.add_argument("--crop", metavar="NAME", default="", help="crop of days without a stated crop")
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        default=os.cpu_count() or 1,
        help="processes on this computer (default: one per core); 0: only this one",
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", default="", help="Dask scheduler of a cluster, tcp://host:8786")
    parser.add_argument("--strict", action="store_true", help="measure nothing if a configuration or name is wrong")
    parser.add_argument("--adaptive", action="store_true", help="adapt the number of processes to the work")
    parser.add_argument("--json", action="store_true", help="print a summary as one JSON document")


def report(words: Words) -> None:
    """Of `fleet report`."""
    parser = words.add_parser(
        "report",
        help="report machines, days, faults, drift of parameters and errors of loads",
        description="Report machines, days, faults, drift of parameters, and errors of loads against their tickets.",
        epilog="example: yieldmon fleet report season --html season.html",
    )
    parser.add_argument("dataset", metavar="DATASET", help="dataset from `fleet run`")
    parser.add_argument("--html", metavar="FILE", help="also write the report as one HTML file")
    parser.add_argument("--json", action="store_true", help="print the report as one JSON document")
    _outputs.add_force(parser, "html")


def compare(words: Words) -> None:
    """Of `fleet compare`."""
    parser = words.add_parser(
        "compare",
        help="compare two datasets of the same logs",
        description="Compare two datasets of the same logs, measured with different parameters or releases.",
        epilog="example: yieldmon fleet compare season season-new-parameters",
    )
    parser.add_argument("first", metavar="A", help="dataset")
    parser.add_argument("second", metavar="B", help="dataset; differences are B minus A")
    parser.add_argument("--json", action="store_true", help="print the comparison as one JSON document")


def prior(words: Words) -> None:
    """Of `fleet prior`."""
    parser = words.add_parser(
        "prior",
        help="write a crop's parameters for a new machine, from other machines' tickets",
        description="Write a crop's parameters for a new machine, with standard deviations that include how machines differ.",
        epilog="example: yieldmon fleet prior season --crop corn --out corn-fleet.yaml",
    )
    parser.add_argument("dataset", metavar="DATASET", help="dataset from `fleet run`, with tickets of at least 3 machines")
    parser.add_argument("--crop", required=True, metavar="NAME", help="name of a shipped crop")
    parser.add_argument("--out", metavar="FILE", help="parameter file to write")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON document")
    _outputs.add_force(parser, "out")


def diagnose(words: Words) -> None:
    """Of `fleet diagnose`."""
    parser = words.add_parser(
        "diagnose",
        help="find missing effects of all machines, and of single machines",
        description="Find missing effects in the sweeps of many machines: those of the model in all, those of a machine in one.",
        epilog="example: yieldmon fleet diagnose season --json",
    )
    parser.add_argument("dataset", metavar="DATASET", help="dataset from `fleet run`, with sweeps of at least 3 machines")
    parser.add_argument("--workers", type=int, metavar="N", default=os.cpu_count() or 1, help="processes (default: one per core)")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON document")
