"""How far results are from those of others, and from the truth."""
