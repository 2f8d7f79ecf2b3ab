"""Yieldmon as a service of this machine: what is written where, and how it is taken away again.

Standard library only, so that it runs before anything is installed.

Each installation is a virtual environment of its own, HOME/releases/N, with exactly what the lock file names; HOME/bin is a link
to the one in use, and HOME/previous to the one before, so switching is one rename and can be taken back. Modes are those of files
that everybody may read, whatever the umask.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import string
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from urllib.parse import unquote, urlsplit

from yieldmon import __version__
from yieldmon.resources import shipped

CHECKOUT = Path(__file__).resolve().parents[2]
HOME = Path("/opt/yieldmon")
COMMAND = HOME / "bin" / "yieldmon"
RELEASES = HOME / "releases"
PREVIOUS = HOME / "previous"
LOCK = "requirements.lock"
WEB_LOCK = "requirements-web.lock"
WEB_UNIT = "yieldmon-web.service"
LINK = Path("/usr/local/bin/yieldmon")
CONFIGURATION = Path("/etc/yieldmon")
UNITS = Path("/etc/systemd/system")
_PLAIN_IN_UNITS = frozenset(string.ascii_letters + string.digits + ":_.")
STATE = (Path("/var/lib/yieldmon"), Path("/var/lib/private/yieldmon"))


@dataclass
class Installer:
    """Writes below `root`; with `dry_run` says what it would do; runs systemctl only where `root` is the running system.

    report: takes a line for each step.
    """

    root: Path
    dry_run: bool
    report: Callable[[str], None]
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
            fresh = target.with_name(f".{target.name}.new")
            fresh.unlink(missing_ok=True)
            # Made for it: what stood there, a link to another file say, is not written to.
            with fresh.open("x", encoding="utf-8") as file:
                file.write(text)
            fresh.chmod(0o644)
            fresh.replace(target)

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

    def point(self, path: Path, to: Path) -> None:
        """A link that is there before and after, and never not: made under another name and renamed."""
        target = self.at(path)
        self.report(f"link    {target} -> {to}")
        if not self.dry_run:
            fresh = target.with_name(f".{target.name}.new")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(to)
            fresh.replace(target)

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


def places(interface: str) -> dict[str, Path]:
    """Shipped file in systemd/ -> where it goes."""
    return {
        "yieldmon.service": UNITS / "yieldmon.service",
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


def unit_name(interface: str) -> str:
    """An interface's name as systemd writes it in the name of a unit (systemd.unit(5), "String escaping")."""
    return "".join(c if c in _PLAIN_IN_UNITS else "".join(f"\\x{byte:02x}" for byte in c.encode()) for c in interface)


def check_interface(interface: str) -> None:
    """Raises ValueError for a name that no interface of Linux has, or that would mean something in a file written here."""
    if not re.fullmatch(r"[A-Za-z0-9_.:-]{1,15}", interface) or interface in (".", ".."):
        raise ValueError(f"{interface!r} is not an interface name: 1 to 15 letters, digits and - _ . :")


def configured_bus(installer: Installer) -> tuple[str, str] | None:
    """Interface and channel, as python-can names them, of the configuration that is in its place already.

    Parameters
    ----------
    installer : Installer

    Returns
    -------
    (str, str) or None
        None where there is no configuration, or none that can be read with what this Python has.
    """
    path = installer.at(CONFIGURATION / "yieldmon.yaml")
    if not path.is_file():
        return None
    try:
        from yieldmon.files import strict_yaml

        content = strict_yaml.load(path)
    except (ImportError, OSError, ValueError):
        return None
    bus = content.get("bus") if isinstance(content, dict) else None
    named = bus if isinstance(bus, dict) else {}
    return str(named.get("interface", "socketcan")), str(named.get("channel", "can0"))


def install(
    installer: Installer,
    interface: str,
    command: Path | None,
    python: str,
    source: str,
    *,
    locked: bool = True,
    web: bool = False,
) -> None:
    """Command, unit, interface and configuration in their places, and the service started.

    Parameters
    ----------
    installer : Installer
        Where it writes, and whether it does; collects what failed.
    interface : str
        CAN interface, such as can0.
    command : Path or None
        An installed command to use; None makes a virtual environment in RELEASES.
    python : str
        Python of that environment.
    source : str
        What pip installs into it.
    locked : bool
        Whether its dependencies are those of the lock file, by hash; else what pip finds.
    web : bool
        Whether the page comes with it, with its dependencies and its unit.
    """
    before = os.umask(0o022)
    try:
        if command is None and not _new_release(installer, python, source, locked=locked, web=web):
            return
        _place(installer, interface, command)
        if web:
            _place_page(installer, command)
    finally:
        os.umask(before)


def _place(installer: Installer, interface: str, command: Path | None) -> None:
    installer.link(LINK, command or COMMAND)
    for name, target in places(interface).items():
        text = shipped(f"systemd/{name}").read_text(encoding="utf-8").replace(str(COMMAND), str(command or COMMAND))
        text = text.replace("devices-can0.device", f"devices-{unit_name(interface)}.device").replace("can0", interface)
        installer.write(target, text)
    configuration = shipped("config/yieldmon.yaml").read_text(encoding="utf-8")
    channel = interface if re.fullmatch(r"[a-z]+[0-9][a-z0-9_.-]*|[a-z]+-[a-z0-9_.-]+", interface) else json.dumps(interface)
    installer.write(CONFIGURATION / "yieldmon.yaml", configuration.replace("channel: can0", f"channel: {channel}"), keep=True)
    installer.run("sysctl", "--quiet", "--load", str(places(interface)["80-yieldmon.conf"]))
    installer.run("systemctl", "enable", "--no-reload", "yieldmon.service")
    installer.run("systemctl", "daemon-reload")
    if installer.root == Path("/"):
        bring_up(installer, interface)


