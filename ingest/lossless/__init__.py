"""The B-Rep as the kernel holds it, to the tables of ``schema.shape_tables`` and back."""
