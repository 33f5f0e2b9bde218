-- Length units that the files declare
-- Topic: records
--
-- Models by unit, with their sizes after conversion to millimetres: a unit that was declared
-- wrongly shows as models a thousand times too large or too small.
--
-- Columns:
--   length_unit: unit as the file declares it; null if it declares none
--   scale_to_mm (mm): length of one such unit
--   models: models that declare it
--   least_diagonal (mm): smallest diagonal of a bounding box among them
--   median_diagonal (mm): median diagonal
--   most_diagonal (mm): largest diagonal
SELECT
    length_unit,
    scale_to_mm,
    count(*) AS models,
    min(diagonal) AS least_diagonal,
    median(diagonal) AS median_diagonal,
    max(diagonal) AS most_diagonal
FROM models
GROUP BY length_unit, scale_to_mm
ORDER BY models DESC, length_unit, scale_to_mm
