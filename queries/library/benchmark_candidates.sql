-- Candidates for a benchmark
-- Topic: quality
--
-- The paper's automatic filters: no nearly empty files, no single primitives, nothing that needed
-- healing while it was read or meshed, no mesh that was refined beyond reason. Further, room for
-- patches of the size that is asked for.
--
-- Parameters:
--   min_bytes BIGINT = 10000 (byte): least size of the source file
--   max_faces BIGINT = 500000: largest mesh, triangles
--   min_vertices BIGINT = 512: smallest mesh, vertices
--   unique BOOLEAN = false: of each cluster of duplicates, only the first by name
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   n_patches: its patches
--   n_curves: its curves
--   n_vertices: vertices of its mesh
--   n_faces: triangles of its mesh
--   duplicate_group: the same for duplicates; splits must not cut through it
SELECT
    model_id, collection, name, n_patches, n_curves, n_vertices, n_faces, duplicate_group
FROM models
WHERE bytes >= $min_bytes
    AND NOT is_single_primitive
    -- no healing
    AND is_valid
    AND n_added_pcurves = 0
    AND coalesce(len(import_repairs), 0) = 0
    AND mesh_kind <> 'tessellation'
    AND mesh_note IS NULL
    AND n_faces <= $max_faces
    AND n_vertices >= $min_vertices
QUALIFY NOT $unique
    OR row_number() OVER (PARTITION BY duplicate_group ORDER BY collection, name) = 1
ORDER BY collection, name
