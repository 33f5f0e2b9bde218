"""Models from the original file formats of the ABC dataset: OBJ, features and stats YAML.

`model.import_model` turns the files of one model, given by kind, into tables; `beside.Beside`
takes those that belong to a STEP file.
"""
