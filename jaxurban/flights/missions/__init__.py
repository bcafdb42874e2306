"""Missions that other tools made, as legs."""
