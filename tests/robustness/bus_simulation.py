"""The bus in a simulated world: other nodes that send what ours send, a clock that is set, frames of our own that come again,
threads that hang, totals near the end of their signals; random by seed, invariants after each life.

    python -m tests.robustness bus-simulation --lives 500 --seed 1
    python -m tests.robustness bus-simulation --undo "each echo once"      # a mend undone: it must be found
    python -m tests.robustness bus-simulation --table                      # every mend undone in turn

A life is a machine that runs empty, harvests half a minute, and meets one trouble. Engine, waiting, transmitter and the faults
are the daemon's own, on one thread and on a clock that only the simulation moves. `simulation` is the same for the store.

Invariants: no mass without its time, whatever the clock is set to, and the fault says so; a forged sensor, speed or angle is said
within two seconds, and a second that is not what the same machine measures unforged is not ok and in no total, while what follows
counts again; a frame of ours that another node repeats is no echo; nothing waits longer than it may; a thread that hangs
is said after two seconds; a mass that its signal cannot carry has been said before; every fault is in each message of them. Ends
with 1 when one is broken.
"""

from __future__ import annotations

import itertools
import random
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any, cast
from unittest import mock

import can
import numpy as np

from tests.robustness import undoing
from tests.robustness.undoing import Simulation, Trouble, live, mend, require
from tests.service.bench import START_S, traffic
from yieldmon import frames
from yieldmon.bus import waiting
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.health import FaultEvent
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import events_in, frames_in, records_in
from yieldmon.engine.sampling import sample_frames
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.state import EngineState
from yieldmon.frames import NOT_AVAILABLE, EstimateQuality, Frame
from yieldmon.network import diagnostics
from yieldmon.network.diagnostics import TroubleCode
from yieldmon.network.name import Name
from yieldmon.network.node import Node, NodeSettings
from yieldmon.service.assembly import monitor_of
from yieldmon.service.config import configuration
from yieldmon.service.storage.writer import StoreHealth
from yieldmon.service.traffic.echoes import ASKED_ECHO_S, ECHO_S, Echoes
from yieldmon.service.traffic.service_faults import ServiceFaults
from yieldmon.service.traffic.transmit import TransmitCounters, Transmitter

EMPTY_S, HARVEST_S = 14, 22
_SAID_S = 2.2
"""Two seconds, and the tenth after which a second is closed."""
_RECOVERED_S = 2.5
_LARGEST_CHANGE = 0.2
"""Of a second's mass: less may be a forger that sends what the sensor sends."""
_HANGS_S = 2.0


def harvest(rng: random.Random) -> list[Frame]:
    """A machine that runs empty and then harvests at some flow."""
    force_mv = rng.uniform(25.0, 80.0)
    return [*traffic(START_S, EMPTY_S, 0.0), *traffic(START_S + EMPTY_S, HARVEST_S, force_mv)]


@dataclass(frozen=True)
class Measured:
    """What an engine made of frames: seconds, what it said of faults, and what it sent."""

    totals: Totals
    seconds: list[WindowRecord]
    faults: list[FaultEvent]
    sent: list[Frame]

    def said_s(self, code: FaultCode, since_s: float) -> float:
        """When a fault was first said from then on; inf: never."""
        return min((e.time_s for e in self.faults if e.code is code and e.active and e.time_s > since_s), default=inf)


def measured(given: Iterable[Frame], totals: Totals | None = None) -> Measured:
    """An engine's work from a start with these totals."""
    engine = monitor_of(configuration.build({}, Path("simulated.yaml"), {}))
    if totals is not None:
        engine.restore(EngineState(totals=totals))
    results = [result for frame in given for result in engine.feed(frame)]
    faults = [event for event in events_in(results) if isinstance(event, FaultEvent)]
    return Measured(engine.totals, records_in(results), faults, frames_in(results))


# Troubles: what another node sends


def _of(given: list[Frame], message: str, begin_s: float, end_s: float) -> list[Frame]:
    return [frame for frame in given if frame.message == message and begin_s <= frame.time_s < end_s]


