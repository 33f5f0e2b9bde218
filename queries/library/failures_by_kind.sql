-- Failures by stage and kind
-- Topic: records
--
-- What went wrong during ingest. A fatal failure means that the input is not in models; after
-- others a later attempt succeeded, or the model has no mesh.
--
-- Columns:
--   stage: stage that failed
--   kind: stable code of the failure
--   fatal: the input is not in models
--   failures: how often
--   inputs: inputs concerned
--   seconds (s): time lost
--   example: name of one input
--   message: what was said about it
SELECT
    stage,
    kind,
    fatal,
    count(*) AS failures,
    count(DISTINCT model_id) AS inputs,
    sum(seconds) AS seconds,
    min(name) AS example,
    arg_min(message, name) AS message
FROM failures
GROUP BY stage, kind, fatal
ORDER BY failures DESC, stage, kind, fatal
