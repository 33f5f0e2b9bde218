-- What the filters for a benchmark reject
-- Topic: quality
--
-- The complement of benchmark_candidates with the same parameters: every other input of the lake,
-- also those that never became models, with all the filters that it does not pass.
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
--   reasons: filters it does not pass: nearly-empty, single-primitive, invalid, healed, no-mesh,
--     tessellation, mesh-note, mesh-too-large, mesh-too-small, duplicate; kinds of failure of an
--     input that is no model
--   bytes (byte): size of the source file
--   n_faces: triangles of its mesh
--   mesh_note: why the mesh is not as asked for
WITH judged AS (
    SELECT
        model_id,
        collection,
        name,
        list_filter([
            if(bytes < $min_bytes, 'nearly-empty', NULL),
            if(is_single_primitive, 'single-primitive', NULL),
            if(NOT is_valid, 'invalid', NULL),
            if(n_added_pcurves > 0 OR coalesce(len(import_repairs), 0) > 0, 'healed', NULL),
            if(mesh_kind IS NULL, 'no-mesh', NULL),
            if(mesh_kind = 'tessellation', 'tessellation', NULL),
            if(mesh_note IS NOT NULL, 'mesh-note', NULL),
            if(n_faces > $max_faces, 'mesh-too-large', NULL),
            if(n_vertices < $min_vertices, 'mesh-too-small', NULL)
        ], lambda reason: reason IS NOT NULL) AS reasons,
        bytes,
        n_faces,
        mesh_note,
        duplicate_group
    FROM models
),
repeated AS (
    SELECT model_id
    FROM judged
    WHERE len(reasons) = 0
    QUALIFY row_number() OVER (PARTITION BY duplicate_group ORDER BY collection, name) > 1
),
failed AS (
    SELECT
        model_id,
        any_value(collection) AS collection,
        any_value(name) AS name,
        list_sort(list(DISTINCT kind)) AS reasons,
        any_value(bytes) AS bytes
    FROM failures
    GROUP BY model_id
    HAVING bool_or(fatal)
)
SELECT
    model_id,
    collection,
    name,
    if($unique AND model_id IN (FROM repeated), ['duplicate'], reasons) AS reasons,
    bytes,
    n_faces,
    mesh_note
FROM judged
WHERE len(reasons) > 0 OR ($unique AND model_id IN (FROM repeated))
UNION ALL
SELECT model_id, collection, name, reasons, bytes, NULL, NULL FROM failed
ORDER BY collection, name
