"""What the fork server imports once, so that each worker starts in milliseconds.

Listed in ``ingest.pool``; importing it anywhere else loads Open CASCADE and Gmsh.
"""

import gmsh
import OCP

import breplake.ingest.worker

__all__ = ["OCP", "breplake", "gmsh"]
