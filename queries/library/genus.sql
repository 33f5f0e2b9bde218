-- Handles: the genus of each model
-- Topic: structure
--
-- How many handles (through openings) the surface of a closed model has, by the formula of Euler
-- and Poincare: V - E + F - H = 2 (S - G) with corners V, curves E (degenerate ones are points and
-- do not count), patches F, inner loops H, shells S and genus G. A ball has 0, a ring 1, a mug 1.
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
WITH edges AS (
    SELECT
        model_id,
        count(*) FILTER (kind <> 'degenerate') AS n_edges,
        bool_or(kind IN ('nonmanifold', 'free')) AS is_odd
    FROM curves
    GROUP BY model_id
),
loops AS (
    SELECT model_id, sum(n_loops - 1)::BIGINT AS n_inner
    FROM patches
    GROUP BY model_id
)
SELECT
    model_id,
    collection,
    name,
    n_shells,
    n_corners - n_edges + n_patches - n_inner AS euler,
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
