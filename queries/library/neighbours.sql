-- Which surface types meet, and at what angle
-- Topic: statistics
--
-- Pairs of patches that meet at a curve, by the types of both. The angle is that between the
-- outward normals: 0 where the patches run into each other smoothly, pi/2 at the edge of a box.
--
-- Columns:
--   type_a: type of one patch, alphabetically not after type_b
--   type_b: type of the other
--   pairs: curves at which such patches meet
--   share: their share of all curves between two patches
--   length (mm): length of these curves
--   mean_angle (rad): mean angle between the normals, weighted with length
--   smooth: pairs whose normals differ by less than 18.2 degrees somewhere along the curve, as
--     by the paper's rule
--   convex: other pairs, that meet at an outer edge
--   concave: other pairs, that meet at an inner edge
--   mixed: other pairs, whose edge is convex here and concave there
--   unknown: pairs at nonmanifold curves, and where the patches' orientations disagree
SELECT
    least(p.type, q.type) AS type_a,
    greatest(p.type, q.type) AS type_b,
    count(*) AS pairs,
    count(*) / sum(count(*)) OVER () AS share,
    sum(a.length) AS length,
    sum((a.angle_min + a.angle_max) / 2 * a.length)
        / nullif(sum(a.length) FILTER (a.angle_max IS NOT NULL), 0) AS mean_angle,
    count(*) FILTER (a.kind = 'smooth') AS smooth,
    count(*) FILTER (a.kind = 'sharp' AND a.convexity = 'convex') AS convex,
    count(*) FILTER (a.kind = 'sharp' AND a.convexity = 'concave') AS concave,
    count(*) FILTER (a.kind = 'sharp' AND a.convexity = 'mixed') AS mixed,
    pairs - smooth - convex - concave - mixed AS unknown
FROM adjacency AS a
JOIN patches AS p ON p.model_id = a.model_id AND p.patch_id = a.patch_a
JOIN patches AS q ON q.model_id = a.model_id AND q.patch_id = a.patch_b
GROUP BY type_a, type_b
ORDER BY pairs DESC, type_a, type_b
