"""Readers: files to a city, a sky, routes and zones."""
