"""Models from the original file formats of the ABC dataset: OBJ, features and stats YAML."""
