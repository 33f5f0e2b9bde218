-- Degrees and sizes of B-spline patches
-- Topic: statistics
--
-- What splines a lake has, for code that must evaluate them: degrees, weights and control points.
--
-- Columns:
--   low_degree: smaller of the degrees in u and v
--   high_degree: larger of the two
--   rational: has weights
--   patches: B-spline patches of these degrees
--   models: models that have one
--   median_poles: median number of control points
--   most_poles: largest number of control points
SELECT
    least(u_degree, v_degree) AS low_degree,
    greatest(u_degree, v_degree) AS high_degree,
    u_rational OR v_rational AS rational,
    count(*) AS patches,
    count(DISTINCT model_id) AS models,
    median(len(poles) * len(poles[1])) AS median_poles,
    max(len(poles) * len(poles[1])) AS most_poles
FROM patches
WHERE type = 'BSpline'
GROUP BY ALL
ORDER BY patches DESC, low_degree, high_degree, rational
