"""LEGO structures: stud grid, bricks, grips, supports and the targets of skills."""
