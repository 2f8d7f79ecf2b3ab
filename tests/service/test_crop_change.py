"""A load of another crop is measured with that crop's parameters, and each crop keeps what was learnt of it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.errors import InputError
from yieldmon.files import parameter_file
from yieldmon.files.crops import crop
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.memory import Memory, recall
from yieldmon.service.operator import commands
from yieldmon.service.storage.ledger import PARAMETERS_UNDO
from yieldmon.service.storage.store import Store


def started(parameters=None):
    known = configuration.load(shipped("config/yieldmon.yaml"))
    known = known if parameters is None else replace(known, parameters=parameters)
    return build_monitor(known.engine, known.machine, known.parameters, known.calibrator), Journal(
        Memory(), known.parameters, now_s=0.0
    )


def load(monitor, journal, name):
    return commands.execute({"command": "load-start", "crop": name}, monitor, journal, 1.7e9)["parameters"]


def test_a_crop_is_measured_with_its_own_parameters_and_comes_back_to_what_was_learnt(tmp_path):
    monitor, journal = started()
    assert load(monitor, journal, "corn") == {"version": 1, "crop": None, "changed": False, "carried_from": ""}
    first = load(monitor, journal, "wheat")
    assert (first["crop"], first["changed"]) == ("wheat", True)
    assert monitor.estimator.parameters.values == crop("wheat").parameters().values
    learnt = replace(monitor.estimator.parameters, values={**monitor.estimator.parameters.values, "friction": 0.3})
    monitor.set_estimator(type(monitor.estimator)(monitor.estimator.model, learnt), 0.0)
    load(monitor, journal, "barley")
    assert load(monitor, journal, "wheat")["changed"]
    assert monitor.estimator.parameters.values["friction"] == 0.3
    with Store(tmp_path / "s.sqlite") as store:
        store.commit([journal.batch(monitor, 1.7e9, {})])
        remembered = recall(store)
    assert remembered.of_crop["wheat"].values["friction"] == 0.3
    assert {"wheat", "barley"} <= set(remembered.of_crop)


def test_the_plate_of_a_machine_is_measured_for_all_crops() -> None:
    """How far its angle is reported wrong, as `setup` puts it into the parameters of the first crop."""
    known = parameter_file.load()
    monitor, journal = started(replace(known, values={**known.values, "plate_angle_offset.angle_rad": 0.025}))
    load(monitor, journal, "corn")
    for name in ("wheat", "barley"):
        load(monitor, journal, name)
        in_use = monitor.estimator.parameters.values
        assert in_use == {**crop(name).parameters().values, "plate_angle_offset.angle_rad": 0.025}


def test_a_load_whose_field_cannot_be_named_changes_no_crop() -> None:
    monitor, journal = started()
    load(monitor, journal, "corn")
    before, number = monitor.estimator.parameters, monitor.totals.load_number
    with pytest.raises(InputError, match="a name of at most 80 printable characters"):
        commands.execute({"command": "load-start", "crop": "wheat", "field": "n" * 81}, monitor, journal, 1.7e9)
    assert (monitor.estimator.parameters, journal.crop, monitor.totals.load_number) == (before, "corn", number)


def test_a_ticket_that_waits_is_for_the_crop_that_it_was_entered_under():
    monitor, journal = started()
    load(monitor, journal, "wheat")
    one = LoadSummary(7, 1000.0, 1500.0, 6000.0, 0.0, 0.0, complete=True)
    monitor.know_load(one, [])
    monitor.ticket(7, 6600.0, 30.0)
    assert monitor.masses_wait
    load(monitor, journal, "barley")
    assert not monitor.masses_wait
    load(monitor, journal, "wheat")
    assert monitor.masses_wait


def test_a_calibration_undone_under_another_crop_is_undone_for_its_own(tmp_path):
    monitor, journal = started()
    load(monitor, journal, "wheat")
    shipped_wheat, before = monitor.estimator.parameters.values, monitor.estimator.parameters
    learnt = replace(before, values={**before.values, "friction": 0.3}, version=before.version + 1)
    monitor.set_estimator(type(monitor.estimator)(monitor.estimator.model, learnt), 0.0)
    journal.parameters.use(learnt, "ticket", tickets=(1,))
    load(monitor, journal, "barley")
    barley = monitor.estimator.parameters

    def undo(version):
        return commands.execute({"command": "calibration-undo", "version": version}, monitor, journal, 1.7e9)

    with pytest.raises(InputError, match=r"is a change of crop; expected a calibration, or `yieldmon load start --crop NAME`"):
        undo(barley.version)
    answer = undo(learnt.version)
    assert (answer["undone"], answer["crop"]) == (learnt.version, "wheat")
    assert monitor.estimator.parameters.values == barley.values == crop("barley").parameters().values
    assert monitor.estimator.parameters.version == answer["version"]
    with Store(tmp_path / "s.sqlite") as store:
        store.commit([journal.batch(monitor, 1.7e9, {})])
        remembered = recall(store)
    assert remembered.parameters.values == barley.values
    assert remembered.of_crop["wheat"].values == shipped_wheat
    load(monitor, journal, "wheat")
    assert monitor.estimator.parameters.values == shipped_wheat
    with pytest.raises(InputError, match="is undone already"):
        undo(learnt.version)


@pytest.mark.parametrize("crop_named", ["", "wheat"])
def test_a_calibration_undone_under_its_own_crop_gives_the_parameters_before_it(crop_named: str) -> None:
    monitor, journal = started()
    journal.parameters.use(monitor.estimator.parameters, "file")
    if crop_named:
        load(monitor, journal, crop_named)
    before = monitor.estimator.parameters
    learnt = replace(before, values={**before.values, "friction": 0.3}, version=before.version + 1)
    monitor.set_estimator(type(monitor.estimator)(monitor.estimator.model, learnt), 0.0)
    journal.parameters.use(learnt, "ticket", tickets=(1,))
    request = {"command": "calibration-undo", "version": learnt.version, "who": "anna"}
    answer = commands.execute(request, monitor, journal, 1.7e9)
    assert (answer["undone"], answer["version"], answer["crop"]) == (learnt.version, learnt.version + 1, "")
    assert monitor.estimator.parameters.values == before.values
    (reported,) = [action for action in journal.batch(monitor, 1.7e9, {}).actions if action.kind == PARAMETERS_UNDO]
    expected = {"version": learnt.version, "versions": [learnt.version]}
    assert (reported.who, reported.document, reported.time_s) == ("anna", expected, 1.7e9)
    with pytest.raises(InputError, match="is undone already"):
        commands.execute(request, monitor, journal, 1.7e9)


def test_a_calibration_of_ones_own_is_only_named():
    own = replace(parameter_file.load(), values={**parameter_file.load().values, "friction": 0.22})
    monitor, journal = started(own)
    assert not load(monitor, journal, "wheat")["changed"]
    assert monitor.estimator.parameters.values["friction"] == 0.22
    assert load(monitor, journal, "barley")["changed"]
    assert load(monitor, journal, "wheat")["changed"]
    assert monitor.estimator.parameters.values["friction"] == 0.22


def test_a_calibration_that_names_no_crop_is_a_renamed_loads_too() -> None:
    """As a load that begins with that name keeps it; once an operator has named a crop it is that one's."""
    own = replace(crop("corn").parameters(), values={**crop("corn").parameters().values, "density": 900.0}, provenance={})
    monitor, journal = started(own)
    assert not load(monitor, journal, None)["changed"]
    for name in ("corn", "wheat", "teff"):
        assert journal.parameters.of(name, own, "") is own
    assert not load(monitor, journal, "wheat")["changed"]
    assert journal.parameters.of("wheat", own, journal.crop) is own
    assert journal.parameters.of("corn", own, journal.crop).values == crop("corn").parameters().values


