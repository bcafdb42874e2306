"""Shadows of roofs: how high they reach above each cell, exactly, at every n-th cell, and softly."""
