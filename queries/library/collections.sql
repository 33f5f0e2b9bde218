-- Collections side by side
-- Topic: records
--
-- What each collection holds: sizes, and how much of it is closed, valid and meshed.
--
-- Columns:
--   collection: the collection
--   models: models in it
--   duplicates: models of which it has an earlier copy
--   median_patches: median number of patches of a model
--   patches: patches of all its models
--   curves: curves of all its models
--   triangles: triangles of all its meshes
--   closed_share: share of models without boundary curves
--   valid_share: share of models in which OCCT finds no fault
--   meshed_share: share of models with a mesh
--   bytes (byte): size of the source files
SELECT
    collection,
    count(*) AS models,
    count(*) - count(DISTINCT duplicate_group) AS duplicates,
    median(n_patches) AS median_patches,
    sum(n_patches)::BIGINT AS patches,
    sum(n_curves)::BIGINT AS curves,
    coalesce(sum(n_faces), 0)::BIGINT AS triangles,
    avg(is_closed::DOUBLE) AS closed_share,
    avg(is_valid::DOUBLE) AS valid_share,
    count(mesh_kind) / count(*) AS meshed_share,
    sum(bytes)::BIGINT AS bytes
FROM models
GROUP BY collection
ORDER BY models DESC, collection
