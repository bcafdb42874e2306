"""What lies along a polyline: the cells crossed, and costs exact and smooth."""
