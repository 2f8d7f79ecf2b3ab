"""Keys of a configuration that are right by themselves and do not go together."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from pathlib import Path

from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sources import THOUSAND_KERNELS_G
from yieldmon.physics.machine import Machine
from yieldmon.service.config.document import Document
from yieldmon.service.folders import LONGEST_SOCKET_BYTES

#: Of python-can, which takes a fifth of a second to ask.
_COMMON_INTERFACES = frozenset({"socketcan", "udp_multicast", "virtual", "pcan", "kvaser", "slcan"})


#: At an angle, beside the windows measured: the one that had begun before, and the edge of the first that reaches into it.
_BESIDE_WINDOWS_S = 2.0


#: What the bus is opened with in any case; python-can would get them twice.
_NAMED_BUS_OPTIONS = frozenset({
    "interface", "channel", "bitrate", "can_filters", "filters", "receive_own", "receive_own_messages", "receive_buffer_bytes",
})  # fmt: skip


_NETWORK_DEVICE = re.compile(r"[^\s/:]+")
_LONGEST_DEVICE_BYTES = 15


def channel_problem(interface: str, channel: str) -> tuple[str, str] | None:
    """Why a bus cannot have this channel, and what is expected of it; None where it can."""
    if interface != "socketcan" or (_NETWORK_DEVICE.fullmatch(channel) and len(os.fsencode(channel)) <= _LONGEST_DEVICE_BYTES):
        return None
    return f"is {channel!r}", f"the name of a network device, as `ip link` lists it: 1 to {_LONGEST_DEVICE_BYTES} bytes, no space"


def contradictions(document: Document, engine: EngineSettings, machine: Machine) -> Iterator[tuple[str, str, str]]:
    """(key, value, expected) where keys that are right by themselves do not go together."""
    yield from _of_the_service(document)
    yield from _of_the_measurement(engine)
    yield from _of_the_sweep(engine, machine)


def _of_the_service(document: Document) -> Iterator[tuple[str, str, str]]:
    if document.bus.interface not in _COMMON_INTERFACES:
        import can

        if document.bus.interface not in can.VALID_INTERFACES:
            yield "bus.interface", repr(document.bus.interface), f"one of {', '.join(sorted(can.VALID_INTERFACES))}"
    if (wrong := channel_problem(document.bus.interface, document.bus.channel)) is not None:
        yield "bus.channel", *wrong
    for key in sorted(_NAMED_BUS_OPTIONS & set(document.bus.options)):
        yield f"bus.options.{key}", "is set by a key of bus, or by the daemon", "options that the bus section has no key for"
    if document.network.task_controller and not document.network.enabled:
        yield "network.task_controller", "true", "network.enabled: true, without which there is no address to connect from"
    if Path(document.status.socket).is_absolute() and len(os.fsencode(document.status.socket)) > LONGEST_SOCKET_BYTES:
        problem = f"has {len(os.fsencode(document.status.socket))} bytes"
        yield "status.socket", problem, f"at most {LONGEST_SOCKET_BYTES}, which is what a socket's address has room for"


def _of_the_measurement(engine: EngineSettings) -> Iterator[tuple[str, str, str]]:
    gate = engine.gate
    if gate.grain_off_n > gate.grain_on_n:
        yield "gate.grain_off_n", f"{gate.grain_off_n:g}", f"at most gate.grain_on_n, {gate.grain_on_n:g} N"
    if gate.certain_force_n < gate.grain_on_n:
        yield "gate.certain_force_n", f"{gate.certain_force_n:g}", f"at least gate.grain_on_n, {gate.grain_on_n:g} N"
    waveform = engine.waveform
    if waveform.kernel_low_hz >= waveform.kernel_high_hz:
        expected = f"below waveform.kernel_high_hz, {waveform.kernel_high_hz:g} Hz"
        yield "waveform.kernel_low_hz", f"{waveform.kernel_low_hz:g}", expected
    if 0.0 < waveform.thousand_kernel_weight_g < THOUSAND_KERNELS_G[0]:
        expected = f"0, or from {THOUSAND_KERNELS_G[0]:g} g, the mass of a thousand kernels"
        yield "waveform.thousand_kernel_weight_g", f"{waveform.thousand_kernel_weight_g:g}", expected
    windows = engine.windows
    if windows.min_coverage > windows.full_coverage:
        expected = f"at most windows.full_coverage, {windows.full_coverage:g}"
        yield "windows.min_coverage", f"{windows.min_coverage:g}", expected


def _of_the_sweep(engine: EngineSettings, machine: Machine) -> Iterator[tuple[str, str, str]]:
    sweep = engine.sweep
    if not sweep.enabled or engine.plate.fixed_angle_deg is not None:
        return
    needed_s = sweep.windows_per_step + _BESIDE_WINDOWS_S
    if sweep.measure_timeout_s < needed_s:
        expected = f"at least {needed_s:g} s for sweep.windows_per_step, {sweep.windows_per_step}; no sweep would end"
        yield "sweep.measure_timeout_s", f"{sweep.measure_timeout_s:g}", expected
    low, high = (math.degrees(a) for a in (machine.min_plate_angle_rad, machine.max_plate_angle_rad))
    for index, angle in enumerate(sweep.angles_deg):
        # The range went through radians and back.
        if not low - 1e-9 <= angle <= high + 1e-9:
            yield f"sweep.angles_deg[{index}]", f"{angle:g}", f"{low:g} to {high:g} deg, the range of {machine.name}"
