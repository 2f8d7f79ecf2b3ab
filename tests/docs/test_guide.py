"""Guide and reference: every command in them runs, they are no longer than agreed, and links lead somewhere."""

from __future__ import annotations

import contextlib
import gzip
import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.service.bench import Bench, running
from yieldmon.cli.main import build_parser, find_verbs, main
from yieldmon.engine.faults import FaultCode
from yieldmon.resources import shipped

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*(DOCS / "guide").glob("*.md"), *(DOCS / "reference").glob("*.md")])
#: Pages whose links are followed.
LINKED = sorted(
    page
    for place in ("*.md", "docs/**/*.md", "studies/**/*.md", "tests/robustness/*.md", "examples/*.md")
    for page in ROOT.glob(place)
)
LONGEST_WORDS = 15_000
VERBS = find_verbs()

#: Verbs that talk to a running daemon.
OF_A_DAEMON = ("status", "load", "ticket", "zero", "sweep")
#: Lines that are only parsed here, and where they are run.
PARSED = {
    "install --rollback": "tests/service/test_installation.py",
    "totals": "tests/service",
    "calibrations": "tests/service/test_remeasuring.py",
    "ticket list": "tests/service/test_remeasuring.py",
    "ticket undo": "tests/service/test_remeasuring.py",
    "load correct": "tests/service/test_load_names.py",
    "map": "tests/field",
    "run --config": "tests/service/test_run.py",
    "calibrate --loads": "tests/estimation, by weighed loads",
    "diagnose": "tests/discrepancy/test_command.py",
    "setup": "the guided set-up's own tests",
    "web": "the page's own tests",
    "fleet": "the fleet's own tests",
    "signals": "tests/signals/test_survey.py",
    "check-config mapping.yaml": "tests/signals/test_survey.py",
}
#: What a page says of a machine -> what there is here.
HERE = {
    "/var/lib/yieldmon/": "", "/etc/yieldmon/": "", "docs/img/": "", "-i socketcan -c can0": "-i virtual -c docs",
    "-i socketcan -c vcan0": "-i virtual -c docs", "-i socketcan --map": "-i virtual --map", "--loop": "",
    "--speed 5": "", "--speed 4": "--speed 0 --once", "ticket 7-9": "ticket 1", "ticket 7": "ticket 1",
}  # fmt: skip


@dataclass(frozen=True)
class Command:
    page: str
    line: str

    @property
    def verb(self) -> str:
        return self.line.split()[0]


def commands() -> Iterator[Command]:
    """Lines of the pages that call the command, without `sudo yieldmon` and comment; help texts left out."""
    for page in [*PAGES, ROOT / "README.md"]:
        text = re.sub(r"```text\n.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
        for line in re.findall(r"^(?: {4}|\t)(?:sudo )?(?:yieldmon|\"\$\(command -v yieldmon\)\") (.*)$", text, re.M):
            yield Command(page.name, re.sub(r"\s+#.*", "", line).strip())


def found(kind: str) -> list[Command]:
    every = list(dict.fromkeys(commands()))
    parsed = {command for command in every if any(command.line.startswith(start) for start in PARSED)}
    daemon = {command for command in every if command.verb in OF_A_DAEMON or command.line == "monitor --cab"}
    kinds = {"parsed": parsed, "daemon": daemon - parsed, "here": set(every) - parsed - daemon}
    return [command for command in every if command in kinds[kind]]


def ids(command: Command) -> str:
    return f"{command.page}: {command.line}"


def words_here(line: str) -> list[str]:
    for there, here in HERE.items():
        line = line.replace(there, here)
    return shlex.split(line)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the pages name."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "s.yaml").write_text(
        "duration_s: 40\nflow:\n  pieces:\n  - {kind: steady, duration_s: 12, flow_kg_s: 0}\n"
        "  - {kind: steady, duration_s: 99, flow_kg_s: 12}\n"
        "frames: {grain_condition: true, position: true, harvest_state: true}\n",
        encoding="utf-8",
    )
    with contextlib.chdir(folder):
        assert main(["simulate", "--scenario", "s.yaml", "--log", "day.log", "--truth", "truth.csv"]) == 0
        assert main(["process", "day.log", "--out", "monday.csv"]) == 0
        shutil.copy("monday.csv", "day.csv")
    with (folder / "day.log").open(encoding="ascii") as log:
        lines = [line for line, _ in zip(log, range(3000), strict=False)]
    (folder / "drive.log").write_text("".join(lines), encoding="ascii")
    (folder / "drive.log.gz").write_bytes(gzip.compress("".join(lines).encode("ascii")))
    shutil.copy(ROOT / "tests/golden/store-0.1.0.sqlite", folder / "yieldmon.sqlite")
    shutil.copy(shipped("config/parameters/corn.yaml"), folder / "corn.yaml")
    shutil.copy(ROOT / "examples/wiring/analog_module.dbc", folder / "maker.dbc")
    (folder / "yieldmon.yaml").write_text("{}\n", encoding="utf-8")
    rows = [f"{angle},{flow},{3.0 * flow + 0.1 * angle}" for angle in (40, 60, 80) for flow in (2, 8, 16)]
    (folder / "table.csv").write_text("plate_angle_deg,mass_flow_kg_s,force_n\n" + "\n".join(rows) + "\n", encoding="utf-8")
    with contextlib.chdir(folder):
        assert main(["simulate", "--duration", "5", "--log", "drive.blf"]) == 0
    return folder


