"""Distance to the nearest source on a raster, exactly and softly."""