def test_a_crop_of_which_nothing_is_known_keeps_the_parameters():
    monitor, journal = started()
    before = monitor.estimator.parameters.values
    assert not load(monitor, journal, "quinoa")["changed"]
    assert monitor.estimator.parameters.values == before


TYPED = [
    (" Wheat ", "wheat", True),
    ("Oilseed rape", "rapeseed", True),
    ("soybeans", "soybean", True),
    ("Winter_Wheat", "wheat", True),
    ("Höstvete", "wheat", True),
    ("höstvete", "wheat", True),
    ("vete", "wheat", True),
    ("maltkorn", "barley", True),
    ("cevada", "barley", True),
    ("girassol", "sunflower", True),
    ("Colza d'hiver", "Colza d'hiver", False),
    ("SŁONECZNIK", "sunflower", True),
    ("hvede", "wheat", True),
    ("Quinoa", "Quinoa", False),
]


@pytest.mark.parametrize(("typed", "kept", "known"), TYPED)
def test_a_crop_is_known_however_it_is_typed(typed: str, kept: str, known: bool) -> None:
    monitor, journal = started()
    answer = commands.execute({"command": "load-start", "crop": typed}, monitor, journal, 1.7e9)
    assert (answer["crop"], answer["crop_known"], answer["parameters"]["changed"]) == (kept, known, known)


