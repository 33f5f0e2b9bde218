-- Parts that an assembly has several times
-- Topic: structure
--
-- A bill of materials: parts of one model with equal volume and area, to five digits, are taken for
-- copies. Mirror images count as copies.
--
-- Parameters:
--   model VARCHAR = NULL: name of one model; all if NULL
--   min_copies BIGINT = 2: copies that a part must have
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   part_id: the first of the copies
--   part: name of that part in the file
--   copies: how many there are
--   volume (mm^3): volume of each; null if not a solid
--   area (mm^2): area of each
SELECT
    model_id,
    any_value(m.collection) AS collection,
    any_value(m.name) AS name,
    min(p.part_id) AS part_id,
    arg_min(coalesce(p.name, ''), p.part_id) AS part,
    count(*) AS copies,
    arg_min(p.volume, p.part_id) AS volume,
    arg_min(p.area, p.part_id) AS area
FROM parts AS p
JOIN models AS m USING (model_id)
WHERE $model IS NULL OR m.name = $model
GROUP BY model_id, p.kind, format('{:.4e}', p.volume), format('{:.4e}', p.area)
HAVING copies >= $min_copies
ORDER BY copies DESC, collection, name, part_id
