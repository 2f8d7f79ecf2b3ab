"""What it costs to add something: in a scratch copy of the package, by the count of product files edited."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = ("yieldmon", "dbc", "config")

DRIVE = """
import json, sys
from yieldmon.bus.log_files import mf4
mf4.defer()
from yieldmon.bus.codec import Codec
from yieldmon.engine.results import frames_in, records_in
from yieldmon.frames import Frame
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.assembly import monitor_of
from yieldmon.service.storage.rows import second_row
from yieldmon.service.storage.batch import Batch
from yieldmon.service.storage.store import Store
codec = Codec()
monitor, results = monitor_of(configuration.load(sys.argv[1] if len(sys.argv) > 1 else shipped("config/yieldmon.yaml"))), []
for k in range(1200):
    at = 100.0 + 0.004 * k
    samples = {f"Sample{i}": 150.0 + (k + i) % 3 for i in range(4)}
    results += monitor.feed(Frame(at, "ImpactSensorSamples", {**samples, "SampleCounter": k % 256, "SensorStatus": 0}))
    if k % 25 == 0:
        results += monitor.feed(Frame(at, "ElevatorSpeed", {"ElevatorSpeed": 400.0}))
        results += monitor.feed(Frame(at, "PlateActuatorFeedback", {"PlateAngle": 70.0, "ActuatorState": 0}))
        results += monitor.feed(Frame(at, "GrainCondition", {"Moisture": 15.0, "TestWeight": 700.0, "BrokenKernels": 2.5}))
sent = {}
for frame in frames_in(results):
    sent[frame.message] = dict(codec.decode(codec.encode(frame)).signals)
