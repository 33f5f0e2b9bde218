-- Histogram of curves per model
-- Topic: statistics
--
-- The paper's histogram of complexity. Like the paper's it is truncated at the right side: the last
-- row holds all models with more. The paper
-- remarks that many models have fewer than 100 curves.
--
-- Parameters:
--   bin BIGINT = 20: width of a bin, at least 1
--   last BIGINT = 600: where the histogram is truncated
-- Columns:
--   low: least number of curves in the bin
--   high: greatest number in the bin; null in the last row
--   models: models in the bin
--   share: their share of all models
--   cumulative: share of the models in this bin and all before it
WITH bins AS (
    SELECT
        unnest(range(0, $last, if($bin < 1, error('bin must be at least 1'), $bin)) || [$last])
            AS low
),
counted AS (
    SELECT if(n_curves < $last, n_curves - n_curves % $bin, $last) AS low, count(*) AS models
    FROM models
    GROUP BY ALL
)
SELECT
    low,
    if(low < $last, least(low + $bin, $last) - 1, NULL) AS high,
    coalesce(models, 0) AS models,
    coalesce(models, 0) / sum(models) OVER () AS share,
    coalesce(sum(models) OVER (ORDER BY low) / sum(models) OVER (), 0) AS cumulative
FROM bins
LEFT JOIN counted USING (low)
ORDER BY low
