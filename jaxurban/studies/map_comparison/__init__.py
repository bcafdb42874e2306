"""Two sets of maps of one place, side by side."""
