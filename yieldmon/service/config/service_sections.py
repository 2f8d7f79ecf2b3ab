"""Sections of the configuration file about what surrounds the measurement: bus, store, status, network, log."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from yieldmon.service.config.section import Section, choice, quantity, text


class Bus(Section):
    """The CAN bus, through python-can."""

    interface: str = text("socketcan", "python-can interface: socketcan, udp_multicast, virtual, pcan, kvaser ...")
    channel: str = text("can0", "channel of that interface")
    bitrate_bit_s: int | None = quantity(
        None,
        10_000,
        1_000_000,
        "bit/s",
        "for interfaces that set it; null: unchanged (SocketCAN: the system sets it)",
    )
    options: dict[str, str | int | float | bool] = Field(
        default_factory=dict, description="further options for that interface, as python-can names them"
    )
    log_channels: list[str] = Field(default_factory=list, max_length=16, description="channels of logs to read; empty: all")
    receive_buffer_bytes: int = quantity(
        4 * 1024 * 1024, 65_536, 64 * 1024 * 1024, "bytes", "SocketCAN receive buffer to request from the kernel"
    )
    receive_queue_frames: int = quantity(20_000, 1_000, 1_000_000, "frames", "frames that can wait for the engine")
    transmit_queue_frames: int = quantity(
        200, 20, 10_000, "frames", "frames that can wait for the bus; the oldest are dropped first"
    )
    transmit_max_age_s: float = quantity(
        0.5, 0.05, 60.0, "s", "older frames are dropped, since late commands and figures mislead"
    )
    idle_after_s: float = quantity(5.0, 0.5, 600.0, "s", "the bus is idle after this long without a frame")


class Outputs(Section):
    """Messages to send besides DM1 and network management."""

    shipped: bool = choice(True, "send the messages of the shipped DBC")
    signals: dict[str, Any] = Field(
        default_factory=dict, description="published quantities in messages of any DBC, by quantity (docs/guide/wiring.md)"
    )


class Store(Section):
    """Records, totals and state on disk."""

    path: str = text("yieldmon.sqlite", "file; relative paths are under the service's state folder")
    record_hours: float = quantity(2000.0, 1.0, 1e5, "h", "hours of one-second records to keep")
    size_mb: float = quantity(512.0, 16.0, 1e5, "MB", "limit of the file; the oldest one-second records are deleted first")
    event_rows: int = quantity(100_000, 100, 10_000_000, "rows", "sweeps and faults to keep, each")
    pending_seconds: int = quantity(
        3600, 10, 100_000, "s", "seconds to hold in memory while the disk fails; totals are kept longer"
    )


class Status(Section):
    """Status of the daemon, for programs on this computer."""

    socket: str = text("yieldmon.sock", "UNIX socket of `yieldmon status`; relative paths are under the runtime folder")
    group: str | None = text(None, "group that may use the socket (mode 0660); null: the daemon's user only (0600)")
    prometheus_file: str | None = text(None, "text file for Prometheus' node exporter, rewritten each interval; null: none")
    prometheus_interval_s: float = quantity(15.0, 1.0, 3600.0, "s", "interval of that file")


class Diagnostics(Section):
    """J1939 DM1, active trouble codes."""

    dm1_enabled: bool = choice(True, "send faults as DM1 in addition to YieldMonitorStatus")


class Network(Section):
    """J1939 and ISO 11783: NAME, address and services."""

    enabled: bool = choice(True, "claim an address and answer requests; false: send from the DBC's addresses")
    preferred_address: int = quantity(131, 0, 253, "1", "address to claim first")
    identity_number: int | None = quantity(
        None, 0, 2_097_151, "1", "of the NAME, unique among units of a manufacturer; null: from this computer's machine id"
    )
    manufacturer_code: int = quantity(0, 0, 2047, "1", "of the NAME, as SAE assigns them")
    ecu_instance: int = quantity(0, 0, 7, "1", "of the NAME")
    function_instance: int = quantity(0, 0, 31, "1", "of the NAME; distinguishes several monitors on one machine")
    function: int = quantity(135, 0, 255, "1", "of the NAME; 135 with vehicle system 17: product mass")
    vehicle_system: int = quantity(17, 0, 127, "1", "of the NAME, ISO 11783's device class; 17: sensor systems")
    vehicle_system_instance: int = quantity(0, 0, 15, "1", "of the NAME")
    industry_group: int = quantity(2, 0, 7, "1", "of the NAME; 2: agriculture")
    arbitrary_address_capable: bool = choice(True, "take another address if the preferred one is lost; false: send nothing then")
    obey_commanded_address: bool = choice(False, "let other nodes command another address")
    task_controller: bool = choice(False, "connect to an ISO 11783-10 task controller and send it the yield")


class Logging(Section):
    """Messages on standard error; systemd keeps them in the journal."""

    level: Literal["debug", "info", "warning", "error"] = choice("info", "least severe message to show")
