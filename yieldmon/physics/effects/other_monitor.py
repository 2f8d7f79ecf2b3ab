"""The error of another combine's monitor, by which trucks that it filled too are weighed: a state of the parameters that no force
depends on."""

from __future__ import annotations

from .effect import Effect, EffectParameter

OTHER_MONITOR = Effect(
    name="other_monitor",
    stage="sensor",
    summary="What another combine's monitor shows of trucks that both filled is off by one and the same share.",
    signature="none in a table of forces; weighed loads of such trucks are off together",
    source="Schmidt, Application of state-space methods to navigation problems (1966)",
    parameters=(
        EffectParameter("bias", "", 0.0, -10.0, 10.0, 1.0, "error of that monitor, in its stated standard deviations", 1.0),
    ),
    measured=True,
)
BIAS = f"{OTHER_MONITOR.name}.{OTHER_MONITOR.parameters[0].name}"
"""Its parameter in a parameter set."""
