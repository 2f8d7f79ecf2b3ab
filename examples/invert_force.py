"""Flow from force, with its standard deviation, by the shipped corn's parameters."""

import numpy as np

from yieldmon import api

parameters = api.load_parameters()
loop = api.OpenLoop(api.ForwardModel(api.Machine(), parameters.effects), parameters)
force_n = np.array([20.0, 60.0, 120.0])
angle_rad, speed_rad_s = np.full(3, np.radians(70.0)), np.full(3, 400.0 * api.RPM)
found = loop.estimate(force_n, angle_rad, speed_rad_s, force_std_dev_n=0.02 * force_n)
for force, flow, sd in zip(force_n, found.mass_flow_kg_s, found.std_dev_kg_s, strict=True):
    print(f"{force:6.1f} N  {flow:5.2f} kg/s, standard deviation {sd:.2f}")
