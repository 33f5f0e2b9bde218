-- Share of sharp edges
-- Topic: features
--
-- Which part of the length of a model's curves is sharp by the paper's rule (normals that differ by
-- 18.2 to 161.8 degrees all along). Seams and degenerate curves do not count, for they are no edges
-- of the shape.
--
-- Parameters:
--   min_share DOUBLE = 0: least share
--   max_share DOUBLE = 1: greatest share
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   sharp_curves: its sharp curves
--   curves: its curves
--   sharp_length (mm): length of the sharp curves
--   length (mm): length of the curves
--   share: share of the length that is sharp
SELECT
    model_id,
    any_value(m.collection) AS collection,
    any_value(m.name) AS name,
    count(*) FILTER (c.sharp) AS sharp_curves,
    count(*) AS curves,
    coalesce(sum(c.length) FILTER (c.sharp), 0) AS sharp_length,
    sum(c.length) AS length,
    sharp_length / nullif(sum(c.length), 0) AS share
FROM curves AS c
JOIN models AS m USING (model_id)
WHERE c.kind NOT IN ('seam', 'degenerate')
GROUP BY model_id
HAVING share BETWEEN $min_share AND $max_share
ORDER BY share DESC, collection, name
