"""CAD file → exact rows, mesh and ground truth → shard → commit.

The only package that imports Open CASCADE (``OCP``) and Gmsh, and it does so inside the
worker processes that handle one model each.
"""
