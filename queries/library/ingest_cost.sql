-- What ingest costs, by stage
-- Topic: records
--
-- CPU seconds of the workers. The stages add up to less than the total, which includes attempts
-- that failed; kernel is the part of all stages that is spent inside Open CASCADE and Gmsh.
--
-- Columns:
--   stage: load, brep, mesh, truth, write, kernel or total
--   models: models
--   total (s): CPU time of all models
--   share: share of the CPU time of all models
--   mean (s): mean of a model
--   median (s): median of a model
--   p95 (s): what 95 % of the models do not exceed
--   most (s): the most expensive model
SELECT
    stage,
    count(*) AS models,
    sum(seconds) AS total,
    sum(seconds) / nullif(max(sum(seconds)) FILTER (stage = 'total') OVER (), 0) AS share,
    avg(seconds) AS mean,
    median(seconds) AS median,
    quantile_cont(seconds, 0.95) AS p95,
    max(seconds) AS most
FROM (
    SELECT
        unnest(['load', 'brep', 'mesh', 'truth', 'write', 'kernel', 'total']) AS stage,
        unnest([cpu_load, cpu_brep, cpu_mesh, cpu_truth, cpu_write, cpu_kernel, cpu_total])
            AS seconds,
        unnest(range(7)) AS place
    FROM models
)
GROUP BY stage, place
ORDER BY place
