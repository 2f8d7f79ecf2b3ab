"""Which received frames are our own, shown to us by the interface that sent them."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress

import can

#: How long a frame that was sent may take to come back from an interface that shows a node its own frames.
ECHO_S = 1.0
#: The same where the interface was asked to show them: a frame waits in the driver while the bus is busy.
ASKED_ECHO_S = 10.0
#: So many frames sent, and none come back in time, indicate an interface that shows a node no frame of its own.
_ENOUGH_WITHOUT_ECHO = 20
#: Received frames are looked at much more often than this, unless the process gets no processor or is stopped.
_PAUSE_S = 0.5

Sent = tuple[float, int, bytes]
"""A frame that was sent: when, its identifier, its data."""


class Echoes:
    """Frames that were sent and have not come back yet; used by several threads.

    Parameters
    ----------
    clock : callable
        Monotonic time, s.
    echo_s : float
        How long a frame that was sent may take to come back; ASKED_ECHO_S: the interface shows each.
    """

    def __init__(self, clock: Callable[[], float], echo_s: float) -> None:
        self._clock = clock
        self._echo_s = echo_s
        self._awaited: deque[Sent] = deque()
        self._unknown = echo_s < ASKED_ECHO_S
        """Whether the interface may show none."""
        self._without = 0
        self._looked_s = clock()
        self._lock = threading.Lock()

    def expect(self, message: can.Message) -> Sent:
        """A frame that is about to be sent."""
        sent = self._clock(), message.arbitration_id, bytes(message.data)
        with self._lock:
            self._awaited.append(sent)
        return sent

    def forget(self, sent: Sent) -> None:
        """The frame was not sent; it may have been found meanwhile, in a copy."""
        with self._lock, suppress(ValueError):
            self._awaited.remove(sent)

    def look(self) -> None:
        """Received frames are being looked at now. After a pause they are so much late, and so are the echoes among them."""
        with self._lock:
            now_s = self._clock()
            paused_s, self._looked_s = now_s - self._looked_s, now_s
            if paused_s > _PAUSE_S:
                self._awaited = deque((sent_s + paused_s, number, data) for sent_s, number, data in self._awaited)
            self._drop_old()

    def is_echo(self, message: can.Message) -> bool:
        """Whether a received frame is one of those sent within the last second (`echo_s`), pauses apart. Each counts once: some
        interfaces show a node its own frames, and another node's copies come on top. Of an interface that has shown none of the
        first ones each copy is another node's."""
        seen = (message.arbitration_id, bytes(message.data))
        with self._lock:
            self._drop_old()
            if self._unknown and self._without >= _ENOUGH_WITHOUT_ECHO:
                return False
            for sent in self._awaited:
                if sent[1:] == seen:
                    self._awaited.remove(sent)
                    self._unknown = False
                    return True
        return False

    def _drop_old(self) -> None:
        oldest_s = self._clock() - self._echo_s
        while self._awaited and self._awaited[0][0] < oldest_s:
            self._awaited.popleft()
            self._without += 1
