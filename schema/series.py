"""Functions with their derivatives: products, quotients and unit vectors of them.

A series holds a function of one or two parameters and its partial derivatives, by how often
each parameter is derived: ``{(0, 0): p, (1, 0): p_u, (0, 1): p_v, (2, 0): p_uu, ...}``. All
follow from Leibniz' rule, which is exact: no series is cut off, only as many derivatives are
known as are given.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product as grid
from math import comb, prod
from typing import TypeAlias

from breplake.schema.namespace import Array, dot, namespace

__all__ = ["Index", "Series", "indices", "multiply", "quotient", "unit"]

Index: TypeAlias = tuple[int, ...]
Series: TypeAlias = dict[Index, Array]


@cache
def indices(variables: int, order: int) -> tuple[Index, ...]:
    """Return how often each of the variables is derived, the lower orders first.

    For two variables: (0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2) and so on.
    """
    every = grid(range(order, -1, -1), repeat=variables)
    return tuple(sorted((i for i in every if sum(i) <= order), key=sum))


@cache
def _terms(index: Index) -> tuple[tuple[int, Index, Index], ...]:
    """Leibniz: (f g)^(index) is the sum of factor f^(lower) g^(upper); f itself comes last."""
    lowers = list(grid(*(range(k + 1) for k in index)))
    return tuple(
        (
            prod(comb(k, i) for k, i in zip(index, lower, strict=True)),
            lower,
            tuple(k - i for k, i in zip(index, lower, strict=True)),
        )
        for lower in lowers
    )


def _times(factor: int, value: Array) -> Array:
    return value if factor == 1 else factor * value


def multiply(f: Series, g: Series, rule: Callable[[Array, Array], Array], order: int) -> Series:
    """Return the product of two series up to `order`.

    Parameters
    ----------
    f, g : Series
        With all derivatives up to `order`.
    rule : callable
        The product: of numbers, dot or cross.
    order : int
        Derivatives wanted.
    """
    variables = len(next(iter(f)))
    found: Series = {}
    for index in indices(variables, order):
        (factor, a, b), *rest = _terms(index)
        total = _times(factor, rule(f[a], g[b]))
        for factor, a, b in rest:
            total = total + _times(factor, rule(f[a], g[b]))
        found[index] = total
    return found


def quotient(vectors: Series, numbers: Series) -> Series:
    """Divide vectors ``(dim, n)`` by numbers ``(n,)``, of which the first must not be zero."""
    found: Series = {}
    inverse = 1 / next(iter(numbers.values()))
    for index, vector in vectors.items():
        rest = vector
        for factor, lower, upper in _terms(index)[:-1]:
            rest = rest - _times(factor, numbers[upper]) * found[lower]
        found[index] = rest * inverse
    return found


def unit(vectors: Series, order: int) -> Series:
    """Divide vectors ``(dim, n)`` by their length; NaN where it is zero."""
    square = multiply(vectors, vectors, dot, order)
    zero = next(iter(square))
    xp = namespace(square[zero])
    defined = square[zero] > 0
    length: Series = {zero: xp.sqrt(xp.where(defined, square[zero], 1.0))}
    for index, value in square.items():
        if index == zero:
            continue
        rest = value
        for factor, lower, upper in _terms(index)[1:-1]:
            rest = rest - _times(factor, length[lower] * length[upper])
        length[index] = rest / (2 * length[zero])
    found = quotient({k: v for k, v in vectors.items() if sum(k) <= order}, length)
    return {k: xp.where(defined, v, xp.nan) for k, v in found.items()}
