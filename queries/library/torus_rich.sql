-- Models with many tori
-- Topic: features
--
-- Tori are rare, and models with dozens of them are rarer. The default asks for more than 30.
--
-- Parameters:
--   more_than BIGINT = 30: tori that a model must exceed
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   n_torus: its torus patches
--   n_patches: all its patches
--   share: share of tori among them
SELECT model_id, collection, name, n_torus, n_patches, n_torus / n_patches AS share
FROM models
WHERE n_torus > $more_than
ORDER BY n_torus DESC, collection, name
