-- Sizes of models in quantiles
-- Topic: statistics
--
-- How large models are by every measure: counts of the B-Rep and of the mesh, dimensions, bytes.
--
-- Columns:
--   measure: column of models
--   models: models for which it is defined
--   least: smallest value
--   p25: first quartile
--   median: median
--   mean: mean
--   p75: third quartile
--   p95: value that 95 % of the models do not exceed
--   most: largest value
--   total: sum over all models
SELECT
    measure,
    count(*) AS models,
    min(value) AS least,
    quantile_cont(value, 0.25) AS p25,
    quantile_cont(value, 0.5) AS median,
    avg(value) AS mean,
    quantile_cont(value, 0.75) AS p75,
    quantile_cont(value, 0.95) AS p95,
    max(value) AS most,
    sum(value) AS total
FROM (
    SELECT
        unnest([
            'n_parts', 'n_patches', 'n_curves', 'n_corners', 'n_sharp_curves',
            'n_vertices', 'n_faces', 'diagonal', 'area', 'volume', 'bytes'
        ]) AS measure,
        unnest([
            n_parts, n_patches, n_curves, n_corners, n_sharp_curves,
            n_vertices, n_faces, diagonal, area, volume, bytes
        ]::DOUBLE[]) AS value,
        unnest(range(11)) AS place
    FROM models
)
WHERE value IS NOT NULL
GROUP BY measure, place
ORDER BY place
