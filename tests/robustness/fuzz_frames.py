"""Random and mutated frames through codec and engine: nothing may escape.

python -m tests.robustness fuzz-frames --count 1000000 --seed 1

A harvest with sweeps whose frames are dropped, doubled, shifted in time and swapped, with bits flipped, lengths, identifiers and
kinds changed, reserved values and values no frame can carry, and random frames between, from one in a thousand to all of them;
operator commands at random instants. An escape is an exception; a frame that the monitor sends and the codec cannot pack within
the signals' ranges; a plate command outside the machine's range; a mass, flow or standard deviation that is negative or no
number; a total that runs back; a state that does not come back from JSON. Every 50,000 frames a new monitor begins.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import can

from tests.service.bench import traffic
from yieldmon import frames
from yieldmon.bus.codec import Codec, FrameError
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import Result, WindowResult
from yieldmon.engine.state import EngineState
from yieldmon.frames import ERROR, NOT_AVAILABLE, CommandMode, Frame
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration
from yieldmon.service.storage.rows import second_row

LIFE_FRAMES = 50_000
RATES = (0.001, 0.01, 0.1, 0.5, 1.0)
#: A sweep soon, and again, that little can end, so that frames go wrong in the middle of one and the calibration sees the rest.
SETTINGS = {
    "sweep": {
        "first_after_s": 5, "interval_s": 60, "backoff_s": 5, "min_flow_kg_s": 0.1, "steady_cv": 1.0, "flow_change": 1.0,
        "flow_change_away": 10.0, "feedback_plausibility_flow_spread": 5.0, "angles_deg": [40.0, 55.0, 90.0],
    }
}  # fmt: skip
TIMES_S = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e10, 1e12, 1e300)
STEPS_S = (-7200.0, -1.0, -0.2, -0.05, -0.004, 0.0, 0.05, 1.5, 30.0, 59.0, 61.0, 7200.0)
VALUES = (math.nan, math.inf, -math.inf, -1.0, 0.0, 1e308, 10**400, True, "x", None, NOT_AVAILABLE, ERROR, b"", 255, 256)
COUNTED = ("frames", "not_ours", "malformed", "windows", "sent", "sweeps", "learnt", "refused_commands")


class Escape(Exception):
    """What must not happen."""


class Fuzzer:
    """One monitor under fire."""

    def __init__(self, codec: Codec, loaded: configuration.Configuration, rng: random.Random) -> None:
        self._codec = codec
        self._machine = loaded.machine
        self._rng = rng
        self._monitor: Monitor = build_monitor(loaded.engine, loaded.machine, loaded.parameters, loaded.calibrator)
        self._identifiers = [layout.frame_id for layout in codec.layouts.values()]
        self._angle_deg = self._home_deg = math.degrees(loaded.machine.home_plate_angle_rad)
        self._total_kg = 0.0
        self._shift_s = 0.0
        self._late: list[can.Message] = []
        self.counts = dict.fromkeys(COUNTED, 0)

    def live(self, count: int) -> None:
        """Feeds so many frames."""
        rng = self._rng
        rate = rng.choice(RATES)
        harvest = self._harvest()
        while self.counts["frames"] < count:
            if rng.random() < 2e-4:
                self._command()
            frame = next(harvest)
            if frame.message == frames.PLATE_ACTUATOR_FEEDBACK:
                frame = frame._replace(signals={"PlateAngle": max(0.0, self._angle_deg), "ActuatorState": 0})
            frame = frame._replace(time_s=frame.time_s + self._shift_s)
            if rng.random() >= rate:
                self._feed_message(self._codec.encode(frame))
            elif rng.random() < 0.1:
                self._feed(self._odd_frame(frame))
            else:
                for message in self._mutations(self._codec.encode(frame)):
                    self._feed_message(message)
        self.counts["sweeps"] = self._monitor.sweep.sweep_id
        self.counts["learnt"] = int(self._monitor.outcome is not None)

    def _harvest(self) -> Iterator[Frame]:
        begin_s = 0.0
        while True:
            force_mv, speed_rpm = self._rng.choice((5.0, 60.0, 60.0, 400.0)), self._rng.choice((300.0, 400.0))
            yield from traffic(begin_s, 12.0, 0.0, speed_rpm=speed_rpm)
            yield from traffic(begin_s + 12.0, 160.0, force_mv, speed_rpm=speed_rpm)
            begin_s += 172.0

    def _mutations(self, message: can.Message) -> Iterator[can.Message]:  # noqa: C901, PLR0912 - a branch a kind
        rng = self._rng
        kind = rng.randrange(12)
        if kind == 0:
            return
        if kind == 1:
            yield message
        elif kind == 2:
            self._late.append(message)
            if len(self._late) > 3:
                rng.shuffle(self._late)
                yield from self._late
                self._late = []
            return
        elif kind == 3:
            if rng.random() < 0.05:
                message.timestamp = rng.choice(TIMES_S)
            else:
                message.timestamp += rng.choice(STEPS_S[2:8])
        elif kind == 4:
            if rng.random() < 0.02:
                self._shift_s += rng.choice(STEPS_S)
        elif kind <= 6:
            for _ in range(rng.randint(1, 8)):
                message.data[rng.randrange(len(message.data))] ^= 1 << rng.randrange(8)
        elif kind == 7:
            message.data = bytearray(rng.randbytes(rng.randrange(9)))
            message.dlc = len(message.data)
        elif kind == 8:
            message.arbitration_id = rng.choice(self._identifiers) ^ (rng.choice((0, 1 << rng.randrange(29))))
        elif kind == 9:
            flag = rng.randrange(3)
            message.is_remote_frame, message.is_error_frame = flag == 0, flag == 1
            message.is_extended_id = flag != 2
        elif kind == 10:
            message.data = bytearray([rng.choice((0x00, 0xFB, 0xFE, 0xFF))] * len(message.data))
        else:
            message.arbitration_id = rng.choice((rng.choice(self._identifiers), rng.getrandbits(29)))
            message.data = bytearray(rng.randbytes(8))
            message.dlc = 8
        yield message

    def _odd_frame(self, frame: Frame) -> Frame:
        """What no codec gives: the engine has to stand it all the same."""
        rng = self._rng
        signals = dict(frame.signals)
        name = rng.choice(list(signals))
        if rng.random() < 0.2:
            del signals[name]
        else:
            signals[name] = rng.choice(VALUES)  # type: ignore[assignment]
        message = frame.message if rng.random() < 0.9 else rng.choice((*frames.INPUTS, *frames.OUTPUTS, "Unheard"))
        return Frame(frame.time_s, message, signals)

    def _command(self) -> None:
        monitor, rng = self._monitor, self._rng
        commands: tuple[Callable[[], object], ...] = (
            monitor.start_load, monitor.stop_load, monitor.calibrate_zero, monitor.request_sweep, monitor.abort_sweep,
            lambda: monitor.ticket(rng.randrange(4), rng.choice((0.0, 500.0, math.nan)), rng.choice((2.0, -1.0))),
            lambda: monitor.report_fault(rng.choice(list(FaultCode)), rng.random() < 0.5, "fuzz"),
            lambda: self._happened(monitor.tick(rng.choice((*TIMES_S, self._shift_s + rng.uniform(0.0, 1e4))))),
        )  # fmt: skip
        try:
            rng.choice(commands)()
        except ValueError:
            # A ticket that makes no sense.
            self.counts["refused_commands"] += 1

    def _feed_message(self, message: can.Message) -> None:
        self.counts["frames"] += 1
        try:
            frame = self._codec.decode(message)
        except FrameError:
            self.counts["malformed"] += 1
            return
        if frame is None:
            self.counts["not_ours"] += 1
            return
        self._happened(self._monitor.feed(frame))

    def _feed(self, frame: Frame) -> None:
        self.counts["frames"] += 1
        self._happened(self._monitor.feed(frame))

    def _happened(self, results: list[Result]) -> None:
        for result in results:
            self._send(result.frames)
            if isinstance(result, WindowResult):
                self._window(result.record)

    def _send(self, out: Sequence[Frame]) -> None:
        for frame in out:
            self.counts["sent"] += 1
            try:
                back = self._codec.decode(self._codec.encode(frame))
            except FrameError as error:
                raise Escape(f"cannot be sent: {error}") from error
            assert back is not None
            if frame.message == frames.PLATE_ACTUATOR_COMMAND:
                self._plate(back)

    def _plate(self, command: Frame) -> None:
        mode, target = command.signals["CommandMode"], command.signals["TargetPlateAngle"]
        if mode == CommandMode.GO_TO_ANGLE.value:
            low, high = (math.degrees(a) for a in (self._machine.min_plate_angle_rad, self._machine.max_plate_angle_rad))
            if not isinstance(target, float) or not low - 0.01 <= target <= high + 0.01:
                raise Escape(f"the plate is commanded to {target} deg, its range is {low:g} to {high:g}")
        if self._rng.random() < 0.9:
            wish = target if isinstance(target, float) and mode == CommandMode.GO_TO_ANGLE.value else self._home_deg
            self._angle_deg += min(max(wish - self._angle_deg, -2.0), 2.0)

    def _window(self, record: WindowRecord) -> None:
        self.counts["windows"] += 1
        row = second_row(self.counts["windows"], record)
        for name in ("mass_kg", "load_kg", "total_kg", "duration_s", "coverage"):
            value = getattr(row, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise Escape(f"{name} is {value}")
        for name in ("mass_flow_kg_s", "std_dev_kg_s"):
            value = getattr(row, name)
            if value is not None and not (math.isfinite(value) and value >= 0.0):
                raise Escape(f"{name} is {value}")
        if row.total_kg < self._total_kg:
            raise Escape(f"the total ran back from {self._total_kg} to {row.total_kg} kg")
        self._total_kg = row.total_kg
        if self.counts["windows"] % 64 == 0:
            # Compared as documents: a standard deviation that is not known is nan, which equals nothing.
            document = self._monitor.snapshot().as_dict()
            if EngineState.from_dict(json.loads(json.dumps(document, allow_nan=False))).as_dict() != document:
                raise Escape("the state does not come back from JSON")


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when nothing escaped."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness fuzz-frames", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    codec = Codec()
    loaded = configuration.build(SETTINGS, Path("fuzz.yaml"), {})
    totals: dict[str, int] = {}
    escapes = 0
    told_s = time.monotonic()
    for life, first in enumerate(range(0, args.count, LIFE_FRAMES)):
        # A life of its own, so that an escape can be had again without those before it.
        fuzzer = Fuzzer(codec, loaded, random.Random(f"{args.seed} {life}"))
        try:
            fuzzer.live(min(LIFE_FRAMES, args.count - first))
        except Exception:  # noqa: BLE001 - what is looked for here
            escapes += 1
            print(f"seed {args.seed}, life {life}, frame {fuzzer.counts['frames']}:\n{traceback.format_exc()}", file=sys.stderr)
        for name, count in fuzzer.counts.items():
            totals[name] = totals.get(name, 0) + count
        if time.monotonic() - told_s > 10.0:
            told_s = time.monotonic()
            print(f"{totals['frames']} frames, {escapes} escapes", file=sys.stderr)
    totals["escapes"] = escapes
    print(json.dumps(totals) if args.json else ", ".join(f"{n} {name}" for name, n in totals.items()))
    return 1 if escapes else 0
