"""Where model and measurement disagree, which effect is missing, and the validation that adding it helps."""
