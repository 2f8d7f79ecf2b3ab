"""Outputs of the commands as version 0.1.0 gave them, to be reproduced bit for bit."""
