-- Clusters of duplicates
-- Topic: structure
--
-- Models with the same fingerprint: the same shape, maybe moved or turned. Splits are made by
-- cluster, so that no copy of a training model is tested on.
--
-- Parameters:
--   min_models BIGINT = 2: models that a cluster must have
-- Columns:
--   duplicate_group: the cluster
--   models: models in it
--   collections: collections they come from
--   n_patches: patches of each
--   bytes (byte): size of their files together
--   names: their names, at most ten
SELECT
    duplicate_group,
    count(*) AS models,
    count(DISTINCT collection) AS collections,
    any_value(n_patches) AS n_patches,
    sum(bytes)::BIGINT AS bytes,
    list(name ORDER BY name)[:10] AS names
FROM models
GROUP BY duplicate_group
HAVING models >= $min_models
ORDER BY models DESC, duplicate_group
