"""Scenario files: their settings, their run, and the record of it."""
