"""Fit the grain's parameters to a table of known flows: here one made by the model, with 1 % noise (seed 1)."""

import numpy as np

from yieldmon import api

model = api.ForwardModel(api.Machine())
truth = {"friction": 0.25, "restitution": 0.55, "density": 1150.0, "shape_ratio": 2.0}
flow, angle = (each.ravel() for each in np.meshgrid([2.0, 6.0, 12.0, 20.0], np.radians([40.0, 55.0, 70.0, 90.0])))
at = api.Conditions(plate_angle_rad=angle, elevator_speed_rad_s=np.full(flow.size, 400.0 * api.RPM), mass_flow_kg_s=flow)
momentum = np.asarray(model.paddle_momentum(at, truth))
measured = momentum * (1.0 + 0.01 * np.random.default_rng(1).standard_normal(flow.size))
free = ("friction", "restitution", "density")
data = api.Measurements(at, measured, sigma=0.01 * momentum)
fitted = api.calibrate(model, data, api.default_start(model, data, free), free, starts=5)
for parameter in fitted.parameters:
    print(f"{parameter.name:12} {parameter.value:8.3f} +- {parameter.standard_error:.3f}, true {truth[parameter.name]:g}")
