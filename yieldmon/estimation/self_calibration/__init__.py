"""What sweeps and time say: the closed loop, drift, home flow, the model's error over angles."""
