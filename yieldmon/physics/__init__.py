"""The impact-plate physics: machine, grain, the four stages and the forward model. SI units and radians throughout."""
