-- Fillets and rounds of each model
-- Topic: features
--
-- Patches that round an edge with one radius: cylinders along straight edges, tori along round ones
-- and spheres at corners (see the view fillets for the exact rule). A fillet fills an inner edge, a
-- round takes an outer one away.
--
-- Parameters:
--   min_radius DOUBLE = 0 (mm): least radius
--   max_radius DOUBLE = NULL (mm): greatest radius; any if NULL
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   fillets: concave ones
--   rounds: convex ones
--   least_radius (mm): smallest radius among them
--   median_radius (mm): median radius
--   most_radius (mm): largest radius
--   area (mm^2): their area
--   area_share: its share of the model's area
SELECT
    model_id,
    any_value(m.collection) AS collection,
    any_value(m.name) AS name,
    count(*) FILTER (f.is_concave) AS fillets,
    count(*) FILTER (NOT f.is_concave) AS rounds,
    min(f.radius) AS least_radius,
    median(f.radius) AS median_radius,
    max(f.radius) AS most_radius,
    sum(f.area) AS area,
    sum(f.area) / nullif(any_value(m.area), 0) AS area_share
FROM fillets AS f
JOIN models AS m USING (model_id)
WHERE f.radius >= $min_radius AND ($max_radius IS NULL OR f.radius <= $max_radius)
GROUP BY model_id
ORDER BY fillets + rounds DESC, collection, name
