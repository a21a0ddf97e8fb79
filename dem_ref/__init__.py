"""A small 2D DEM for disks that measures what the point law claims: packing, loading, measurement."""
