"""Lidar scan returns: over flat ground, at every n-th cell, over terrain, and softly."""
