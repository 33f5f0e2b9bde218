-- Invalid and open models
-- Topic: quality
--
-- Models whose B-Rep has a fault: OCCT's analyser objects, curves are open or nonmanifold, or a
-- tolerance is so large that patches need not meet.
--
-- Parameters:
--   max_tolerance DOUBLE = 0.1 (mm): tolerance from which on it is a fault
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   faults: what is wrong: invalid, open, nonmanifold, tolerance
--   boundary_curves: curves with one patch only
--   nonmanifold_curves: curves with three or more patches
--   tolerance (mm): largest tolerance of its patches
WITH edges AS (
    SELECT
        model_id,
        count(*) FILTER (kind = 'boundary') AS boundary_curves,
        count(*) FILTER (kind = 'nonmanifold') AS nonmanifold_curves
    FROM curves
    GROUP BY model_id
),
tolerances AS (SELECT model_id, max(tolerance) AS tolerance FROM patches GROUP BY model_id)
SELECT
    model_id,
    collection,
    name,
    list_filter([
        if(NOT is_valid, 'invalid', NULL),
        if(NOT is_closed, 'open', NULL),
        if(nonmanifold_curves > 0, 'nonmanifold', NULL),
        if(tolerance > $max_tolerance, 'tolerance', NULL)
    ], lambda fault: fault IS NOT NULL) AS faults,
    coalesce(boundary_curves, 0) AS boundary_curves,
    coalesce(nonmanifold_curves, 0) AS nonmanifold_curves,
    tolerance
FROM models
LEFT JOIN edges USING (model_id)
LEFT JOIN tolerances USING (model_id)
WHERE len(faults) > 0
ORDER BY len(faults) DESC, collection, name
