"""Instances made by the short way are those that the class makes itself."""

from __future__ import annotations

import copy
from dataclasses import FrozenInstanceError, fields, replace

import pytest

from yieldmon.engine.fast_dataclasses import changer_of, maker_of
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.sampling.windows import Window
from yieldmon.service.storage.rows import SecondRow


@pytest.mark.parametrize("kind", [WindowRecord, Window, SecondRow])
def test_instances_are_those_of_the_class(kind: type) -> None:
    names = [field.name for field in fields(kind)]
    values = [float(place) for place in range(len(names))]
    made, expected = maker_of(kind)(*values), kind(*values)
    assert type(made) is kind
    assert made == expected
    assert hash(made) == hash(expected)
    assert [getattr(made, name) for name in names] == values
    assert copy.deepcopy(made) == expected
    with pytest.raises(FrozenInstanceError):
        setattr(made, names[0], 1.0)
    with pytest.raises(TypeError):
        maker_of(kind)(*values[:-1])


@pytest.mark.parametrize("kind", [WindowRecord, Window, SecondRow])
def test_a_changed_instance_is_that_of_replace_and_the_other_stays(kind: type) -> None:
    names = [field.name for field in fields(kind)]
    before = kind(*[float(place) for place in range(len(names))])
    changes = {names[-1]: "last", names[0]: "first"}
    changed = changer_of(kind)(before, **changes)
    assert type(changed) is kind
    assert changed == replace(before, **changes)
    assert [getattr(before, name) for name in names] == [float(place) for place in range(len(names))]
    assert changer_of(kind)(before) == before
    with pytest.raises(KeyError):
        changer_of(kind)(before, no_such_field=1.0)
