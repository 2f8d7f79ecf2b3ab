"""The service against the memory limit of its unit and the kernel's out-of-memory killer: it starts again with its totals."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from combine_service import adds_up, grows, harvest, pid, records, service, status, total_kg, write_log
from service_manager import UNIT, eventually, journal, run, show

pytestmark = [pytest.mark.systemd, pytest.mark.slow]

LIMIT = "512M"


@pytest.fixture(scope="module", autouse=True)
def harvesting(daemon_command: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    log = write_log(tmp_path_factory.mktemp("traffic") / "combine.log")
    with service(daemon_command), harvest(log):
        eventually(lambda: total_kg() > 10.0, "some grain")
        yield


def started_again(before: int) -> None:
    eventually(lambda: show("ActiveState") == "active" and pid() not in (0, before), "a new process that is ready")
    eventually(lambda: bool(status()), "its first answer")


def survived(kept_kg: float) -> None:
    assert total_kg() >= kept_kg
    grows()
    adds_up(records())


def test_the_units_limit_has_room() -> None:
    assert show("MemoryMax") == str(512 << 20)
    lines = Path("/sys/fs/cgroup/system.slice", UNIT, "memory.stat").read_text(encoding="ascii").splitlines()
    used = {name: int(value) for name, value in (line.split() for line in lines)}
    assert used["anon"] < 256 << 20, "the rest is files, which make room"


def test_beyond_the_units_limit() -> None:
    before, kept_kg = pid(), records()[-1].total_kg
    run("systemctl", "set-property", "--runtime", UNIT, "MemoryMax=16M", "MemorySwapMax=0")
    eventually(lambda: "oom-kill" in journal(200), "the kill")
    run("systemctl", "set-property", "--runtime", UNIT, f"MemoryMax={LIMIT}")
    started_again(before)
    survived(kept_kg)


def test_chosen_by_the_kernel() -> None:
    assert Path("/proc", str(pid()), "oom_score_adj").read_text(encoding="ascii").strip() == "-500"
    before, kept_kg = pid(), records()[-1].total_kg
    Path("/proc", str(os.getpid()), "oom_score_adj").write_text("-1000", encoding="ascii")
    Path("/proc", str(before), "oom_score_adj").write_text("1000", encoding="ascii")
    Path("/proc/sysrq-trigger").write_text("f", encoding="ascii")
    started_again(before)
    survived(kept_kg)
