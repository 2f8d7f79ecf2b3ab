"""What weighed loads say: density, gain, load curve, and which tickets are wrong."""