@pytest.mark.parametrize("typed", ["Milho", "Maïs", "maíz", "majs", "MAIS"])
def test_the_shipped_crop_is_known_in_other_languages(typed: str) -> None:
    monitor, journal = started()
    before = monitor.estimator.parameters
    answer = commands.execute({"command": "load-start", "crop": typed}, monitor, journal, 1.7e9)
    assert (answer["crop"], answer["crop_known"], answer["parameters"]["changed"]) == ("corn", True, False)
    assert monitor.estimator.parameters == before


@pytest.mark.parametrize("states_crop", [True, False])
def test_a_crop_of_which_nothing_is_known_takes_no_calibration_away(tmp_path, states_crop: bool) -> None:
    shipped_corn = parameter_file.load()
    own = replace(shipped_corn, values={**shipped_corn.values, "friction": 0.22})
    monitor, journal = started(replace(own, provenance={**own.provenance, "crop": "corn"}) if states_crop else own)
    load(monitor, journal, "corn")
    assert not load(monitor, journal, "quinoa")["changed"]
    assert monitor.estimator.parameters.values == own.values
    learnt = replace(monitor.estimator.parameters, values={**own.values, "friction": 0.3})
    monitor.set_estimator(type(monitor.estimator)(monitor.estimator.model, learnt), 0.0)
    assert load(monitor, journal, "corn")["changed"]
    assert monitor.estimator.parameters.values == own.values
    assert monitor.estimator.parameters.covariance.tolist() == own.covariance.tolist()
    with Store(tmp_path / "s.sqlite") as store:
        store.commit([journal.batch(monitor, 1.7e9, {})])
        assert recall(store).of_crop["quinoa"].values["friction"] == 0.3
    answer = commands.execute({"command": "load-start", "crop": "quinoa"}, monitor, journal, 1.7e9)
    assert (answer["crop_known"], answer["parameters"]["changed"]) == (True, True)
    assert monitor.estimator.parameters.values["friction"] == 0.3


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("cron", "corn"),
        ("WHEET", "wheat"),
        ("weat", "wheat"),
        ("barleyy", "barley"),
        ("maze", "corn"),
        ("canolla", "rapeseed"),
        ("vetee", "wheat"),
        ("korn", "barley or corn"),
    ],
)
def test_a_slip_of_a_finger_is_no_crop(typed: str, meant: str) -> None:
    monitor, journal = started()
    number, before = monitor.totals.load_number, monitor.estimator.parameters
    with pytest.raises(InputError, match=rf"crop: '{typed}' is not a known crop; expected {meant}; or, for another crop, a name"):
        commands.execute({"command": "load-start", "crop": typed}, monitor, journal, 1.7e9)
    assert (monitor.totals.load_number, journal.crop, monitor.estimator.parameters) == (number, "", before)


@pytest.mark.parametrize(
    "name",
    [
        "oats",
        "rye",
        "popcorn",
        "triticale",
        "winter oats",
        "corn 2",
        "beans",
        "spelt",
        "buckwheat",
        "havre",
        "råg",
        "ruis",
        "centeio",
    ],
)
def test_another_crop_is_no_slip(name: str) -> None:
    monitor, journal = started()
    assert commands.execute({"command": "load-start", "crop": name}, monitor, journal, 1.7e9)["crop"] == name


