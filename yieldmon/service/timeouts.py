"""Time limits of the daemon."""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.bus.receiver import LISTEN_S
from yieldmon.service.storage.writer import RETRY_S


@dataclass(frozen=True, kw_only=True)
class Timeouts:
    """How long the daemon waits, s.

    Parameters
    ----------
    silence_s : float
        With no frame of ours for this long the engine's time goes on by the monotonic clock; infinite for traffic that is not
        sent in real time.
    listen_s : float
        One read of the bus waits so long for a frame, and a stop for that read.
    store_s : float
        A start waits so long for the store; then measuring begins without it.
    kept_frames : int
        Frames kept for a store that answers later: three minutes of nominal traffic, 25 MB.
    reload_s : float
        Reading the configuration and the files that it names anew may take so long; a pipe alone takes up to 5 s.
    command_s : float
        A command waits so long for the engine.
    answer_s : float
        A command is answered, or given up, within so long: clients wait 10 s.
    retry_s : float
        A write that failed is tried again after so long.
    written_s : float
        An answer waits so long for the disk to have what was entered.
    stop_s : float
        A stop waits so long for the disk; with its other steps it is over within 5 s.
    """

    silence_s: float = 0.15
    listen_s: float = LISTEN_S
    store_s: float = 20.0
    kept_frames: int = 50_000
    reload_s: float = 20.0
    command_s: float = 5.0
    answer_s: float = 9.5
    retry_s: float = RETRY_S
    written_s: float = 2.0
    stop_s: float = 1.5


DEFAULT = Timeouts()
