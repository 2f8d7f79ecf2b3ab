"""Where model and measurement disagree, which effect is missing, and the proof that adding it helps."""
