"""A stand-in for the daemon: its control socket and its store, filled with seconds of a made-up harvest as fast as wanted."""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tests import forked
from yieldmon.engine.records import COLUMNS
from yieldmon.errors import InputError
from yieldmon.frames import EstimateQuality, OperatingState
from yieldmon.service.operator.control import ControlServer
from yieldmon.service.storage.batch import Batch, Load
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

TEMPLATE = json.loads((Path(__file__).parent / "data" / "status.json").read_text())
_EMPTY = {float: 0.0, int: 0, str: ""}
SPEED_M_S, PASS_M, PASS_S = 1.8, 7.0, 240
HOME = (51.05, 12.15)


def row(number: int, start_s: float, load: int = 1) -> SecondRow:
    """A second of a harvest in parallel passes, with a better and a worse corner."""
    passes, along_s = divmod(number, PASS_S)
    along_m = SPEED_M_S * (along_s if passes % 2 == 0 else PASS_S - along_s)
    across_m = PASS_M * passes
    latitude = HOME[0] + along_m / 111_200.0
    longitude = HOME[1] + across_m / (111_200.0 * math.cos(math.radians(HOME[0])))
    flow = 7.0 + 2.0 * math.sin(along_m / 90.0) * math.cos(across_m / 70.0) + 0.1 * math.sin(1.7 * number)
    values: dict[str, Any] = {column.name: None if column.optional else _EMPTY[column.kind] for column in COLUMNS}
    values |= {
        "time_s": start_s + number, "duration_s": 1.0, "mass_flow_kg_s": flow, "std_dev_kg_s": 0.25,
        "mass_kg": flow, "load_number": load, "load_kg": 7.0 * (number % 1500), "coverage": 1.0,
        "total_kg": 7.0 * number, "force_n": 12.0, "force_std_dev_n": 0.3,
        "elevator_speed_rpm": 402.0, "plate_angle_deg": 70.0, "plate_still": 1, "moisture_pct": 15.0 + math.sin(number / 600.0),
        "latitude_deg": latitude, "longitude_deg": longitude, "ground_speed_m_s": SPEED_M_S, "quality": EstimateQuality.OK.value,
        "operating_state": OperatingState.HARVESTING.value, "parameter_version": 1, "sweep_step": -1, "load_std_dev_kg": 40.0,
    }  # fmt: skip
    return SecondRow(number, **values)


def shown(second: SecondRow) -> dict[str, Any]:
    """A second as `status` shows it."""
    window = asdict(second)
    window["quality"] = EstimateQuality(second.quality).name.lower()
    window["operating_state"] = OperatingState(second.operating_state).name.lower()
    return window


def two_hours_of_a_day(now_s: float) -> float:
    """The start of two hours of one day that are over: the page's map of today is of the newest day."""
    start_s = float(int(now_s) - 7200)
    return start_s if time.localtime(start_s).tm_yday == time.localtime(now_s).tm_yday else start_s - 7200.0


@dataclass
class StandIn:
    """What the page sees of a daemon. `second` lets time go on."""

    folder: Path
    start_s: float = field(default_factory=lambda: two_hours_of_a_day(time.time()))
    field_name: str = "north"
    crop: str = "corn"
    parameters_crop: str = "corn"
    units: str = "metric"
    faults: list[dict[str, Any]] = field(default_factory=list)
    asked: list[Mapping[str, Any]] = field(default_factory=list)
    statuses: int = 0
    refuses: str = ""
    number: int = 0
    windows: list[SecondRow] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.socket = self.folder / "yieldmon.sock"
        self.store_path = self.folder / "yieldmon.sqlite"
        self._batch = 0
        self.commit()

    def start(self) -> None:
        """Answer from now on."""
        self.server = ControlServer(self.socket, None, self.answer)
        self.server.start()

    def stop(self) -> None:
        """Answer no more, as a daemon that has ended."""
        self.server.stop()

    def commit(self, rows: tuple[SecondRow, ...] = (), **more: Any) -> None:
        """Seconds and whatever else comes with them, into the store."""
        self._batch += 1
        load = Load(1, self.field_name, self.crop, self.start_s, None, 7.0 * self.number, None)
        with Store(self.store_path) as store:
            more.setdefault("loads", (load,))
            store.commit([Batch(self._batch, self.start_s + self.number, {"engine": {}}, seconds=rows, **more)])

    def seconds(self, count: int) -> None:
        """Some more seconds."""
        rows = tuple(row(number, self.start_s) for number in range(self.number + 1, self.number + count + 1))
        self.number += count
        self.commit(rows)
        self.windows = [*self.windows, *rows][-10:]

    def status(self) -> dict[str, Any]:
        """The whole status document."""
        self.statuses += 1
        document = json.loads(json.dumps(TEMPLATE))
        document |= {"age_s": 0.0, "stale": False, "state": "harvesting", "faults": self.faults, "units": self.units}
        document["load"] |= {"field": self.field_name, "crop": self.crop, "mass_kg": 7.0 * self.number, "std_dev_kg": 40.0}
        document["crop"] = {"name": self.crop or self.parameters_crop, "bushel_kg": None, "market_moisture_pct": None}
        document["total"]["mass_kg"] = 7.0 * self.number
        document["store"]["file"] = str(self.store_path)
        document["windows"] = [shown(second) for second in self.windows]
        return document

    def answer(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """As the daemon's control socket does."""
        if request["command"] == "status":
            return self.status()
        # The control server adds who asks.
        self.asked.append({name: value for name, value in request.items() if name != "who"})
        if self.refuses:
            raise InputError(request["command"], self.refuses)
        weighed = {"factor": 1.0, "measured_mass_kg": 1.0, "weighed_mass_kg": 1.0, "is_reference": True}
        named = {"load": 1, "field": "", "crop": "", "zero": "started", "sweep": "started"}
        return {"mass_kg": 1.0, "restored_kg": 0.0, **named, **weighed}


def fault(code: str = "FramesLost", detail: str = "") -> dict[str, Any]:
    """A fault as `status` shows it."""
    return {
        "code": code, "severity": "stop_trusting", "since_s": 1.0, "occurrences": 1, "detail": detail, "cause": "c",
        "effect": "What it does.", "remedy": "What to do.",
    }  # fmt: skip


@contextmanager
def standing_in(folder: Path, **how: Any) -> Iterator[StandIn]:
    """A stand-in that answers."""
    daemon = StandIn(folder, **how)
    daemon.start()
    try:
        yield daemon
    finally:
        daemon.stop()


class Site(str):
    """A page's address, and the process that serves it."""

    pid: int


@contextmanager
def page(socket: Path, *options: str, before: str = "") -> Iterator[Site]:
    """`yieldmon web` as a process of its own at a free port, forked from one with its packages; yields its address.
    before: Python that it runs first."""
    with forked.running("web", "--socket", str(socket), "--listen", "127.0.0.1:0", *options, before=before) as process:
        line = process.line()
        assert "http://" in line, line + process.rest()
        try:
            site = Site(line.split()[-1].rstrip("/"))
            site.pid = process.pid
            yield site
        finally:
            process.send_signal(signal.SIGTERM)
            said = process.rest()
            assert process.wait() == 0, said
            assert said == ""
