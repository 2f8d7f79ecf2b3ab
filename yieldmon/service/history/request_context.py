"""What a request of an operator is carried out on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from yieldmon.engine.monitor import Monitor
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.reference_loads import StoredLoad


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestContext:
    """Monitor and journal as a request finds them. who: the user who asks; now_s: Unix time; stored: loads that the request
    concerns, as the store has them."""

    monitor: Monitor
    journal: Journal
    who: str
    now_s: float
    stored: Sequence[StoredLoad]
