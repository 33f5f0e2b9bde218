-- Handles: the genus of each model
-- Topic: structure
--
-- How many handles (through openings) the surface of a closed model has, by the formula of Euler
-- and Poincare: V - E + F - H = 2 (S - G) with corners V, curves E (degenerate ones are points and
-- do not count), patches F, rings H, shells S and genus G. A ball has 0, a ring 1, a mug 1. The
-- rings of a patch are the pieces of its boundary but one: loops that share a corner are one piece.
-- Models with nonmanifold or free curves, or whose files count in another way, are left out.
--
-- Parameters:
--   min_genus BIGINT = 0: least genus
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   n_shells: its shells
--   euler: V - E + F - H
--   genus: number of handles of all its shells together
WITH RECURSIVE edges AS (
    SELECT
        model_id,
        count(*) FILTER (kind <> 'degenerate') AS n_edges,
        bool_or(kind IN ('nonmanifold', 'free')) AS is_odd
    FROM curves
    GROUP BY model_id
),
-- loops of a patch that share a corner, each with the first of them, both ways
corner_uses AS (
    SELECT DISTINCT e.model_id, e.patch_id, e.loop, unnest([c.start_corner, c.end_corner]) AS corner
    FROM coedges AS e
    JOIN curves AS c USING (model_id, curve_id)
    SEMI JOIN (FROM patches WHERE n_loops > 1) AS p
        ON p.model_id = e.model_id AND p.patch_id = e.patch_id
),
first_uses AS (
    SELECT *, min(loop) OVER (PARTITION BY model_id, patch_id, corner) AS first_loop
    FROM corner_uses
    WHERE corner IS NOT NULL
),
touching AS (
    SELECT model_id, patch_id, loop AS a, first_loop AS b FROM first_uses WHERE loop > first_loop
    UNION
    SELECT model_id, patch_id, first_loop, loop FROM first_uses WHERE loop > first_loop
),
reached AS (
    SELECT model_id, patch_id, a, b FROM touching
    UNION
    SELECT r.model_id, r.patch_id, r.a, t.b
    FROM reached AS r
    JOIN touching AS t ON t.model_id = r.model_id AND t.patch_id = r.patch_id AND t.a = r.b
),
-- of every piece of a boundary, all loops but the first
joined AS (
    SELECT model_id, count(DISTINCT (patch_id, a)) AS n_joined
    FROM reached
    WHERE b < a
    GROUP BY model_id
),
loops AS (
    SELECT model_id, sum(n_loops - 1)::BIGINT - coalesce(any_value(n_joined), 0) AS n_rings
    FROM patches
    LEFT JOIN joined USING (model_id)
    GROUP BY model_id
)
SELECT
    model_id,
    collection,
    name,
    n_shells,
    n_corners - n_edges + n_patches - n_rings AS euler,
    n_shells - euler // 2 AS genus
FROM models
JOIN edges USING (model_id)
JOIN loops USING (model_id)
WHERE is_closed
    AND NOT is_odd
    AND n_shells > 0
    AND euler % 2 = 0
    AND genus >= greatest($min_genus, 0)
ORDER BY genus DESC, collection, name
