"""The checkout's own virtual environment, made once: what the tools run in."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / ".venv"
OLDEST = (3, 11)


def ensure(extra: str) -> Path:
    """The environment's Python, with the project (editable, so that edits count) and the named extra installed.

    extra: a name in pyproject.toml's optional-dependencies. Nothing is done when pyproject.toml has not changed since.
    Raises SystemExit with one line when there is no Python that is new enough or pip fails.
    """
    python = FOLDER / "bin" / "python"
    stamp = FOLDER / f"yieldmon-{extra}.stamp"
    wanted = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
    if python.exists() and stamp.exists() and stamp.read_text() == wanted:
        return python
    if not python.exists():
        say(f"making {FOLDER}")
        hint = "no virtual environment made; on Debian: apt-get install python3-venv"
        run([new_enough_python(), "-m", "venv", str(FOLDER)], hint)
    say(f"installing yieldmon[{extra}] and what it needs")
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    run([*pip, "--editable", f"{ROOT}[{extra}]"], "pip could not install the project")
    stamp.write_text(wanted)
    return python


def enter_always(extra: str) -> None:
    """Go on in the checkout's environment, whatever this Python has. Replaces the process unless it is there already."""
    python = ensure(extra)
    if Path(sys.prefix) != FOLDER:
        os.execve(str(python), [str(python), *sys.argv], activated())


def new_enough_python() -> str:
    if sys.version_info >= OLDEST:
        return sys.executable
    for minor in range(20, OLDEST[1] - 1, -1):
        if found := shutil.which(f"python3.{minor}"):
            return found
    raise SystemExit(f"Python {sys.version.split()[0]} is too old; expected {OLDEST[0]}.{OLDEST[1]} or newer on PATH")


def run(command: list[str], problem: str) -> None:
    if subprocess.run(command, check=False, stdout=sys.stderr).returncode != 0:
        raise SystemExit(problem)


def activated() -> dict[str, str]:
    """This process's environment variables as they are inside the virtual environment."""
    path = f"{FOLDER / 'bin'}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONHOME"}
    return kept | {"VIRTUAL_ENV": str(FOLDER), "PATH": path}


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
