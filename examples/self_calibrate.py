"""Flow and friction together from one sweep of the plate: the grain has become rougher than the parameters say (seed 1)."""

from dataclasses import replace

import numpy as np

from yieldmon import api

shipped = api.load_parameters()
sd = np.array([0.15 * shipped.values[name] for name in shipped.covariance_names])
prior = replace(shipped, covariance=np.diag(sd**2))  # nothing weighed since last year
model = api.ForwardModel(api.Machine(), prior.effects)
truth = {**prior.values, "friction": 1.2 * prior.values["friction"]}
angle = np.radians(np.repeat([40.0, 50.0, 60.0, 80.0, 90.0], 4))
speed = np.full(angle.size, 400.0 * api.RPM)
at = api.Conditions(plate_angle_rad=angle, elevator_speed_rad_s=speed, mass_flow_kg_s=np.full(angle.size, 12.0))
force = np.asarray(model.force(at, truth))
measured = force * (1.0 + 0.005 * np.random.default_rng(1).standard_normal(angle.size))
sweep = api.Sweep(np.arange(angle.size, dtype=float), angle, speed, measured, 0.005 * force)
outcome = api.self_calibrate(model, prior, [sweep])
before, after = prior.values["friction"], outcome.parameter_set.values["friction"]
print(f"friction before {before:.3f}, after {after:.3f}, true {truth['friction']:.3f}")
for flow in outcome.flows:
    print(f"flow {flow.mass_flow_kg_s:.2f} kg/s, standard deviation {flow.std_dev_kg_s:.2f}, true 12.00")
