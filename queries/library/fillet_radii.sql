-- Radii of fillets
-- Topic: features
--
-- Which radii designers use: fillets and rounds by radius over all models.
--
-- Parameters:
--   min_models BIGINT = 1: models in which a radius must occur
-- Columns:
--   radius (mm): radius, rounded to a micrometre
--   fillets: fillets (concave) of that radius
--   rounds: rounds (convex) of that radius
--   models: models that have one
SELECT
    round(radius, 3) AS radius,
    count(*) FILTER (is_concave) AS fillets,
    count(*) FILTER (NOT is_concave) AS rounds,
    count(DISTINCT model_id) AS models
FROM fillets
GROUP BY ALL
HAVING models >= $min_models
ORDER BY count(*) DESC, radius
