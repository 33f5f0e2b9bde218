"""Trimmed patches in their parameter planes: what is inside, how large it is, samples of it."""
