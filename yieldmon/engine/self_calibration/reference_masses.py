"""All reference masses of one machine: what the tank scale weighs, the tickets, and which of them are still to be used."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from yieldmon.engine.flow import Flow
from yieldmon.engine.inputs import InputSnapshot
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.sampling.windows import Window
from yieldmon.engine.self_calibration.load_forces import WindowForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.self_calibration.scale_alarm import ScaleCheck, as_stated, name_of
from yieldmon.engine.self_calibration.tank_scale import TankScale
from yieldmon.engine.self_calibration.ticket_book import TicketBook
from yieldmon.engine.settings import ReferenceMassSettings
from yieldmon.frames import EstimateQuality


class ReferenceMasses:
    """Tank scale and tickets.

    Parameters
    ----------
    settings : ReferenceMassSettings

    Attributes
    ----------
    tickets : TicketBook
    """

    def __init__(self, settings: ReferenceMassSettings) -> None:
        self.tickets = TicketBook(settings.keep)
        self._scale = TankScale(settings)
        self._weighed_s = float("-inf")
        """Bus time of the scale's last reading."""
        self._wait = False
        self._compared: frozenset[ReferenceMass] = frozenset()

    @property
    def wait(self) -> bool:
        """Whether a mass has not been handed over yet."""
        return self._wait

    @property
    def kept(self) -> tuple[ReferenceMass, ...]:
        """All that are kept, by time."""
        return tuple(sorted((*self._scale.masses, *self.tickets.kept), key=lambda mass: mass.end_s))

    @property
    def of_scale(self) -> tuple[ReferenceMass, ...]:
        """Those of the tank scale."""
        return tuple(self._scale.masses)

    def loads_named(self, names: frozenset[str]) -> frozenset[int]:
        """Numbers of the loads with a ticket that have these names, of any crop."""
        if not names:
            return frozenset()
        return frozenset(ticket.load_number for ticket in self.tickets.of_any_crop if name_of(ticket) in names)

    def load_of(self, check: ScaleCheck) -> int:
        """Number of the load whose ticket was checked; 0 for a mass of the tank scale."""
        return next((ticket.load_number for ticket in self.tickets.of_any_crop if name_of(ticket) == check.name), 0)

    # Tank scale

    def match_tank_scale(
        self,
        window: Window,
        inputs: InputSnapshot,
        flow: Flow,
        total_before_kg: float,
        mass_kg: float,
        budget: MassBudget,
        *,
        forces: WindowForces | None,
        zero_doubted: bool,
    ) -> float:
        """Match the tank scale's stable readings with a measured window.

        Parameters
        ----------
        window : Window
        inputs : InputSnapshot
            Held at its end.
        flow : Flow
            As it is counted.
        total_before_kg, mass_kg : float
            Total before the window, and its mass.
        budget : MassBudget
            Of the total after the window.
        forces : WindowForces or None
            None where the window has no mass.
        zero_doubted : bool
            Whether the zero is suspect.

        Returns
        -------
        float
            Mass that the scale shows to be missed while the zero was suspect, kg.
        """
        if zero_doubted:
            self._scale.doubt_zero()
        if inputs.tank_disputed:
            self._scale.forget()
            return 0.0
        if inputs.tank_time_s != self._weighed_s:
            self._weighed_s = inputs.tank_time_s
            self._scale.reading(inputs.tank_time_s, inputs.tank_kg)
        # A window of not harvesting is measured too: no grain came.
        watched = (flow.measured or flow.quality is EstimateQuality.NOT_HARVESTING) and not window.contested
        weighed = self._scale.window(
            window.start_s, window.end_s, total_before_kg, mass_kg, measured=watched, budget=budget, forces=forces
        )
        if weighed is None:
            return 0.0
        if not weighed.zero_doubted:
            self._wait = True
            return 0.0
        missed_kg = max(0.0, weighed.reference_kg - weighed.measured_kg)
        self._scale.counted(missed_kg)
        return missed_kg

    def next_weighed(self, ahead: Iterable[InputSnapshot]) -> int:
        """Position, from 1, of the first window ahead in which a mass may be weighed that updates the parameters; 0 for none."""
        return self._scale.next_mass(inputs.tank_kg for inputs in ahead)

    def empty_since(self, time_s: float) -> None:
        """No grain has come since a time, although the flow was not known."""
        self._scale.empty_since(time_s)

    def totals_reset(self) -> None:
        """The total begins anew: the scale's next reading is a new start."""
        self._scale.forget()

    def frames_missed(self) -> None:
        """Grain may have come unmeasured: the scale's next reading is a new start."""
        self._scale.forget()

    def zero_undone(self) -> None:
        """Masses measured with another zero were corrected: the forces over them and the rise of the total are useless."""
        self.tickets.forces.forget()
        self._scale.forget()

    # Handing over

    def enter(self, ticket: ReferenceMass, crop: str = "") -> None:
        """Enter a ticket that is to update the parameters. crop: on whose return; "": the crop harvested now."""
        self.tickets.enter(ticket, crop)
        self._wait = self._wait or not crop

    def hand_over(self) -> tuple[tuple[ReferenceMass, ...], tuple[ReferenceMass, ...]]:
        """Hand over the masses to use now; of several tickets one with each call, in the order of entry.

        Returns
        -------
        tickets : tuple of ReferenceMass
            Those handed over with this call.
        masses : tuple of ReferenceMass
            All that were handed over with this call or an earlier one.
        """
        handed, waiting = self.tickets.hand_over(), self.tickets.waiting
        self._wait = bool(waiting)
        return handed, tuple(mass for mass in self.kept if mass not in waiting)

    def compare(self) -> list[ScaleCheck]:
        """Without a calibrator: compare new masses with the counted ones."""
        self._wait = False
        self.tickets.none_waits()
        checks = [as_stated(mass) for mass in self.kept if mass not in self._compared]
        self._compared = frozenset(self.kept)
        return [check for check in checks if check is not None]

    def wait_again(self, *, scale: bool) -> None:
        """Let tickets wait again after others were taken back; scale: also masses of the tank scale that had been used."""
        scale_waits = scale or (self._wait and bool(self._scale.masses))
        self._wait = bool(self.tickets.waiting) or scale_waits

    def change_crop(self, before: str, now: str) -> list[ReferenceMass]:
        """Another crop from now on; returns its masses that were handed over before."""
        used = self.tickets.change_crop(before, now)
        self._scale.forget()
        self._scale.masses.clear()
        self._wait = bool(self.tickets.waiting)
        return used

    def remember(self, tickets: Sequence[ReferenceMass], waiting: Sequence[ReferenceMass]) -> None:
        """After a restart or a reload: tickets entered before; `waiting`: those of them not used yet."""
        self.tickets.remember(tickets, waiting)
        self._compared = frozenset(tickets)
        self._wait = self._wait or bool(waiting)
