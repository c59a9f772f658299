"""Band-to-band QA: displacements of all pairs of bands, closure of triangles, requirements, report."""
