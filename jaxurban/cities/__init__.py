"""Cities: files of outlines, rasters and people to one `City`; README.md says how."""
