-- Combinations of surface types
-- Topic: statistics
--
-- Which types occur together: how many models are made of planes alone, of planes and cylinders,
-- and so on.
--
-- Columns:
--   types: surface types that the models have, joined by +
--   models: models with exactly these types
--   share: their share of all models
--   patches: patches of these models
--   example: the model of them with the fewest patches
SELECT
    concat_ws(
        ' + ',
        if(n_plane > 0, 'Plane', NULL),
        if(n_cylinder > 0, 'Cylinder', NULL),
        if(n_cone > 0, 'Cone', NULL),
        if(n_sphere > 0, 'Sphere', NULL),
        if(n_torus > 0, 'Torus', NULL),
        if(n_revolution > 0, 'Revolution', NULL),
        if(n_extrusion > 0, 'Extrusion', NULL),
        if(n_bspline > 0, 'BSpline', NULL),
        if(n_other > 0, 'Other', NULL)
    ) AS types,
    count(*) AS models,
    count(*) / sum(count(*)) OVER () AS share,
    sum(n_patches)::BIGINT AS patches,
    first(name ORDER BY n_patches, name) AS example
FROM models
GROUP BY types
ORDER BY models DESC, types
