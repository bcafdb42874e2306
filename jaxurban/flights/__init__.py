"""Flights: missions in and out, and the verdict on them; README.md says how."""
