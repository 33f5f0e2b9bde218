"""What the fork server imports once, so that each worker starts in milliseconds.

Listed in ``ingest.processes``; importing it anywhere else loads Open CASCADE and Gmsh, and ties the
process to its parent.
"""

import gmsh
import OCP
import pebble.pool
import pyarrow

import breplake.ingest.pool
import breplake.ingest.worker
from breplake.ingest.orphans import die_with_parent

__all__ = ["OCP", "breplake", "gmsh", "pebble", "pyarrow"]

# At its first array pyarrow imports pandas, if that is installed: a third of a second.
pyarrow.array([0])

# The fork server, and with it the workers, is not to outlive a run that was killed.
die_with_parent()
