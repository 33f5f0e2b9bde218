"""Gmsh as a guest in our process."""

from __future__ import annotations

import os

import pytest

from breplake.ingest.kernel import gmsh_session


def test_a_closed_pipe_stays_an_error_and_does_not_end_the_process():
    with gmsh_session():
        pass
    read, write = os.pipe()
    os.close(read)
    with pytest.raises(BrokenPipeError):
        os.write(write, b"x")
    os.close(write)
