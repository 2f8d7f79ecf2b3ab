"""`yieldmon install` below another root: what is written, kept, said and taken away."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from yieldmon.cli.main import main
from yieldmon.resources import shipped
from yieldmon.service.installation import package_source

ROOT = Path(__file__).parents[2]
UNIT, CONFIGURATION = "etc/systemd/system/yieldmon.service", "etc/yieldmon/yieldmon.yaml"


def files(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if not path.is_dir() or path.is_symlink()}


def install(root: Path, *options: str) -> int:
    return main(["install", "--root", str(root), "--command", "/usr/bin/yieldmon", *options])


def test_what_is_written_and_taken_away(tmp_path: Path) -> None:
    assert install(tmp_path, "--interface", "can1") == 0
    found = files(tmp_path)
    assert found == {
        UNIT, CONFIGURATION, "etc/systemd/network/80-can1.network", "etc/sysctl.d/80-yieldmon.conf", "usr/local/bin/yieldmon",
    }
    assert "ExecStart=/usr/bin/yieldmon run" in (tmp_path / UNIT).read_text(encoding="utf-8")
    assert "channel: can1" in (tmp_path / CONFIGURATION).read_text(encoding="utf-8")
    assert not any("can0" in (tmp_path / name).read_text(encoding="utf-8") for name in found if name.startswith("etc/systemd"))
    assert main(["install", "--root", str(tmp_path), "--interface", "can1", "--uninstall"]) == 0
    assert files(tmp_path) == {CONFIGURATION}
    assert main(["install", "--root", str(tmp_path), "--uninstall", "--purge"]) == 0
    assert files(tmp_path) == set()


def test_a_configuration_that_is_there_is_kept(tmp_path: Path) -> None:
    own = tmp_path / CONFIGURATION
    own.parent.mkdir(parents=True)
    own.write_text("bus: {channel: can7}\n", encoding="utf-8")
    assert install(tmp_path) == 0
    assert own.read_text(encoding="utf-8") == "bus: {channel: can7}\n"


def test_dry_run_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["install", "--root", str(tmp_path), "--dry-run"]) == 0
    assert files(tmp_path) == set()
    printed = capsys.readouterr().out
    assert f"pip install --quiet --disable-pip-version-check --upgrade {ROOT}" in printed
    assert str(tmp_path / UNIT) in printed


def test_the_checkout_is_what_a_checkout_installs() -> None:
    assert package_source() == str(ROOT)
    assert shipped("systemd/yieldmon.service").is_relative_to(ROOT)


@pytest.mark.parametrize(
    ("options", "wrong"),
    [(["--command", "bin/yieldmon"], "absolute path"), (["--purge"], "--uninstall")],
    ids=["relative", "purge alone"],
)
def test_bad_options(options: list[str], wrong: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["install", *options, "--dry-run"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert wrong in lines[0]


def test_the_tool_needs_no_package(tmp_path: Path) -> None:
    command = [sys.executable, "-S", "-I", str(ROOT / "tools" / "install"), "--root", str(tmp_path), "--command", "/bin/true"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert UNIT in files(tmp_path)
