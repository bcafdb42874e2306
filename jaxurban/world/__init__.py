"""What stands where: grids, cities, surfaces, skies, and the synthetic city."""
