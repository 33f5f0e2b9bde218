-- Round holes by size
-- Topic: features
--
-- Concave cylinders that go round once, by radius and by what is at their ends (see the view holes
-- for the exact rule): through holes, blind holes with a bottom, and stepped ones that go on behind
-- an inner edge, such as the wide part of a counterbore.
--
-- Parameters:
--   min_radius DOUBLE = 0 (mm): least radius
--   max_radius DOUBLE = NULL (mm): greatest radius; any if NULL
-- Columns:
--   radius (mm): radius, rounded to a micrometre
--   through: through holes of that radius
--   blind: blind holes
--   stepped: stepped holes
--   models: models that have one
--   least_depth (mm): smallest depth among them
--   most_depth (mm): largest depth
SELECT
    round(radius, 3) AS radius,
    count(*) FILTER (kind = 'through') AS through,
    count(*) FILTER (kind = 'blind') AS blind,
    count(*) FILTER (kind = 'stepped') AS stepped,
    count(DISTINCT model_id) AS models,
    min(depth) AS least_depth,
    max(depth) AS most_depth
FROM holes
WHERE holes.radius >= $min_radius AND ($max_radius IS NULL OR holes.radius <= $max_radius)
GROUP BY ALL
ORDER BY through + blind + stepped DESC, radius
