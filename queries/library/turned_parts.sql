-- Parts that a lathe can make
-- Topic: features
--
-- How much of a part's area is turned: on cylinders, cones, tori and surfaces of revolution about
-- the part's main axis, on spheres centred on it, and on planes whose outer loop is a circle about
-- it. Bolt holes and keyways lower the share.
--
-- Parameters:
--   min_share DOUBLE = 0.95: least share of turned area
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   part_id: the part
--   turned_area (mm^2): area on turned patches
--   area (mm^2): area of the part
--   share: share of turned area
WITH surfaces AS (
    SELECT
        model_id, part_id, patch_id, type, area, location, z_axis,
        z_axis.x * location.x + z_axis.y * location.y + z_axis.z * location.z AS t
    FROM patches
    WHERE z_axis IS NOT NULL AND location IS NOT NULL
),
-- the grid is shifted so that round numbers are not on its borders
axes AS (
    SELECT
        model_id, part_id, any_value(location) AS location, any_value(z_axis) AS axis,
        sum(area) AS area
    FROM surfaces
    WHERE type IN ('Cylinder', 'Cone', 'Torus', 'Revolution')
    GROUP BY
        model_id, part_id,
        floor(abs(z_axis.x) * 1e5 + 0.382), floor(abs(z_axis.y) * 1e5 + 0.382),
        floor(abs(z_axis.z) * 1e5 + 0.382),
        floor((location.x - t * z_axis.x) * 1e3 + 0.382),
        floor((location.y - t * z_axis.y) * 1e3 + 0.382),
        floor((location.z - t * z_axis.z) * 1e3 + 0.382)
),
main_axes AS (
    SELECT model_id, part_id, arg_max(location, area) AS location, arg_max(axis, area) AS axis
    FROM axes
    GROUP BY model_id, part_id
),
-- distance of centres from the main axis, and whether directions agree
placed AS (
    SELECT
        *,
        abs(axis.x * z_axis.x + axis.y * z_axis.y + axis.z * z_axis.z) > 1 - 1e-9 AS is_parallel,
        sqrt(
            pow(y * axis.z - z * axis.y, 2)
            + pow(z * axis.x - x * axis.z, 2)
            + pow(x * axis.y - y * axis.x, 2)
        ) < 1e-3 AS is_centred
    FROM (
        SELECT
            model_id, part_id, patch_id, type, area, z_axis, m.location AS origin, m.axis AS axis,
            s.location.x - m.location.x AS x,
            s.location.y - m.location.y AS y,
            s.location.z - m.location.z AS z
        FROM surfaces AS s
        JOIN main_axes AS m USING (model_id, part_id)
    )
),
outlines AS MATERIALIZED (
    SELECT model_id, e.patch_id, c.type, c.location AS centre
    FROM coedges AS e
    JOIN curves AS c USING (model_id, curve_id)
    WHERE e.loop = 0
),
discs AS (
    SELECT p.model_id, p.patch_id
    FROM placed AS p
    JOIN outlines AS o USING (model_id, patch_id)
    WHERE p.type = 'Plane' AND p.is_parallel
    GROUP BY p.model_id, p.patch_id
    HAVING bool_and(
        o.type = 'Circle' AND sqrt(
            pow((o.centre.y - origin.y) * axis.z - (o.centre.z - origin.z) * axis.y, 2)
            + pow((o.centre.z - origin.z) * axis.x - (o.centre.x - origin.x) * axis.z, 2)
            + pow((o.centre.x - origin.x) * axis.y - (o.centre.y - origin.y) * axis.x, 2)
        ) < 1e-3
    )
),
turned AS (
    SELECT model_id, part_id, sum(area) AS turned_area
    FROM placed
    LEFT JOIN (SELECT *, true AS is_disc FROM discs) USING (model_id, patch_id)
    WHERE CASE type
        WHEN 'Plane' THEN is_disc
        WHEN 'Sphere' THEN is_centred
        ELSE is_parallel AND is_centred
    END
    GROUP BY model_id, part_id
)
SELECT
    model_id,
    m.collection,
    m.name,
    part_id,
    t.turned_area,
    p.area,
    t.turned_area / p.area AS share
FROM turned AS t
JOIN parts AS p USING (model_id, part_id)
JOIN models AS m USING (model_id)
WHERE p.area > 0 AND share >= $min_share
ORDER BY share DESC, m.collection, m.name, part_id
