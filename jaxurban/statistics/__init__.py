"""Intervals, and what they let a study conclude."""