def _changed(frame: Frame, factor: float, later_s: float, counter: int | None = None) -> Frame:
    """A sample frame with so many times the signal."""
    values = {
        name: factor * cast("float", v) if name.startswith("Sample") and name[6:].isdigit() else v
        for name, v in frame.signals.items()
    }
    if counter is not None:
        values["SampleCounter"] = counter % 256
    return Frame(frame.time_s + later_s, frame.message, values)


def _same_counters(rng: random.Random, true: list[Frame]) -> Iterator[Frame]:
    every, factor, ahead_s = rng.choice((1, 2, 10, 50)), rng.choice((0.5, 1.5, 3.0)), rng.uniform(0.0005, 0.0015)
    return (_changed(frame, factor, -ahead_s) for frame in true[::every])


def _many_times(rng: random.Random, true: list[Frame]) -> Iterator[Frame]:
    """In the sensor's place one at many times its rate, with counters that run."""
    times = rng.randint(3, 10)
    for number, frame in enumerate(true):
        for k in range(times):
            yield _changed(frame, 1.0, 0.004 * k / times, times * number + k)


def _recording(rng: random.Random, true: list[Frame]) -> Iterator[Frame]:
    """What a sensor sent at another flow, with the counters of then."""
    shift, factor = rng.randrange(20, 230), rng.choice((0.6, 2.0))
    return (_changed(frame, factor, 0.0007, cast("int", frame.signals["SampleCounter"]) + shift) for frame in true)


def _late_copies(rng: random.Random, true: list[Frame]) -> Iterator[Frame]:
    late_s = rng.uniform(0.05, 0.3)
    return (_changed(frame, 1.0, late_s) for frame in true[:: rng.choice((1, 10))])


def _speed(rng: random.Random, true: list[Frame]) -> Iterator[Frame]:
    every, rpm = rng.choice(((1, 300.0), (1, 396.0), (2, 300.0), (10, 280.0)))
    return (Frame(frame.time_s + 0.03, frame.message, {"ElevatorSpeed": rpm}) for frame in true[::every])


def _angle(rng: random.Random, true: list[Frame]) -> Iterator[Frame]:
    every, angle_deg = rng.choice(((1, 60.0), (1, 69.0), (10, 55.0)))
    return (Frame(f.time_s + 0.02, f.message, {"PlateAngle": angle_deg, "ActuatorState": 0}) for f in true[::every])


_Forger = Callable[[random.Random, list[Frame]], Iterator[Frame]]
FORGERS: dict[_Forger, str] = {
    _same_counters: frames.IMPACT_SENSOR_SAMPLES, _many_times: frames.IMPACT_SENSOR_SAMPLES,
    _recording: frames.IMPACT_SENSOR_SAMPLES, _late_copies: frames.IMPACT_SENSOR_SAMPLES, _speed: frames.ELEVATOR_SPEED,
    _angle: frames.PLATE_ACTUATOR_FEEDBACK,
}  # fmt: skip


_REPLACING = (_many_times,)


def forged(rng: random.Random) -> None:
    """Another node for five seconds of a harvest."""
    _forged(rng, rng.choice(list(FORGERS)))


def contradicted(rng: random.Random) -> None:
    """One that sends other samples under the sensor's counters."""
    _forged(rng, _same_counters)


def crowded(rng: random.Random) -> None:
    """One in the sensor's place, at many times its rate."""
    _forged(rng, _many_times)


