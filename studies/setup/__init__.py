"""From a set-up and a few weighed loads to a number one can trust."""
