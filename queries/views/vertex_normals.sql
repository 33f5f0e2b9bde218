-- One averaged unit normal for each mesh vertex: the normalised sum of the unit normals that
-- the vertex has on its patches, as the normal estimation benchmark of the ABC paper takes it.
-- Null where no patch defines a normal or where they cancel out.
--
-- model_id, vertex_id : the mesh vertex
-- x, y, z             : position (mm)
-- nx, ny, nz          : averaged unit normal
-- n_patches           : patches that the vertex lies on, its rows in vertices
SELECT
    model_id,
    vertex_id,
    x,
    y,
    z,
    sum_x / length AS nx,
    sum_y / length AS ny,
    sum_z / length AS nz,
    n_patches
FROM (
    SELECT
        *,
        -- a shorter sum is rounding, not a direction
        CASE WHEN hypot > 1e-9 THEN hypot END AS length
    FROM (
        SELECT *, sqrt(sum_x * sum_x + sum_y * sum_y + sum_z * sum_z) AS hypot
        FROM (
            SELECT
                model_id,
                vertex_id,
                max(x) FILTER (is_primary) AS x,
                max(y) FILTER (is_primary) AS y,
                max(z) FILTER (is_primary) AS z,
                fsum(nx) AS sum_x,
                fsum(ny) AS sum_y,
                fsum(nz) AS sum_z,
                count(*)::INTEGER AS n_patches
            FROM vertices
            GROUP BY model_id, vertex_id
        )
    )
)
