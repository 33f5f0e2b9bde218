-- Owners and licences
-- Topic: records
--
-- Under which terms models may be used, and whose they are. A null licence means that the source
-- states none: ask before you publish such a model.
--
-- Columns:
--   licence: licence as the source states it
--   owner: owner as the source states it
--   collections: collections with such models
--   models: models
--   bytes (byte): size of their files
--   example: one of them
SELECT
    licence,
    owner,
    count(DISTINCT collection) AS collections,
    count(*) AS models,
    sum(bytes)::BIGINT AS bytes,
    min(name) AS example
FROM models
GROUP BY licence, owner
ORDER BY models DESC, licence, owner
