"""`yieldmon install` as it is shipped: by hash from the lock, for can-rear, under every umask; upgraded and rolled back.

Packages come from out/wheelhouse, which tools/test fills: the guest has no network.
"""

from __future__ import annotations

import os
import stat
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from service_manager import ROOT, UNIT, eventually, journal, run, show

pytestmark = [pytest.mark.systemd, pytest.mark.slow]

INTERFACE = "can-rear"
WHEELHOUSE = ROOT / "out" / "wheelhouse"
HOME = Path("/opt/yieldmon")
#: Unpacking a hundred megabytes takes its time in the guest.
INSTALL_S = 1200.0


@pytest.fixture(scope="module")
def wheel(service_manager: None) -> Path:
    found = sorted(WHEELHOUSE.glob("yieldmon-*.whl"))
    assert found, f"{WHEELHOUSE} is empty: tools/test --only systemd-attacks fills it"
    return found[-1]


@pytest.fixture(scope="module", autouse=True)
def rear(interpreter: Path) -> Iterator[None]:
    """The interface, a slow machine's patience, and everything taken away at the end."""
    slow = Path("/run/systemd/system/yieldmon.service.d/slow.conf")
    slow.parent.mkdir(parents=True, exist_ok=True)
    slow.write_text("[Service]\nTimeoutStartSec=600\nWatchdogSec=60\n", encoding="utf-8")
    run("ip", "link", "add", "dev", INTERFACE, "type", "vcan")
    run("ip", "link", "set", INTERFACE, "up")
    yield
    command("--uninstall", "--purge")
    run("ip", "link", "delete", INTERFACE)
    slow.unlink()


def command(*options: str, umask: int = 0o022, python: Path | None = None) -> None:
    """`yieldmon install` of this checkout, under a umask; fails with what it said."""
    variables = {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(WHEELHOUSE), "PIP_NO_COMPILE": "1"}
    words = [str(python or "python3"), str(ROOT / "tools" / "install"), "--interface", INTERFACE, *options]
    done = subprocess.run(
        words, env={**os.environ, **variables}, umask=umask, capture_output=True, text=True, timeout=INSTALL_S, check=False
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}\n{journal()}"


def released() -> str:
    return os.readlink(HOME / "bin").split("/")[1]


def runs(before: int) -> int:
    """The service's new process, from the release in use, by a user of its own."""
    eventually(lambda: show("ActiveState") == "active" and int(show("MainPID")) not in (0, before), "the service")
    now = int(show("MainPID"))
    assert Path("/proc", str(now)).stat().st_uid != 0
    script = Path("/proc", str(now), "cmdline").read_bytes().split(b"\0")
    assert any(b"yieldmon" in word for word in script)
    return now


def readable_by_all(folder: Path) -> None:
    for path in folder.rglob("*"):
        if not path.is_symlink():
            mode = path.stat().st_mode
            assert mode & stat.S_IROTH, path
            assert mode & stat.S_IXOTH or not path.is_dir(), path


def test_installed_upgraded_and_rolled_back_under_any_umask(wheel: Path, interpreter: Path) -> None:
    process = 0
    for number, umask in enumerate((0o077, 0o027, 0o022), start=1):
        command("--from", str(wheel), "--python", str(interpreter), umask=umask)
        assert released() == str(number)
        readable_by_all(HOME / "releases" / str(number))
        process = runs(process)
    assert {path.name for path in (HOME / "releases").iterdir()} == {"2", "3"}
    for umask, release in ((0o077, "2"), (0o027, "3")):
        command("--rollback", umask=umask)
        assert released() == release
        process = runs(process)


def test_every_package_is_the_locks(wheel: Path) -> None:
    # By its own path: through the link, Python does not find that it is an environment's.
    python = HOME / "releases" / released() / "bin" / "python"
    reported = run(str(python), "-m", "pip", "list", "--format", "freeze")
    installed = {line.strip().lower().replace("_", "-") for line in reported.splitlines() if line}
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    pinned = {line.split()[0].split(";")[0].lower() for line in lock if "==" in line and not line.startswith((" ", "#"))}
    ours = {"pip", "setuptools", "yieldmon"}
    assert {line for line in installed if line.split("==")[0] not in ours} <= pinned


def test_the_unit_belongs_to_the_interface() -> None:
    assert run("systemd-analyze", "verify", "--man=no", UNIT) == ""
    device = r"sys-subsystem-net-devices-can\x2drear.device"
    # systemd quotes a name with a backslash.
    assert device in show("BindsTo").replace("\\\\", "\\")
    before = int(show("MainPID"))
    run("ip", "link", "delete", INTERFACE)
    eventually(lambda: show("ActiveState") == "inactive", "stopped with its interface")
    run("ip", "link", "add", "dev", INTERFACE, "type", "vcan")
    run("ip", "link", "set", INTERFACE, "up")
    runs(before)


def test_a_release_that_does_not_install_changes_nothing(tmp_path: Path, interpreter: Path) -> None:
    before, process = released(), int(show("MainPID"))
    broken = tmp_path / "yieldmon-9.9.9-py3-none-any.whl"
    broken.write_bytes(b"no wheel")
    with pytest.raises(AssertionError, match="stays in use"):
        command("--from", str(broken), "--python", str(interpreter))
    assert (released(), int(show("MainPID"))) == (before, process)
