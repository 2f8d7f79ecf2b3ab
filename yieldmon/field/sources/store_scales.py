"""Which scale the loads of a store were measured with: weighed loads change it, sweeps and a change of crop and back do not."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.files import parameter_file
from yieldmon.service.storage.batch import ParameterVersion
from yieldmon.service.storage.rows import SecondRow

_LEAST_SHARE = 0.02
"""Of a load's mass, with another scale than the rest."""


def load_scales(rows: Sequence[SecondRow], versions: Iterable[ParameterVersion], where: str) -> Mapping[str, str]:
    """The scale of each load with grain.

    Parameters
    ----------
    rows : sequence of SecondRow
    versions : iterable of ParameterVersion
        In order.
    where : str
        The store, for errors.

    Returns
    -------
    mapping of str to str
        Load -> the first parameter version with its scale; several, joined by "+", where the scale changed within it.
    """
    scales = _version_scales(versions, where)
    masses_kg: dict[int, dict[int, float]] = defaultdict(lambda: defaultdict(float))
    for row in rows:
        if row.mass_kg > 0.0:
            masses_kg[row.load_number][scales.get(row.parameter_version, row.parameter_version)] += row.mass_kg
    return {
        str(load): "+".join(str(scale) for scale, kg in sorted(by_scale.items()) if kg > _LEAST_SHARE * sum(by_scale.values()))
        for load, by_scale in masses_kg.items()
    }


def _version_scales(versions: Iterable[ParameterVersion], where: str) -> Mapping[int, int]:
    """Version -> the first one with its scale."""
    scales: dict[int, int] = {}
    of_values: dict[frozenset[tuple[str, float]], int] = {}
    before: int | None = None
    for version in versions:
        values = frozenset(parameter_file.from_document(version.document, where).values.items())
        kept = before if version.origin == ParameterOrigin.SWEEP else None
        before = scales[version.version] = of_values.setdefault(values, version.version if kept is None else kept)
    return scales