rows = [second_row(n, record) for n, record in enumerate(records_in(results), 1)]
"""


class Scratch:
    """A copy of what the product consists of, in which files are edited."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in PRODUCT:
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("dem"))

    def edit(self, name: str, *changes: tuple[str, str]) -> None:
        """Replace texts that stand there once or more, each its first time."""
        path = self.folder / name
        text = path.read_text()
        for old, new in changes:
            assert old in text, f"{name} has no {old!r}"
            text = text.replace(old, new, 1)
        path.write_text(text)

    @property
    def edited(self) -> list[str]:
        """Product files that are not as they were, or new."""
        files = (path for name in PRODUCT for path in (self.folder / name).rglob("*") if path.is_file())
        names = (str(path.relative_to(self.folder)) for path in files if "__pycache__" not in path.parts)
        return sorted(
            name for name in names
            if not (ROOT / name).is_file() or (ROOT / name).read_bytes() != (self.folder / name).read_bytes()
        )  # fmt: skip

    def run(self, script: str) -> dict:
        """What a script prints, run with the copy as the package."""
        environment = {**os.environ, "PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, "-c", DRIVE + script]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=self.folder, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)


def add_a_fault(scratch: Scratch) -> None:
    scratch.edit(
        "yieldmon/engine/faults.py",
        ('    SCALE_FAULT = "ScaleFault"\n', '    SCALE_FAULT = "ScaleFault"\n    GRAIN_WET = "GrainWet"\n'),
        (
            "FAULTS: Mapping",
            '_TABLE += (FaultDefinition(_C.GRAIN_WET, 524000, 16, _N, 1, 3, "Wet.", "None.", "Wait.",\n'
            '    lambda o: "wet" if o.reading.inputs.fresh["moisture"] > 14.0 else None),)\n'
            "FAULTS: Mapping",
        ),
    )
    scratch.edit(
        "dbc/yieldmon.dbc",
        (
            ' SG_ ScaleFault : 44|2@1+ (1,0) [0|1] "" Combine\n',
            ' SG_ ScaleFault : 44|2@1+ (1,0) [0|1] "" Combine\n SG_ GrainWet : 62|2@1+ (1,0) [0|1] "" Combine\n',
        ),
        ("VAL_ 2566855043 ScaleFault", 'VAL_ 2566855043 GrainWet 0 "Off" 1 "On" 2 "E" 3 "N" ;\nVAL_ 2566855043 ScaleFault'),
    )


def fault_is_there(scratch: Scratch) -> None:
    found = scratch.run('print(json.dumps({"sent": sent["YieldMonitorStatus"]["GrainWet"], "faults": rows[-1].faults}))')
    assert found == {"sent": 1, "faults": "GrainWet"}


def add_a_signal(scratch: Scratch) -> None:
    """Broken kernels: taken in, recorded in every form, published."""
    scratch.edit(
        "yieldmon/engine/sources.py",
        (
            '        Quantity("test_weight"',
            '        Quantity("broken_kernels", "%", _within(0.0, 100.0), "condition_timeout_s", "share of mass"),\n'
            '        Quantity("test_weight"',
        ),
        (
            '        InputSource("test_weight"',
            '        InputSource("broken_kernels", bus.GRAIN_CONDITION, "BrokenKernels"),\n        InputSource("test_weight"',
        ),
    )
    scratch.edit(
        "yieldmon/engine/records.py",
        (
            '    course_deg: float = second_field(lambda s: s.reading.inputs.fresh["course"], "known")\n',
            '    course_deg: float = second_field(lambda s: s.reading.inputs.fresh["course"], "known")\n'
            '    broken_kernels_pct: float = second_field(lambda s: s.reading.inputs.fresh["broken_kernels"], "known",\n'
            '                                                 since=10, published=("MassFlow", "BrokenKernels"))\n',
        ),
    )
    scratch.edit(
        "dbc/yieldmon.dbc",
        (
            ' SG_ WindowCounter : 40|8@1+ (1,0) [0|255] "" Combine\n',
            ' SG_ WindowCounter : 40|8@1+ (1,0) [0|255] "" Combine\n SG_ BrokenKernels : 48|16@1+ (0.01,0) [0|100] "%" Combine\n',
        ),
    )


def signal_is_there(scratch: Scratch) -> None:
    store = ROOT / "tests" / "golden" / "store-0.1.0.sqlite"
    shutil.copy(store, scratch.folder / "old.sqlite")
    found = scratch.run("""
from pathlib import Path
from yieldmon.service.logs import tables
with Store.reading(Path("old.sqlite")) as store:
    read_as_it_is = store.seconds()[0].broken_kernels_pct
with Store(Path("old.sqlite")) as store:
    old, number = store.seconds()[-1], store.last_second().number
    kept = len(store.seconds())
    batch = Batch(store.last_batch() + 1, 1.0, {}, seconds=(second_row(number + 1, records_in(results)[-1]),))
    store.commit([batch])
    new = store.last_second()
print(json.dumps({
    "row": rows[-1].broken_kernels_pct, "sent": sent["MassFlow"]["BrokenKernels"],
    "column": "broken_kernels_pct" in tables.COLUMNS,
    "read_as_it_is": read_as_it_is, "old": old.broken_kernels_pct, "new": new.broken_kernels_pct, "kept": kept,
}))
""")
    expected = {"row": 2.5, "sent": 2.5, "column": True, "old": None, "new": 2.5, "kept": 179}
    assert found == expected | {"read_as_it_is": None}


def add_a_sensor(scratch: Scratch) -> None:
    """A second impact sensor is configuration: here its samples come in the same frames' places."""
    impact = "{message: ImpactSensorSamples, signals: [Sample0, Sample1, Sample2, Sample3], spacing_ms: 1, source: %s}"
    scratch.edit("config/yieldmon.yaml", ("signals: {}", f"signals: {{impact_voltage: [{impact % 129}, {impact % 145}]}}"))


def sensor_is_there(scratch: Scratch) -> None:
    found = scratch.run('print(json.dumps({"sensors": len(monitor.sources.impact)}))')
    assert found == {"sensors": 2}


@pytest.mark.parametrize(
    ("add", "check", "most"),
    [(add_a_fault, fault_is_there, 2), (add_a_signal, signal_is_there, 3), (add_a_sensor, sensor_is_there, 2)],
    ids=["fault", "signal", "impact sensor"],
)
def test_product_files_that_an_addition_takes(
    add: Callable[[Scratch], None], check: Callable[[Scratch], None], most: int, tmp_path: Path
) -> None:
    scratch = Scratch(tmp_path)
    assert scratch.edited == []
    add(scratch)
    assert 1 <= len(scratch.edited) <= most
    check(scratch)
