"""One metric a file: its parameters, its equation, its map."""
