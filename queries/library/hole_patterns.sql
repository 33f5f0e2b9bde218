-- Patterns of equal holes
-- Topic: features
--
-- Holes of one part with the same radius and direction: bolt circles, rows, rectangles. Holes on
-- one axis, as in a fork, count once.
--
-- Parameters:
--   min_holes BIGINT = 3: holes that a pattern must have
--   tolerance DOUBLE = 0.01 (mm): how far holes may be off their place
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   part_id: the part
--   radius (mm): radius of the holes
--   holes: number of holes
--   pattern: circle (evenly spaced), rectangle, row or other
--   circle_radius (mm): radius of the circle through the axes; null for row and other
--   spacing (mm): least distance between two axes, for circles and rectangles
WITH axes AS (
    -- the grid is shifted so that round numbers are not on its borders
    SELECT
        model_id, part_id, any_value(radius) AS radius, any_value(foot) AS foot,
        [
            floor(radius * 1e3 + 0.382),
            floor(axis.x * 1e5 + 0.382), floor(axis.y * 1e5 + 0.382), floor(axis.z * 1e5 + 0.382)
        ] AS kind_key
    FROM holes
    GROUP BY
        model_id, part_id, kind_key,
        floor(foot.x * 1e3 + 0.382), floor(foot.y * 1e3 + 0.382), floor(foot.z * 1e3 + 0.382)
),
centred AS (
    SELECT
        *,
        foot.x - avg(foot.x) OVER family AS x,
        foot.y - avg(foot.y) OVER family AS y,
        foot.z - avg(foot.z) OVER family AS z,
        sqrt(x * x + y * y + z * z) AS away
    FROM axes
    WINDOW family AS (PARTITION BY model_id, part_id, kind_key)
),
-- distance of every axis from the line through the middle and the outermost axis
lined AS (
    SELECT
        c.*,
        sqrt(greatest(away * away - pow(c.x * o.x + c.y * o.y + c.z * o.z, 2), 0)) AS off_line
    FROM centred AS c
    JOIN (
        SELECT
            model_id, part_id, kind_key,
            arg_max({'x': x / away, 'y': y / away, 'z': z / away}, away) AS o
        FROM centred
        WHERE away > 0
        GROUP BY ALL
    ) USING (model_id, part_id, kind_key)
),
families AS (
    SELECT
        model_id, part_id, kind_key,
        any_value(radius) AS radius,
        count(*) AS holes,
        avg(away) AS circle_radius,
        max(away) - min(away) <= $tolerance AND circle_radius > $tolerance AS is_round,
        max(off_line) <= $tolerance AS is_row
    FROM lined
    GROUP BY ALL
    HAVING count(*) >= $min_holes
),
spaced AS (
    SELECT
        model_id, part_id, kind_key,
        min(sqrt(pow(a.x - b.x, 2) + pow(a.y - b.y, 2) + pow(a.z - b.z, 2))) AS spacing
    FROM families AS f
    JOIN centred AS a USING (model_id, part_id, kind_key)
    JOIN centred AS b USING (model_id, part_id, kind_key)
    WHERE f.is_round AND NOT f.is_row AND a.foot <> b.foot
    GROUP BY ALL
)
SELECT
    model_id,
    m.collection,
    m.name,
    part_id,
    f.radius,
    f.holes,
    CASE
        WHEN f.is_row THEN 'row'
        -- points on a circle that all keep this distance are spaced evenly
        WHEN s.spacing >= 2 * f.circle_radius * sin(pi() / f.holes) - $tolerance THEN 'circle'
        -- and four points about their middle, equally far from it, are a rectangle
        WHEN f.is_round AND f.holes = 4 THEN 'rectangle'
        ELSE 'other'
    END AS pattern,
    if(pattern IN ('circle', 'rectangle'), f.circle_radius, NULL) AS circle_radius,
    if(pattern IN ('circle', 'rectangle'), s.spacing, NULL) AS spacing
FROM families AS f
LEFT JOIN spaced AS s USING (model_id, part_id, kind_key)
JOIN models AS m USING (model_id)
ORDER BY f.holes DESC, m.collection, m.name, part_id, f.radius
