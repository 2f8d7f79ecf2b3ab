"""Whatever adds logs up or learns from them refuses one that is there twice under another name, as it is or gzipped."""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from tests.fleet import logs
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.logs import measured_loads, tap_samples, weighed_waves

CONFIGURED = configuration.load(shipped("config/yieldmon.yaml"))
READERS: dict[str, Callable[[Sequence[str]], object]] = {
    "weighed loads": lambda paths: measured_loads.read(paths, CONFIGURED),
    "waves of weighed loads": lambda paths: weighed_waves.read(paths, CONFIGURED),
    "taps": lambda paths: tap_samples.read(paths, CONFIGURED.signals),
}


@pytest.fixture(params=["b.log", "b.log.gz"])
def copied(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[str, str]:
    path = logs.write(tmp_path / "a.log")
    content = path.read_bytes()
    copy = tmp_path / request.param
    copy.write_bytes(gzip.compress(content) if copy.suffix == ".gz" else content)
    return str(path), str(copy)


@pytest.mark.parametrize("reader", READERS)
def test_readers_of_several_logs(reader: str, copied: tuple[str, str]) -> None:
    with pytest.raises(InputError, match=re.escape(f"{copied[1]}: is the same log as {copied[0]}")):
        READERS[reader](copied)


@pytest.mark.parametrize("verb", ["process", "pack"])
def test_commands_on_several_logs(verb: str, copied: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / ("out.csv" if verb == "process" else "out.parquet")
    assert main([verb, *copied, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"{copied[1]}: is the same log as {copied[0]}" in said
    assert said.count("\n") == 1
    assert not out.exists()
