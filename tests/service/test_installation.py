"""`yieldmon install` below another root: what is written, kept, said and taken away."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from urllib.parse import quote

import pytest
import yaml

import yieldmon
from yieldmon.cli.main import main
from yieldmon.files import parameter_file
from yieldmon.resources import shipped
from yieldmon.service import installation
from yieldmon.service.installation import Installer, bring_up, package_source, uninstall

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
        UNIT,
        CONFIGURATION,
        "etc/systemd/network/80-can1.network",
        "etc/sysctl.d/80-yieldmon.conf",
        "usr/local/bin/yieldmon",
    }
    assert "ExecStart=/usr/bin/yieldmon run" in (tmp_path / UNIT).read_text(encoding="utf-8")
    assert "channel: can1" in (tmp_path / CONFIGURATION).read_text(encoding="utf-8")
    assert not any("can0" in (tmp_path / name).read_text(encoding="utf-8") for name in found if name.startswith("etc/systemd"))
    assert main(["install", "--root", str(tmp_path), "--interface", "can1", "--uninstall"]) == 0
    assert files(tmp_path) == {CONFIGURATION}
    assert main(["install", "--root", str(tmp_path), "--uninstall", "--purge"]) == 0
    assert files(tmp_path) == set()


def test_what_was_written_for_an_earlier_interface_goes_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for interface in ("can0", "can-rear", "can9"):
        assert install(tmp_path, "--interface", interface) == 0
    changed = tmp_path / "etc/systemd/network/80-can9.network"
    changed.write_text(changed.read_text().replace("250K", "500K"))
    strange = tmp_path / "etc/systemd/network/80-eth0.network"
    strange.write_text("[Match]\nName=eth0\n")
    capsys.readouterr()
    assert main(["install", "--root", str(tmp_path), "--uninstall", "--dry-run"]) == 0
    assert capsys.readouterr().out.count("80-can0.network") == 1
    assert main(["install", "--root", str(tmp_path), "--uninstall"]) == 0
    assert files(tmp_path) == {CONFIGURATION, *(str(path.relative_to(tmp_path)) for path in (changed, strange))}


def test_the_page_comes_when_asked_for(tmp_path: Path) -> None:
    assert install(tmp_path, "--web") == 0
    page = (tmp_path / "etc/systemd/system/yieldmon-web.service").read_text(encoding="utf-8")
    assert "ExecStart=/usr/bin/yieldmon web --config /etc/yieldmon/yieldmon.yaml\n" in page
    assert main(["install", "--root", str(tmp_path), "--uninstall"]) == 0
    assert files(tmp_path) == {CONFIGURATION}


@pytest.mark.parametrize(
    ("source", "wanted"), [("x.whl", "x.whl[web]"), ("/a/b", "/a/b[web]"), ("yieldmon==1.0", "yieldmon[web]==1.0")]
)
def test_the_page_comes_with_its_dependencies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], source: str, wanted: str
) -> None:
    arguments = ["install", "--root", str(tmp_path), "--dry-run", "--web", "--from", source]
    assert main(arguments) == 0
    assert f"--require-hashes --no-deps -r {ROOT}/requirements-web.lock\n" in capsys.readouterr().out
    assert main([*arguments, "--no-lock"]) == 0
    assert wanted in capsys.readouterr().out.replace("'", "")


def test_the_page_may_do_less_than_the_daemon() -> None:
    def settings(name: str) -> set[str]:
        sandbox = re.compile(r"(Protect|Private|Restrict(?!art)|NoNew|Lock|Memory\w+Execute|Capab|Ambient|Syst)")
        lines = shipped(f"systemd/{name}").read_text(encoding="utf-8").splitlines()
        return {line for line in lines if sandbox.match(line)}

    daemon, page = settings("yieldmon.service"), settings("yieldmon-web.service")
    assert daemon - page == {"RestrictAddressFamilies=AF_CAN AF_UNIX", "SystemCallFilter=@chown"}
    assert page - daemon == {
        "RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX",
        "SystemCallFilter=~kill tkill tgkill pidfd_send_signal process_vm_readv process_vm_writev ptrace",
    }


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
    assert f"--require-hashes --no-deps -r {ROOT}/requirements.lock" in printed
    assert f"--no-deps {ROOT}" in printed
    assert str(tmp_path / UNIT) in printed


def test_the_checkout_is_what_a_checkout_installs() -> None:
    assert package_source() == str(ROOT)
    assert shipped("systemd/yieldmon.service").is_relative_to(ROOT)


@pytest.mark.parametrize(
    ("options", "wrong"),
    [
        (["--command", "bin/yieldmon"], "absolute path"),
        (["--purge"], "--uninstall"),
        (
            ["--uninstall", "--web"],
            "--web: with --uninstall, which removes the page and the service; expected --uninstall",
        ),
    ],
    ids=["relative", "purge alone", "the page alone"],
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


@pytest.mark.parametrize(
    ("interface", "escaped"), [("can0", "can0"), ("can-rear", r"can\x2drear"), ("can_a.1", "can_a.1"), ("a--b", r"a\x2d\x2db")]
)
def test_an_interfaces_name_is_escaped_in_unit_names_alone(tmp_path: Path, interface: str, escaped: str) -> None:
    assert install(tmp_path, "--interface", interface) == 0
    unit = (tmp_path / UNIT).read_text(encoding="utf-8")
    assert f"BindsTo=sys-subsystem-net-devices-{escaped}.device" in unit
    assert f"WantedBy=sys-subsystem-net-devices-{escaped}.device" in unit
    assert f"on {interface}\n" in unit
    assert f"Name={interface}\n" in (tmp_path / f"etc/systemd/network/80-{interface}.network").read_text(encoding="utf-8")
    loaded = yaml.safe_load((tmp_path / CONFIGURATION).read_text(encoding="utf-8"))
    assert loaded["bus"]["channel"] == interface


@pytest.mark.parametrize("interface", ["", "can 0", "../x", "can0\nExecStart=/bin/sh", "a" * 16, "..", "can%i"])
def test_no_interface_has_such_a_name(tmp_path: Path, interface: str) -> None:
    assert install(tmp_path, "--interface", interface) == 2
    assert files(tmp_path) == set()


@pytest.mark.parametrize("umask", [0o022, 0o027, 0o077])
def test_modes_are_set_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    root = tmp_path / "root"
    root.mkdir(mode=0o755)
    before = os.umask(umask)
    try:
        assert install(root) == 0
        parameter_file.save(parameter_file.load(), tmp_path / "corn.yaml")
    finally:
        os.umask(before)
    for path in (*root.rglob("*"), tmp_path / "corn.yaml"):
        if not path.is_symlink():
            assert path.stat().st_mode & 0o777 == (0o755 if path.is_dir() else 0o644), path


class FakePip:
    """A Python whose environments hold a yieldmon that says its number; `fails` at the step with that word in it."""

    def __init__(self, folder: Path) -> None:
        self.python = folder / "python"
        self.python.write_text(
            "#!/bin/sh\n"
            'case "$*" in *"-m venv"*) for last; do :; done; mkdir -p "$last/bin"; cp "$0" "$last/bin/python";;\n'
            f'  *pip*) echo "$*" >> {folder}/log; test ! -e {folder}/fails || exit 1;'
            ' d=$(dirname "$0"); printf "#!/bin/sh\\necho %s\\n" "$d" > "$d/yieldmon"; chmod +x "$d/yieldmon";; esac\n'
        )
        self.python.chmod(0o755)
        self.log, self.fails = folder / "log", folder / "fails"


def test_releases_are_switched_whole_and_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fake, root = FakePip(tmp_path), tmp_path / "root"
    command = root / "opt/yieldmon/bin/yieldmon"

    def says() -> str:
        return Path(subprocess.run([command], capture_output=True, text=True, check=True).stdout.strip()).parent.name

    arguments = ["install", "--root", str(root), "--python", str(fake.python), "--from", "x.whl"]
    assert main(arguments) == 0
    assert says() == "1"
    assert main([*arguments, "--rollback"]) == 1
    assert "no earlier installation" in capsys.readouterr().err
    assert main(arguments) == 0
    assert says() == "2"
    fake.fails.touch()
    assert main(arguments) == 1
    assert says() == "2", "what was in use stays so"
    fake.fails.unlink()
    assert main([*arguments, "--rollback"]) == 0
    assert says() == "1"
    assert main([*arguments, "--rollback"]) == 0
    assert says() == "2"
    assert main(arguments) == 0
    assert says() == "3"
    assert sorted(path.name for path in (root / "opt/yieldmon/releases").iterdir()) == ["2", "3"]
    steps = fake.log.read_text().splitlines()
    assert "--require-hashes --no-deps -r" in steps[0]
    assert steps[0].endswith("requirements.lock")
    assert steps[1].endswith("--no-deps x.whl")


def test_an_installation_of_before_releases_makes_way(tmp_path: Path) -> None:
    fake, root = FakePip(tmp_path), tmp_path / "root"
    old = root / "opt/yieldmon/bin"
    old.mkdir(parents=True)
    (old / "yieldmon").write_text("old")
    assert main(["install", "--root", str(root), "--python", str(fake.python), "--from", "x.whl"]) == 0
    assert (root / "opt/yieldmon/bin").is_symlink()
    assert (root / "opt/yieldmon/bin/yieldmon").read_text() != "old"


def test_the_bill_of_materials_names_all_that_the_lock_does() -> None:
    made = subprocess.run([sys.executable, str(ROOT / "tools" / "sbom")], capture_output=True, text=True, check=True).stdout
    bill = json.loads(made)
    locks = [(ROOT / name).read_text(encoding="utf-8") for name in ("requirements.lock", "requirements-web.lock")]
    names = [
        [line.partition("==")[0] for line in lock.splitlines() if "==" in line and not line.startswith((" ", "#"))]
        for lock in locks
    ]
    *packages, charts = bill["components"]
    assert [part["name"] for part in packages] == [*names[0], *names[1]]
    assert [part["scope"] for part in packages] == ["required"] * len(names[0]) + ["optional"] * len(names[1])
    assert all(part["hashes"] and part["purl"].startswith("pkg:pypi/") for part in packages)
    assert (charts["name"], charts["licenses"]) == ("uplot", [{"license": {"id": "MIT"}}])
    assert f"uPlot {charts['version']} (MIT" in (ROOT / "docs" / "internals" / "web.md").read_text(encoding="utf-8")
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.5")


def test_a_planted_link_is_not_written_to(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("somebody else's", encoding="utf-8")
    root = tmp_path / "root"
    unit = root / UNIT
    unit.parent.mkdir(parents=True)
    unit.with_name(f".{unit.name}.new").symlink_to(victim)
    assert install(root) == 0
    assert victim.read_text(encoding="utf-8") == "somebody else's"
    assert not unit.is_symlink()


def test_a_command_that_is_not_there_is_a_failure(tmp_path: Path) -> None:
    installer = Installer(tmp_path, dry_run=False, report=print)
    assert installer.run(str(tmp_path / "gone"), live_only=False) is False
    assert installer.failures == [f"{tmp_path / 'gone'}: not on this machine"]


class NoSuchUnit(Installer):
    """A machine on which the service was never installed; broken: what systemctl cannot do there beside that."""

    broken = ""

    def run(self, *command: str, live_only: bool = True) -> bool:
        if "disable" in command or self.broken in command:
            self.failures.append(f"{command[1]}: no such unit")
        return not self.failures


@pytest.mark.parametrize(("broken", "failures"), [("", []), ("daemon-reload", ["daemon-reload: no such unit"])])
def test_a_unit_that_was_never_there_is_no_failure_to_take_it_away(tmp_path: Path, broken: str, failures: list[str]) -> None:
    installer = NoSuchUnit(tmp_path, dry_run=False, report=print)
    installer.broken = broken
    uninstall(installer, "can0", purge=False)
    assert installer.failures == failures


class Told(Installer):
    """What is run and said, and what the machine has."""

    def __init__(self) -> None:
        self.said: list[str] = []
        super().__init__(Path("/"), dry_run=True, report=self.said.append)
        self.ran: list[tuple[str, ...]] = []

    def run(self, *command: str, live_only: bool = True) -> bool:
        self.ran.append(command)
        return True


RESTART = ("systemctl", "restart", "yieldmon.service")


@pytest.mark.parametrize(
    ("managed", "interface", "ran", "said"),
    [
        (True, "lo", [("networkctl", "reload"), RESTART], 0),
        (True, "can99", [("networkctl", "reload")], 1),
        (False, "lo", [RESTART], 3),
        (False, "can99", [], 4),
    ],
)
def test_the_service_starts_where_its_interface_is_there(
    managed: bool, interface: str, ran: list[tuple[str, ...]], said: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[list[str]] = []

    def run(command: list[str], check: bool, **_: object) -> subprocess.CompletedProcess[str]:
        asked.append(command)
        return subprocess.CompletedProcess(command, 0 if managed else 3)

    monkeypatch.setattr(subprocess, "run", run)
    reported = Told()
    bring_up(reported, interface)
    assert asked == [["systemctl", "is-active", "--quiet", "systemd-networkd.service"]]
    assert (reported.ran, len(reported.said)) == (ran, said)
    assert any(f"no {interface} yet" in line for line in reported.said) is (interface != "lo")
    assert any(f"ip link set {interface} up" in line for line in reported.said) is not managed


class Recorded:
    """A distribution that was installed from somewhere."""

    def __init__(self, url: str | None) -> None:
        self.url = url

    def read_text(self, name: str) -> str | None:
        assert name == "direct_url.json"
        return None if self.url is None else json.dumps({"url": self.url})


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("file://{folder}", "{folder}"),
        ("file://{folder}/gone", f"yieldmon=={yieldmon.__version__}"),
        ("https://example.org{folder}", f"yieldmon=={yieldmon.__version__}"),
        (None, f"yieldmon=={yieldmon.__version__}"),
    ],
)
def test_what_is_installed_is_what_this_was_installed_from(
    url: str | None, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "with a blank"
    folder.mkdir()
    monkeypatch.setattr(installation, "CHECKOUT", tmp_path)
    recorded = Recorded(url.format(folder=quote(str(folder))) if url else None)
    monkeypatch.setattr(installation, "distribution", lambda name: recorded)
    assert package_source() == expected.format(folder=folder)

    def gone(name: str) -> Recorded:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(installation, "distribution", gone)
    assert package_source() == f"yieldmon=={yieldmon.__version__}"


def kept(root: Path, bus: str) -> Path:
    configuration = root / CONFIGURATION
    configuration.parent.mkdir(parents=True)
    configuration.write_text(f"bus: {bus}\n", encoding="utf-8")
    return configuration


@pytest.mark.parametrize(
    ("options", "interface", "note"),
    [
        ([], "can1", ""),
        (["--interface", "can1"], "can1", ""),
        (["--interface", "can0"], "can0", "reads can1, but the unit waits for can0: use the same in both"),
    ],
)
def test_the_unit_waits_for_the_interface_of_the_kept_configuration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], interface: str, note: str
) -> None:
    configuration = kept(tmp_path, "{channel: can1}")
    assert install(tmp_path, *options) == 0
    assert f"BindsTo=sys-subsystem-net-devices-{interface}.device" in (tmp_path / UNIT).read_text(encoding="utf-8")
    assert note in capsys.readouterr().out
    assert configuration.read_text(encoding="utf-8") == "bus: {channel: can1}\n"
    assert main(["install", "--root", str(tmp_path), *options, "--uninstall"]) == 0
    assert files(tmp_path) == {CONFIGURATION}


def test_a_kept_configuration_of_another_bus_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept(tmp_path, "{interface: pcan, channel: PCAN_USBBUS1}")
    assert install(tmp_path) == 0
    assert "reads pcan PCAN_USBBUS1; the unit supports SocketCAN only and waits for can0" in capsys.readouterr().out


def test_a_kept_configuration_that_cannot_be_read_is_kept(tmp_path: Path) -> None:
    configuration = kept(tmp_path, "[")
    assert install(tmp_path) == 0
    assert configuration.read_text(encoding="utf-8") == "bus: [\n"


@pytest.mark.parametrize("command", ["/home/otto/.local/bin/yieldmon", "/root/.venv/bin/yieldmon", "/run/user/1000/yieldmon"])
def test_a_command_that_the_service_does_not_see_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    assert main(["install", "--root", str(tmp_path), "--command", command, "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert f"--command: {command} lies in a home folder, which the service cannot read; expected a command outside" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("command", ["/opt/nothing/yieldmon", "/opt", "/etc/passwd"])
def test_a_command_that_is_no_program_is_refused(capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert main(["install", "--command", command, "--dry-run"]) == 2
    assert f"--command: {command} is not an executable program; expected" in capsys.readouterr().err
