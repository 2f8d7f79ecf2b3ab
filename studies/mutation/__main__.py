"""How many small changes of service, bus, engine and network the tests find.

    python -m studies.mutation --sample 60 --seed 1        # a sample, by package in proportion; a line each, then the score
    python -m studies.mutation --named                     # changes that once went unnoticed
    python -m studies.mutation --package engine --sample 20

A mutant runs in a fork of this process, which has the third-party packages loaded, against the tests that concern its module:
those that import it, those that import what imports it, and where there are few those of its package. It is killed when one of
them fails or they take CPU time without end. Exit code 1 when fewer than 90 % are killed.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import importlib
import importlib.machinery
import json
import os
import random
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from studies.mutation.mutants import Mutant, mutants, mutated

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("service", "bus", "engine", "network")
GOAL = 0.9
#: A mutant's tests that take more CPU time than this, or twenty times it by the clock, have been stopped from ending: s.
CPU_LIMIT_S = 300
#: What tests import from outside; loaded once, before the forks.
LOADED = (
    "numpy", "scipy.optimize", "scipy.interpolate", "scipy.stats", "scipy.linalg", "scipy.special", "can", "cantools", "yaml",
    "pydantic", "rich.live", "hypothesis", "pytest", "_pytest.assertion.rewrite",
)  # fmt: skip
#: Test files that concern a package as a whole, the quick ones first.
OF_PACKAGE = {
    "service": ("tests/service/test_limits_hold.py", "tests/service/test_daemon.py"),
    "bus": ("tests/bus",),
    "engine": ("tests/engine/test_engine_parts.py", "tests/engine/test_engine_monitor.py"),
    "network": ("tests/network",),
}
FEWEST_FILES, MOST_FILES = 2, 6
#: Packages whose parts are seen together more than alone: the files of OF_PACKAGE come after those of each module.
TOGETHER = ("engine", "network")
#: What holds the defaults and ranges of the settings, and the modules that state them.
OF_SETTINGS = ("tests/service/test_configuration.py", "tests/docs/test_reference_pages.py")
SETTINGS = re.compile(r"yieldmon/(service/(\w+_sections|document|section)|engine/settings)\.py")
#: Folders of tests that need a machine of their own, or a long time.
AWAY = ("vcan", "systemd", "benchmarks", "docs", "golden", "robustness")


@dataclass(frozen=True)
class Named:
    """A change by its text, which once went unnoticed."""

    name: str
    path: str
    old: str
    new: str
    tests: tuple[str, ...] = ("tests/service/test_limits_hold.py",)


NAMED = (
    Named("reported faults are kept at a reload", "yieldmon/service/daemon.py", "        self._faults.report_all_anew()\n", ""),
    Named(
        "a dead thread is passed over", "yieldmon/service/daemon.py",
        "            if not is_alive:\n", "            if False:\n",
        ("tests/service/test_stalls.py", "tests/service/test_signs_of_life.py"),
    ),
    Named(
        "bus-off never ends", "yieldmon/service/service_faults.py",
        'self._conditions.present("bus-off", until_s, detail)', 'self._conditions.present("bus-off", _FOREVER, detail)',
    ),
    Named(
        "bus-off outlives its interface", "yieldmon/service/service_faults.py",
        '            self._conditions.ended("bus-off")\n', "",
    ),
    Named(
        "old counters are kept when records are given up", "yieldmon/service/writer.py",
        "counters={**oldest.counters, **following.counters}", "counters={**following.counters, **oldest.counters}",
    ),
    Named("room is made without bound", "yieldmon/service/store.py", "_PRUNE_ROWS = 2000", "_PRUNE_ROWS = 2_000_000_000"),
    Named(
        "quick_check without loads", "yieldmon/service/store.py",
        "for table in _NEEDED + _EVENTS:\n", 'for table in [t for t in _NEEDED + _EVENTS if t != "load"]:\n',
    ),
    Named("patience with a peer", "yieldmon/service/control.py", "_PATIENCE_S = 5.0", "_PATIENCE_S = 500.0"),
    Named(
        "size of a request", "yieldmon/service/control.py",
        "MAX_REQUEST_BYTES = 64 * 1024\n", "MAX_REQUEST_BYTES = 64 * 1024 * 1024\n",
    ),
    Named(
        "a restart takes the bus-off behind it along", "yieldmon/service/service_faults.py",
        'self._conditions.present("bus-off", _FOREVER, detail)', 'self._conditions.present("bus-off", until_s, detail)',
    ),
    Named("timeout of the speed", "yieldmon/engine/settings.py", "speed_timeout_s: float = 1.0", "speed_timeout_s: float = 3.0"),
    Named(
        "share of a sensor's faults", "yieldmon/engine/faults.py",
        "2 * o.window.sensor_fault_frames >", "20 * o.window.sensor_fault_frames >",
    ),
)  # fmt: skip


def concerned(path: str) -> tuple[str, ...]:
    """Test files for a module, few of them: those that import it or bear its name, then those that import what imports it, the
    small ones first, then its package's; the configuration's for settings."""
    part, name = path.split("/")[1], Path(path).stem
    users = _importing([path], (ROOT / "yieldmon").rglob("*.py"))
    tests = [file for file in sorted((ROOT / "tests").glob("*/test_*.py")) if file.parent.name not in AWAY]
    direct = [file for file in tests if file.stem == f"test_{name}" or file in _importing([path], tests)]
    direct.sort(key=lambda file: (file.parent.name != part, name not in file.name, file.stat().st_size))
    named = {f"test_{user.stem}" for user in users}
    known = _importing([str(user.relative_to(ROOT)) for user in users], tests)
    by_others = [file for file in tests if file not in direct and (file.stem in named or file in known)]
    by_others.sort(key=lambda file: (file.parent.name != part, file.stem not in named, file.stat().st_size))
    files = list(OF_SETTINGS) if SETTINGS.fullmatch(path) else []
    files += [str(file.relative_to(ROOT)) for file in (*direct, *by_others)]
    files = list(dict.fromkeys(files))[:MOST_FILES]
    files += [name for name in OF_PACKAGE[part] if name not in files and (part in TOGETHER or len(files) < FEWEST_FILES)]
    return tuple(files)


def _importing(paths: Sequence[str], files: Iterable[Path]) -> list[Path]:
    """Those of some files that import one of the modules at these paths, by its whole name or within its package."""
    ways = []
    for module in (path.removesuffix(".py").replace("/", ".") for path in paths):
        package, name = module.rsplit(".", 1)
        ways += [rf"from {re.escape(module)} import", rf"from {re.escape(package)} import [^\n]*\b{name}\b"]
        ways += [rf"from \.{name} import", rf"from \. import [^\n]*\b{name}\b"]
    pattern = re.compile("|".join(ways))
    return [file for file in files if ways and pattern.search(_text(file))]


@functools.cache
def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")


def killed(path: str, text: str, tests: tuple[str, ...]) -> str:
    """How the tests end with this text in the place of a module: "killed", "survived", "endless" (killed as well)."""
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S))
        with open(os.devnull, "w") as nothing:
            os.dup2(nothing.fileno(), 1)
            os.dup2(nothing.fileno(), 2)
        os._exit(_run_tests(ROOT / path, text, tests))
    until_s = time.monotonic() + 20 * CPU_LIMIT_S
    while time.monotonic() < until_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            _end(child)
            code = os.waitstatus_to_exitcode(status)
            return "endless" if code == -signal.SIGXCPU else "survived" if code == 0 else "killed"
        time.sleep(0.1)
    _end(child)
    os.waitpid(child, 0)
    return "endless"


def _end(group: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


def _run_tests(path: Path, text: str, tests: tuple[str, ...]) -> int:
    original = importlib.machinery.SourceFileLoader.get_code

    def get_code(loader: importlib.machinery.SourceFileLoader, name: str) -> object:
        return compile(text, str(path), "exec") if loader.path == str(path) else original(loader, name)

    setattr(importlib.machinery.SourceFileLoader, "get_code", get_code)  # noqa: B010 - a method of a standard class
    options = ("-x", "-q", "-p", "no:cacheprovider", "-m", "not slow and not strace and not vcan and not systemd")
    return int(importlib.import_module("pytest").main([*options, *tests]))


def sample(packages: tuple[str, ...], count: int, seed: int) -> list[Mutant]:
    """So many mutants of all of these packages' modules, drawn without preference."""
    files = [path for package in packages for path in sorted((ROOT / "yieldmon" / package).rglob("*.py"))]
    return random.Random(seed).sample([mutant for path in files for mutant in mutants(path, ROOT)], count)


