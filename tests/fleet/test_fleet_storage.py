"""`fleet run` on storage that is full, read-only or closed to this user: no fault of the day, which the next run measures."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import subprocess
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest

from tests.file_limit import files_end_at
from tests.fleet import logs
from tests.fleet.logs import dataset_files
from tests.fleet.runs import tasks
from yieldmon import api
from yieldmon.bus.log_files.log_writing import writing
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.field import sources
from yieldmon.fleet import manifest
from yieldmon.fleet.copies import with_copies
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.worker import DONE, LEFT, SKIPPED, Outcome, work

Resize = Callable[[str], None]
Run = Callable[[], tuple[int, dict[str, Any], str]]


def whole(out: Path) -> dict[str, bytes]:
    return {name: content for name, content in dataset_files(out).items() if name != "_run"}


@pytest.fixture
def small(tmp_path: Path) -> Iterator[tuple[Path, Resize]]:
    """A medium of 80 KB of its own, and what mounts it anew with other options."""
    place = tmp_path / "small"
    place.mkdir()
    mounted = subprocess.run(("mount", "-t", "tmpfs", "-o", "size=80k", "none", place), capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip(f"no file system may be mounted here: {mounted.stderr.decode().strip()}")

    def anew(options: str) -> None:
        subprocess.run(("mount", "-o", f"remount,{options}", place), check=True)

    try:
        yield place, anew
    finally:
        subprocess.run(("umount", "-l", place), check=True)


@pytest.fixture
def run(tree: Path, capsys: pytest.CaptureFixture[str]) -> Callable[[Path], tuple[int, dict[str, Any], str]]:
    def once(out: Path) -> tuple[int, dict[str, Any], str]:
        code = main(["fleet", "run", str(tree), "--out", str(out), "--workers", "0", "--json"])
        said = capsys.readouterr()
        return code, json.loads(said.out), said.err

    return once


def test_days_that_a_full_disk_has_no_room_for_are_left(
    small: tuple[Path, Resize], run: Callable[[Path], tuple[int, dict[str, Any], str]], measured: Path
) -> None:
    place, anew = small
    out = place / "out"
    code, document, said = run(out)
    assert (code, document["done"], document["left"], document["failed"], document["poisoned"]) == (1, 1, 3, 0, [])
    assert {item["problem"].partition("; ")[0] for item in document["why_left"]} == {f"{out}: No space left on device"}
    assert said.count("left to the next run; continuing with other days") == 1
    assert "expected room for the file" in said
    assert Dataset(str(out)).failures() == []
    assert {*whole(out).items()} < {*whole(measured).items()}
    anew("size=10m")
    code, document, _ = run(out)
    assert (code, document["done"], document["skipped"], document["left"]) == (0, 3, 1, 0)
    assert whole(out) == whole(measured)


def test_without_json_the_reason_stands_once_for_a_machine(
    tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with files_end_at(4_000):
        assert main(["fleet", "run", str(tree), "--out", str(tmp_path / "out"), "--workers", "0"]) == 1
    *_, first, second, last = capsys.readouterr().err.splitlines()
    for line, machine in ((first, "m0"), (second, "m1")):
        assert line.startswith(f"left to the next run: machine={machine} (2 days): ")
        assert line.endswith("File too large; expected a medium and a user that may have a file of this size (`ulimit -f`)")
    assert last.endswith(": 0 measured, 0 already there, 0 failed, 4 left to the next run; 0 frames")


def test_a_read_only_medium_leaves_the_day_and_what_is_there(small: tuple[Path, Resize], tree: Path) -> None:
    place, anew = small
    anew("size=10m")
    first, second, *_ = tasks(tree, place / "out")
    assert work(first).status == DONE
    before = dataset_files(place / "out")
    anew("ro")
    outcomes = [work(first), work(second)]
    assert [outcome.status for outcome in outcomes] == [LEFT, LEFT]
    assert all("Read-only file system; expected a place on a medium that takes writing" in each.why_left for each in outcomes)
    anew("rw")
    assert dataset_files(place / "out") == before
    assert [work(first).status, work(second).status] == [SKIPPED, DONE]


def test_a_folder_that_this_user_may_not_write_leaves_the_day() -> None:
    place = Path(tempfile.mkdtemp())
    user, was_root = os.geteuid(), os.geteuid() == 0
    try:
        place.chmod(0o755)
        logs.tree(place / "tree", 1, 1)
        [task] = tasks(place / "tree", place / "out")
        (place / "out").chmod(0o555)
        if was_root:
            os.seteuid(65534)
        outcome = work(task)
    finally:
        os.seteuid(user)
        (place / "out").chmod(0o755)
        shutil.rmtree(place)
    assert (outcome.status, outcome.poisoned) == (LEFT, ())
    assert "Permission denied; expected a file or folder that user " in outcome.why_left


def test_too_many_open_files_end_the_run_before_a_copy_counts_twice(tree: Path, tmp_path: Path) -> None:
    """A log that could not be compared would be taken for no copy, and its mass counted again."""
    source = shutil.copytree(tree, tmp_path / "tree")
    shutil.copy(source / "m0" / "2026-10-01" / "a.log", source / "m0" / "2026-10-02" / "b.log")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    found = manifest.load(str(source)).partitions
    least = max(int(name) for name in os.listdir("/proc/self/fd")) - 1
    held = [os.open("/dev/null", os.O_RDONLY) for _ in range(3)]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(least, *held), hard))
    try:
        with pytest.raises(OSError, match="Too many open files"):
            with_copies(found)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for descriptor in held:
            os.close(descriptor)
    assert [len(partition.copies) for partition in with_copies(found)] == [0, 1, 0, 0]


def packed_log(path: Path) -> Path:
    """A log that is unpacked into the folder for temporary files to be read."""
    path.parent.mkdir(parents=True)
    plain = path.with_suffix("")
    source = logs.write(path.with_name("plain.log"))
    with writing(plain) as writer:
        for message in api.read_log(source):
            writer.on_message_received(message)
    source.unlink()
    subprocess.run(("gzip", "-1", plain), check=True)
    return path


def test_no_room_to_unpack_a_log_is_no_damage_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = packed_log(tmp_path / "tree" / "m" / "1" / "a.db.gz")
    [task] = tasks(tmp_path / "tree", tmp_path / "out")
    with files_end_at(100_000):
        outcome: Outcome = work(task)
        assert main(["process", str(log), "--out", str(tmp_path / "rows.csv"), "--jobs", "1"]) == 2
    assert (outcome.status, outcome.poisoned) == (LEFT, ())
    expected = f"{log}: no room in {tempfile.gettempdir()} to unpack it; expected room there, or another folder by TMPDIR"
    assert capsys.readouterr().err == f"yieldmon: {expected}\n"
    assert not (tmp_path / "rows.csv").exists()
    assert work(task).status == DONE


def test_no_room_to_unpack_harvests_leaves_none_out(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name, count in (("small.csv", 10), ("large.csv", 20_000)):
            archive.writestr(name, "time_s,latitude_deg,longitude_deg,mass_flow_kg_s\n" + "1,50,10,5\n" * count)
    with files_end_at(100_000), pytest.raises(InputError, match="to unpack it; expected room there, or another folder"):
        sources.read(tmp_path / "a.zip", sources.ReadOptions())


def test_a_dataset_in_a_storage_leaves_those_whose_names_its_own_is_a_pattern_for(tmp_path: Path) -> None:
    def stored() -> dict[str, bytes]:
        names: list[str] = files.find("/fleet")
        return {name: files.cat_file(name) for name in names}

    files, _ = fsspec.core.url_to_fs("memory://fleet")
    (tmp_path / "records.parquet").write_bytes(b"records")
    name, content = "machine=m/day=d", {"key": "k", "poisoned": []}
    first, second = Dataset("memory://fleet/season1"), Dataset("memory://fleet/season[1]")
    first.commit(name, tmp_path, content, first.begin())
    before = stored()
    token = second.begin()
    second.commit(name, tmp_path, content, token)
    second.fail("machine=m/day=e", {"machine": "m", "day": "e", "problem": "p"}, token)
    files.pipe_file(f"/fleet/season[1]/{name}/stray.parquet", b"half")
    token = second.begin()
    second.commit(name, tmp_path, content, token)
    second.commit("machine=m/day=e", tmp_path, content, token)
    second.end(token)
    after = stored()
    own = {path.removeprefix("/fleet/season[1]/") for path in after if path.startswith("/fleet/season[1]/")}
    files.rm_file("/fleet/season1/_run")
    assert own == {f"machine=m/day={day}/{file}" for day in "de" for file in ("records.parquet", "_COMMITTED")}
    assert {path: after[path] for path in before} == before


def test_a_storage_that_does_not_answer_is_named_while_it_is_tried(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The library for S3 tries for seven minutes, and nothing was said."""
    from fsspec.implementations.memory import MemoryFileSystem

    def silent(*_: object, **__: object) -> None:
        time.sleep(0.5)
        raise TimeoutError(errno.ETIMEDOUT, "Read timeout")

    monkeypatch.setattr("yieldmon.fleet.filesystem.SLOW_S", 0.1)
    for name in ("ls", "find", "exists", "isdir", "info", "cat_file", "open"):
        monkeypatch.setattr(MemoryFileSystem, name, silent)
    assert main(["fleet", "report", "memory://season"]) == 1
    first, second = capsys.readouterr().err.splitlines()
    assert first == "yieldmon: memory://season: no answer for 0 s; still trying"
    assert "Read timeout" in second
    assert "run again" not in second