def _forged(rng: random.Random, forger: _Forger) -> None:
    given, begin_s = harvest(rng), START_S + EMPTY_S + rng.uniform(4.0, 8.0)
    end_s = begin_s + 5.0
    true = _of(given, FORGERS[forger], begin_s, end_s)
    false = list(forger(rng, true))
    left = [frame for frame in given if frame not in true] if forger in _REPLACING else given
    alone, found = measured(given), measured(sorted([*left, *false], key=lambda frame: frame.time_s))
    kind = forger.__name__.strip("_")
    said_s = found.said_s(FaultCode.FRAMES_LOST, begin_s)
    require(said_s <= begin_s + _SAID_S, f"{kind}: said after {said_s - begin_s:.1f} s")
    for lone, second in zip(alone.seconds, found.seconds, strict=True):
        at_s, wrong = second.time_s, abs(second.mass_kg - lone.mass_kg) > _LARGEST_CHANGE * lone.mass_kg
        if said_s <= at_s <= end_s and at_s - 1.0 >= begin_s:
            require(
                second.mass_kg == 0.0 and second.quality is not EstimateQuality.OK,
                f"{kind}: {second.mass_kg:.1f} kg contested, counted",
            )
        elif wrong:
            require(not said_s <= at_s <= end_s or second.quality is not EstimateQuality.OK, f"{kind}: a wrong second is ok")
            require(
                begin_s < at_s < end_s + _RECOVERED_S, f"{kind}: {second.mass_kg:.1f} kg of {lone.mass_kg:.1f} kg out of its time"
            )
    require(found.totals.total_contested_kg > 0.0, f"{kind}: no mass is apart")
    count_kg = sum(second.mass_kg for second in found.seconds)
    require(abs(count_kg - found.totals.total_kg) < 1e-6 * max(1.0, count_kg), f"{kind}: seconds do not add up to the total")


# Troubles: clocks, echoes, threads, ends of ranges


def clock_is_set(rng: random.Random) -> None:
    """By hours or seconds, with frames flowing."""
    given, at_s = harvest(rng), START_S + EMPTY_S + rng.uniform(2.0, 15.0)
    by_s = rng.choice((-1.0, 1.0)) * rng.choice((5.0, 3600.0, 86400.0, 1e7))
    found, alone = measured(f if f.time_s < at_s else f._replace(time_s=f.time_s + by_s) for f in given), measured(given)
    # A short step forward looks as if nothing had come for so long; a longer one is the clock's.
    silent_s = by_s if 0.0 < by_s <= EngineSettings().clock.max_gap_s else 0.0
    said = any(e.code is FaultCode.CLOCK_JUMPED and e.active for e in found.faults)
    require(said or silent_s > 0.0, f"a clock set by {by_s} s, unsaid")
    due = len(alone.seconds) + silent_s
    require(abs(len(found.seconds) - due) <= 1, f"{len(found.seconds)} windows of {due:g} with a clock set by {by_s} s")
    second_kg = max(second.mass_kg for second in alone.seconds)
    require(
        abs(found.totals.total_kg - alone.totals.total_kg) <= 1.1 * second_kg,
        f"{found.totals.total_kg:.1f} kg of {alone.totals.total_kg:.1f} kg with a clock set by {by_s} s",
    )


class _SilentBus(can.BusABC):
    """A bus on which nothing comes; waiting moves the clocks, of which the wall's is set now and then."""

    def __init__(self, rng: random.Random) -> None:
        super().__init__(channel="silent")
        self._rng, self.monotonic_s, self.wall_s = rng, 1000.0, 1.7e9

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Woken early by what the filters leave out, as a busy bus does."""
        waited_s = (timeout or 0.0) * self._rng.choice((0.3, 1.0))
        self.monotonic_s += waited_s
        self.wall_s += waited_s + self._rng.choice((0.0, 0.0, -3600.0, 3600.0))
        return (can.Message(), False) if self._rng.random() < 0.5 else (None, False)

    def _matches_filters(self, msg: can.Message) -> bool:
        return False


def waits(rng: random.Random) -> None:
    """For frames on a silent bus, while the clock is set."""
    bus = _SilentBus(rng)
    clocks = {"monotonic": mock.Mock(side_effect=lambda: bus.monotonic_s), "time": mock.Mock(side_effect=lambda: bus.wall_s)}
    with mock.patch.object(waiting, "monotonic", clocks["monotonic"]), mock.patch("can.bus.time", clocks["time"]):
        for _ in range(20):
            begun_s = bus.monotonic_s
            waiting.receive(bus, 0.1)
            require(bus.monotonic_s - begun_s <= 0.2, f"waits {bus.monotonic_s - begun_s:.0f} s of 0.1 s")
    bus.shutdown()


def repeated(rng: random.Random) -> None:
    """Our own frames, by an interface that shows them to us or does not, and another node's copies."""
    now_s, asked = 100.0, rng.random() < 0.5
    heard: deque[can.Message] = deque()
    sender = Transmitter(
        lambda message, _: heard.append(message) if asked else None, 64, 1.0, lambda: now_s, ASKED_ECHO_S if asked else ECHO_S
    )
    copies = 0
    for number in range(120):
        message = can.Message(arbitration_id=0x18FF0000, data=bytes([number % 256] * 8))
        sender.submit(message)
        _sends(sender)
        copied = number > 60 and rng.random() < 0.5
        now_s += 0.002
        foreign = sum(not sender.echoes.is_echo(one) for one in [*heard, *[message] * copied])
        heard.clear()
        copies += copied
        require(
            foreign == copied,
            f"frame {number}: {foreign} of another node, not {int(copied)}; echo {'asked for' if asked else 'none'}",
        )
        now_s += rng.uniform(0.05, 1.0)