def main() -> int:
    """Prints a line for each mutant, and the score as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--package", choices=PACKAGES, action="append", help="repeatable; default: all")
    parser.add_argument("--sample", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no further mutant after so long")
    parser.add_argument("--named", action="store_true", help="the changes that once went unnoticed")
    args = parser.parse_args()
    os.chdir(ROOT)
    for name in LOADED:
        importlib.import_module(name)
    begun_s = time.monotonic()
    rows: list[tuple[str, str, str]] = []
    if args.named:
        work = [(named.name, named.path, _replaced(named), named.tests) for named in NAMED]
    else:
        chosen = sample(tuple(args.package or PACKAGES), args.sample, args.seed)
        work = [(f"{m.path}:{m.line} {m.what}", m.path, mutated(m, ROOT), concerned(m.path)) for m in chosen]
    for name, path, text, tests in work:
        if time.monotonic() - begun_s > 60.0 * args.minutes:
            break
        rows.append((name, path, killed(path, text, tests)))
        print(f"{rows[-1][2]:9} {name}", flush=True)
    commit = subprocess.run(("git", "rev-parse", "--short", "HEAD"), capture_output=True, text=True, check=False).stdout
    killed_count = sum(outcome != "survived" for _, _, outcome in rows)
    score = {
        "commit": commit.strip(),
        "seed": None if args.named else args.seed,
        "mutants": len(rows),
        "killed": killed_count,
        "survivors": [name for name, _, outcome in rows if outcome == "survived"],
    }
    json.dump(score, sys.stdout, indent=2)
    print()
    return 0 if rows and killed_count >= GOAL * len(rows) else 1


def _replaced(named: Named) -> str:
    text = (ROOT / named.path).read_text(encoding="utf-8")
    if text.count(named.old) != 1:
        raise SystemExit(f"{named.path} has {text.count(named.old)} times {named.old!r}; expected once")
    return text.replace(named.old, named.new)


if __name__ == "__main__":
    sys.exit(main())
