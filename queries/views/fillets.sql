-- Patches that round an edge with one radius: one row for each.
--
-- Such a patch is a cylinder or torus of less than half a turn around its own axis or tube that
-- runs into different surfaces on both sides of the rolling ball's way without an edge (within 0.02
-- rad), or a part of a sphere where three of them meet. Bends of sheet metal look the same and are
-- listed too. Fillets that a file stores as splines, and those of changing radius, are not.
--
-- model_id, patch_id, part_id : the patch
-- type      : Cylinder (along a straight edge), Torus (round edge) or Sphere (corner)
-- radius    : radius of the rolling ball (mm)
-- is_concave : fills an inner edge (a fillet); otherwise it takes an outer edge away (a round)
-- sweep     : angle of the arc across the edge (rad); null for corners
-- area      : area of the patch (mm^2)
WITH rolled AS (
    SELECT
        model_id,
        patch_id,
        part_id,
        type,
        z_axis,
        area,
        coalesce(min_radius, radius) AS radius,
        CASE type WHEN 'Cylinder' THEN u_max - u_min WHEN 'Torus' THEN v_max - v_min END AS sweep,
        -- axes may be left-handed, and then du x dv points inwards
        reversed <> (
            (x_axis.y * y_axis.z - x_axis.z * y_axis.y) * z_axis.x
            + (x_axis.z * y_axis.x - x_axis.x * y_axis.z) * z_axis.y
            + (x_axis.x * y_axis.y - x_axis.y * y_axis.x) * z_axis.z < 0
        ) AS is_concave
    FROM patches
    WHERE type IN ('Cylinder', 'Torus', 'Sphere')
),
sides AS (
    SELECT model_id, left_patch AS patch_id, right_patch AS other, type, z_axis
    FROM curves WHERE angle_max < 0.02 AND left_patch <> right_patch
    UNION ALL
    SELECT model_id, right_patch, left_patch, type, z_axis
    FROM curves WHERE angle_max < 0.02 AND left_patch <> right_patch
)
SELECT
    r.model_id,
    r.patch_id,
    any_value(r.part_id) AS part_id,
    any_value(r.type) AS type,
    any_value(r.radius) AS radius,
    any_value(r.is_concave) AS is_concave,
    any_value(r.sweep) AS sweep,
    any_value(r.area) AS area
FROM rolled AS r
JOIN sides AS s ON r.model_id = s.model_id AND r.patch_id = s.patch_id
LEFT JOIN rolled AS o ON s.model_id = o.model_id AND s.other = o.patch_id
WHERE
    -- a full half turn is the end of a slot
    (r.sweep IS NULL OR r.sweep < pi() - 1e-3)
    -- the other half of the same surface is no other side
    AND NOT coalesce(
        o.type = r.type
        AND o.is_concave = r.is_concave
        AND abs(o.radius - r.radius) <= 1e-6 * r.radius,
        false
    )
    -- along the way of the ball: generators of the cylinder, parallels of the torus
    AND CASE r.type
        WHEN 'Cylinder' THEN s.type = 'Line'
        WHEN 'Torus' THEN s.type = 'Circle' AND abs(
            s.z_axis.x * r.z_axis.x + s.z_axis.y * r.z_axis.y + s.z_axis.z * r.z_axis.z
        ) > 1 - 1e-6
        ELSE o.type IS NOT NULL
    END
GROUP BY r.model_id, r.patch_id
HAVING count(DISTINCT s.other) >= if(any_value(r.type) = 'Sphere', 3, 2)
