"""The machine for which a parameter file was made, as its provenance names it."""

from __future__ import annotations

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine

_NAME, _GAIN, _GEOMETRY = "machine", "gain_n_per_mv", "geometry_m"
_SAME = 0.02
"""Relative difference of a gain or length that is measured anew: about what a calibration by weighed loads leaves open."""


def facts(machine: Machine) -> dict[str, str]:
    """Entries of the provenance."""
    return {
        _NAME: machine.name,
        _GAIN: f"{machine.sensor.gain_n_per_mv:.6g}",
        _GEOMETRY: " ".join(f"{length:.6g}" for length in machine.geometry_m),
    }


def names_geometry(known: ParameterSet) -> bool:
    """Whether the provenance says for which lengths the parameters were made."""
    return _GEOMETRY in known.provenance


def is_of_other_geometry(known: ParameterSet, machine: Machine) -> bool:
    """Whether the parameters were made for a machine of other lengths; False where their provenance does not say so."""
    return names_geometry(known) and not _alike(known.provenance[_GEOMETRY], facts(machine)[_GEOMETRY])


def difference(known: ParameterSet, machine: Machine) -> str:
    """What tells that the parameters were made for another machine; "" where nothing does."""
    here, found = facts(machine), list[str]()
    if is_of_other_geometry(known, machine):
        found.append("other lengths of elevator and plate")
    if _GAIN in known.provenance and not _alike(known.provenance[_GAIN], here[_GAIN]):
        found.append(f"a force cell of {known.provenance[_GAIN]} N/mV, here {here[_GAIN]}")
    if known.provenance.get(_NAME, machine.name) != machine.name:
        found.append(f"the name {known.provenance[_NAME]}, here {machine.name}")
    return ", ".join(found)


def _alike(these: str, those: str) -> bool:
    try:
        one, other = np.array(these.split(), dtype=float), np.array(those.split(), dtype=float)
    except ValueError:
        return False
    return one.shape == other.shape and bool(np.allclose(one, other, rtol=_SAME, atol=0.0))
