"""What becomes of sources, as the tests of them ask for it."""

from __future__ import annotations

from breplake.ingest.sources.resolve import Sources


def find(*sources, limits=None, **options):
    """The inputs that sources hold."""
    with Sources.open(limits) as opened:
        return opened.find(sources, **options)


def kinds(inputs):
    """What is wrong with inputs, by their names."""
    return {item.name: item.failure.kind for item in inputs if item.failure}
