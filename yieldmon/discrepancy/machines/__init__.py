"""Joint diagnosis of the sweeps of many machines: errors common to all belong to the model, others to single machines."""