def _sends(sender: Transmitter) -> None:
    """What waits, on this thread."""
    sender._stopping = True
    sender._run()
    sender._stopping = False


def hangs(rng: random.Random) -> None:
    """A driver that does not come back from sending for a while."""
    now_s, faults, hung_s = 100.0, ServiceFaults(), rng.uniform(2.5, 30.0)
    said: list[tuple[float, bool]] = []

    def send(message: can.Message, timeout_s: float | None) -> None:
        nonlocal now_s
        end_s = now_s + hung_s
        while now_s < end_s:
            now_s += 0.25
            found = faults.changes(
                now_s,
                sent=TransmitCounters(),
                hangs_s={"transmit": sender.hangs_s()},
                store=StoreHealth(),
                store_note="",
                network=(),
            )
            if found.get(FaultCode.BUS_ERROR):
                said.append((now_s, True))

    sender = Transmitter(send, 64, 1.0, lambda: now_s)
    sender.submit(can.Message())
    begun_s = now_s
    _sends(sender)
    require(bool(said) and said[0][0] <= begun_s + _HANGS_S + 0.5, f"hung for {hung_s:.0f} s, said {said[:1]}")


def near_the_end(rng: random.Random) -> None:
    """Totals of a fleet's life: what a signal does not carry has been said before it."""
    load_kg = rng.choice((1e3, 1.5e5, 1.7e5, 1.6e6, 1.7e6))
    total_kg = rng.choice((1e6, 4e7, 4.5e7, 4.2e8, 4.1e10, 4.3e10))
    totals = Totals(total_kg=max(total_kg, load_kg), load_kg=load_kg, load_number=3)
    found = measured(harvest(rng), totals)
    published = [frame for frame in found.sent if frame.message == frames.ACCUMULATED_MASS]
    silent = [name for frame in published for name in ("LoadMass", "TotalMass") if frame.signals[name] is NOT_AVAILABLE]
    said = any(e.code is FaultCode.MASS_NEAR_END and e.active for e in found.faults)
    require(bool(published), "no totals sent")
    require(said or not silent, f"{sorted(set(silent))} not available at {load_kg:g} and {total_kg:g} kg, unsaid")


_DM1, _BROADCAST, _PACKETS = 0xFECA, 0xECFF, 0xEBFF


def trouble_codes(rng: random.Random) -> None:
    """Several faults at once, as a display hears of them that puts messages together by the standard's own rules."""
    node = Node(NodeSettings(name=Name(identity_number=1)))
    node.start(0.0)
    due, heard = set[tuple[int, int]](), list[set[tuple[int, int]]]()
    size, parts = 0, list[bytes]()
    for tenth in range(200):
        sent = node.poll(0.1 * tenth)
        if tenth % 10 == 0 and node.address is not None:
            if tenth % 50 == 20:
                due = {(520192 + number, rng.randrange(31)) for number in range(rng.randint(2, 19))}
                heard.clear()
            sent = [*sent, *node.report_trouble([TroubleCode(spn, fmi) for spn, fmi in sorted(due)], 0.1 * tenth)]
        for frame in sent:
            group = frame.identifier >> 8 & 0x1FFFF
            if group == _DM1:
                heard.append(_codes_in(frame.data))
            elif group == _BROADCAST and frame.data[0] == 32 and int.from_bytes(frame.data[5:8], "little") == _DM1:
                size, parts = int.from_bytes(frame.data[1:3], "little"), []
            elif group == _PACKETS and size:
                parts.append(frame.data[1:])
                if 7 * len(parts) >= size:
                    heard.append(_codes_in(b"".join(parts)[:size]))
                    size = 0
        if due and tenth % 50 == 15:
            # The first one may have been on its way since before these faults.
            require(len(heard) >= 2, f"{len(heard)} messages of {len(due)} faults in 4 s")
            require(all(codes == due for codes in heard[1:]), f"{len(heard[-1])} of {len(due)} faults in a message")


