"""Check a configuration file, with the machine and parameter files that it names."""

from __future__ import annotations

import argparse
import json
import sys

from yieldmon.errors import InputError
from yieldmon.resources import shipped
from yieldmon.service import configuration
from yieldmon.service.document import Document


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "check-config", help="check a configuration file",
        description=__doc__,
        epilog="example: yieldmon check-config /etc/yieldmon/yieldmon.yaml",
    )
    parser.add_argument("file", nargs="?", help="configuration (YAML); default: the shipped one")
    parser.add_argument("--json", action="store_true", help="print what was found as one JSON document")
    parser.add_argument("--defaults", action="store_true", help="print the default configuration, commented, and end")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 for a configuration that can run, 2 for one that cannot."""
    if args.defaults:
        print(configuration.document_text(), end="")
        return 0
    path = args.file if args.file is not None else str(shipped("config/yieldmon.yaml"))
    problems: list[InputError] = []
    loaded = None
    try:
        loaded = configuration.load(path)
    except configuration.ConfigurationError as error:
        problems = error.problems
    except InputError as error:
        problems = [error]
    if args.json:
        document = {
            "file": path,
            "valid": not problems,
            "problems": [{"where": p.where, "problem": p.problem, "expected": p.expected} for p in problems],
            "configuration": loaded.document.model_dump() if loaded is not None else None,
        }
        print(json.dumps(document, indent=2))
    elif loaded is not None:
        defaults = ", all defaults" if loaded.document == Document() else ""
        print(f"{path}: valid{defaults}; machine {loaded.machine_path}, parameters {loaded.parameter_path}")
    else:
        for problem in problems:
            print(f"yieldmon: {problem}", file=sys.stderr)
    return 2 if problems else 0
