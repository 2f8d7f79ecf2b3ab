"""Whether published standard deviations hold."""
