-- Pairs of patches that meet at a curve: one row for each curve and each pair of its patches
-- (a nonmanifold curve has several pairs; seams and boundaries have none).
--
-- model_id         : the model
-- patch_a, patch_b : the two patches, patch_a < patch_b
-- curve_id         : the curve between them
-- curve_type       : Line, Circle ... Other
-- kind             : sharp, smooth, nonmanifold ...
-- angle_min, angle_max : range of the angle between the outward normals along the curve (rad)
-- convexity        : convex, concave or mixed, of smooth curves too; null where the normals nowhere
--                    differ by more than 0.5 degrees or the patches' orientations disagree
-- sharp            : sharp by ABC's rule
-- length           : arc length of the curve (mm)
WITH uses AS (SELECT DISTINCT model_id, curve_id, patch_id FROM coedges)
SELECT
    a.model_id,
    a.patch_id AS patch_a,
    b.patch_id AS patch_b,
    a.curve_id,
    c.type AS curve_type,
    c.kind,
    c.angle_min,
    c.angle_max,
    c.convexity,
    c.sharp,
    c.length
FROM uses AS a
JOIN uses AS b
    ON a.model_id = b.model_id AND a.curve_id = b.curve_id AND a.patch_id < b.patch_id
JOIN curves AS c ON a.model_id = c.model_id AND a.curve_id = c.curve_id
