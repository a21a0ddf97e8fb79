"""What accuracy costs: work-precision studies behind `granfabric cost`."""
