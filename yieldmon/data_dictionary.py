"""Identifiers (DDI) of values by the data dictionary of ISO 11783-11, and their raw units."""

from __future__ import annotations

WIDTH, DEFAULT_WIDTH, MAX_WIDTH = 67, 68, 70
"""Actual, default and largest working width, mm."""
VOLUME_PER_AREA, VOLUME_PER_TIME, TOTAL_VOLUME = 83, 86, 89
"""Yield as a volume: ml/m2, ml/s, l."""
MASS_PER_AREA, MASS_PER_TIME, TOTAL_MASS = 84, 87, 90
"""Yield: mg/m2, mg/s, kg."""
MOISTURE = 99
"""Of the crop, ppm."""
TOTAL_AREA, EFFECTIVE_TIME = 116, 119
"""m2; s."""
OFFSET_X, OFFSET_Y = 134, 135
"""Of a device element, mm ahead and to the right of its device's reference point."""
WORK_STATE = 141
"""1 at work, of the whole implement."""
LATENCY, CONNECTOR_TYPE = 143, 157
"""Physical actual value time latency, ms, below 0 where a value was true before it is sent; type of the connector."""
CONDENSED_STATES = range(161, 177)
"""Work states of sixteen sections each."""
LENGTH_OF_CUT = 177
"""um; only a forage harvester has one."""
DRY_PER_AREA, DRY_PER_TIME, DRY_TOTAL, REFERENCE_MOISTURE = 181, 182, 183, 184
"""Yield at a reference moisture: mg/m2, mg/s, kg; ppm."""
HOLD = 239
"""Yield hold status, 1 where yield does not count."""
LAG, LEAD = 259, 260
"""Yield lag and lead ignore time, ms: for how long yield does not count after work ends and begins."""
