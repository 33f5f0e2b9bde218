-- Distribution of curve types
-- Topic: statistics
--
-- The paper's figure of curve types over all models. Seams and degenerate curves count, as they do
-- in the paper's files. The paper has no names for parabolas and hyperbolas and calls them Other.
--
-- Columns:
--   type: curve type; all seven are listed
--   paper_type: what the paper calls it
--   curves: curves of that type
--   share: their share of all curves
--   models: models that have at least one
--   model_share: their share of all models
--   sharp: how many of the curves are sharp
--   length (mm): length of these curves
--   length_share: their share of the length of all curves
WITH types (place, type, paper_type) AS (
    VALUES
    (0, 'Line', 'Line'), (1, 'Circle', 'Circle'), (2, 'Ellipse', 'Ellipse'),
    (3, 'BSpline', 'BSpline'), (4, 'Parabola', 'Other'), (5, 'Hyperbola', 'Other'),
    (6, 'Other', 'Other')
),
counted AS (
    SELECT
        type,
        count(*) AS curves,
        count(DISTINCT model_id) AS models,
        count(*) FILTER (sharp) AS sharp,
        sum(length) AS length
    FROM curves
    GROUP BY type
)
SELECT
    type,
    paper_type,
    coalesce(curves, 0) AS curves,
    coalesce(curves, 0) / sum(curves) OVER () AS share,
    coalesce(models, 0) AS models,
    coalesce(models, 0) / (SELECT nullif(count(*), 0) FROM models) AS model_share,
    coalesce(sharp, 0) AS sharp,
    coalesce(length, 0) AS length,
    coalesce(length, 0) / sum(length) OVER () AS length_share
FROM types
LEFT JOIN counted USING (type)
ORDER BY place
