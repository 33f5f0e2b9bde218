-- Mirror symmetry about the coordinate planes
-- Topic: structure
--
-- Models whose corners map onto corners when mirrored at the plane through their middle at right
-- angles to an axis. Corners alone decide; models with few of them are left out.
--
-- Parameters:
--   min_corners BIGINT = 8: corners that a model must have
--   min_share DOUBLE = 1: least share of corners that have a mirror image
--   tolerance DOUBLE = 1e-5: how far images may be off, as a share of the model's size
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   n_corners: its corners
--   x: share of corners with a mirror image at the plane across the x axis; null if below min_share
--   y: the same for the y axis
--   z: the same for the z axis
--   planes: number of planes with at least min_share
WITH centred AS (
    SELECT
        model_id, corner_id, n,
        x - (lx + hx) / 2 AS x, y - (ly + hy) / 2 AS y, z - (lz + hz) / 2 AS z,
        $tolerance * greatest(hx - lx, hy - ly, hz - lz) AS reach,
        -- a few times the tolerance: most images are then sought in one cell of the grid
        16 * reach AS cell
    FROM (
        SELECT
            model_id, corner_id, point.x AS x, point.y AS y, point.z AS z,
            min(point.x) OVER model AS lx, max(point.x) OVER model AS hx,
            min(point.y) OVER model AS ly, max(point.y) OVER model AS hy,
            min(point.z) OVER model AS lz, max(point.z) OVER model AS hz,
            count(*) OVER model AS n
        FROM corners
        WINDOW model AS (PARTITION BY model_id)
    )
    WHERE n >= $min_corners AND greatest(hx - lx, hy - ly, hz - lz) > 0
),
-- the grid is shifted so that round numbers are not on its borders
places AS (
    SELECT
        *,
        floor(x / cell + 0.382) AS i, floor(y / cell + 0.382) AS j, floor(z / cell + 0.382) AS k
    FROM centred
),
images AS (
    SELECT
        model_id, corner_id, reach, cell, axis,
        if(axis = 'x', -x, x) AS x, if(axis = 'y', -y, y) AS y, if(axis = 'z', -z, z) AS z
    FROM centred, (VALUES ('x'), ('y'), ('z')) AS axes (axis)
),
-- each image with the cells that the ball about it meets
sought AS (
    SELECT
        *,
        unnest(list_distinct([
            floor((z - reach) / cell + 0.382), floor((z + reach) / cell + 0.382)
        ])) AS k
    FROM (
        SELECT
            *,
            unnest(list_distinct([
                floor((y - reach) / cell + 0.382), floor((y + reach) / cell + 0.382)
            ])) AS j
        FROM (
            SELECT
                *,
                unnest(list_distinct([
                    floor((x - reach) / cell + 0.382), floor((x + reach) / cell + 0.382)
                ])) AS i
            FROM images
        )
    )
),
found AS (
    SELECT DISTINCT s.model_id, s.axis, s.corner_id
    FROM sought AS s
    JOIN places AS p
        ON p.model_id = s.model_id AND p.i = s.i AND p.j = s.j AND p.k = s.k
        AND (p.x - s.x) ** 2 + (p.y - s.y) ** 2 + (p.z - s.z) ** 2 <= s.reach ** 2
),
shares AS (
    SELECT
        c.model_id,
        any_value(c.n) AS n_corners,
        count(*) FILTER (axis = 'x') / n_corners AS x,
        count(*) FILTER (axis = 'y') / n_corners AS y,
        count(*) FILTER (axis = 'z') / n_corners AS z
    FROM centred AS c
    LEFT JOIN found AS f ON f.model_id = c.model_id AND f.corner_id = c.corner_id
    GROUP BY c.model_id
)
SELECT
    model_id,
    m.collection,
    m.name,
    s.n_corners,
    if(s.x >= $min_share, s.x, NULL) AS x,
    if(s.y >= $min_share, s.y, NULL) AS y,
    if(s.z >= $min_share, s.z, NULL) AS z,
    (s.x >= $min_share)::INTEGER + (s.y >= $min_share)::INTEGER + (s.z >= $min_share)::INTEGER
        AS planes
FROM shares AS s
JOIN models AS m USING (model_id)
WHERE greatest(s.x, s.y, s.z) >= $min_share
ORDER BY planes DESC, s.n_corners DESC, m.collection, m.name
