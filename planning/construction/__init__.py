"""Long-horizon construction by heterogeneous mobile teams, after Hartmann et al."""