@pytest.mark.parametrize("command", found("here"), ids=ids)
def test_it_runs(command: Command, files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "here"
    shutil.copytree(files, folder)
    words = words_here(command.line)
    if ">" in words:
        words = words[: words.index(">")]
    if command.verb == "monitor" and "virtual" in words:
        words += ["--once"] * ("--once" not in words) + ["--seconds", "0.1"]
    if command.verb == "replay" and "--speed" not in words:
        words += ["--speed", "0"]
    if command.verb == "simulate" and "-i" in words:
        words += ["--duration", "1"]
    if command.verb == "install":
        words += ["--root", str(tmp_path / "root")] + ["--command", "/bin/true"] * ("--uninstall" not in words)
    outputs = [Path(words[words.index(option) + 1]) for option in ("--out", "--log", "--truth") if option in words[:-1]]
    for output in outputs:
        if command.verb != "plot" or output.suffix in (".png", ".svg"):
            (folder / output).unlink(missing_ok=True)
    with contextlib.chdir(folder):
        assert main(words) == 0, capsys.readouterr().err
        assert all(output.exists() for output in outputs)


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Bench]]:
    folder = tmp_path_factory.mktemp("daemon")
    with running(folder) as bench:
        bench.play(12.0, 0.0)
        bench.play(4.0, 60.0)
        bench.played()
        yield folder, bench


@pytest.mark.parametrize("command", found("daemon"), ids=ids)
def test_it_reaches_a_daemon(command: Command, daemon: tuple[Path, Bench], capsys: pytest.CaptureFixture[str]) -> None:
    folder, _ = daemon
    words = words_here(command.line)
    if command.verb == "zero":
        words.append("--force")  # there is grain
    if command.verb == "monitor":
        words.append("--once")
    if command.verb == "ticket":
        with contextlib.suppress(SystemExit):
            main(["load", "stop", "--socket", str(folder / "yieldmon.sock")])  # an open load takes none
        capsys.readouterr()
    place = 2 if words[0] in ("load", "sweep") else 1
    assert main([*words[:place], "--socket", str(folder / "yieldmon.sock"), *words[place:]]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("command", found("parsed"), ids=ids)
def test_it_parses(command: Command) -> None:
    words = words_here(command.line)
    parser, _ = build_parser(VERBS, VERBS[command.verb])
    assert parser.parse_args(words).verb == command.verb


def test_commands_are_found() -> None:
    pages = {command.page for command in commands()}
    assert {"getting-started.md", "season.md", "service.md", "exporting.md", "logs.md", "README.md"} <= pages


def test_guide_and_reference_are_short() -> None:
    count = {page.name: len(page.read_text(encoding="utf-8").split()) for page in PAGES}
    assert sum(count.values()) <= LONGEST_WORDS, count


def test_troubleshooting_speaks_of_every_fault() -> None:
    text = (DOCS / "guide" / "troubleshooting.md").read_text(encoding="utf-8")
    assert {code.value for code in FaultCode if code.value not in text} == set()


@pytest.mark.parametrize("page", LINKED, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_paths_of_the_repository_are_there(page: Path) -> None:
    named = re.findall(
        r"`((?:yieldmon|tests|studies|tools|config|dbc|examples|systemd|docs)/[\w./-]+)`", page.read_text(encoding="utf-8")
    )
    assert [path for path in named if "NAME" not in path and not (ROOT / path).exists()] == []


@pytest.mark.parametrize("page", LINKED, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\(([^)\s#]+)(?:#[^)\s]*)?\)", page.read_text(encoding="utf-8"))
    missing = [target for target in targets if "://" not in target and not (page.parent / target).exists()]
    assert missing == []


@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_every_page_is_linked(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    names = [f"{part}/{other.name}" for part in ("guide", "reference", "internals") for other in (DOCS / part).glob("*.md")]
    assert [name for name in sorted(names) if f"{name})" not in text] == []


@pytest.mark.parametrize("folder", ["studies", "examples"])
def test_a_list_names_every_study_and_example(folder: str) -> None:
    text = (ROOT / folder / "README.md").read_text(encoding="utf-8")
    there = [path for path in (ROOT / folder).iterdir() if path.suffix == ".py" or (path.is_dir() and any(path.glob("*.*")))]
    assert [path.name for path in sorted(there) if path.name[0] not in "_." and path.name not in text] == []
