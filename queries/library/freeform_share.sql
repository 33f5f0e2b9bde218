-- Share of freeform area
-- Topic: features
--
-- How much of a model's area lies on freeform patches: B-splines, surfaces of type Other, and
-- extrusions and revolutions of B-splines.
--
-- Parameters:
--   min_share DOUBLE = 0.5: least share of the area
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   freeform_patches: its freeform patches
--   n_patches: all its patches
--   freeform_area (mm^2): area of the freeform patches
--   share: their share of the area of all patches
WITH summed AS (
    SELECT
        model_id,
        count(*) FILTER (freeform) AS freeform_patches,
        coalesce(sum(area) FILTER (freeform), 0) AS freeform_area,
        sum(area) AS area
    FROM (
        SELECT
            model_id,
            area,
            type IN ('BSpline', 'Other')
                OR (type IN ('Extrusion', 'Revolution') AND curve.type IN ('BSpline', 'Other'))
                AS freeform
        FROM patches
    )
    GROUP BY model_id
)
SELECT
    model_id,
    collection,
    name,
    freeform_patches,
    n_patches,
    freeform_area,
    freeform_area / nullif(summed.area, 0) AS share
FROM summed
JOIN models USING (model_id)
WHERE share >= $min_share
ORDER BY share DESC, collection, name
