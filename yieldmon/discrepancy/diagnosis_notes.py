"""What a diagnosis says beside its verdict, a sentence each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .noise import Noise
from .proof import Proof
from .selection import Choice


def refuted(names: tuple[str, ...], proof: Proof) -> str:
    """Why the sealed rows speak against the effects that were found."""
    where = f"; {', '.join(proof.worse)} worse than before" if proof.worse else ""
    low, high = (100.0 * (proof.crossed.value + s * proof.crossed.sd) for s in (-1.96, 1.96))
    return (
        f"{' + '.join(names)} is not named: unseen rows lie {low:.0f} to {high:.0f} % of the way to it, where more than 50 % "
        f"is needed{where}"
    )


def against(choice: Choice) -> str:
    """Why the effects that were found are only leading candidates."""
    return f"{' + '.join(step.added for step in choice.steps)} is not named: {choice.against}"


def not_trusted(choice: Choice) -> str:
    """Why effects that were found are not named: too many cases that look alike are another effect."""
    first = choice.steps[0]
    names = " or ".join((first.added, *first.equivalent))
    return f"{names}: not named, right in {100.0 * first.confidence:.0f} of 100 cases that look like this one"


def of_noise(noise: Noise, outliers: int) -> list[str]:
    """Where the noise is known from, how large it is, and how many outliers are left out."""
    how = {
        "replicates": f"noise from replicates ({noise.dof:.0f} degrees of freedom)",
        "smooth": "no replicates: noise from the scatter about a smooth surface through the rows",
        "stated": "noise as stated, not measured in this table",
    }[noise.how]
    form = f"sd = {noise.constant:.4g}" + (
        f" + {100.0 * noise.proportional:.2g} % of reading (in quadrature)" if noise.proportional else ""
    )
    return [f"{how}: {form}"] + ([f"{outliers} outlying rows left out"] if outliers else [])


def of_overfull(opened: NDArray[np.bool_], proven_rows: int) -> list[str]:
    """How many of the rows opened prove nothing; proven_rows: those that do."""
    lost = int(np.count_nonzero(opened)) - proven_rows
    return [f"{lost} held-out rows prove nothing: they overfill the paddles of the model fitted without them"] if lost else []


def of_undetectable(effects: tuple[str, ...]) -> list[str]:
    """Effects that this design cannot show."""
    return [f"at no physical size would these rows show: {', '.join(effects)}"] if effects else []
