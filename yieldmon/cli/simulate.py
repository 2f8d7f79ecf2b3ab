"""Simulate a combine on a bus or into a log, and write the true flow as a table."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections import Counter
from contextlib import ExitStack

import can

from yieldmon import frames
from yieldmon.bus.codec import Codec, FrameError
from yieldmon.bus.log_files.log_writing import ENDINGS, writing
from yieldmon.bus.opening import add_bus_arguments, open_bus_from
from yieldmon.bus.waiting import receive
from yieldmon.cli import _named_files, _outputs
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import whole_number, within
from yieldmon.documents.simulate import SimulationDocument
from yieldmon.errors import InputError
from yieldmon.files import whole_file
from yieldmon.plant import scenario as scenarios
from yieldmon.plant.combine import BLOCK_S, VirtualCombine
from yieldmon.plant.truth_file import write_csv

NOT_SENT = "not sent"
"""Beside the message names in the summary's counts: frames that the bus did not take."""
LATEST_S = 9_999_999_999.0
"""Latest time stamp, in the year 2286: ten digits, as log formats print them."""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "simulate",
        help="simulate a combine on a bus or into a log",
        description=__doc__,
        epilog="example: yieldmon simulate --scenario demo --log demo.log --truth demo-truth.csv",
    )
    parser.add_argument("--scenario", default="demo", metavar="FILE", help="scenario file or shipped name (default: demo)")
    parser.add_argument("--machine", metavar="FILE", help="file or shipped name (default: the scenario's)")
    parser.add_argument("--log", metavar="FILE", help="write a log, as fast as possible (.log .asc .blf .trc .csv .db .mf4)")
    parser.add_argument("--truth", metavar="FILE", help="write the true flow per second from 0, as CSV")
    parser.add_argument("--duration", type=float, metavar="S", help="stop after S seconds (default: the scenario's)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="random seed (default: 0)")
    parser.add_argument("--start-time", type=float, default=0.0, metavar="T", help="first time stamp of the log, s (default: 0)")
    parser.add_argument("--json", action="store_true", help="print a summary as one JSON document")
    _outputs.add_force(parser, "log", "truth")
    add_bus_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Exit code 0; InputError for what cannot be used."""
    scenario = scenarios.load(_named_files.scenario_path(args.scenario))
    if args.duration is not None:
        scenario = scenario.model_copy(update={"duration_s": within("--duration", args.duration, 1.0, 400_000.0, "s")})
    whole_number("--seed", args.seed, 0)
    within("--start-time", args.start_time, 0.0, LATEST_S, "s")
    if args.truth is not None:
        whole_file.check_place(args.truth)
    machine = _named_files.machine(args.machine if args.machine is not None else scenario.machine)
    combine = VirtualCombine(scenario, machine, args.seed)
    codec = Codec()
    if args.log is not None and getattr(args, "interface", None) is not None:
        raise InputError("--log and -i", "both given", "a log or a bus")
    counts: Counter[str] = Counter()
    has_log = True
    try:
        if args.log is None:
            _drive_bus(combine, codec, args, counts)
        else:
            _write_log(combine, codec, args, counts)
    except (OSError, InputError):
        has_log = args.log is None
        raise
    except KeyboardInterrupt:
        if args.log is not None:
            print(f"yieldmon: interrupted; {args.log} holds {combine.time_s:.0f} s", file=sys.stderr)
        raise
    finally:
        # Beside a log that could not be written there is nothing that it is true of.
        if args.truth is not None and has_log:
            write_csv(args.truth, combine.truth)
    _report(combine, counts, args)
    return 0


def _write_log(combine: VirtualCombine, codec: Codec, args: argparse.Namespace, counts: Counter[str]) -> None:
    interrupted = None
    with whole_file.scratch_for(args.log) as scratch, ExitStack() as stack:
        try:
            writer = stack.enter_context(writing(scratch))
        except ValueError as error:
            raise InputError(f"--log {args.log}", str(error), ENDINGS) from None
        try:
            for frame in combine.frames_until(combine.scenario.duration_s):
                message = codec.encode(frame._replace(time_s=args.start_time + frame.time_s))
                message.channel = "can0"
                writer.on_message_received(message)
                counts[frame.message] += 1
        except KeyboardInterrupt as interrupt:
            # The part that is written is kept, which is said.
            interrupted = interrupt
    if interrupted is not None:
        raise interrupted


def _drive_bus(combine: VirtualCombine, codec: Codec, args: argparse.Namespace, counts: Counter[str]) -> None:
    """Real time against absolute deadlines; waiting for the next deadline is listening for commands."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    with open_bus_from(args, filters=codec.filters([frames.PLATE_ACTUATOR_COMMAND])) as bus:
        begin = time.monotonic()
        try:
            while combine.time_s + BLOCK_S <= combine.scenario.duration_s + 1e-9:
                for frame in list(combine.frames_until(combine.time_s + BLOCK_S)):
                    _listen_until(begin + frame.time_s, bus, codec, combine)
                    try:
                        bus.send(codec.encode(frame))
                        counts[frame.message] += 1
                    except can.CanOperationError as error:
                        if counts[NOT_SENT] == 0:
                            print(f"simulate: not sent ({error}); continuing", file=sys.stderr)
                        counts[NOT_SENT] += 1
        except KeyboardInterrupt:
            print(f"simulate: stopped at {combine.time_s:.2f} s", file=sys.stderr)


def _listen_until(deadline: float, bus: can.BusABC, codec: Codec, combine: VirtualCombine) -> None:
    while True:
        left = deadline - time.monotonic()
        message = receive(bus, max(left, 0.0))
        if message is None:
            if deadline - time.monotonic() <= 0.0:
                return
            continue
        try:
            frame = codec.decode(message)
        except FrameError as error:
            print(f"simulate: {error}", file=sys.stderr)
            continue
        if frame is not None:
            combine.handle(frame)


def _report(combine: VirtualCombine, counts: Counter[str], args: argparse.Namespace) -> None:
    truth = combine.truth
    flow = truth.columns["mass_flow_kg_s"]
    total = float(truth.columns["total_mass_kg"][-1]) if len(flow) else 0.0
    summary: SimulationDocument = {
        "scenario": args.scenario,
        "seed": args.seed,
        "duration_s": round(combine.time_s, 3),
        "frames": dict(sorted(counts.items())),
        "total_mass_kg": total,
        "largest_mass_flow_kg_s": float(flow.max()) if len(flow) else 0.0,
        "loads": [{"time_s": load.time_s, "mass_kg": load.mass_kg} for load in truth.loads],
        "log": args.log,
        "truth": args.truth,
    }
    if args.json:
        print_json(summary, indent=None)
        return
    print(f"{combine.time_s:.1f} s simulated, {total:.1f} kg, {sum(counts.values())} frames")
    for name, count in sorted(counts.items()):
        print(f"  {name:24s}{count:9d}")
