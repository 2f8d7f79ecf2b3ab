"""Yieldmon as a service of this machine: what is written where, and how it is taken away again.

Standard library only, so that it runs before anything is installed.
"""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from urllib.parse import unquote, urlsplit

from yieldmon import __version__
from yieldmon.resources import shipped

CHECKOUT = Path(__file__).resolve().parents[2]
HOME = Path("/opt/yieldmon")
COMMAND = HOME / "bin" / "yieldmon"
LINK = Path("/usr/local/bin/yieldmon")
CONFIGURATION = Path("/etc/yieldmon")
STATE = (Path("/var/lib/yieldmon"), Path("/var/lib/private/yieldmon"))


@dataclass
class Installer:
    """Writes below `root`; with `dry_run` says what it would do; runs systemctl only where `root` is the running system."""

    root: Path
    dry_run: bool
    failures: list[str] = field(default_factory=list)

    def at(self, path: Path) -> Path:
        return self.root / path.relative_to("/")

    def write(self, path: Path, text: str, *, keep: bool = False) -> None:
        target = self.at(path)
        if keep and target.exists():
            self.report(f"keep    {target}")
            return
        self.report(f"write   {target}")
        if not self.dry_run:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(text, encoding="utf-8")
            target.chmod(0o644)

    def link(self, path: Path, to: Path) -> None:
        target = self.at(path)
        if target.exists() and not target.is_symlink():
            self.report(f"keep    {target} (not a link of ours)")
            return
        self.report(f"link    {target} -> {to}")
        if not self.dry_run:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.unlink(missing_ok=True)
            target.symlink_to(to)

    def remove(self, path: Path) -> None:
        target = self.at(path)
        if not target.exists() and not target.is_symlink():
            return
        self.report(f"remove  {target}")
        if self.dry_run:
            return
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target)
        else:
            target.unlink()

    def run(self, *command: str, live_only: bool = True) -> bool:
        """Whether the command succeeded; commands on the running system are left out when installing below another root."""
        if live_only and self.root != Path("/"):
            return True
        self.report(f"run     {shlex.join(command)}")
        if self.dry_run:
            return True
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except FileNotFoundError:
            self.failures.append(f"{command[0]}: not on this machine")
            return False
        if done.returncode != 0:
            reason = (done.stderr.strip() or done.stdout.strip() or f"exit {done.returncode}").splitlines()[-1]
            self.failures.append(f"{shlex.join(command)}: {reason}")
        return done.returncode == 0

    @staticmethod
    def report(text: str) -> None:
        print(text, flush=True)


def places(interface: str) -> dict[str, Path]:
    """Shipped file in systemd/ -> where it goes."""
    return {
        "yieldmon.service": Path("/etc/systemd/system/yieldmon.service"),
        "80-can0.network": Path(f"/etc/systemd/network/80-{interface}.network"),
        "80-yieldmon.conf": Path("/etc/sysctl.d/80-yieldmon.conf"),
    }


def package_source() -> str:
    """What pip installs: this checkout, else the file or folder that this program was installed from, else its version.

    Returns
    -------
    str
        A path or a requirement, as pip takes it.
    """
    if (CHECKOUT / "pyproject.toml").exists():
        return str(CHECKOUT)
    try:
        recorded = distribution("yieldmon").read_text("direct_url.json")  # PEP 610
    except PackageNotFoundError:
        recorded = None
    url = urlsplit(json.loads(recorded)["url"]) if recorded else None
    if url is not None and url.scheme == "file" and Path(unquote(url.path)).exists():
        return unquote(url.path)
    return f"yieldmon=={__version__}"


def install(installer: Installer, interface: str, command: Path | None, python: str, source: str) -> None:
    """Command, unit, interface and configuration in their places, and the service started.

    Parameters
    ----------
    installer : Installer
        Where it writes, and whether it does; collects what failed.
    interface : str
        CAN interface, such as can0.
    command : Path or None
        An installed command to use; None makes a virtual environment in HOME.
    python : str
        Python of that environment.
    source : str
        What pip installs into it.
    """
    if command is None:
        installer.run(python, "-m", "venv", str(installer.at(HOME)), live_only=False)
        pip = (str(installer.at(HOME) / "bin/python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
        installer.run(*pip, "--upgrade", source, live_only=False)
        if installer.failures:
            return
    installer.link(LINK, command or COMMAND)
    for name, target in places(interface).items():
        text = shipped(f"systemd/{name}").read_text(encoding="utf-8")
        text = text.replace(str(COMMAND), str(command or COMMAND)).replace("can0", interface)
        installer.write(target, text)
    configuration = shipped("config/yieldmon.yaml").read_text(encoding="utf-8")
    installer.write(CONFIGURATION / "yieldmon.yaml", configuration.replace("channel: can0", f"channel: {interface}"), keep=True)
    installer.run("sysctl", "--quiet", "--load", str(places(interface)["80-yieldmon.conf"]))
    installer.run("systemctl", "enable", "--no-reload", "yieldmon.service")
    installer.run("systemctl", "daemon-reload")
    if installer.root == Path("/"):
        bring_up(installer, interface)


def bring_up(installer: Installer, interface: str) -> None:
    """Start the service where its interface is there; otherwise the interface's appearance starts it."""
    managed = subprocess.run(["systemctl", "is-active", "--quiet", "systemd-networkd.service"], check=False).returncode == 0
    if managed:
        installer.run("networkctl", "reload")
    else:
        installer.report(f"note    systemd-networkd is not running, so nothing sets the bit rate of {interface}: either")
        installer.report("note      systemctl enable --now systemd-networkd")
        installer.report(f"note    or, at each boot: ip link set {interface} up type can bitrate 250000 restart-ms 100")
    if Path("/sys/class/net", interface).exists():
        installer.run("systemctl", "restart", "yieldmon.service")
    else:
        installer.report(f"note    no {interface} yet; the service starts when it appears")


def uninstall(installer: Installer, interface: str, *, purge: bool) -> None:
    """Take everything away; configuration and records only with `purge`."""
    installer.run("systemctl", "disable", "--now", "--no-reload", "yieldmon.service")
    # A unit that was never there is no failure to take it away.
    installer.failures.clear()
    for path in places(interface).values():
        installer.remove(path)
    link = installer.at(LINK)
    if link.is_symlink():
        installer.remove(LINK)
    installer.remove(HOME)
    if purge:
        for path in (CONFIGURATION, *STATE):
            installer.remove(path)
    installer.run("systemctl", "daemon-reload")
