"""Two sets of maps of one place, side by side: their values, and the routes that they lead to."""
