"""A small 2D DEM for disks that measures what the point law claims.

Reading order:

- `sample` (what is kept), `neighbours`, `stepping` and `motion` (the compiled core);
- `relaxation` and `packing` (isotropic packings from a seed);
- `legs`, `leg_state`, `endings`, `servo`, `path`, `biaxial` (loading, history, checkpoints), `ensemble` (several
  samples);
- `measure`, `events`, `distribution`, `tessellation`, `probes`, `weak_contacts`, `material`, `sliding` (what is
  measured, from definitions), `uncertainty` (how far that may be off);
- `fields` (arrays for pictures).

Nothing here is shared with the law that it verifies. Stresses and strains are tension positive, order xx, yy, xy;
forces at contacts are compression positive; second harmonics are vectors in the double-angle plane.
"""
