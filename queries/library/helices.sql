-- Helices: threads, worms and springs
-- Topic: features
--
-- Curves that climb a cylinder steadily: in the parameter plane of the cylinder, whose axes are
-- angle and height, a helix is a straight slanted line. Models with many turns are threaded.
--
-- Parameters:
--   min_turns DOUBLE = 0.5: turns that the longest helix of a model must have
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   pitch (mm): rise of a turn, rounded to a micrometre
--   handed: right or left
--   helices: curves with that pitch
--   turns: turns of the longest of them; kernels cut helices where they cross a seam
--   all_turns: turns of all of them together
--   least_radius (mm): radius of the innermost
--   most_radius (mm): radius of the outermost
WITH sloped AS (
    SELECT
        model_id, pcurve_id, type, poles, poles[1].u AS u0, poles[1].v AS v0,
        if(type = 'Line', direction.u, (poles[-1].u - u0) / (knots[-1] - knots[1])) AS slope_u,
        if(type = 'Line', direction.v, (poles[-1].v - v0) / (knots[-1] - knots[1])) AS slope_v
    FROM pcurves
    WHERE type = 'Line' OR (type = 'BSpline' AND knots[-1] > knots[1])
),
-- how far poles are off the line from the first to the last, times its slope: splines that are
-- straight lines count too
bent AS (
    SELECT
        model_id, pcurve_id, slope_u, slope_v,
        if(type = 'Line', 0, list_max([
            abs((pole.u - u0) * slope_v - (pole.v - v0) * slope_u) FOR pole IN poles
        ])) AS bend
    FROM sloped
),
straight AS (
    FROM bent
    UNION ALL
    SELECT c.model_id, c.pcurve_id, b.slope_u, b.slope_v, b.bend
    FROM pcurves AS c
    JOIN bent AS b ON b.model_id = c.model_id AND b.pcurve_id = c.basis
    WHERE c.type = 'Trimmed'
),
on_cylinders AS (
    SELECT
        e.model_id, e.patch_id, e.curve_id, p.radius,
        s.slope_u * (e.t_max - e.t_min) AS du,
        s.slope_v * (e.t_max - e.t_min) AS dv,
        s.bend * (e.t_max - e.t_min) AS bend,
        (p.x_axis.y * p.y_axis.z - p.x_axis.z * p.y_axis.y) * p.z_axis.x
        + (p.x_axis.z * p.y_axis.x - p.x_axis.x * p.y_axis.z) * p.z_axis.y
        + (p.x_axis.x * p.y_axis.y - p.x_axis.y * p.y_axis.x) * p.z_axis.z < 0 AS left_axes
    FROM coedges AS e
    JOIN patches AS p USING (model_id, patch_id)
    JOIN straight AS s ON s.model_id = e.model_id AND s.pcurve_id = e.pcurve
    WHERE p.type = 'Cylinder'
),
-- angle u and height v that the curve covers, once where it lies between two patches of a cylinder
covered AS (
    SELECT model_id, curve_id, radius, left_axes, du, dv
    FROM on_cylinders
    WHERE
        -- neither a circle nor a straight line
        abs(dv) > 1e-3 * radius * abs(du) AND radius * abs(du) > 1e-3 * abs(dv)
        AND bend * radius <= 1e-3 * (radius * radius * du * du + dv * dv)
    QUALIFY row_number() OVER (PARTITION BY model_id, curve_id ORDER BY patch_id, abs(du) DESC) = 1
)
SELECT
    model_id,
    any_value(m.collection) AS collection,
    any_value(m.name) AS name,
    round(2 * pi() * abs(dv / du), 3) AS pitch,
    if((dv / du < 0) <> left_axes, 'left', 'right') AS handed,
    count(DISTINCT curve_id) AS helices,
    max(abs(du)) / (2 * pi()) AS turns,
    sum(abs(du)) / (2 * pi()) AS all_turns,
    min(radius) AS least_radius,
    max(radius) AS most_radius
FROM covered
JOIN models AS m USING (model_id)
GROUP BY model_id, pitch, handed
HAVING turns >= $min_turns
ORDER BY all_turns DESC, collection, name, pitch
