"""The standard deviation of a load's corrected mass: by tickets, by what measured it again, as measured; and whether it holds."""

from __future__ import annotations

from dataclasses import fields, replace
from math import hypot, nan, sqrt
from typing import Any

import numpy as np
import pytest

from studies.load_laws import machines as laws
from yieldmon import api
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.self_calibration.load_forces import LoadForceSums, WindowForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.service.config.configuration import calibrator_settings
from yieldmon.service.config.document import Document
from yieldmon.service.history.parameter_timeline import timeline
from yieldmon.service.history.remeasuring import remeasured
from yieldmon.service.history.update_steps import step_document
from yieldmon.service.logs.measured_loads import measured_loads
from yieldmon.service.storage.batch import Action, Load, Step, Ticket
from yieldmon.service.storage.ledger import PARAMETERS_UNDO, REMEASURED, TICKET, TICKET_UNDO, ledger
from yieldmon.service.storage.rows import SecondRow, second_row

NOISE_KG, PARAMETERS_KG, ZERO_KG = 3.0, 40.0, 4.0
AS_MEASURED_KG = hypot(NOISE_KG, PARAMETERS_KG, ZERO_KG)


def load(number: int, mass_kg: float = 1000.0, budget: MassBudget | None = None) -> Load:
    """One that is measured to 40 kg in 1000."""
    known = MassBudget(NOISE_KG**2, PARAMETERS_KG, ZERO_KG) if budget is None else budget
    return Load(number, "", "corn", 0.0, 1.0, mass_kg, None, None, known.std_dev_kg, known)


def entered(number: int, std_dev_kg: float | None, **more: Any) -> Action:
    return Action(number, 0.0, TICKET, "", {"ticket": number, "std_dev_kg": std_dev_kg} | more)


def again(number: int, factors: dict[str, float], spreads: dict[str, list[float]], version: int = 2) -> Action:
    return Action(number, 0.0, REMEASURED, "", {"tickets": [], "version": version, "factors": factors, "spreads": spreads})


ONE = Ticket(0.0, 1, 1, 1100.0, 1000.0)
BOTH = Ticket(0.0, 1, 2, 2200.0, 2000.0)
AGAIN = again(9, {"1": 1.1, "2": 1.1}, {"1": [0.01, 0.0, 0.002], "2": [0.01, 0.0, 0.002]})
OWN_KG = hypot(1.1 * NOISE_KG, 0.002 * 1100.0)


@pytest.mark.parametrize(
    ("tickets", "actions", "expected"),
    [
        ([], [], AS_MEASURED_KG),
        ([ONE], [entered(1, 7.0)], 7.0),
        ([ONE], [entered(1, None)], 0.005 * 1100.0),
        ([ONE], [], 0.005 * 1100.0),
        ([ONE], [entered(1, 30.0, best_std_dev_kg=20.0)], 20.0),
        ([ONE], [entered(1, 7.0), Action(2, 0.0, TICKET_UNDO, "", {"ticket": 1})], AS_MEASURED_KG),
        ([], [AGAIN], hypot(11.0, 1.1 * ZERO_KG, OWN_KG)),
        ([ONE], [entered(1, 7.0), AGAIN], 7.0),
        ([], [again(9, {"1": 1.1}, {})], 1.1 * AS_MEASURED_KG),
        ([], [AGAIN, again(10, {"1": 1.1}, {})], 1.1 * AS_MEASURED_KG),
        ([], [AGAIN, Action(10, 0.0, PARAMETERS_UNDO, "", {"version": 2})], AS_MEASURED_KG),
        # What both loads are off by alike does not matter to a ticket for both; what each is off by alone does, by half.
        ([BOTH], [entered(1, 10.0), AGAIN], hypot(0.5 * 10.0, OWN_KG / sqrt(2.0))),
        ([BOTH], [entered(1, 10.0), again(9, {"1": 1.1}, {"1": [0.01, 0.0]})], None),
        # Of a ticket that contradicts its load by more than both allow either may be wrong.
        ([replace(ONE, weighed_mass_kg=1200.0)], [entered(1, 7.0), AGAIN], hypot(7.0, 100.0)),
        ([replace(ONE, weighed_mass_kg=9000.0)], [entered(1, 45.0)], hypot(45.0, 8000.0)),
        ([replace(ONE, weighed_mass_kg=1130.0)], [entered(1, 7.0), AGAIN], 7.0),
    ],
)  # fmt: skip
def test_of_a_load(tickets: list[Ticket], actions: list[Action], expected: float | None) -> None:
    first, _ = ledger(tickets, actions).rows([load(1), load(2)])
    if expected is None:
        # Measured by different parameters: nothing of their errors cancels.
        assert first["corrected_std_dev_kg"] > 0.45 * first["corrected_mass_kg"] * hypot(0.01, 0.04)
    else:
        assert first["corrected_std_dev_kg"] == pytest.approx(expected, rel=1e-6)


def test_of_a_load_whose_deviation_is_not_known() -> None:
    plain = replace(load(1), std_dev_kg=None, budget=None)
    (row,) = ledger([], []).rows([plain])
    assert row["corrected_std_dev_kg"] is None
    (row,) = ledger([ONE], [entered(1, 7.0)]).rows([plain])
    assert row["corrected_std_dev_kg"] == pytest.approx(7.0)
    assert [row["corrected_std_dev_kg"] for row in ledger([BOTH], []).rows([plain, load(2)])] == [None, None]


