"""What becomes of a model is its own doing: broken pools and killed servers are not."""

import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing import forkserver

import pytest

pytest.importorskip("pebble")

from breplake.ingest.inputs import find_inputs
from breplake.ingest.pool import run_models
from breplake.ingest.samples import write_samples
from breplake.ingest.settings import Settings
from breplake.ingest.spool import Spool

NAMES = ["ring_o", "base_plate_mm", "hinge", "mug"]


def test_a_killed_fork_server_costs_no_model(tmp_path):
    write_samples(tmp_path / "in", NAMES)
    spools = {}

    def spool(item):
        spools[item.name] = Spool(tmp_path / item.name)
        return spools[item.name]

    def kill_while_one_is_meshed():
        server = forkserver._forkserver
        end = time.monotonic() + 60
        while time.monotonic() < end:
            if any(s.folder.exists() and s.stage[0] == "mesh" for s in list(spools.values())):
                os.kill(server._forkserver_pid, signal.SIGKILL)
                return
            time.sleep(0.005)

    killer = threading.Thread(target=kill_while_one_is_meshed)
    killer.start()
    inputs = find_inputs([tmp_path / "in"])
    results = list(run_models(inputs, Settings(max_edge=0.05), 2, spool))
    killer.join()
    assert sorted(r.input.name for r in results) == sorted(NAMES)
    assert [r.failures for r in results] == [[]] * len(NAMES)
    assert all(r.spool.read_model()["mesh_kind"] for r in results)


def test_a_script_needs_no_guard(tmp_path):
    """Its workers do not run it again, as those of multiprocessing do."""
    write_samples(tmp_path / "in", ["ring_o"])
    script = tmp_path / "script.py"
    script.write_text(
        "print('top level')\n"
        "from breplake.ingest.run import ingest\n"
        f"found = ingest([{str(tmp_path / 'in')!r}], {str(tmp_path / 'lake')!r}, jobs=1)\n"
        "print(found.n_models, found.n_fatal)\n"
    )
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.splitlines() == ["top level", "1 0"]
