-- Short curves and sliver patches
-- Topic: quality
--
-- Features that are tiny against their model and cost triangles or break meshers: curves shorter,
-- and patches narrower, than a share of the model's diagonal. The width of a patch is twice its
-- area divided by its perimeter, which is right for long strips.
--
-- Parameters:
--   max_ratio DOUBLE = 1e-3: greatest ratio of size to the model's diagonal
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   feature: curve or patch
--   id: its curve_id or patch_id
--   type: type of the curve or patch
--   size (mm): length of the curve, width of the patch
--   ratio: ratio of size to the model's diagonal
WITH perimeters AS MATERIALIZED (
    SELECT model_id, patch_id, sum(c.length) AS perimeter
    FROM coedges
    JOIN curves AS c USING (model_id, curve_id)
    WHERE c.kind <> 'seam'
    GROUP BY model_id, patch_id
),
sizes AS (
    SELECT model_id, 'curve' AS feature, curve_id AS id, type, length AS size
    FROM curves
    WHERE kind <> 'degenerate'
    UNION ALL
    SELECT model_id, 'patch', patch_id, type, 2 * abs(area) / nullif(perimeter, 0)
    FROM patches
    JOIN perimeters USING (model_id, patch_id)
)
SELECT
    model_id,
    m.collection,
    m.name,
    s.feature,
    s.id,
    s.type,
    s.size,
    s.size / m.diagonal AS ratio
FROM sizes AS s
JOIN models AS m USING (model_id)
WHERE m.diagonal > 0 AND s.size <= $max_ratio * m.diagonal
ORDER BY ratio, m.collection, m.name, s.feature, s.id
