"""What a killed worker leaves behind is whole."""

from __future__ import annotations

import pytest

pytest.importorskip("OCP")

from breplake.ingest.spool import Spool
from breplake.schema.tables import COEDGES


def coedges(n):
    row = {
        "model_id": 1,
        "patch_id": 0,
        "loop": 0,
        "curve_id": 0,
        "reversed": False,
        "internal": False,
    }
    return {"coedges": COEDGES.from_rows(row | {"place": i} for i in range(n))}


def test_the_fullest_record_counts(tmp_path):
    spool = Spool(tmp_path)
    assert not spool.has_record
    with pytest.raises(FileNotFoundError):
        spool.read_model()
    spool.write("brep", coedges(1), lambda: {"level": "brep"})
    assert spool.read_model() == {"level": "brep"}
    spool.write("mesh", coedges(2), lambda: {"level": "mesh"})
    assert spool.read_model() == {"level": "mesh"}
    assert spool.read_table("coedges").num_rows == 2
    assert spool.read_table("faces") is None


def test_a_kill_before_the_last_byte_leaves_the_record_before(tmp_path):
    spool = Spool(tmp_path)
    spool.write("brep", coedges(1), lambda: {"level": "brep"})

    def killed():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        spool.write("mesh", coedges(2), killed)
    assert spool.read_model() == {"level": "brep"}
    assert spool.read_table("coedges").num_rows == 1


def test_stage_is_remembered(tmp_path):
    spool = Spool(tmp_path)
    assert spool.stage == ("read", "")
    spool.mark("mesh:uniform")
    assert spool.stage == ("mesh", "uniform")
