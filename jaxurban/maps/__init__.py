"""From a city to its metric maps: one recipe for the maps of a surface, whoever runs it."""
