"""What samples hold beside their mean: pulses' shape, kernels' noise, taps."""
