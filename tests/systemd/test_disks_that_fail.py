"""The service on a disk of its own that is full, turns read-only, or is gone: measuring goes on, totals stay.

An ext4 file system on a device-mapper target on a loop device. One daemon lives through the module, in the order of the tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from combine_service import STORE, adds_up, failing, faults, grows, harvest, kill_and_wait, records, service, total_kg, write_log
from service_manager import UNIT, eventually, run, show

pytestmark = [pytest.mark.systemd, pytest.mark.slow]

STATE = Path("/var/lib/private/yieldmon")
SIZE_MB = 24
NAME = "yieldmon-disk"
DEVICE = Path("/dev/mapper", NAME)


class Disk:
    """A disk under the state folder, and what can befall it."""

    def __init__(self, folder: Path) -> None:
        self._image = folder / "disk.img"
        self._ballast = STATE / "ballast"
        with self._image.open("wb") as file:
            file.truncate(SIZE_MB << 20)
        self._loop = run("losetup", "--find", "--show", str(self._image)).strip()
        self._sectors = (SIZE_MB << 20) // 512
        run("dmsetup", "create", NAME, "--noudevsync", "--table", self._linear)
        run("dmsetup", "mknodes", NAME)
        run("mkfs.ext4", "-q", "-F", "-m", "0", "-E", "lazy_itable_init=0,lazy_journal_init=0", str(DEVICE))
        STATE.parent.mkdir(mode=0o700, exist_ok=True)
        STATE.mkdir(exist_ok=True)
        self.mount()

    @property
    def _linear(self) -> str:
        return f"0 {self._sectors} linear {self._loop} 0"

    def mount(self) -> None:
        run("mount", str(DEVICE), str(STATE))

    def unmount(self) -> None:
        run("umount", str(STATE))

    def fill(self) -> bool:
        """Writes until nothing more fits; True, for waiting loops."""
        with self._ballast.open("ab", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(512))
            except OSError:
                return True

    def empty(self) -> None:
        self._ballast.unlink()

    @property
    def read_only(self) -> bool:
        lines = (line.split() for line in Path("/proc/mounts").read_text(encoding="ascii").splitlines())
        return any(fields[1] == str(STATE) and "ro" in fields[3].split(",") for fields in lines)

    def turn_read_only(self) -> None:
        """As the kernel does in an emergency, whoever has files open; no other file system here is on a block device."""
        Path("/proc/sysrq-trigger").write_text("u", encoding="ascii")
        eventually(lambda: self.read_only, "a read-only disk")

    def turn_writable(self) -> None:
        run("mount", "-o", "remount,rw", str(STATE))

    def _load(self, table: str) -> None:
        run("dmsetup", "suspend", "--noflush", "--nolockfs", "--noudevsync", NAME)
        run("dmsetup", "load", NAME, "--table", table)
        run("dmsetup", "resume", "--noudevsync", NAME)

    def go(self) -> None:
        """Every access fails from now on."""
        self._load(f"0 {self._sectors} error")

    def come_back(self) -> None:
        self._load(self._linear)

    def mend(self) -> None:
        """What a start does after a crash: the journal is replayed, and the rest found sound. Unmounted."""
        run("e2fsck", "-f", "-p", str(DEVICE), check=False)
        run("e2fsck", "-f", "-n", str(DEVICE))

    def away(self) -> None:
        run("umount", "--lazy", str(STATE), check=False)
        run("dmsetup", "remove", "--force", "--noudevsync", NAME, check=False)
        run("losetup", "--detach", self._loop, check=False)


@pytest.fixture(scope="module")
def disk(service_manager: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Disk]:
    made = Disk(tmp_path_factory.mktemp("disk"))
    yield made
    made.away()


@pytest.fixture(scope="module", autouse=True)
def harvesting(disk: Disk, daemon_command: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    log = write_log(tmp_path_factory.mktemp("traffic") / "combine.log")
    with service(daemon_command, purge=False), harvest(log):
        eventually(lambda: total_kg() > 10.0, "some grain")
        yield


def test_the_store_is_on_that_disk() -> None:
    assert (STATE / STORE.name).samefile(STORE)
    assert run("findmnt", "-n", "-o", "SOURCE", str(STATE)).strip() == str(DEVICE)


def test_full(disk: Disk) -> None:
    disk.fill()
    eventually(lambda: disk.fill() and bool(failing()), "a store that says that it fails")
    eventually(lambda: "StoreFailing" in faults(), "the fault")
    grows()
    kept = records()[-1]
    kill_and_wait()
    assert total_kg() >= kept.total_kg, "what was committed is read from a full disk"
    eventually(lambda: disk.fill() and bool(failing()), "a store that fails again")
    grows()
    measured_kg = total_kg()
    disk.empty()
    eventually(lambda: not failing(), "a store that is written again")
    eventually(lambda: records()[-1].total_kg > measured_kg, "what was measured meanwhile in the store")
    assert records()[kept.number - 1] == kept, "a record that was written stays"
    adds_up(records())


def test_read_only(disk: Disk) -> None:
    kept = records()[-1]
    disk.turn_read_only()
    eventually(lambda: bool(failing()), "a store that says that it fails")
    grows()
    kill_and_wait()
    assert total_kg() >= kept.total_kg, "what was committed is read from a read-only disk"
    eventually(lambda: "StoreFailing" in faults(), "the fault after a start on it")
    grows()
    measured_kg = total_kg()
    disk.turn_writable()
    eventually(lambda: not failing(), "a store that is written again")
    eventually(lambda: records()[-1].total_kg > measured_kg, "what was measured meanwhile in the store")
    assert records()[kept.number - 1] == kept, "a record that was written stays"
    adds_up(records())


def test_device_gone(disk: Disk) -> None:
    eventually(lambda: records()[-1].mass_kg > 0.0, "grain")
    kept = records()[-1]
    disk.go()
    eventually(lambda: bool(failing()), "a store that says that it fails")
    eventually(lambda: "StoreFailing" in faults(), "the fault")
    grows()
    run("systemctl", "stop", UNIT)
    assert show("Result") in ("success", "exit-code"), "ended by itself, not killed for taking too long"
    disk.unmount()
    disk.come_back()
    disk.mend()
    disk.mount()
    run("systemctl", "start", UNIT)
    eventually(lambda: total_kg() >= kept.total_kg, "the total that was committed")
    assert records()[kept.number - 1] == kept, "a record that was written stays"
    grows()
    eventually(lambda: not failing(), "a store that is written")
    adds_up(records())
