-- Largest models
-- Topic: structure
--
-- The largest by one measure, be it the size of the B-Rep, of the mesh or of the file, the
-- dimensions or what ingest cost.
--
-- Parameters:
--   by VARCHAR = patches: patches, curves, parts, vertices, triangles, bytes, diagonal (mm),
--     area (mm^2), volume (mm^3) or seconds (s)
--   limit BIGINT = 20: how many
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   value: the measure
--   n_patches: its patches
--   n_faces: its triangles; null without mesh
SELECT model_id, collection, name, value, n_patches, n_faces
FROM (
    SELECT
        *,
        CASE $by
            WHEN 'patches' THEN n_patches
            WHEN 'curves' THEN n_curves
            WHEN 'parts' THEN n_parts
            WHEN 'vertices' THEN n_vertices
            WHEN 'triangles' THEN n_faces
            WHEN 'bytes' THEN bytes
            WHEN 'diagonal' THEN diagonal
            WHEN 'area' THEN area
            WHEN 'volume' THEN volume
            WHEN 'seconds' THEN seconds
            ELSE error(
                'by is patches, curves, parts, vertices, triangles, bytes, diagonal, area, volume '
                || 'or seconds, not ' || $by
            )
        END::DOUBLE AS value
    FROM models
)
WHERE value IS NOT NULL
ORDER BY value DESC, collection, name
LIMIT $limit
