"""The daemon on its bus: frames in for the engine, frames out from our address, and what went wrong on the way."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from time import monotonic
from typing import Any, cast

import can
from can.typechecking import CanFilter

from yieldmon.bus.codec import Codec, FrameError
from yieldmon.bus.opening import open_bus
from yieldmon.bus.receiver import BusEvent, BusEventKind, Receiver
from yieldmon.documents.status import StatusNetwork
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import Result, frames_in, records_in
from yieldmon.frames import OUTPUTS, Frame
from yieldmon.identifiers import GROUP_MASK, SOURCE_MASK
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.traffic.bus_time import BusTime
from yieldmon.service.traffic.bus_traffic import BusTraffic, FrameRate
from yieldmon.service.traffic.echoes import ASKED_ECHO_S, ECHO_S
from yieldmon.service.traffic.frame_sender import FrameSender
from yieldmon.service.traffic.input_frames import InputFrames
from yieldmon.service.traffic.link import link_for
from yieldmon.service.traffic.mapped_outputs import MappedOutputs
from yieldmon.service.traffic.service_faults import ServiceFaults
from yieldmon.service.traffic.transmit import Transmitter

_log = logging.getLogger(__name__)

_BATCH_FRAMES = 512
_WAIT_S = 0.05
#: The same while an address is being claimed, which takes several rounds and holds back all frames.
_CLAIMING_WAIT_S = 0.005
#: How long what a window leaves to be done waits for its frames.
_SENDING_FIRST_S = 0.01
#: A thread that gives no sign of life for so long is a reason to have the daemon started anew.
_HANGS_FOR_GOOD_S = 8.0
_NEVER = float("-inf")


class BusNode:
    """The bus as the engine's thread uses it; the receiver and the transmitter have threads of their own.

    Attributes
    ----------
    receiver : Receiver
        Takes frames off the bus.
    transmitter : Transmitter
        Sends frames.
    time : BusTime
    faults : ServiceFaults
        Of the bus and of the service.
    """

    def __init__(
        self,
        configuration: Configuration,
        *,
        bus_factory: Callable[[], can.BusABC] | None,
        silence_s: float,
        listen_s: float,
        clock: Callable[[], float],
    ) -> None:
        """bus_factory: opens the bus, by default the configured one. silence_s, listen_s: see `Timeouts`. clock: times the
        network's protocols."""
        settings = configuration.document.bus
        codec = Codec()
        self._configuration = configuration
        self._inputs = InputFrames(codec, configuration.signals)
        self._link = link_for(configuration)
        # Other makers use these groups for messages of their own, so only a monitor's NAME makes them ours.
        self._published = {
            codec.layouts[name].identity & GROUP_MASK: name for name in OUTPUTS if not codec.layouts[name].any_source
        }
        self._outputs = MappedOutputs(configuration.outputs, configuration.engine.totals)
        self._clock = clock
        self._address: int | None = None
        self._claims_anew = False
        self._malformed = 0
        self._rate = FrameRate()
        self.faults = ServiceFaults()
        self.time = BusTime(silence_s, settings.idle_after_s, monotonic())
        self.receiver = Receiver(bus_factory or self._open, capacity=settings.receive_queue_frames, listen_s=listen_s)
        self.transmitter = Transmitter(
            self.receiver.send, settings.transmit_queue_frames, settings.transmit_max_age_s,
            echo_s=ASKED_ECHO_S if bus_factory is None and settings.interface == "socketcan" else ECHO_S,
        )  # fmt: skip
        self._sender = FrameSender(codec, self._link, self.transmitter, clock)

    def _open(self) -> can.BusABC:
        settings = self._configuration.document.bus
        # Our own messages are let through as well: seen from another node they are a conflict.
        return open_bus(
            settings.interface,
            settings.channel,
            settings.bitrate_bit_s,
            filters=[*self._inputs.filters(), *self._outputs.filters(), *self._link.filters(), *self._rival_filters()],
            # A copy that comes back once is our own; without it, another node's first copy would pass for it.
            receive_own=settings.interface == "socketcan",
            receive_buffer_bytes=settings.receive_buffer_bytes,
            **cast("dict[str, Any]", settings.options),
        )

    def _rival_filters(self) -> list[CanFilter]:
        if not (self._configuration.outputs.shipped and self._configuration.document.network.enabled):
            return []
        return [CanFilter(can_id=group, can_mask=GROUP_MASK, extended=True) for group in self._published]

    def use(self, configuration: Configuration) -> None:
        """Go on with another configuration's machine, totals and names; the bus and its mapping stay."""
        self._configuration = configuration
        self._outputs.use(configuration.engine.totals)
        self._link.use(configuration.machine, configuration.engine.totals, self._clock())

    def claim_address(self) -> None:
        """Begin, or begin anew, on a bus that is there."""
        self._sender.send(self._link.start(self._clock()))

    # In

    def items(self) -> tuple[list[can.Message | BusEvent], float]:
        """What came since the last call, waiting up to 50 ms for it; and with nothing, the monotonic time, s, until which the
        bus is known to have been silent, else -inf."""
        # Read before the queue: what came by then is in there.
        empty_until_s = self.receiver.empty_until_s
        items = self.receiver.get_many(_BATCH_FRAMES, _CLAIMING_WAIT_S if self._link.claiming else _WAIT_S)
        self.transmitter.echoes.look()
        return items, empty_until_s if not items else _NEVER

    def take_event(self, event: BusEvent) -> None:
        """What the receiver has found on the bus."""
        self.faults.bus_event(event, monotonic())
        if event.kind is BusEventKind.INTERFACE_RESTORED:
            self._claims_anew = True
            self.claim_address()

    def receive(self, message: can.Message) -> Sequence[Frame]:
        """The frames for the engine that a message brings; the network's are answered, and another node's of ours reported."""
        received: Sequence[Frame] = ()
        published: Sequence[str] = ()
        try:
            received, published = self._inputs.receive(message)
        except FrameError as error:
            # To the network it may still be a frame, the last one of a message that is too short for the mapping.
            self._malformed += 1
            if self._malformed == 1:
                _log.warning("%s", error)
        if not received and not published:
            published = self._of_a_rival(message)
        concerned = self._link.concerns(message)
        mapped = self._outputs.name_of(message, self._link.address) if self._outputs.sends else None
        if (concerned or published or mapped) and self.transmitter.echoes.is_echo(message):
            return ()
        if concerned:
            self._sender.send(self._link.receive(message, self._clock()))
        if received:
            self.time.ours_s = received[-1].time_s
        if published and self._configuration.outputs.shipped:
            for name in published:
                self.faults.conflict(name, monotonic())
        if mapped:
            self.faults.conflict(mapped, monotonic())
        return received

    def _of_a_rival(self, message: can.Message) -> Sequence[str]:
        """The name of a frame that another monitor sends from an address of its own."""
        identifier = message.arbitration_id
        name = self._published.get(identifier & GROUP_MASK) if message.is_extended_id and not message.is_error_frame else None
        return (name,) if name is not None and self._link.is_rival(identifier & SOURCE_MASK) else ()

    def silent_until_s(self, empty_until_s: float) -> float | None:
        """Bus time, s, up to which no frame of ours comes any more; None where one may. empty_until_s: of `items`."""
        return self.time.without_ours(empty_until_s, monotonic(), time.time())

    # Out

    def send(self, results: Sequence[Result], totals: Totals) -> None:
        """The frames of what happened; with a window among it, until they are sent, 10 ms at most."""
        if self._configuration.outputs.shipped:
            self._sender.send_frames(frames_in(results))
        self._sender.send_mapped(self._outputs.take(results, totals, self._clock()))
        if records_in(results):
            # What follows would keep the interpreter from the transmit thread for as long as it takes.
            self.transmitter.wait_until_sent(_SENDING_FIRST_S)

    def poll(self, due_s: float) -> bool:
        """What the network and the mapping have to send by now; whether our address has changed. due_s: bus time of the frame
        that the engine waits for."""
        self.receiver.due_s = due_s
        self._sender.send(self._link.poll(self._clock()))
        self._sender.send_mapped(self._outputs.poll(self._clock()))
        if self._link.address == self._address:
            return False
        self._address = self._link.address
        network = self._configuration.document.network
        preferred = network.preferred_address
        claims_anew, self._claims_anew = self._claims_anew, False
        if not network.enabled:
            _log.info("network: off; frames are sent from the DBC's addresses, DM1 from %d", preferred)
        elif self._address is None:
            if not claims_anew:
                _log.warning("network: our address was taken, another one is claimed")
        elif self._address != preferred:
            _log.warning("network: our address is %d, the preferred %d is another node's", self._address, preferred)
        else:
            _log.info("network: our address is %d", self._address)
        return True

    def report_second(self, record: WindowRecord | None, active: Sequence[FaultCode], totals: Totals) -> None:
        """Trouble codes, and the second's values for a task controller."""
        now_s = self._clock()
        if self._configuration.document.diagnostics.dm1_enabled:
            self._sender.send(self._link.report_trouble(active, now_s))
        if record is not None:
            self._sender.send(self._link.report_second(record, totals, now_s))

    # What there is to see

    def hangs_s(self) -> dict[str, float]:
        """For how long each thread has given no sign of life, s."""
        return {"receive": self.receiver.hangs_s(), "transmit": self.transmitter.hangs_s()}

    @property
    def lives(self) -> bool:
        """Whether frames are still taken and sent."""
        return max(self.hangs_s().values()) < _HANGS_FOR_GOOD_S

    def network_troubles(self) -> tuple[str, ...]:
        """What is wrong with the network, a sentence each."""
        return self._link.troubles(self._clock())

    def network_status(self) -> StatusNetwork:
        """For `yieldmon status`."""
        return self._link.status()

    def count_second(self) -> None:
        """A second is over."""
        self._rate.second(monotonic(), self.receiver.counters().received)

    def traffic(self) -> BusTraffic:
        """Frames in and out since the start."""
        return BusTraffic(
            received=self.receiver.counters(),
            sent=self.transmitter.counters(),
            frames_per_s=self._rate.frames_per_s,
            malformed=self._malformed,
            incomplete=self._inputs.incomplete,
        )
