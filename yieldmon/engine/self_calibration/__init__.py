"""What sweeps, weighed masses and kernels change of the parameters."""
