-- Thin-walled solids
-- Topic: features
--
-- Sheet metal, housings, tubes: solids whose mean wall thickness, twice their volume divided by
-- their area, is small against their size.
--
-- Parameters:
--   max_ratio DOUBLE = 0.02: greatest ratio of thickness to the diagonal of the solid's box
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   part_id: the solid
--   thickness (mm): mean wall thickness
--   diagonal (mm): diagonal of the solid's bounding box
--   ratio: their ratio
SELECT
    model_id,
    m.collection,
    m.name,
    part_id,
    2 * p.volume / p.area AS thickness,
    sqrt(
        pow(p.bbox_max.x - p.bbox_min.x, 2)
        + pow(p.bbox_max.y - p.bbox_min.y, 2)
        + pow(p.bbox_max.z - p.bbox_min.z, 2)
    ) AS diagonal,
    thickness / nullif(sqrt(
        pow(p.bbox_max.x - p.bbox_min.x, 2)
        + pow(p.bbox_max.y - p.bbox_min.y, 2)
        + pow(p.bbox_max.z - p.bbox_min.z, 2)
    ), 0) AS ratio
FROM parts AS p
JOIN models AS m USING (model_id)
WHERE p.kind = 'solid' AND p.volume > 0 AND p.area > 0 AND ratio <= $max_ratio
ORDER BY ratio, m.collection, m.name, part_id
