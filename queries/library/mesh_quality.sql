-- Outliers of mesh quality
-- Topic: quality
--
-- Meshes that an algorithm may trip over, and models without one.
--
-- Parameters:
--   min_angle DOUBLE = 0.02 (rad): smallest triangle angle that is still good
--   min_regular DOUBLE = 0.8: share of angles between 30 and 90 degrees that is still good
-- Columns:
--   model_id: the model
--   collection: its collection
--   name: its name
--   faults: what is wrong: no mesh, angle, irregular, holes (of a closed model), nonmanifold, long
--     edges, tessellation
--   mesh_kind: how the mesh was made
--   n_faces: its triangles
--   min_angle (rad): smallest triangle angle
--   regular_angles: share of angles between 30 and 90 degrees
--   edge_ratio: longest edge as a multiple of what was asked for
--   n_nonmanifold_edges: mesh edges with three or more triangles
--   mesh_note: why the mesh is not as asked for
SELECT
    model_id,
    collection,
    name,
    list_filter([
        if(mesh_kind IS NULL, 'no mesh', NULL),
        if(min_angle < $min_angle, 'angle', NULL),
        if(regular_angles < $min_regular, 'irregular', NULL),
        if(is_closed AND n_boundary_edges > 0, 'holes', NULL),
        if(n_nonmanifold_edges > 0, 'nonmanifold', NULL),
        if(max_edge > mesh_limit * (1 + 1e-6), 'long edges', NULL),
        if(mesh_kind = 'tessellation', 'tessellation', NULL)
    ], lambda fault: fault IS NOT NULL) AS faults,
    mesh_kind,
    n_faces,
    min_angle,
    regular_angles,
    max_edge / nullif(mesh_limit, 0) AS edge_ratio,
    n_nonmanifold_edges,
    mesh_note
FROM models
WHERE len(faults) > 0
ORDER BY len(faults) DESC, regular_angles, collection, name