def test_of_a_load_on_a_ticket_with_one_that_the_store_has_lost() -> None:
    (kept,) = ledger([BOTH], [entered(1, 10.0)]).rows([load(1)])
    assert kept["corrected_mass_kg"] == pytest.approx(1100.0)
    assert kept["corrected_std_dev_kg"] > hypot(5.0, 1.1 * NOISE_KG / sqrt(2.0))


UNKNOWN: dict[str, Any] = {f.name: nan if f.type == "float" else 0 for f in fields(WindowRecord)} | {"faults": ()}


class Daemon:
    """A machine's loads, measured, weighed and measured again by the daemon's own parts."""

    def __init__(self) -> None:
        shipped = laws.SHIPPED
        first = replace(shipped, provenance={**shipped.provenance, "scale": "not calibrated"})
        model = api.ForwardModel(laws.MACHINE, shipped.effects)
        self.loop = ClosedLoopCalibrator(model, calibrator_settings(Document()))
        self.estimator: Any = api.OpenLoop(model, first)
        self.versions = {first.version: first}
        self.steps: list[Step] = []
        self.rows: list[SecondRow] = []
        self.loads: list[Load] = []
        self.references: list[ReferenceMass] = []
        self.time_s = self.total_kg = 0.0

    def harvest(self, grain: WeighedLoad, *, weigh: bool) -> None:
        found = self.estimator.estimate(grain.force_n, grain.plate_angle_rad, grain.elevator_speed_rad_s)
        flow, number, start_s = np.nan_to_num(found.mass_flow_kg_s), len(self.loads) + 1, self.time_s
        sums, record = LoadForceSums(), WindowRecord(**UNKNOWN)
        for kg_s, force_n, angle_rad, speed_rad_s in zip(
            *(a.tolist() for a in (flow, grain.force_n, grain.plate_angle_rad, grain.elevator_speed_rad_s)), strict=True
        ):
            self.time_s += 1.0
            self.total_kg += kg_s
            record = WindowRecord(
                **UNKNOWN
                | {
                    "time_s": self.time_s, "duration_s": 1.0, "coverage": 1.0, "load_number": number, "moisture_pct": 15.0,
                    "parameter_version": self.estimator.parameters.version, "mass_kg": kg_s, "mass_flow_kg_s": kg_s,
                    "force_n": force_n, "force_std_dev_n": laws.SCATTER * force_n, "plate_angle_rad": angle_rad,
                    "elevator_speed_rad_s": speed_rad_s, "total_kg": self.total_kg,
                }
            )  # fmt: skip
            self.rows.append(second_row(len(self.rows) + 1, record))
            sums.add(number, kg_s, WindowForces(1.0, force_n, angle_rad, speed_rad_s, 15.0))
        mass_kg = float(flow.sum())
        budget = MassBudget((grain.noise_sd * mass_kg) ** 2, float(np.nansum(found.std_dev_kg_s)), 0.002 * mass_kg)
        self.loads.append(Load(number, "", "corn", start_s, self.time_s, mass_kg, None, None, budget.std_dev_kg, budget))
        if weigh:
            self.references.append(
                ReferenceMass(
                    ReferenceSource.TICKET, start_s, self.time_s, grain.weighed_kg, grain.std_dev_kg, mass_kg, True, number,
                    budget=budget, forces=sums.of(number),
                )
            )  # fmt: skip
            self._told(self.loop.weigh(record, self.references, self.estimator))

    def _told(self, outcome: CalibrationOutcome) -> None:
        if outcome.estimator is not None:
            self.estimator = outcome.estimator
            version = self.estimator.parameters.version
            self.versions[version] = self.estimator.parameters
            assert outcome.step is not None
            self.steps.append(Step(version, outcome.step.end_s, step_document(outcome.step)))

    def listed(self) -> list[Any]:
        """The loads as `load list` has them, without the tickets' own correction."""
        known = timeline(self.steps, self.estimator.parameters, self.versions)
        found = remeasured(measured_loads(self.rows, self.versions), known, laws.MACHINE)
        spreads = {str(n): one.spread.document for n, one in found.items() if one.spread is not None}
        return ledger([], [again(1, {str(n): one.factor for n, one in found.items()}, spreads)]).rows(self.loads)


def errors(name: str, tickets: int) -> tuple[list[float], list[float]]:
    """z of the corrected masses of ten loads that were not weighed, among others that were; and their deviations, relative."""
    drawn, daemon = laws.draw(name, 9001), Daemon()
    truth: dict[int, float] = {}
    for k, (grain, true_kg) in enumerate(drawn.further):
        if k % 2 == 0 and k // 2 < tickets:
            daemon.harvest(drawn.weighed[k // 2], weigh=True)
        daemon.harvest(grain, weigh=False)
        truth[len(daemon.loads)] = true_kg
    rows = [row for row in daemon.listed() if row["number"] in truth]
    errors_kg = [row["corrected_mass_kg"] - truth[row["number"]] for row in rows]
    deviations_kg = [row["corrected_std_dev_kg"] for row in rows]
    return list(np.divide(errors_kg, deviations_kg)), [row["corrected_std_dev_kg"] / row["corrected_mass_kg"] for row in rows]


@pytest.mark.slow
def test_deviations_hold_on_machines_of_other_laws_and_fall_with_each_ticket() -> None:
    stated, z = list[float](), list[float]()
    for tickets in (1, 2, 5):
        found = [errors(name, tickets) for name in (*laws.LAWS, *laws.MODELS)]
        z += [one for ones, _ in found for one in ones]
        stated.append(float(np.sqrt(np.mean([one**2 for _, ones in found for one in ones]))))
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.2
    assert np.mean(np.abs(z) < 2.0) > 0.93
    assert stated[0] > 1.3 * stated[1] > 1.6 * stated[2]
