"""A small study: what does a wrong friction cost, and does the plate's angle matter?"""

import numpy as np

from yieldmon import api

model = api.ForwardModel(api.Machine())
grain = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
assumed = api.OpenLoop(model, api.ParameterSet(values=grain))
flow, speed = np.full(3, 10.0), np.full(3, 400.0 * api.RPM)
angles_deg = np.array([40.0, 70.0, 90.0])
print("true friction   error of the flow at 40, 70 and 90 deg, %")
for friction in (0.15, 0.20, 0.25, 0.30):
    at = api.Conditions(plate_angle_rad=np.radians(angles_deg), elevator_speed_rad_s=speed, mass_flow_kg_s=flow)
    force = np.asarray(model.force(at, {**grain, "friction": friction}))
    measured = assumed.invert(force, np.radians(angles_deg), speed)
    print(f"{friction:13.2f}  ", *(f"{error:z8.1f}" for error in 100.0 * (measured / flow - 1.0)))
