-- Round holes: one row for each, whatever number of patches its wall is made of.
--
-- The wall is one or more concave cylinders with the same axis and radius that touch along the
-- axis and together go round it once. What is at its ends tells the kind.
--
-- model_id, part_id : the part
-- hole_id   : number of the hole in its model, from 0
-- radius    : radius (mm)
-- depth     : extent of the wall along the axis (mm)
-- kind      : through (no end has an inner edge), blind (a bottom closes it) or stepped (it goes
--             on behind an inner edge: the wide part of a counterbore, a rounded bottom)
-- axis      : unit direction of the axis; its first component that is not zero is positive
-- foot      : the point of the axis nearest to the origin (mm)
-- low, high : where the wall begins and ends along the axis, from the foot (mm)
-- patches   : patch_ids of the wall, ascending
WITH walls AS (
    SELECT
        *,
        low_v + t AS low,
        high_v + t AS high,
        {'x': l.x - t * d.x, 'y': l.y - t * d.y, 'z': l.z - t * d.z} AS foot
    FROM (
        SELECT
            *,
            d.x * l.x + d.y * l.y + d.z * l.z AS t,
            least(turn * v_min, turn * v_max) AS low_v,
            greatest(turn * v_min, turn * v_max) AS high_v
        FROM (
            SELECT
                model_id, part_id, patch_id, radius, u_min, u_max, v_min, v_max, x_axis, turn,
                location AS l,
                {'x': turn * z_axis.x, 'y': turn * z_axis.y, 'z': turn * z_axis.z} AS d
            FROM (
                SELECT
                    *,
                    sign(CASE
                        WHEN abs(z_axis.x) > 1e-6 THEN z_axis.x
                        WHEN abs(z_axis.y) > 1e-6 THEN z_axis.y
                        ELSE z_axis.z
                    END) AS turn
                FROM patches
                WHERE type = 'Cylinder'
                    -- concave; axes may be left-handed, and then du x dv points inwards
                    AND reversed <> (
                        (x_axis.y * y_axis.z - x_axis.z * y_axis.y) * z_axis.x
                        + (x_axis.z * y_axis.x - x_axis.x * y_axis.z) * z_axis.y
                        + (x_axis.x * y_axis.y - x_axis.y * y_axis.x) * z_axis.z < 0
                    )
            )
        )
    )
),
-- equal up to rounding: the grid is shifted so that round numbers are not on its borders
keyed AS (
    SELECT
        *,
        [
            floor(radius * 1e3 + 0.382),
            floor(d.x * 1e5 + 0.382), floor(d.y * 1e5 + 0.382), floor(d.z * 1e5 + 0.382),
            floor(foot.x * 1e3 + 0.382), floor(foot.y * 1e3 + 0.382), floor(foot.z * 1e3 + 0.382)
        ] AS axis_key
    FROM walls
),
-- walls on one axis that do not touch are different holes
marked AS (
    SELECT
        *,
        low > 1e-3 + max(high) OVER (
            PARTITION BY model_id, part_id, axis_key ORDER BY low, high, patch_id
            ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
        ) AS is_new
    FROM keyed
),
numbered AS (
    SELECT
        *,
        count(*) FILTER (is_new) OVER (
            PARTITION BY model_id, part_id, axis_key ORDER BY low, high, patch_id
            ROWS UNBOUNDED PRECEDING
        ) AS place
    FROM marked
),
arcs AS (
    SELECT
        model_id, part_id, axis_key, place,
        max(u_max - u_min) AS sweep,
        any_value(radius ORDER BY patch_id) AS radius,
        any_value(d ORDER BY patch_id) AS axis,
        any_value(foot ORDER BY patch_id) AS foot,
        min(low) AS low,
        max(high) AS high,
        list(patch_id) AS patches
    FROM numbered
    GROUP BY
        model_id, part_id, axis_key, place,
        round(u_min, 3), round(x_axis.x, 3), round(x_axis.y, 3), round(x_axis.z, 3)
),
tubes AS (
    SELECT
        *,
        row_number() OVER (PARTITION BY model_id ORDER BY list_min(patches))::INTEGER - 1 AS hole_id
    FROM (
        SELECT
            model_id,
            part_id,
            any_value(radius) AS radius,
            any_value(axis) AS axis,
            any_value(foot) AS foot,
            min(low) AS low,
            max(high) AS high,
            list_sort(flatten(list(patches))) AS patches
        FROM arcs
        GROUP BY model_id, part_id, axis_key, place
        HAVING sum(sweep) > 2 * pi() - 1e-2
    )
),
sides AS (
    SELECT model_id, left_patch AS patch_id, right_patch AS other, convexity
    FROM curves WHERE left_patch <> right_patch
    UNION ALL
    SELECT model_id, right_patch, left_patch, convexity
    FROM curves WHERE left_patch <> right_patch
),
wall AS (SELECT model_id, hole_id, unnest(patches) AS patch_id FROM tubes),
inner_ends AS (
    SELECT DISTINCT w.model_id, w.hole_id, s.other
    FROM wall AS w
    JOIN sides AS s USING (model_id, patch_id)
    ANTI JOIN wall AS same
        ON same.model_id = w.model_id AND same.hole_id = w.hole_id AND same.patch_id = s.other
    LEFT JOIN fillets AS f ON f.model_id = w.model_id AND f.patch_id = s.other
    WHERE s.convexity = 'concave' OR f.is_concave
),
ends AS (
    -- a bottom borders on nothing but the wall
    SELECT model_id, hole_id, bool_or(is_bottom) AS has_bottom
    FROM (
        SELECT e.model_id, e.hole_id, bool_and(w.patch_id IS NOT NULL) AS is_bottom
        FROM inner_ends AS e
        JOIN sides AS s ON s.model_id = e.model_id AND s.patch_id = e.other
        LEFT JOIN wall AS w
            ON w.model_id = e.model_id AND w.hole_id = e.hole_id AND w.patch_id = s.other
        GROUP BY e.model_id, e.hole_id, e.other
    )
    GROUP BY model_id, hole_id
)
SELECT
    t.model_id,
    t.part_id,
    t.hole_id,
    t.radius,
    t.high - t.low AS depth,
    CASE WHEN e.has_bottom THEN 'blind' WHEN e.has_bottom IS NULL THEN 'through' ELSE 'stepped' END
        AS kind,
    t.axis,
    t.foot,
    t.low,
    t.high,
    t.patches
FROM tubes AS t
LEFT JOIN ends AS e USING (model_id, hole_id)
