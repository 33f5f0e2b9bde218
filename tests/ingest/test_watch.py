import pytest

from breplake.ingest import watch
from breplake.ingest.watch import HangDetector


def surface(number, algorithm="Frontal-Delaunay"):
    return f"Info    : [ 40%] Meshing surface {number} (Torus, {algorithm})"


def crossing(count):
    return f"Info    : [100%] :-( There are {count} intersections in the 1D mesh (curves 1 2)"


def judged(lines):
    detector = HangDetector()
    return [reason for line, second in lines if (reason := detector.feed(line, second))]


def test_intersections_that_double_are_a_hang_and_the_surface_is_named():
    counts = [12, 25, 46, 90, 170]
    found = judged([(surface(7), 0), *((crossing(n), 1 + i) for i, n in enumerate(counts))])
    assert found
    assert "surface 7" in found[0]


@pytest.mark.parametrize(
    "counts",
    [
        [300, 280, 120, 30],  # many but fewer each time
        [2, 4, 8, 16, 20, 22],  # growing but few
        [90, 95, 100, 104],  # hardly growing
    ],
)
def test_intersections_that_may_yet_be_resolved_are_not(counts):
    assert not judged([(surface(7), 0), *((crossing(n), 1 + i) for i, n in enumerate(counts))])


def test_a_new_surface_starts_counting_anew():
    lines = []
    for number in range(5):
        lines += [(surface(number), number), (crossing(40), number), (crossing(80), number)]
    assert not judged(lines)


def test_the_slow_algorithm_may_take_so_much_in_all_and_no_more():
    lines = [(surface(i, "MeshAdapt" if i % 2 else "Frontal-Delaunay"), 8.0 * i) for i in range(9)]
    found = judged(lines)
    assert found
    assert "surface 5" in found[0]  # 8 s each on the surfaces 1, 3 and 5
    assert not judged([(surface(i), 100.0 * i) for i in range(9)])


def test_silence_counts():
    detector = HangDetector()
    detector.feed(surface(1, "MeshAdapt"), 0.0)
    assert detector.tick(watch.SLOW_SECONDS - 1) is None
    assert detector.tick(watch.SLOW_SECONDS + 1) is not None
