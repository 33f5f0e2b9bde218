"""How fast breplake is, as ratios."""
