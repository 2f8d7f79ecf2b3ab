"""Force on the plate from flow, angle and speed."""

import numpy as np

from yieldmon import api

model = api.ForwardModel(api.Machine())
grain = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
flow_kg_s = np.array([2.0, 5.0, 10.0, 20.0])
at = api.Conditions(plate_angle_rad=np.radians(70.0), elevator_speed_rad_s=400.0 * api.RPM, mass_flow_kg_s=flow_kg_s)
for flow, force in zip(flow_kg_s, model.force(at, grain), strict=True):
    print(f"{flow:5.1f} kg/s  {force:6.1f} N")
