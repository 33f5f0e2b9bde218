"""Several processes write one lake, and some are killed: nothing is lost, nothing is left over."""

from __future__ import annotations

import random
import subprocess
import sys
import time
from datetime import timedelta
from pathlib import Path

import pytest

from breplake.schema.gc import collect
from breplake.schema.lake import LakeStore

STEADY = 200

WRITER = """
import hashlib, sys
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import FileEntry

path, worker, times, lock = sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4] == "lock"
store = LakeStore.open_or_create(path)


def write(name):
    entry = FileEntry("corners", name, 1, 0, "", 1, 2)
    data = hashlib.sha256(name.encode()).digest() * 2000
    target = store.root / entry.path
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.open("wb") as file:
        for at in range(0, len(data), 8000):
            file.write(data[at : at + 8000])
            file.flush()
    return entry._replace(bytes=len(data), sha256=hashlib.sha256(data).hexdigest())


def commit(i):
    entries = [write(f"{worker}-{i}-{part}") for part in range(2)]
    return store.commit(entries, message="m", tools={}, config_hash="c").number


for i in range(times):
    if lock:
        with store.lock():
            number = commit(i)
    else:
        number = commit(i)
    print(number, i, flush=True)
"""


def start(path: Path, worker: str, times: int, lock: str = "") -> subprocess.Popen[str]:
    command = [sys.executable, "-P", "-c", WRITER, str(path), worker, str(times), lock]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def names_of(store: LakeStore) -> set[str]:
    head = store.head()
    return {entry.shard for entry in head.files} if head else set()


def test_two_processes_commit_a_hundred_times_each(tmp_path):
    running = [start(tmp_path / "lake", str(worker), 100) for worker in range(2)]
    output = [process.communicate(timeout=120)[0] for process in running]
    assert [process.returncode for process in running] == [0, 0]
    numbers = sorted(int(line.split()[0]) for text in output for line in text.splitlines())
    assert numbers == list(range(1, 201))
    store = LakeStore.open(tmp_path / "lake")
    assert store.numbers() == numbers
    assert names_of(store) == {f"{w}-{i}-{p}" for w in range(2) for i in range(100) for p in (0, 1)}
    for number in numbers:  # each commit added its own two files to what was there
        snapshot = store.snapshot(number)
        assert (snapshot.parent, len(snapshot.files)) == (number - 1 or None, 2 * number)
    assert store.verify(store.snapshot()) == []
    assert collect(store, grace=timedelta(0)).garbage == []


@pytest.mark.parametrize("seed", range(3))
def test_kills_at_random_moments(tmp_path, seed):
    """Two writers, one of them killed again and again, and the garbage collected in between."""
    root, chance = tmp_path / "lake", random.Random(seed)
    told: set[str] = set()
    steady = start(root, "steady", STEADY, "lock")
    for turn in range(6):
        victim = start(root, f"victim{turn}", 1000, "lock")
        line = victim.stdout.readline().split()  # at work, and not starting any more
        told.add(f"victim{turn}-{line[1]}")
        time.sleep(chance.uniform(0, 0.08))
        victim.kill()
        rest = victim.communicate()[0].splitlines(keepends=True)
        told |= {f"victim{turn}-{text.split()[1]}" for text in rest if text.endswith("\n")}
        store = LakeStore.open(root)
        assert store.verify(store.snapshot()) == []
        collect(store, grace=timedelta(0))  # the steady writer is in the middle of its work
    told |= {
        f"steady-{line.split()[1]}" for line in steady.communicate(timeout=120)[0].splitlines()
    }
    assert steady.returncode == 0
    assert len([name for name in told if name.startswith("steady")]) == STEADY
    store = LakeStore.open(root)
    names = names_of(store)
    assert {f"{name}-{part}" for name in told for part in (0, 1)} <= names
    head = store.snapshot()
    assert head.number == len(store.numbers()) == len(names) / 2
    assert store.verify(head) == []
    collect(store, grace=timedelta(0))
    assert {path.stem for path in root.glob("tables/corners/*")} == names
    assert not list(root.rglob("*#*"))