def _codes_in(data: bytes) -> set[tuple[int, int]]:
    """Suspect parameter numbers and failure modes of a DM1, SAE J1939-73, conversion method 0."""
    found = (data[at : at + 4] for at in range(2, len(data) - 3, 4))
    return {(one[0] | one[1] << 8 | (one[2] >> 5) << 16, one[2] & 0x1F) for one in found if any(one)}


TROUBLES: tuple[Trouble, ...] = (*(forged, forged, forged, clock_is_set, waits, repeated, hangs, near_the_end, trouble_codes),)


def simulate(lives: int, seed: int) -> tuple[list[str], Counter[str]]:
    """What so many lives broke, and how often each trouble came."""
    return live(lives, seed, TROUBLES)


# Each mend undone


def _any_copy_is_an_echo(echoes: Echoes, message: can.Message) -> bool:
    """As it was: what was sent within the last second is an echo, however often it comes."""
    return (message.arbitration_id, bytes(message.data)) in [entry[1:] for entry in echoes._awaited]


def _counters_alone() -> AbstractContextManager[Any]:
    """Frames whose counter comes again are left out, whatever is in them."""
    return mock.patch.object(sample_frames, "_contradicted", lambda table, new, bounds: np.zeros(bounds.size - 1, np.intp))


def _no_rivals(self: object, times_s: Any, values: Any, bounds: Any, edges_s: Any) -> Any:
    return np.zeros(len(bounds) - 1, np.intp)


def _one_by_one() -> AbstractContextManager[Any]:
    """As it was: one code each second, by turns."""
    before, turn = diagnostics.message, itertools.count()

    def message(codes: Iterable[TroubleCode]) -> bytes:
        active = tuple(codes)
        return before((active[next(turn) % len(active)],) if active else ())

    return mock.patch.object(diagnostics, "message", message)


MENDS = {
    "waiting on monotonic time": mend((3,), waits, lambda: mock.patch.object(waiting, "receive", can.BusABC.recv)),
    "counters that come again": mend((8,), contradicted, _counters_alone),
    "frames closer than a sensor sends": mend((8,), crowded, lambda: mock.patch.object(sample_frames, "_CROWDED_FRAMES", 1e9)),
    "rivals of speed and angle": mend(
        (8,), forged, lambda: mock.patch("yieldmon.engine.duplicate_senders.DuplicateSenderWatch.take", _no_rivals),
    ),
    "contested mass apart": mend(
        (8,), forged, lambda: mock.patch("yieldmon.engine.sampling.windows.Window.contested", property(lambda window: False)),
    ),
    "each echo once": mend((8,), repeated, lambda: mock.patch.object(Echoes, "is_echo", _any_copy_is_an_echo)),
    "signs of life of the transmitter": mend(
        (9,), hangs, lambda: mock.patch.object(Transmitter, "hangs_s", return_value=0.0),
    ),
    "masses near the end": mend(
        (10,), near_the_end, lambda: mock.patch("yieldmon.engine.publishing.Publisher.mass_near_end", return_value=None),
    ),
    "a clock that is set": mend(
        (3,), clock_is_set, lambda: mock.patch("yieldmon.engine.clock.BusClock._absorb", return_value=None),
    ),
    "trouble codes together": mend((19,), trouble_codes, _one_by_one),
}  # fmt: skip


SIMULATION = Simulation(__doc__, "lives", 200, simulate, MENDS)


def main(arguments: list[str]) -> int:
    """See `undoing.main`."""
    return undoing.main(SIMULATION, arguments)