def test_a_crop_of_which_nothing_is_known_is_not_measured_as_surely_as_the_one_that_was_weighed() -> None:
    """It begins with the other's parameters, whose grain was on the scale."""
    known = replace(parameter_file.load(), provenance={"scale": "weighed", "crop": "corn"})
    monitor, journal = started(known)
    assert monitor.estimator.parameters.scale_error == 0.0
    load(monitor, journal, "lupin")
    assert monitor.estimator.parameters.scale_error > 0.3
    load(monitor, journal, "corn")
    assert monitor.estimator.parameters.scale_error == 0.0


def corn_weighed(scale="weighed"):
    """The corn of a machine whose plate gives three quarters of the force, by its provenance set by weighed loads."""
    published = crop("corn").parameters()
    return replace(
        published,
        values={**{k: v for k, v in published.values.items() if k != "restitution"}, "k1": 0.0, "k2": 1.16},
        covariance_names=("friction", "density", "k2"),
        provenance={"crop": "corn", "scale": scale},
    )


def carried_from(answer):
    return answer["carried_from"]


@pytest.mark.parametrize(
    ("scale", "from_crop", "error"),
    [("weighed", "corn", 0.12), ("kernel noise", "corn", 0.12), ("not calibrated", "", 0.45), ("another crop", "", 0.45)],
)
def test_a_crop_begins_with_the_scale_of_one_that_was_weighed(scale: str, from_crop: str, error: float) -> None:
    monitor, journal = started(corn_weighed(scale))
    load(monitor, journal, "corn")
    assert carried_from(load(monitor, journal, "wheat")) == from_crop
    in_use = monitor.estimator.parameters
    assert (in_use.carried_from, in_use.scale_error, in_use.provenance["crop"]) == (from_crop, error, "wheat")
    said = [row["what"] for row in journal.parameters.table(in_use, journal.crop)]
    assert ("wheat begins with the scale of corn" in said) is bool(from_crop)
    assert carried_from(load(monitor, journal, "corn")) == ""


def test_a_crop_begins_with_the_scale_of_the_one_that_was_weighed_not_of_the_one_between() -> None:
    monitor, journal = started(corn_weighed())
    for name in ("corn", "wheat", "barley"):
        answer = load(monitor, journal, name)
    assert carried_from(answer) == "corn"
    barley, corn = (1.0 + crop(name).parameters().values["restitution"] for name in ("barley", "corn"))
    assert 1.0 + monitor.estimator.parameters.values["restitution"] == pytest.approx(barley * 1.16 / corn)


@pytest.mark.parametrize("swept", [False, True])
def test_a_crop_that_returns_takes_the_scale_that_was_weighed_since_unless_sweeps_have_updated_it(swept: bool) -> None:
    monitor, journal = started(corn_weighed("not calibrated"))
    load(monitor, journal, "corn")
    load(monitor, journal, "wheat")
    if swept:
        known = monitor.estimator.parameters
        known = replace(known, values={**known.values, "friction": 0.3}, version=known.version + 1)
        monitor.set_estimator(type(monitor.estimator)(monitor.estimator.model, known), 0.0)
        journal.parameters.use(known, "sweep")
    load(monitor, journal, "corn")
    ticketed = replace(corn_weighed(), version=journal.parameters.version + 1)
    monitor.set_estimator(type(monitor.estimator)(monitor.estimator.model, ticketed), 0.0)
    journal.parameters.use(ticketed, "ticket", tickets=(1,))
    assert carried_from(load(monitor, journal, "wheat")) == ("" if swept else "corn")
    assert (monitor.estimator.parameters.values["friction"] == 0.3) is swept


def test_a_scale_whose_ticket_is_undone_is_no_other_crops_any_more() -> None:
    monitor, journal = started(corn_weighed("not calibrated"))
    load(monitor, journal, "corn")
    journal.parameters.use(monitor.estimator.parameters, "file")
    ticketed = replace(corn_weighed(), version=journal.parameters.version + 1)
    monitor.set_estimator(type(monitor.estimator)(monitor.estimator.model, ticketed), 0.0)
    journal.parameters.use(ticketed, "ticket", tickets=(1,))
    assert carried_from(load(monitor, journal, "wheat")) == "corn"
    commands.execute({"command": "calibration-undo", "version": ticketed.version}, monitor, journal, 1.7e9)
    in_use = monitor.estimator.parameters
    assert (in_use.carried_from, in_use.scale_error) == ("", 0.45)
    assert in_use.values == crop("wheat").parameters().values
