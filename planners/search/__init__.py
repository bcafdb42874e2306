"""The searches that planners run."""
