-- Distribution of surface types
-- Topic: statistics
--
-- The paper's figure of patch types: how many patches are planes, cylinders and so on, over all
-- models. Also how many models have the type at all, and how much area it covers.
--
-- Columns:
--   type: surface type, in the paper's order; all nine are listed
--   patches: patches of that type
--   share: their share of all patches
--   models: models that have at least one
--   model_share: their share of all models
--   area (mm^2): area of these patches
--   area_share: their share of the area of all patches
WITH types (place, type) AS (
    VALUES
    (0, 'Plane'), (1, 'Cylinder'), (2, 'Cone'), (3, 'Sphere'), (4, 'Torus'),
    (5, 'Revolution'), (6, 'Extrusion'), (7, 'BSpline'), (8, 'Other')
),
counted AS (
    SELECT type, count(*) AS patches, count(DISTINCT model_id) AS models, sum(area) AS area
    FROM patches
    GROUP BY type
)
SELECT
    type,
    coalesce(patches, 0) AS patches,
    coalesce(patches, 0) / sum(patches) OVER () AS share,
    coalesce(models, 0) AS models,
    coalesce(models, 0) / (SELECT nullif(count(*), 0) FROM models) AS model_share,
    coalesce(area, 0) AS area,
    coalesce(area, 0) / sum(area) OVER () AS area_share
FROM types
LEFT JOIN counted USING (type)
ORDER BY place
