-- Counterbored holes
-- Topic: features
--
-- Two holes of one part on one axis that touch, the wider of them stepped: room for the head of a
-- screw, or a bearing seat with a shoulder.
--
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   part_id: the part
--   radius (mm): radius of the narrow hole
--   depth (mm): depth of the narrow hole
--   kind: kind of the narrow hole
--   head_radius (mm): radius of the wide hole
--   head_depth (mm): depth of the wide hole
SELECT
    model_id,
    m.collection,
    m.name,
    part_id,
    n.radius,
    n.depth,
    n.kind,
    w.radius AS head_radius,
    w.depth AS head_depth
FROM holes AS n
JOIN holes AS w USING (model_id, part_id)
JOIN models AS m USING (model_id)
WHERE w.kind = 'stepped'
    AND w.radius > n.radius
    AND abs(w.foot.x - n.foot.x) < 1e-3
    AND abs(w.foot.y - n.foot.y) < 1e-3
    AND abs(w.foot.z - n.foot.z) < 1e-3
    AND abs(w.axis.x * n.axis.x + w.axis.y * n.axis.y + w.axis.z * n.axis.z) > 1 - 1e-9
    AND (abs(w.low - n.high) < 1e-3 OR abs(n.low - w.high) < 1e-3)
ORDER BY m.collection, m.name, part_id, n.hole_id, w.hole_id
