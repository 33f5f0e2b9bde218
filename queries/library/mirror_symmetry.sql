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
        model_id, x - (lx + hx) / 2 AS x, y - (ly + hy) / 2 AS y, z - (lz + hz) / 2 AS z,
        $tolerance * greatest(hx - lx, hy - ly, hz - lz) AS cell
    FROM (
        SELECT
            model_id, point.x AS x, point.y AS y, point.z AS z,
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
cells AS (
    SELECT
        model_id,
        floor(x / cell + 0.382) AS x, floor(y / cell + 0.382) AS y, floor(z / cell + 0.382) AS z,
        floor(-x / cell + 0.382) AS mx, floor(-y / cell + 0.382) AS my,
        floor(-z / cell + 0.382) AS mz
    FROM centred
),
places AS (SELECT DISTINCT model_id, x, y, z FROM cells),
shares AS (
    SELECT
        c.model_id,
        count(*) AS n_corners,
        count(px.model_id) / count(*) AS x,
        count(py.model_id) / count(*) AS y,
        count(pz.model_id) / count(*) AS z
    FROM cells AS c
    LEFT JOIN places AS px
        ON px.model_id = c.model_id AND px.x = c.mx AND px.y = c.y AND px.z = c.z
    LEFT JOIN places AS py
        ON py.model_id = c.model_id AND py.x = c.x AND py.y = c.my AND py.z = c.z
    LEFT JOIN places AS pz
        ON pz.model_id = c.model_id AND pz.x = c.x AND pz.y = c.y AND pz.z = c.mz
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
