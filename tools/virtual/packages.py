"""Debian packages: what is missing, installing and fetching them."""

from __future__ import annotations

import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

SYSTEM_FOLDERS = ":/usr/sbin:/sbin"


class VmError(Exception):
    """The machine cannot be prepared or started; one line says what to do."""


def missing(tools: Mapping[str, str]) -> list[str]:
    """The packages, of those that hold these programs, whose program is not there. tools: program -> package."""
    path = os.environ.get("PATH", "") + SYSTEM_FOLDERS
    return sorted({package for tool, package in tools.items() if not shutil.which(tool, path=path)})


def require_debian() -> None:
    """Raises VmError on other systems."""
    if platform.machine() != "x86_64" or not shutil.which("apt-get"):
        raise VmError("--prepare knows Debian on x86-64 only; elsewhere load the vcan module and run in place")


def install(packages: list[str]) -> None:
    """Install packages by apt, as root or by sudo."""
    if packages:
        print(f"vcan-vm: installing {' '.join(packages)}", file=sys.stderr, flush=True)
        _apt("update", "-qq")
        _apt("install", "-y", "-qq", "--no-install-recommends", *packages)


def download(folder: Path, *packages: str) -> Path:
    """Packages unpacked, not installed, in a folder below this one."""
    try:
        _download(folder, *packages)
    except VmError:
        _apt("update", "-qq")
        _download(folder, *packages)
    for archive in folder.glob("*.deb"):
        subprocess.run(["dpkg", "-x", archive.name, "root"], cwd=folder, check=True)
    return folder / "root"


def dependency(package: str, pattern: str) -> str | None:
    """The first package that `package` depends on and whose name fits, by apt; None where there is none."""
    try:
        depends = _apt("cache", "depends", package, as_root=False)
    except VmError:
        return None
    found = re.search(rf"Depends: ({pattern})", depends)
    return found[1] if found else None


def update() -> None:
    """Fetch apt's lists anew."""
    _apt("update", "-qq")


def kmod(*command: str) -> str:
    """What a program of kmod prints."""
    path = os.environ.get("PATH", "") + SYSTEM_FOLDERS
    done = subprocess.run(command, env=os.environ | {"PATH": path}, text=True, capture_output=True, check=False)
    if done.returncode != 0:
        raise VmError(f"{shlex.join(command)}: {done.stderr.strip()}")
    return done.stdout


def _download(folder: Path, *packages: str) -> None:
    _apt("-o", "APT::Sandbox::User=root", "download", *packages, cwd=folder, as_root=False)


def _apt(*arguments: str, cwd: Path | None = None, as_root: bool = True) -> str:
    command = ["apt-get", *arguments] if arguments[0] != "cache" else ["apt-cache", *arguments[1:]]
    if as_root and os.geteuid() != 0:
        command = ["sudo", "-n", "--preserve-env=DEBIAN_FRONTEND", *command]
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        reason = (done.stderr.strip() or done.stdout.strip() or f"exit {done.returncode}").splitlines()[-1]
        raise VmError(f"{shlex.join(command)}: {reason}")
    return done.stdout
