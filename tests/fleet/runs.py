"""Tasks of a tree of logs."""

from __future__ import annotations

from pathlib import Path

from yieldmon.fleet import manifest
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.identity import parameters_sha256, software
from yieldmon.fleet.worker import Task
from yieldmon.resources import shipped
from yieldmon.service.config import configuration

LOADED = configuration.load(shipped("config/yieldmon.yaml"))
HASH = parameters_sha256(LOADED)


def tasks(source: Path, out: Path) -> list[Task]:
    dataset = Dataset(str(out))
    token = dataset.begin()
    return [
        Task(partition, dataset.address, token, LOADED, HASH, software()) for partition in manifest.load(str(source)).partitions
    ]