def _place_page(installer: Installer, command: Path | None) -> None:
    """The page's unit, started; it waits for no interface."""
    text = shipped(f"systemd/{WEB_UNIT}").read_text(encoding="utf-8").replace(str(COMMAND), str(command or COMMAND))
    installer.write(UNITS / WEB_UNIT, text)
    installer.run("systemctl", "daemon-reload")
    installer.run("systemctl", "enable", WEB_UNIT)
    installer.run("systemctl", "restart", WEB_UNIT)


def with_page(source: str) -> str:
    """A source for pip with the extra of the page.

    Parameters
    ----------
    source : str
        A path or a requirement.

    Returns
    -------
    str
        The same with ``[web]`` in its place.
    """
    name, equals, version = source.partition("==")
    return f"{name}[web]{equals}{version}"


def _new_release(installer: Installer, python: str, source: str, *, locked: bool, web: bool) -> bool:
    """Make an environment, try it, and switch to it; what was in use stays so when anything fails."""
    releases = installer.at(RELEASES)
    number = 1 + max((int(path.name) for path in releases.glob("[0-9]*") if path.name.isdigit()), default=0)
    release = RELEASES / str(number)
    pip = (
        str(installer.at(release) / "bin/python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
    )  # fmt: skip
    steps: list[tuple[str, ...]] = [(python, "-m", "venv", str(installer.at(release)))]
    if locked:
        lock = str(shipped(WEB_LOCK if web else LOCK))
        steps += [(*pip, "--require-hashes", "--no-deps", "-r", lock), (*pip, "--no-deps", source)]
    else:
        steps.append((*pip, with_page(source) if web else source))
    steps.append((str(installer.at(release) / "bin/yieldmon"), "--version"))
    for step in steps:
        if not installer.run(*step, live_only=False):
            installer.remove(release)
            installer.report("note    what was installed before stays in use")
            return False
    _keep_what_was_one_environment(installer)
    in_use = _in_use(installer)
    installer.point(HOME / "bin", Path("releases") / str(number) / "bin")
    if in_use is not None:
        installer.point(PREVIOUS, Path("releases") / str(in_use))
    for path in releases.glob("[0-9]*"):
        if path.name.isdigit() and int(path.name) not in (number, in_use):
            installer.remove(RELEASES / path.name)
    return True


def _keep_what_was_one_environment(installer: Installer) -> None:
    """Installations before releases had HOME itself as their environment: its commands make way for the link."""
    folder = installer.at(HOME / "bin")
    if folder.is_dir() and not folder.is_symlink():
        for name in ("bin", "lib", "lib64", "include", "share", "pyvenv.cfg"):
            installer.remove(HOME / name)


def _in_use(installer: Installer) -> int | None:
    link = installer.at(HOME / "bin")
    name = Path(os.readlink(link)).parent.name if link.is_symlink() else ""
    return int(name) if name.isdigit() else None


def roll_back(installer: Installer) -> None:
    """Switch to the release that was in use before, and back again when called once more; restarts the service."""
    previous, in_use = installer.at(PREVIOUS), _in_use(installer)
    name = Path(os.readlink(previous)).name if previous.is_symlink() else ""
    if in_use is None or not (installer.at(RELEASES) / name / "bin" / "yieldmon").exists() or not name.isdigit():
        installer.failures.append("there is no earlier installation to go back to; expected two, as after an update by `install`")
        return
    installer.point(HOME / "bin", Path("releases") / name / "bin")
    installer.point(PREVIOUS, Path("releases") / str(in_use))
    installer.run("systemctl", "try-restart", "yieldmon.service")
    if installer.at(UNITS / WEB_UNIT).exists():
        installer.run("systemctl", "try-restart", WEB_UNIT)


def bring_up(installer: Installer, interface: str) -> None:
    """Start the service where its interface is there; otherwise the interface's appearance starts it."""
    asked = ["systemctl", "is-active", "--quiet", "systemd-networkd.service"]
    managed = subprocess.run(asked, check=False, capture_output=True).returncode == 0
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


def _networks(installer: Installer) -> list[Path]:
    """The network files that installations for any interface wrote, unless they were changed since."""
    folder = Path("/etc/systemd/network")
    text = shipped("systemd/80-can0.network").read_text(encoding="utf-8")
    return [
        folder / path.name
        for path in sorted(installer.at(folder).glob("80-*.network"))
        if path.read_bytes() == text.replace("can0", path.name.removeprefix("80-").removesuffix(".network")).encode()
    ]


def uninstall(installer: Installer, interface: str, *, purge: bool) -> None:
    """Take everything away; configuration and records only with `purge`."""
    if installer.at(UNITS / WEB_UNIT).exists():
        installer.run("systemctl", "disable", "--now", "--no-reload", WEB_UNIT)
    installer.run("systemctl", "disable", "--now", "--no-reload", "yieldmon.service")
    # A unit that was never there is no failure to take it away.
    installer.failures.clear()
    for path in dict.fromkeys((*places(interface).values(), UNITS / WEB_UNIT, *_networks(installer))):
        installer.remove(path)
    link = installer.at(LINK)
    if link.is_symlink():
        installer.remove(LINK)
    installer.remove(HOME)
    if purge:
        for path in (CONFIGURATION, *STATE):
            installer.remove(path)
    installer.run("systemctl", "daemon-reload")
